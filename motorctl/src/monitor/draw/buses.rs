//! The buses: a summary below the joints, and a page with every counter.

use super::super::picture::{Picture, Reading};
use super::text::{ALARM, WARNING, bold, flowed, left, right, warning};
use crate::report::BusReport;
use motord_client::BusCondition;
use motord_terminal::number;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

/// Returns at most `most` lines; faulty buses first.
pub(super) fn lines(reading: &Reading, picture: &Picture, width: usize, most: usize) -> Vec<Line<'static>> {
    let loads = picture.loads.iter().copied().chain(std::iter::repeat(None));
    let mut buses: Vec<(&BusReport, Option<f64>)> = reading.report.buses.iter().zip(loads).collect();
    buses.sort_by_key(|(bus, _)| is_well(bus));
    let entries = buses.into_iter().map(|(bus, load)| entry(bus, load)).collect();
    flowed(entries, width, most, |count| format!("and {count} more buses: press 2"))
}

fn is_well(bus: &BusReport) -> bool {
    bus.condition == BusCondition::Active.name()
}

fn condition_style(bus: &BusReport) -> Style {
    if is_well(bus) { Style::new() } else { ALARM }
}

fn percent(load: Option<f64>) -> String {
    format!("{}%", number(load.map(|load| 100.0 * load), 0))
}

fn entry(bus: &BusReport, load: Option<f64>) -> Line<'static> {
    let mut line = Line::from(vec![
        bold(bus.name.clone()),
        Span::raw(" "),
        Span::styled(bus.condition, condition_style(bus)),
        Span::raw(format!(" {}", percent(load))),
    ]);
    for (name, count) in counters(bus).into_iter().filter(|(_, count)| *count > 0) {
        line.push_span(warning(format!(" {name} {count}")));
    }
    line
}

/// Returns the counters that should be 0.
fn counters(bus: &BusReport) -> [(&'static str, u32); 6] {
    [
        ("errors", bus.errors),
        ("lost", bus.lost),
        ("dropped", bus.dropped),
        ("unexpected", bus.unexpected_id),
        ("duplicate", bus.duplicate),
        ("malformed", bus.malformed),
    ]
}

/// Returns the heading and a row for each bus.
pub(super) fn table(reading: &Reading, picture: &Picture) -> (Line<'static>, Vec<Line<'static>>) {
    let buses = &reading.report.buses;
    let names = buses.iter().map(|bus| bus.name.chars().count()).max().unwrap_or(0).max(3);
    let heading = format!(
        "{:<names$} {:<8}{:>5}{:>7}{:>5}{:>8}{:>11}{:>10}{:>10}",
        "bus", "state", "load", "errors", "lost", "dropped", "unexpected", "duplicate", "malformed"
    );
    let loads = picture.loads.iter().copied().chain(std::iter::repeat(None));
    let rows = buses.iter().zip(loads).map(|(bus, load)| {
        let mut spans = vec![left(&bus.name, names, Style::new()), Span::raw(" ")];
        spans.push(left(bus.condition, 8, condition_style(bus)));
        spans.push(right(&percent(load), 5, Style::new()));
        for ((_, count), width) in counters(bus).into_iter().zip([7, 5, 8, 11, 10, 10]) {
            let style = if count == 0 { Style::new() } else { WARNING };
            spans.push(right(&count.to_string(), width, style));
        }
        Line::from(spans)
    });
    (bold(heading).into(), rows.collect())
}
