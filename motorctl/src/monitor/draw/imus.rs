//! The IMUs: a summary below the joints, and the artificial horizon of one right of them, where a
//! large terminal has free columns.

use super::super::picture::Reading;
use super::text::{ALARM, alarm, bold, flowed, warning};
use crate::imu_report::ImuReport;
use motord_terminal::number;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::Widget;
use ratatui::widgets::canvas::{Canvas, Line as Stroke};

/// Its columns, and its least and most rows, with the title.
const WIDTH: u16 = 42;
const ROWS: [u16; 2] = [7, 13];
/// Columns left of it that belong to the joints.
const LEFT: u16 = 88;
/// From the middle to the upper edge, °.
const PITCH_MAX: f64 = 30.0;

/// Draws the first IMU into the free columns of `area`, the rows of the joints; nothing where they
/// are not free.
pub(super) fn draw_horizon(buffer: &mut Buffer, area: Rect, imus: &[ImuReport]) {
    let Some(imu) = imus.first() else { return };
    if area.width < LEFT + WIDTH || area.height < ROWS[0] {
        return;
    }
    let inset = Rect { x: area.right() - WIDTH, width: WIDTH, height: area.height.min(ROWS[1]), ..area };
    if inset.positions().any(|position| buffer[position].symbol() != " ") {
        return;
    }
    buffer.set_line(inset.x, inset.y, &title(imu), inset.width);
    let angles = imu.roll_pitch_yaw.filter(|_| !imu.lost);
    let view = Rect { y: inset.y + 1, height: inset.height - 1, ..inset };
    picture(view, angles.map(|[roll, pitch, _]| [roll, pitch].map(f64::from))).render(view, buffer);
}

fn title(imu: &ImuReport) -> Line<'static> {
    let name = bold(imu.name.clone());
    if imu.lost {
        return Line::from(vec![name, Span::styled(" lost", ALARM)]);
    }
    let degrees = |angle: f32| number(Some(f64::from(angle).to_degrees()), 1);
    let [roll, pitch, yaw] =
        imu.roll_pitch_yaw.map_or_else(|| ["-"; 3].map(str::to_owned), |angles| angles.map(degrees));
    Line::from(vec![name, Span::from(format!(" roll {roll}° pitch {pitch}° yaw {yaw}°"))])
}

/// The horizon as seen from the robot towards its nose: above the mark with the nose down, and its
/// right end up with the right side down. The short stroke points to the ground. `angles` are roll
/// and pitch, rad.
fn picture(
    inset: Rect,
    angles: Option<[f64; 2]>,
) -> Canvas<'static, impl Fn(&mut ratatui::widgets::canvas::Context<'_>)> {
    // A cell has 2 x 4 dots.
    let wide = PITCH_MAX * f64::from(inset.width) / (2.0 * f64::from(inset.height));
    Canvas::default().marker(Marker::Braille).x_bounds([-wide, wide]).y_bounds([-PITCH_MAX, PITCH_MAX]).paint(
        move |canvas| {
            if let Some([roll, pitch]) = angles {
                let (sin, cos) = roll.sin_cos();
                // Beyond the edge it stays at the edge, so that the ground is always in the
                // picture.
                let shift = pitch.to_degrees().clamp(-0.9 * PITCH_MAX, 0.9 * PITCH_MAX);
                let middle = [-shift * sin, shift * cos];
                let at = |along: f64, down: f64| {
                    [middle[0] + along * cos + down * sin, middle[1] + along * sin - down * cos]
                };
                canvas.draw(&stroke(at(-3.0 * wide, 0.0), at(3.0 * wide, 0.0)));
                canvas.draw(&stroke(at(0.0, 0.0), at(0.0, PITCH_MAX / 4.0)));
            }
            canvas.print(-wide / 3.0, 0.0, "──");
            canvas.print(0.0, 0.0, "○");
            canvas.print(wide / 3.0 - wide / f64::from(inset.width), 0.0, "──");
        },
    )
}

fn stroke([x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) -> Stroke {
    Stroke { x1, y1, x2, y2, color: Color::Reset }
}

/// Returns at most `most` lines; lost IMUs first. None for a robot without IMUs.
pub(super) fn lines(reading: &Reading, width: usize, most: usize) -> Vec<Line<'static>> {
    let mut imus: Vec<&ImuReport> = reading.report.imus.iter().collect();
    imus.sort_by_key(|imu| (!imu.lost, imu.contradictions.is_empty()));
    if imus.is_empty() {
        return Vec::new();
    }
    flowed(imus.into_iter().map(entry).collect(), width, most, |count| format!("and {count} more IMUs"))
}

fn entry(imu: &ImuReport) -> Line<'static> {
    let mut line = Line::from(vec![bold(imu.name.clone()), Span::raw(" ")]);
    if imu.lost {
        line.push_span(alarm("lost"));
        line.push_span(Span::raw(" "));
    }
    let [roll, pitch, yaw] = [0, 1, 2]
        .map(|axis| number(imu.roll_pitch_yaw.map(|angles| f64::from(angles[axis]).to_degrees()), 1));
    let (rate, age) = (number(imu.turning(), 2), number(imu.age_us.map(|age| age / 1e3), 1));
    if !imu.contradictions.is_empty() {
        line.push_span(alarm(format!("contradicts gravity: {} ", imu.contradictions.join(", "))));
    }
    // The age first: the end of the line may not fit.
    line.push_span(Span::raw(format!("{age} ms old, roll {roll}° pitch {pitch}° yaw {yaw}° {rate} rad/s")));
    for (name, count) in [("missing", imu.missing), ("rejected", imu.rejected)] {
        if count > 0 {
            line.push_span(warning(format!(" {name} {count}")));
        }
    }
    line
}
