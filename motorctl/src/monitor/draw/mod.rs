//! The pages of the monitor. Each part depends only on the picture, so that a test can draw any
//! robot.

mod buses;
mod curves;
mod frame;
mod groups;
mod imus;
mod joints;
mod latencies;
mod text;
mod troubles;

use super::picture::{Picture, Reading};
use super::request::Notice;
use super::view::{Page, View};
use motord_terminal::is_harmless;
use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Line;
use std::ops::Range;
use text::{bold, dim};

/// Rows that stops and troubles leave to the rest of a small screen: the first line, four of the
/// joints, two of buses and latencies, and the keys.
const OTHERS: usize = 8;

/// The style of values that are no longer received: without the marks of living ones.
const OLD: Style = Style::reset().dim();

/// Smallest terminal, in rows and columns. A smaller one shows a note.
const HEIGHT_MIN: u16 = 8;
const WIDTH_MIN: u16 = 40;

const LIVE_HELP: &[&str] = &[
    "SPACE     emergency stop: damps and stops every motor now",
    "d         disable: damps, then stops the chosen groups",
    "r, y      reset: clears the cause of a stop; nothing moves",
    "g         choose the group for d and r",
];

const REPLAY_HELP: &[&str] = &[
    "This is a recording: no key reaches a robot.",
    "SPACE     pause, and go on",
    "n         the next cycle",
];

const HELP: &[&str] = &[
    "Tab 1 2 3 joints, buses, latencies",
    "s S       another order of the joints",
    "/         show only joints, buses or modes with this text",
    "↑ ↓ PgUp PgDn Home End: scroll.   q: quit",
    "← → c C   details of a joint; its curves, if there is room",
    "+ - l     their time; a scale that includes the limits",
    "position  the mark stands within the limits of the joint",
    "torque    N·m, and its part of the limit",
    "age       age of the state, in cycles",
    "notes     faults, limits that acted, counts of bad replies",
    "bus %     part of the time that the bus is busy, at most",
    "latency   since the start; the curve: the last readings",
];

/// Draws everything, and records in `view` what fitted.
pub(super) fn draw(frame: &mut Frame<'_>, picture: &Picture, view: &mut View, notice: &Notice) {
    let area = frame.area();
    let Rows { lines, joints, curves, values } =
        lines(area.width.into(), area.height.into(), picture, view, notice);
    let buffer = frame.buffer_mut();
    for (line, y) in lines.iter().zip(area.y..area.bottom()) {
        buffer.set_line(area.x, y, line, area.width);
    }
    if let (Some(part_area), Some(reading)) = (part(area, joints), &picture.reading) {
        imus::draw_horizon(buffer, part_area, &reading.report.imus);
    }
    if let Some(part_area) = part(area, curves) {
        curves::draw(buffer, part_area, picture, &view.selection);
    }
    if let Some(part_area) = part(area, values).filter(|_| picture.loss.is_some()) {
        buffer.set_style(part_area, OLD);
    }
    scrub(buffer, area);
    if view.is_colourless {
        remove_colours(buffer, area);
    }
}

/// Returns some rows of an area; `None` for no row.
fn part(area: Rect, rows: Range<usize>) -> Option<Rect> {
    let height = rows.len() as u16;
    area.rows()
        .nth(rows.start)
        .filter(|_| height > 0)
        .map(|first| Rect { height, ..first }.intersection(area))
}

/// Shows cells with a background in reverse video instead, and removes all colours.
fn remove_colours(buffer: &mut Buffer, area: Rect) {
    for position in area.positions() {
        let cell = &mut buffer[position];
        if cell.bg != Color::Reset {
            cell.modifier.insert(Modifier::REVERSED);
        }
        (cell.fg, cell.bg) = (Color::Reset, Color::Reset);
    }
}

/// Replaces control characters and characters that reorder text by `?`: names come from other
/// processes.
fn scrub(buffer: &mut Buffer, area: Rect) {
    for position in area.positions() {
        let cell = &mut buffer[position];
        if !cell.symbol().chars().all(is_harmless) {
            cell.set_symbol("?");
        }
    }
}

/// The rows of the screen or of a page, and those of them that the joints, the curves and all
/// values take.
#[derive(Default)]
struct Rows {
    lines: Vec<Line<'static>>,
    joints: Range<usize>,
    curves: Range<usize>,
    values: Range<usize>,
}

impl Rows {
    /// The same rows below `above` others.
    fn below(self, above: usize) -> Self {
        let lower = |rows: Range<usize>| rows.start + above..rows.end + above;
        Self {
            lines: self.lines,
            joints: lower(self.joints),
            curves: lower(self.curves),
            values: lower(self.values),
        }
    }
}

impl From<Vec<Line<'static>>> for Rows {
    fn from(lines: Vec<Line<'static>>) -> Self {
        Self { lines, ..Self::default() }
    }
}

fn lines(width: usize, height: usize, picture: &Picture, view: &mut View, notice: &Notice) -> Rows {
    let mut rows = Rows::default();
    let mut lines = frame::head(picture, width);
    let mut foot = frame::foot(view, picture, notice, width);
    let mut left = height.saturating_sub(lines.len() + foot.len());
    if width < WIDTH_MIN.into() || height < HEIGHT_MIN.into() {
        lines.push(dim(format!("too small: {WIDTH_MIN}x{HEIGHT_MIN} or more")).into());
        left = left.saturating_sub(1);
    }
    if let Some(reading) = &picture.reading {
        let above = groups::lines(reading, width, (height / 2).max(height.saturating_sub(OTHERS)).min(left));
        left = left.saturating_sub(above.len());
        let begin = lines.len();
        lines.extend(above);
        rows = page(reading, picture, view, width, left).below(lines.len());
        lines.append(&mut rows.lines);
        rows.values = if view.page == Page::Help { 0..0 } else { begin..lines.len() };
    } else if view.page == Page::Help {
        lines.extend(help(picture));
    }
    lines.resize(height.saturating_sub(foot.len()), Line::default());
    lines.append(&mut foot);
    Rows { lines, ..rows }
}

fn help(picture: &Picture) -> impl Iterator<Item = Line<'static>> {
    let keys = if picture.replay.is_some() { REPLAY_HELP } else { LIVE_HELP };
    keys.iter().chain(HELP).map(|line| Line::from(*line))
}

/// Returns the chosen page in `height` lines.
fn page(reading: &Reading, picture: &Picture, view: &mut View, width: usize, height: usize) -> Rows {
    let table = match view.page {
        Page::Joints => return joints_page(reading, picture, view, width, height),
        Page::Buses => buses::table(reading, picture),
        Page::Latencies => latencies::table(reading),
        Page::Help => (bold(" keys and columns").into(), help(picture).collect()),
    };
    scrolled(view, height, table).into()
}

/// Returns the joints, then free rows with curves, then IMUs, buses and latencies in at most half
/// of the lines.
fn joints_page(reading: &Reading, picture: &Picture, view: &mut View, width: usize, height: usize) -> Rows {
    let mut below = imus::lines(reading, width, (height / 6).max(1));
    below.extend(buses::lines(reading, picture, width, (height / 5).max(2)));
    below.extend(latencies::lines(reading, picture, width, if height < 10 { 1 } else { 2 }));
    below.truncate(height / 2);
    let above = height - below.len();
    let shown = joints::shown(reading, view);
    let free = above.saturating_sub(shown.len() + 1);
    let rows = if curves::are_shown(width, free) { free } else { 0 };
    view.selection.know_rows(shown.iter().map(|joint| joint.name.clone()).collect());
    let cursor = shown.iter().find(|joint| Some(joint.name.as_str()) == view.selection.cursor());
    let mut details =
        cursor.filter(|_| rows == 0).map_or_else(Vec::new, |joint| joints::details(joint, width));
    details.truncate(above / 2);
    let table = joints::table(reading, &shown, view, width);
    let mut lines = scrolled(view, above - details.len(), table);
    lines.append(&mut details);
    let (joints, curves) = (0..lines.len(), lines.len()..lines.len() + rows);
    lines.resize(above, Line::default());
    lines.append(&mut below);
    Rows { lines, joints, curves, values: 0..0 }
}

/// Returns a heading and the rows that fit below it. The heading shows the row numbers if there are
/// more.
fn scrolled(
    view: &mut View,
    height: usize,
    (mut heading, rows): (Line<'static>, Vec<Line<'static>>),
) -> Vec<Line<'static>> {
    let fit = height.saturating_sub(1);
    view.fit(rows.len(), fit);
    if view.scroll_max > 0 {
        let last = (view.scroll + fit).min(rows.len());
        heading.push_span(dim(format!(" {}-{last}/{}", view.scroll + 1, rows.len())));
    }
    let rows = rows.into_iter().skip(view.scroll).take(fit);
    std::iter::once(heading).chain(rows).take(height).collect()
}
