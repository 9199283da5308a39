//! The effective limits of the joints, and where each comes from.

use std::io::{self, Write};

use serde::Serialize;

use motord_configuration::{Limit, Loaded, Origin};
use motord_settings::settings::MotorSettings;

/// A joint of the object that `--json` prints.
#[derive(Serialize)]
pub(super) struct JointReport<'a> {
    name: &'a str,
    model: &'a str,
    protocol: &'static str,
    limits: Vec<LimitReport>,
}

impl<'a> JointReport<'a> {
    fn of(motor: &'a MotorSettings, limits: &[Limit]) -> Self {
        Self {
            name: &motor.name,
            model: &motor.model,
            protocol: motor.protocol.name(),
            limits: limits.iter().map(LimitReport::from).collect(),
        }
    }
}

/// One limit.
#[derive(Serialize)]
struct LimitReport {
    key: &'static str,
    unit: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    min: Option<f32>,
    max: Option<f32>,
    source: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    line: Option<usize>,
    /// The source in words.
    from: String,
}

impl From<&Limit> for LimitReport {
    fn from(limit: &Limit) -> Self {
        let &Limit { key, unit, min, max, origin } = limit;
        Self { key, unit, min, max, source: origin.word(), line: origin.line(), from: origin.to_string() }
    }
}

/// Every joint, in the order of the file.
pub(super) fn reports(loaded: &Loaded) -> Vec<JointReport<'_>> {
    let joints = loaded.settings.motors.iter().zip(&loaded.limits);
    joints.map(|(motor, limits)| JointReport::of(motor, limits)).collect()
}

/// The same for people: joints with equal limits in one table, which has a line for each limit.
pub(super) fn print(loaded: &Loaded, out: &mut impl Write) -> io::Result<()> {
    for equal in groups(loaded) {
        let Some((first, limits, _)) = equal.first() else { continue };
        let name = |(motor, _, line): &Joint<'_>| format!("{} id {} (line {line})", motor.name, motor.id);
        let names: Vec<_> = equal.iter().map(name).collect();
        let (model, protocol) = (&first.model, first.protocol.name());
        writeln!(out, "\n{}: {model}, {protocol}", names.join(", "))?;
        for (index, limit) in limits.iter().enumerate() {
            let value = format!("{} {}", value(limit), if limit.max.is_some() { limit.unit } else { "" });
            let origins: Vec<_> = equal.iter().map(|(_, limits, _)| limits[index].origin).collect();
            writeln!(out, "  {:<26}  {:<24}  {}", limit.key, value.trim_end(), origin(&origins))?;
        }
    }
    Ok(())
}

/// A motor, its limits and its line of the file.
type Joint<'a> = (&'a MotorSettings, &'a [Limit], usize);

/// Joints with equal limits, in the order of their first one.
fn groups(loaded: &Loaded) -> Vec<Vec<Joint<'_>>> {
    let mut groups: Vec<Vec<Joint<'_>>> = Vec::new();
    let joints = loaded.settings.motors.iter().zip(&loaded.limits).zip(&loaded.motor_lines);
    for ((motor, limits), &line) in joints {
        match groups.iter_mut().find(|group| are_equal(group[0], (motor, limits, line))) {
            Some(group) => group.push((motor, limits, line)),
            None => groups.push(vec![(motor, limits, line)]),
        }
    }
    groups
}

/// Returns whether two joints differ only in the lines of the file that their limits come from.
fn are_equal(one: Joint<'_>, other: Joint<'_>) -> bool {
    let anywhere = |limit: &Limit| Limit { origin: anywhere(limit.origin), ..*limit };
    (&one.0.model, one.0.protocol) == (&other.0.model, other.0.protocol)
        && one.1.iter().map(anywhere).eq(other.1.iter().map(anywhere))
}

/// The origin without its line.
fn anywhere(origin: Origin) -> Origin {
    match origin {
        Origin::File { .. } => Origin::File { line: 0 },
        Origin::Key { key, .. } => Origin::Key { key, line: 0 },
        other => other,
    }
}

/// The origin of a limit of several joints, with each line.
fn origin(origins: &[Origin]) -> String {
    let lines: Vec<_> =
        origins.iter().filter_map(|origin| origin.line()).map(|line| line.to_string()).collect();
    match origins.first() {
        Some(Origin::File { .. }) if lines.len() > 1 => format!("lines {}", lines.join(", ")),
        Some(Origin::Key { key, .. }) if lines.len() > 1 => format!("{key} in lines {}", lines.join(", ")),
        Some(origin) => origin.to_string(),
        None => String::new(),
    }
}

/// `-1.2 to 1.2`, `12.5` or `half a turn`.
fn value(limit: &Limit) -> String {
    match (limit.min, limit.max) {
        (Some(min), Some(max)) => format!("{min} to {max}"),
        (None, Some(max)) => max.to_string(),
        (_, None) => "half a turn".to_owned(),
    }
}
