//! The first lines with the daemon, and the last lines with the keys.

use super::super::picture::{Loss, Picture, Reading};
use super::super::request::{Notice, Tone};
use super::super::view::{Page, View};
use super::text::{BANNER, banner, dim, duration, shortened, warning, wrapped};
use motord_terminal::number;
use ratatui::style::Stylize;
use ratatui::text::{Line, Span};
use std::time::Instant;

const LIVE_KEYS: [(&str, &str); 3] = [("SPACE", "e-stop"), ("d", "disable"), ("r", "reset")];
const REPLAY_KEYS: [(&str, &str); 2] = [("SPACE", "pause, go on"), ("n", "next cycle")];
/// The keys of both.
const KEYS: [(&str, &str); 6] =
    [("?", "help"), ("q", "quit"), ("Tab", "page"), ("s", "sort"), ("/", "filter"), ("← → c", "curves")];

/// Returns the lines about the daemon and its troubles, after the name of a recording.
pub(super) fn head(picture: &Picture, width: usize) -> Vec<Line<'static>> {
    let recording = picture.replay.iter().flat_map(|name| wrapped(&format!(" {name}"), width, 1));
    let mut lines: Vec<Line<'static>> =
        recording.map(|line| Span::from(format!("{line:width$}")).bold().reversed().into()).collect();
    lines.extend(picture.reading.iter().map(|reading| daemon(reading, width)));
    if let Some(loss) = &picture.loss {
        lines.extend(lost(loss, width));
    }
    let Some(reading) = &picture.reading else { return lines };
    let alarms = [
        (reading.report.shutting_down, "The daemon is shutting down."),
        (reading.report.config_changed, "The configuration file has changed: restart the daemon to use it."),
    ];
    lines.extend(alarms.iter().filter(|(is_on, _)| *is_on).map(|(_, text)| Line::from(warning(*text))));
    lines
}

/// Returns the line about the daemon. A small terminal omits the version.
fn daemon(reading: &Reading, width: usize) -> Line<'static> {
    let report = &reading.report;
    let mut line =
        Line::from(vec![Span::from(format!(" {} ", report.instance)).bold().reversed(), " ".into()]);
    if report.emergency_stop {
        line.push_span(Span::styled(" EMERGENCY STOP ", BANNER));
        line.push_span(" ");
    }
    if !report.realtime {
        line.push_span(warning("not real-time  "));
    }
    if report.overruns > 0 {
        line.push_span(warning(format!("{} missed ticks  ", report.overruns)));
    }
    let digits = if report.rate_hz.fract() == 0.0 { 0 } else { 1 };
    let rate = number(Some(report.rate_hz), digits);
    let version = format!("motord {} ({}) {rate} Hz", report.version, report.pid);
    if line.width() + version.chars().count() <= width {
        line.push_span(version);
    }
    line
}

/// Returns a banner: the state below is old.
fn lost(loss: &Loss, width: usize) -> Vec<Line<'static>> {
    let text = format!(" NO CONTACT for {}: {}", duration(loss.lasting), loss.reason);
    let lines = wrapped(&text, width, 1).into_iter();
    lines.map(|line| banner(&line, width)).collect()
}

/// Returns the outcome of the last request, and the keys.
pub(super) fn foot(view: &View, picture: &Picture, notice: &Notice, width: usize) -> Vec<Line<'static>> {
    let mut lines = Vec::new();
    for (tone, text) in notice.texts(Instant::now()) {
        let wrapped = wrapped(&text, width, 1).into_iter();
        lines.extend(wrapped.map(|line| match tone {
            Tone::Plain => Line::from(line),
            Tone::Warning => warning(line).into(),
            Tone::Alarm => banner(&line, width),
        }));
    }
    lines.push(if view.is_filtering {
        let text = format!("filter: {}▏", view.filter);
        let stops = if picture.replay.is_none() { ", SPACE stops" } else { "" };
        vec![Span::from(text).bold(), dim(format!("  Enter keeps it, Esc clears it{stops}"))].into()
    } else {
        keys(view, picture, width)
    });
    lines
}

fn keys(view: &View, picture: &Picture, width: usize) -> Line<'static> {
    let mut line = Line::default();
    let is_live = picture.replay.is_none();
    let keys = if is_live { &LIVE_KEYS[..] } else { &REPLAY_KEYS };
    for &(key, name) in keys.iter().chain(&KEYS) {
        let style =
            if key == "SPACE" && is_live { Span::styled(key, BANNER) } else { Span::from(key).bold() };
        let entry = [style, Span::from(format!(" {name}  "))];
        let entry_width: usize = entry.iter().map(Span::width).sum();
        if line.width() + entry_width <= width + 2 {
            line.spans.extend(entry);
        }
    }
    let choice = choice(view, picture);
    if !choice.is_empty() && line.width() < width {
        line.push_span(dim(shortened(&choice, width - line.width())));
    }
    line
}

/// Returns the group that d and r act on, if not all, and the filter.
fn choice(view: &View, picture: &Picture) -> String {
    let group = view.group.zip(picture.reading.as_ref());
    let group =
        group.and_then(|(group, reading)| Some(format!("g {} ", reading.robot.groups.get(group)?.name)));
    let filter = (!view.filter.is_empty() && view.page == Page::Joints).then(|| format!("/{}", view.filter));
    group.into_iter().chain(filter).collect()
}
