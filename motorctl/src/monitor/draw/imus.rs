//! The IMUs: a summary below the joints.

use super::super::picture::Reading;
use super::text::{alarm, bold, flowed, warning};
use crate::imu_report::ImuReport;
use motord_terminal::number;
use ratatui::text::{Line, Span};

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
