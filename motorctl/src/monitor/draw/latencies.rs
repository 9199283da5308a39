//! Latencies: a summary with the curve of the last readings, and a page with every percentile.

use super::super::picture::{Picture, Reading, Sample};
use super::text::{bold, dim, right, sparkline};
use motord_client::Percentiles;
use motord_terminal::number;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

const COLUMNS: usize = 2;
/// Shortest useful curve, characters.
const CURVE_MIN: usize = 4;

/// Name, percentiles, and the latency of a reading.
type Row = (&'static str, Percentiles, fn(&Sample) -> f64);

fn rows(reading: &Reading) -> [Row; 4] {
    let telemetry = &reading.telemetry;
    [
        ("wake", telemetry.wake_latency_us, |sample| sample.wake),
        ("reply", telemetry.reply_latency_us, |sample| sample.reply),
        ("cycle", telemetry.cycle_us, |sample| sample.cycle),
        ("age", telemetry.setpoint_age_us, |sample| sample.age),
    ]
}

/// Returns at most `most` lines of two latencies each.
pub(super) fn lines(reading: &Reading, picture: &Picture, width: usize, most: usize) -> Vec<Line<'static>> {
    let column = (width / COLUMNS).saturating_sub(1);
    let rows = rows(reading);
    let line = |pair: &[Row]| {
        let spans = pair.iter().flat_map(|row| entry(row, picture, column));
        Line::from(spans.collect::<Vec<_>>())
    };
    rows.chunks(COLUMNS).take(most).map(line).collect()
}

/// `wake 27/111/2185 µs ▁▂▁`: p50, p99, max, and the curve.
fn entry((name, latency, value): &Row, picture: &Picture, width: usize) -> Vec<Span<'static>> {
    let text = format!("{name:<5} {}", short(latency));
    let left = width.saturating_sub(text.chars().count() + 1);
    let curve = sparkline(picture.samples.iter().map(value), if left < CURVE_MIN { 0 } else { left });
    vec![Span::from(text), dim(format!(" {curve:<left$} "))]
}

fn short(latency: &Percentiles) -> String {
    if latency.count == 0 {
        return "-".to_owned();
    }
    let values = [latency.p50, latency.p99, latency.max].map(|value| number(Some(value), 0));
    format!("{} µs", values.join("/"))
}

/// Returns the heading, and a row for each latency and each joint's replies.
pub(super) fn table(reading: &Reading) -> (Line<'static>, Vec<Line<'static>>) {
    let joints = reading.report.joints.iter().zip(&reading.telemetry.joints);
    let joints = joints.map(|(joint, latency)| (format!("reply {}", joint.name), *latency));
    let named = rows(reading).map(|(name, latency, _)| (name.to_owned(), latency));
    let more = [
        ("control".to_owned(), reading.telemetry.control_latency_us),
        ("publish".to_owned(), reading.telemetry.publication_us),
    ];
    let all: Vec<(String, Percentiles)> = named.into_iter().chain(more).chain(joints).collect();
    let names = all.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let heading = format!("{:<names$}{:>9}{:>9}{:>9}{:>9}", "µs", "p50", "p99", "p99.9", "max");
    let row = |(name, latency): &(String, Percentiles)| {
        let values = [latency.p50, latency.p99, latency.p99_9, latency.max];
        let known = |value: f64| number((latency.count > 0).then_some(value), 0);
        let mut spans = vec![Span::from(format!("{name:<names$}"))];
        spans.extend(values.map(|value| right(&known(value), 9, Style::new())));
        Line::from(spans)
    };
    (bold(heading).into(), all.iter().map(row).collect())
}
