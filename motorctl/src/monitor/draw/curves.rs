//! Curves of position, velocity and torque below the joints, where a large terminal has free rows.

use super::super::picture::{Picture, Reading};
use super::super::selection::Selection;
use super::super::trends::{APPLIED, Mark, Point, quantities};
use super::text::{bold, dim, flowed};
use motord_terminal::number;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Widget};

/// The style of the marks of stops and faults.
const MARK: Style = Style::new().bold();
/// The style of the applied position.
const APPLIED_STYLE: Style = Style::new().dim();
/// Smallest number of rows of a panel.
const ROWS: usize = 11;
/// Smallest width of three panels side by side, and of one.
const THREE_WIDE: usize = 96;
const ONE_WIDE: usize = 60;
/// Rows that name the marks.
const NAMES: usize = 2;
/// Smallest range of a panel, as a part of the range of the limits, or without limits.
const LEAST: f64 = 0.01;
/// A panel includes limits whose range is at most this many times that of the values.
const NEAR: f64 = 5.0;

/// Returns the number of panels side by side, and of joints, that fit `rows` rows; `None` for no
/// joint.
fn fit(width: usize, rows: usize) -> Option<(usize, usize)> {
    let panels = rows.saturating_sub(NAMES) / ROWS;
    let (columns, joints) = match width {
        0..ONE_WIDE => return None,
        ONE_WIDE..THREE_WIDE => (1, panels / 3),
        THREE_WIDE.. => (3, panels),
    };
    (joints > 0).then_some((columns, joints))
}

/// Returns whether curves of a joint fit.
pub(super) fn are_shown(width: usize, rows: usize) -> bool {
    fit(width, rows).is_some()
}

/// Draws the curves of the selected joints into `area`.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, picture: &Picture, selection: &Selection) {
    let Some(reading) = &picture.reading else { return };
    let Some((columns, most)) = fit(area.width.into(), area.height.into()) else { return };
    let index = |name: &&str| reading.robot.joints.iter().position(|joint| joint.name == **name);
    let joints: Vec<usize> = selection.shown(most).iter().filter_map(index).collect();
    let marks: Vec<(f64, &Mark)> =
        picture.trends.marks(&reading.robot, &joints, selection.seconds()).collect();
    let [panels, names] =
        area.layout(&Layout::vertical([Constraint::Fill(1), Constraint::Length(NAMES as u16)]));
    let rows = Layout::vertical(vec![Constraint::Fill(1); joints.len() * 3 / columns]).split(panels);
    let across = Layout::horizontal(vec![Constraint::Fill(1); columns]).spacing(1);
    let cells = rows.iter().flat_map(|row| across.split(*row).to_vec());
    let all = joints.iter().flat_map(|joint| (0..3).map(move |quantity| (*joint, quantity)));
    for ((joint, quantity), cell) in all.zip(cells) {
        Panel::new(picture, reading, selection, joint, quantity).draw(buffer, cell, &marks);
    }
    for (line, y) in name_lines(&marks, area.width.into()).iter().zip(names.rows()) {
        buffer.set_line(y.x, y.y, line, y.width);
    }
}

/// Returns the marks by name, the newest first.
fn name_lines(marks: &[(f64, &Mark)], width: usize) -> Vec<Line<'static>> {
    let entry = |(time, mark): &(f64, &Mark)| {
        let text = format!(" {} s ago: {}", number(Some(-time), 1), mark.text());
        Line::from(vec![letter(mark), Span::from(text)])
    };
    let entries = marks.iter().rev().map(entry).collect();
    flowed(entries, width, NAMES, |count| format!("and {count} more stops and faults"))
}

fn letter(mark: &Mark) -> Span<'static> {
    bold(mark.letter.to_string())
}

struct Panel {
    title: Line<'static>,
    parts: Vec<Vec<Point>>,
    /// The applied position; empty for the other quantities.
    applied: Vec<Vec<Point>>,
    limits: [f64; 2],
    seconds: f64,
    range: [f64; 2],
}

impl Panel {
    fn new(
        picture: &Picture,
        reading: &Reading,
        selection: &Selection,
        joint: usize,
        quantity: usize,
    ) -> Self {
        let description = &reading.robot.joints[joint];
        let (name, unit) = quantities().nth(quantity).unwrap_or_default();
        let bounds = &description.limits;
        let limits = match quantity {
            0 => bounds.position,
            1 => [-bounds.velocity, bounds.velocity],
            _ => [-bounds.torque, bounds.torque],
        };
        let limits = limits.map(f64::from);
        let seconds = selection.seconds();
        let parts = picture.trends.curve(joint, quantity, seconds);
        let applied = if quantity == 0 { picture.trends.curve(joint, APPLIED, seconds) } else { Vec::new() };
        let newest = parts.last().and_then(|part| part.last()).filter(|(time, _)| *time > -1.0);
        let value = number(newest.map(|(_, value)| *value), 2);
        let limits_text = limits.map(|limit| number(Some(limit), 2)).join(" to ");
        let values: Vec<f64> = parts.iter().chain(&applied).flatten().map(|(_, value)| *value).collect();
        let range = range(&values, limits, selection.has_limits);
        let is_on_scale = limits.iter().any(|limit| (range[0]..=range[1]).contains(limit));
        let key = if is_on_scale { "" } else { ", key l" };
        let grey = if applied.is_empty() { "" } else { ", grey: applied" };
        let title = vec![
            bold(format!("{} {name}", description.name)),
            Span::from(format!(" {value} {unit}")),
            dim(format!("  limits {limits_text}{key}{grey}")),
        ];
        Self { title: title.into(), parts, applied, limits, seconds, range }
    }

    fn draw(&self, buffer: &mut Buffer, cell: Rect, marks: &[(f64, &Mark)]) {
        let begin = -self.seconds;
        let [low, high] = self.range;
        let limits = self.limits.map(|limit| [(begin, limit), (0.0, limit)]);
        let lines: Vec<_> = marks.iter().map(|(time, _)| [(*time, low), (*time, high)]).collect();
        let letters: Vec<_> = marks.iter().map(|(time, mark)| (mark.letter, [(*time, high)])).collect();
        let mut data: Vec<Dataset<'_>> = Vec::new();
        data.extend(limits.iter().map(|limit| line(limit, Marker::Custom('┄'))));
        data.extend(lines.iter().map(|mark| line(mark, Marker::Custom('┊')).style(MARK)));
        data.extend(self.applied.iter().map(|part| line(part, Marker::Braille).style(APPLIED_STYLE)));
        data.extend(self.parts.iter().map(|part| line(part, Marker::Braille)));
        data.extend(letters.iter().map(|(letter, at)| line(at, Marker::Custom(*letter)).style(MARK)));
        let middle = f64::midpoint(low, high);
        let digits = digits(high - low);
        let times = [format!("-{} s", self.seconds), format!("-{}", self.seconds / 2.0), "0".to_owned()];
        Chart::new(data)
            .block(Block::new().title(self.title.clone()))
            .legend_position(None)
            .x_axis(Axis::default().bounds([begin, 0.0]).labels(times))
            .y_axis(
                Axis::default()
                    .bounds(self.range)
                    .labels([low, middle, high].map(|value| number(Some(value), digits))),
            )
            .render(cell, buffer);
    }
}

fn line(points: &[Point], marker: Marker) -> Dataset<'_> {
    Dataset::default().data(points).marker(marker).graph_type(GraphType::Line)
}

/// Returns the range of a panel: that of the values, and that of the limits if it is wanted or not
/// much larger.
fn range(values: &[f64], limits: [f64; 2], has_limits: bool) -> [f64; 2] {
    let limits = limits.map(|limit| Some(limit).filter(|limit| limit.is_finite()));
    let of_limits = extremes(limits.iter().copied().flatten());
    let least = of_limits.map_or(0.0, |[low, high]| LEAST * (high - low)).max(LEAST);
    let of_values = extremes(values.iter().copied());
    let [low, high] = match (of_values, of_limits) {
        (Some(values), Some(limits)) => {
            let [low, high] = [values[0].min(limits[0]), values[1].max(limits[1])];
            let is_near = high - low <= NEAR * (values[1] - values[0]);
            if has_limits || is_near { [low, high] } else { values }
        }
        (values, limits) => values.or(limits).unwrap_or([0.0, 1.0]),
    };
    let margin = (0.05 * (high - low)).max(least / 2.0);
    let step = step(high - low + 2.0 * margin);
    [((low - margin) / step).floor() * step, ((high + margin) / step).ceil() * step]
}

fn extremes(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    values.fold(None, |known, value| {
        let [low, high] = known.unwrap_or([value; 2]);
        Some([value.min(low), value.max(high)])
    })
}

/// Returns the step that the ends of an axis of this range are rounded to.
fn step(range: f64) -> f64 {
    10.0_f64.powf(range.log10().floor()) / 5.0
}

/// Returns the decimals of the ends of an axis and of its middle.
fn digits(range: f64) -> usize {
    (-step(range).log10().floor()).clamp(0.0, 6.0) as usize
}
