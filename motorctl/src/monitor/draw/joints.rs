//! The joints, one in a row.

use super::super::picture::Reading;
use super::super::view::{SortOrder, View};
use super::text::{ALARM, WARNING, bold, dim, flowed, left, right};
use crate::joint_report::JointReport;
use motord_client::MotorMode;
use motord_terminal::number;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

/// Smallest width for every column.
const WIDE: usize = 78;
const NAME_MAX: usize = 16;

/// Returns the joints that pass the filter of `view`, in its order.
pub(super) fn shown<'a>(reading: &'a Reading, view: &View) -> Vec<&'a JointReport> {
    let joints = reading.report.joints.iter();
    let mut shown: Vec<&JointReport> = joints.filter(|joint| passes(joint, &view.filter)).collect();
    sort(&mut shown, view.order);
    shown
}

/// Returns the heading, and the rows of `shown`.
pub(super) fn table(
    reading: &Reading,
    shown: &[&JointReport],
    view: &View,
    width: usize,
) -> (Line<'static>, Vec<Line<'static>>) {
    let joints = &reading.report.joints;
    let names = joints.iter().map(|joint| joint.name.chars().count()).max().unwrap_or(0).clamp(5, NAME_MAX);
    let columns = Columns { names, bar: if width < WIDE { 8 } else { 12 }, is_wide: width >= WIDE };
    let mut heading = columns.heading();
    // A narrow heading has no room for notes and row numbers.
    if columns.is_wide {
        heading.push_span(bold(" notes"));
    }
    if view.order != SortOrder::Trouble {
        heading.push_span(dim(format!("  by {}", view.order.name())));
    }
    let mut rows: Vec<Line<'static>> = shown.iter().map(|joint| columns.row(joint)).collect();
    let cursor = shown.iter().position(|joint| Some(joint.name.as_str()) == view.selection.cursor());
    if let Some(name) = cursor.and_then(|row| rows[row].spans.first_mut()) {
        name.style = name.style.reversed();
    }
    (heading, rows)
}

fn passes(joint: &JointReport, filter: &str) -> bool {
    let mut texts = [joint.name.as_str(), &joint.bus, joint.mode].into_iter();
    texts.any(|text| text.contains(filter))
}

fn sort(joints: &mut [&JointReport], order: SortOrder) {
    let largest_first = |value: fn(&JointReport) -> f64| {
        move |a: &&JointReport, b: &&JointReport| value(b).total_cmp(&value(a))
    };
    match order {
        SortOrder::Trouble => joints.sort_by_key(|joint| trouble(joint)),
        SortOrder::Configuration => {}
        SortOrder::Name => joints.sort_by(|a, b| a.name.cmp(&b.name)),
        SortOrder::Position => joints.sort_by(largest_first(|joint| {
            fraction(joint).map_or(-1.0, |fraction| (2.0 * fraction - 1.0).abs())
        })),
        SortOrder::Velocity => joints.sort_by(largest_first(|joint| {
            joint.velocity_rad_s.map_or(-1.0, |speed| f64::from(speed.abs()))
        })),
        SortOrder::Torque => joints.sort_by(largest_first(|joint| torque_part(joint).unwrap_or(-1.0))),
        SortOrder::Temperature => {
            joints.sort_by(largest_first(|joint| joint.temperature_celsius.map_or(-1e9, f64::from)));
        }
        SortOrder::Age => joints.sort_by_key(|joint| std::cmp::Reverse(joint.age_cycles)),
    }
}

/// Returns the rank of a joint by its mode only: an intermittent limit would make the rows jump.
fn trouble(joint: &JointReport) -> u8 {
    match joint.mode {
        mode if mode == MotorMode::Fault.name() => 0,
        mode if mode == MotorMode::Offline.name() => 1,
        _ => 2,
    }
}

/// Returns the position within the limits: 0 is the lowest, 1 the highest.
fn fraction(joint: &JointReport) -> Option<f64> {
    let [lowest, highest] = joint.position_range_rad.map(f64::from);
    let fraction = (f64::from(joint.position_rad?) - lowest) / (highest - lowest);
    Some(fraction).filter(|fraction| fraction.is_finite())
}

fn torque_part(joint: &JointReport) -> Option<f64> {
    Some(f64::from(joint.torque_nm?.abs()) / f64::from(joint.torque_max_nm))
}

struct Columns {
    names: usize,
    bar: usize,
    is_wide: bool,
}

impl Columns {
    fn heading(&self) -> Line<'static> {
        let names = self.names;
        let bar = self.bar;
        let mut text = format!("{:<names$} {:<bar$} {:>6} {:>6}", "joint", "position", "rad", "rad/s");
        if self.is_wide {
            text.push_str(&format!(" {:>6}", "N·m"));
        }
        text.push_str(&format!(" {:>4} {:>3} {:<8}", "torq", "°C", "mode"));
        if self.is_wide {
            text.push_str(&format!(" {:>4}", "age"));
        }
        bold(text).into()
    }

    fn row(&self, joint: &JointReport) -> Line<'static> {
        let known = |value: Option<f32>| value.map(f64::from);
        let plain = Style::new();
        let torque = torque_part(joint).map(|part| 100.0 * part);
        let mut spans = vec![left(&joint.name, self.names, plain), Span::raw(" ")];
        spans.extend(bar(joint, self.bar));
        spans.push(right(&number(known(joint.position_rad), 2), 7, plain));
        spans.push(right(&number(known(joint.velocity_rad_s), 2), 7, plain));
        if self.is_wide {
            spans.push(right(&number(known(joint.torque_nm), 2), 7, plain));
        }
        let percent = torque.map_or_else(|| "-".to_owned(), |torque| format!("{}%", number(Some(torque), 0)));
        spans.push(right(&percent, 5, plain));
        spans.push(right(&number(known(joint.temperature_celsius.filter(|_| joint.valid)), 0), 4, plain));
        spans.push(Span::raw(" "));
        spans.push(left(joint.mode, 8, mode_style(joint.mode)));
        if self.is_wide {
            spans.push(right(&age(joint), 5, age_style(joint)));
        }
        spans.push(Span::raw(" "));
        spans.extend(notes(joint, self.is_wide));
        spans.into()
    }
}

/// Draws the position as a mark on a line between the limits. Outside, the mark is an arrow.
fn bar(joint: &JointReport, width: usize) -> [Span<'static>; 3] {
    let inner = width.saturating_sub(2);
    let line = |count: usize| "─".repeat(count);
    let nothing = || Span::raw(String::new());
    let Some(fraction) = fraction(joint) else {
        return [dim(format!("├{}┤", line(inner))), nothing(), nothing()];
    };
    if fraction < 0.0 {
        return [bold("◀"), dim(format!("{}┤", line(inner))), nothing()];
    }
    if fraction > 1.0 {
        return [dim(format!("├{}", line(inner))), bold("▶"), nothing()];
    }
    let offset = ((fraction * inner as f64) as usize).min(inner.saturating_sub(1));
    [
        dim(format!("├{}", line(offset))),
        bold("●"),
        dim(format!("{}┤", line(inner.saturating_sub(offset + 1)))),
    ]
}

fn mode_style(mode: &str) -> Style {
    if mode == MotorMode::Fault.name() || mode == MotorMode::Offline.name() {
        ALARM
    } else if mode == MotorMode::Active.name() {
        Style::new().bold()
    } else {
        Style::new()
    }
}

/// Formats the age in at most four characters.
fn age(joint: &JointReport) -> String {
    match joint.age_cycles {
        cycles @ 0..10_000 => cycles.to_string(),
        cycles @ 10_000..1_000_000 => format!("{}k", cycles / 1000),
        _ => "old".to_owned(),
    }
}

fn age_style(joint: &JointReport) -> Style {
    if joint.age_cycles == 0 { Style::new() } else { WARNING }
}

/// Returns everything about a joint in lines of at most `width`: a row of a small terminal cuts its
/// notes.
pub(super) fn details(joint: &JointReport, width: usize) -> Vec<Line<'static>> {
    let known = |value: Option<f32>| number(value.map(f64::from), 2);
    let [position, velocity, torque] = [joint.position_rad, joint.velocity_rad_s, joint.torque_nm].map(known);
    let first = format!("{}: {position} rad, {velocity} rad/s, {torque} N·m, {}", joint.name, joint.mode);
    let first = Line::from(vec![bold(first), Span::raw(format!(", age {}", age(joint)))]);
    let notes = notes(joint, true).into_iter().map(|note| Line::from(vec![note]));
    flowed([first].into_iter().chain(notes).collect(), width, usize::MAX, |_| String::new())
}

/// Returns the notes, worst first: the end of a row may not fit.
fn notes(joint: &JointReport, is_wide: bool) -> Vec<Span<'static>> {
    let mut notes: Vec<(String, Style)> = joint.faults.iter().map(|fault| (fault.clone(), ALARM)).collect();
    if fraction(joint).is_some_and(|fraction| !(0.0..=1.0).contains(&fraction)) {
        notes.push(("outside limits".to_owned(), ALARM));
    }
    if !is_wide && joint.age_cycles > 0 {
        notes.push((format!("age {}", age(joint)), WARNING));
    }
    notes.extend(joint.limits.iter().map(|limit| ((*limit).to_owned(), WARNING)));
    let counters = [
        ("missed", joint.missed),
        ("late", joint.late),
        ("implausible", joint.implausible),
        ("foreign", joint.foreign_commands),
        ("clamped", joint.clamped),
    ];
    let counted = counters.into_iter().filter(|(_, count)| *count > 0);
    notes.extend(counted.map(|(name, count)| (format!("{count} {name}"), Style::new().dim())));
    notes.into_iter().map(|(text, style)| Span::styled(text + " ", style)).collect()
}
