//! The groups: phase and owner; for each stop its cause, its age, and the commands that end it.

use super::super::picture::Reading;
use super::text::{alarm, bold, dim, duration, warning, wrapped};
use super::troubles;
use crate::report::{GroupReport, StopReport};
use motord_client::{GroupHistory, Phase, Process};
use motord_terminal::number;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

/// Returns at most `height` lines.
pub(super) fn lines(reading: &Reading, width: usize, height: usize) -> Vec<Line<'static>> {
    let groups = &reading.report.groups;
    let names = groups.iter().map(|group| group.name.chars().count()).max().unwrap_or(0);
    let group = |(index, group): (usize, &GroupReport)| group_line(group, &reading.history(index), names);
    let mut first: Vec<Line<'static>> = groups.iter().enumerate().map(group).collect();
    let stops = stops(reading);
    first.extend(stops.iter().flat_map(|stop| stop.cause(width)));
    let mut middle = troubles::lines(reading, width);
    let last: Vec<Line<'static>> = stops.iter().flat_map(|stop| stop.remedy(reading, width)).collect();
    let most = height.saturating_sub(first.len() + last.len());
    if middle.len() > most {
        let left_out = middle.len() + 1 - most;
        middle.truncate(most.saturating_sub(1));
        middle.push(dim(format!("  and {left_out} more troubles")).into());
        middle.truncate(most);
    }
    first.into_iter().chain(middle).chain(last).take(height).collect()
}

fn group_line(group: &GroupReport, history: &GroupHistory, names: usize) -> Line<'static> {
    let GroupReport { name, phase, .. } = group;
    let mut line =
        Line::from(vec![bold(format!("{name:<names$}")), Span::raw("  "), phase_span(phase), "  ".into()]);
    line.spans.extend(owner(group, history));
    if let Some(age) = group.setpoint_age_us {
        line.push_span(Span::from(format!("  setpoint {} µs old", number(Some(age), 0))));
    }
    if group.is_often_late() {
        line.push_span(warning(format!("  {} late", group.late)));
    }
    for (reason, count) in &group.rejected {
        line.push_span(warning(format!("  {count} rejected: {reason}")));
    }
    line
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

/// Groups with the same cause and joint of their stops.
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
        let is_same =
            |other: &&mut Stopped<'_>| other.stop.cause == stop.cause && other.stop.joint == stop.joint;
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
        let text = format!("STOPPED{since}, {who}: {}{}", self.stop.sentence, self.stop.origin());
        wrapped(&text, width, 2).into_iter().map(|line| alarm(line).into()).collect()
    }

    /// Returns the advice and the lines to paste.
    fn remedy(&self, reading: &Reading, width: usize) -> Vec<Line<'static>> {
        let steps = &self.stop.steps;
        let text = format!("  {}. Then paste, or press r:", steps.remedy);
        let mut lines: Vec<Line<'static>> =
            wrapped(&text, width, 2).into_iter().map(|line| line_of(&line, Style::new())).collect();
        let motorctl = crate::advice::motorctl(&reading.report.instance);
        let resets: Vec<String> = match self.is_all {
            true => vec![format!("{motorctl} reset")],
            false => self.groups.iter().map(|group| format!("{motorctl} reset {group}")).collect(),
        };
        lines.extend(resets.into_iter().map(|reset| bold(format!("  {reset}")).into()));
        lines
    }
}

/// Restores the indent of a remedy, which `wrapped` drops from the first line.
fn line_of(text: &str, style: Style) -> Line<'static> {
    Line::styled(format!("  {}", text.trim_start()), style)
}
