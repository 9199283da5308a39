//! The effective limits of the joints, and where each comes from.

use std::io::{self, Write};

use serde::Serialize;

use motord_configuration::{Limit, Loaded};
use motord_core::settings::MotorSettings;

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

/// The same for people: a line for each limit.
pub(super) fn print(loaded: &Loaded, out: &mut impl Write) -> io::Result<()> {
    for (motor, limits) in loaded.settings.motors.iter().zip(&loaded.limits) {
        let (name, model, protocol) = (&motor.name, &motor.model, motor.protocol.name());
        writeln!(out, "\n{name}: {model}, {protocol}")?;
        for limit in limits {
            let value = format!("{} {}", value(limit), if limit.max.is_some() { limit.unit } else { "" });
            writeln!(out, "  {:<26}  {:<24}  {}", limit.key, value.trim_end(), limit.origin)?;
        }
    }
    Ok(())
}

/// `-1.2 to 1.2`, `12.5` or `not watched`.
fn value(limit: &Limit) -> String {
    match (limit.min, limit.max) {
        (Some(min), Some(max)) => format!("{min} to {max}"),
        (None, Some(max)) => max.to_string(),
        (_, None) => "not watched".to_owned(),
    }
}
