//! The groups: phase and owner; for each stop its cause, its age, and the commands that end it.

use super::super::picture::Reading;
use super::text::{alarm, bold, dim, duration, flowed, warning, wrapped};
use super::troubles;
use crate::report::{GroupReport, StopReport};
use motord_client::{GroupHistory, Phase, Process};
use motord_terminal::number;
use ratatui::text::{Line, Span};

/// Returns at most `height` lines. Where they do not fit, the causes of the stops stay, and a note
/// states how many lines are left out.
pub(super) fn lines(reading: &Reading, width: usize, height: usize) -> Vec<Line<'static>> {
    let stops = stops(reading);
    let causes: Vec<Line<'static>> = stops.iter().flat_map(|stop| stop.cause(width)).collect();
    let mut remedies = remedies(&stops, reading, width);
    let mut troubles = troubles::lines(reading, width);
    let mut groups = groups(reading, width);
    if groups.len() + causes.len() + troubles.len() + remedies.len() > height {
        groups = short_groups(reading, width);
    }
    let free = height.saturating_sub(groups.len() + causes.len());
    let wanted = troubles.len() + remedies.len();
    let mut note = None;
    if wanted > free {
        let free = free.saturating_sub(1);
        let most = (free / 2).max(free.saturating_sub(troubles.len()));
        remedies.truncate(most);
        troubles.truncate(free - remedies.len());
        let motorctl = crate::advice::motorctl(&reading.report.instance);
        note = Some(alarm(format!("  and {} more lines: `{motorctl} status`", wanted - free)).into());
    }
    groups.into_iter().chain(causes).chain(troubles).chain(remedies).chain(note).take(height).collect()
}

fn groups(reading: &Reading, width: usize) -> Vec<Line<'static>> {
    let groups = &reading.report.groups;
    let names = groups.iter().map(|group| group.name.chars().count()).max().unwrap_or(0);
    let entries =
        |(index, group)| flowed(entries(group, &reading.history(index), names), width, 3, |_| String::new());
    groups.iter().enumerate().flat_map(entries).collect()
}

/// Returns what is to be known of a group, the most important first.
fn entries(group: &GroupReport, history: &GroupHistory, names: usize) -> Vec<Line<'static>> {
    let GroupReport { name, phase, .. } = group;
    let mut first =
        Line::from(vec![bold(format!("{name:<names$}")), Span::raw("  "), phase_span(phase), "  ".into()]);
    first.spans.extend(owner(group, history));
    let age = group.setpoint_age_us.map(|age| format!("setpoint {} old", micros(age)).into());
    let late = group.is_often_late().then(|| warning(format!("{} late", group.late)).into());
    let rejected =
        group.rejected.iter().map(|(reason, count)| warning(format!("{count} rejected: {reason}")).into());
    [first].into_iter().chain(late).chain(rejected).chain(age).collect()
}

/// Returns name and phase of the groups.
fn short_groups(reading: &Reading, width: usize) -> Vec<Line<'static>> {
    let entry =
        |group: &GroupReport| Line::from(vec![bold(group.name.clone()), " ".into(), phase_span(group.phase)]);
    let entries = reading.report.groups.iter().map(entry).collect();
    flowed(entries, width, 2, |count| format!("and {count} more groups"))
}

/// Formats a time in the unit that keeps it short.
fn micros(time: f64) -> String {
    match time {
        1e6.. => format!("{} s", number(Some(time / 1e6), 1)),
        1e4.. => format!("{} ms", number(Some(time / 1e3), 0)),
        _ => format!("{} µs", number(Some(time), 0)),
    }
}

fn phase_span(phase: &str) -> Span<'static> {
    let is_calm = phase == Phase::Disarmed.name() || phase == Phase::Active.name();
    if is_calm { bold(phase) } else { warning(phase) }
}

fn owner(group: &GroupReport, history: &GroupHistory) -> Vec<Span<'static>> {
    let name = |process: &Process| match process.program.as_str() {
        "" => format!("process {}", process.pid),
        program => format!("{program} ({})", process.pid),
    };
    match (group.lease, &history.owner) {
        (Some(_), Some(process)) => vec![Span::from(format!("owner {}", name(process)))],
        (Some(lease), None) => vec![Span::from(format!("owner lease {lease}"))],
        (None, Some(last)) => vec![warning("no owner"), dim(format!(", before {}", name(last)))],
        (None, None) => vec![dim("no owner")],
    }
}

/// Groups with the same cause, joint and first cause of their stops.
struct Stopped<'a> {
    groups: Vec<&'a str>,
    stop: &'a StopReport,
    since: Option<std::time::Duration>,
    /// True for every group of the robot.
    is_all: bool,
}

fn stops(reading: &Reading) -> Vec<Stopped<'_>> {
    let mut stops: Vec<Stopped<'_>> = Vec::new();
    for (index, group) in reading.report.groups.iter().enumerate() {
        let Some(stop) = &group.stop else { continue };
        let since = reading.history(index).stop_cycle.map(|cycle| reading.since(cycle));
        let is_same = |other: &&mut Stopped<'_>| {
            (other.stop.cause, &other.stop.joint, &other.stop.first) == (stop.cause, &stop.joint, &stop.first)
        };
        match stops.iter_mut().find(is_same) {
            Some(other) => other.groups.push(&group.name),
            None => stops.push(Stopped { groups: vec![&group.name], stop, since, is_all: false }),
        }
    }
    for stop in &mut stops {
        stop.is_all = stop.groups.len() > 1 && stop.groups.len() == reading.report.groups.len();
    }
    stops
}

impl Stopped<'_> {
    fn cause(&self, width: usize) -> Vec<Line<'static>> {
        let who = if self.is_all { "every group".to_owned() } else { self.groups.join(", ") };
        let since = self.since.map_or_else(String::new, |since| format!(" {} ago", duration(since)));
        let text = format!("STOPPED{since}, {who}: {}", self.stop.reason());
        wrapped(&text, width, 2).into_iter().map(|line| alarm(line).into()).collect()
    }

    /// Returns the lines to paste.
    fn resets(&self, motorctl: &str) -> Vec<String> {
        match self.is_all {
            true => vec![format!("{motorctl} reset")],
            false => self.groups.iter().map(|group| format!("{motorctl} reset {group}")).collect(),
        }
    }
}

/// Returns the advice of the stops, each sentence once, and the lines to paste. What a trouble
/// already advises is left out.
fn remedies(stops: &[Stopped<'_>], reading: &Reading, width: usize) -> Vec<Line<'static>> {
    let motorctl = crate::advice::motorctl(&reading.report.instance);
    let mut advised: Vec<(String, Vec<String>)> = Vec::new();
    for stop in stops {
        let is_known = troubles::advise(reading, stop.stop.cause);
        let remedy = if is_known { String::new() } else { format!("{}. ", stop.stop.steps.remedy) };
        let resets = stop.resets(&motorctl);
        match advised.iter_mut().find(|(known, _)| *known == remedy) {
            Some((_, others)) => others.extend(resets),
            None => advised.push((remedy, resets)),
        }
    }
    let lines = advised.into_iter().flat_map(|(remedy, resets)| {
        let text = wrapped(&format!("{remedy}Then paste, or press r:"), width.saturating_sub(2), 0);
        let text = text.into_iter().map(|line| Line::from(format!("  {line}")));
        text.chain(resets.into_iter().map(|reset| bold(format!("  {reset}")).into()))
    });
    lines.collect()
}
