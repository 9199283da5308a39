//! The effective limits of a joint, and where each comes from.

use std::fmt;

use motord_core::settings::{MotorSettings, Settings};

use crate::document::{Document, Motor};
use crate::entry::Entry;
use crate::findings::line;

use super::limits::{CAUTIOUS_VELOCITY, DERATE_CELSIUS};

/// One effective limit of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    /// Its key in the configuration.
    pub key: &'static str,
    /// The unit of its values.
    pub unit: &'static str,
    /// The lowest value, of a limit that has two ends.
    pub min: Option<f32>,
    /// The highest value. `None`: there is no limit.
    pub max: Option<f32>,
    /// Where it comes from.
    pub origin: Origin,
}

/// Where a limit comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Its own key, in this line of the file, counted from 1.
    File {
        /// The line.
        line: usize,
    },
    /// Another key, which is in this line of the file.
    Key {
        /// The other key.
        key: &'static str,
        /// Its line, counted from 1.
        line: usize,
    },
    /// This fact of the motor's model.
    Model(&'static str),
    /// The largest value that the motor's protocol can carry, with some margin.
    Protocol,
    /// Another limit of the joint, by this rule.
    Rule(&'static str),
    /// The cautious value of motord.
    Default,
}

impl Origin {
    /// One word: `file`, `model`, `protocol`, `rule` or `default`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::File { .. } | Self::Key { .. } => "file",
            Self::Model(_) => "model",
            Self::Protocol => "protocol",
            Self::Rule(_) => "rule",
            Self::Default => "default",
        }
    }

    /// The line of the file, counted from 1.
    #[must_use]
    pub const fn line(self) -> Option<usize> {
        match self {
            Self::File { line } | Self::Key { line, .. } => Some(line),
            _ => None,
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { line } => write!(f, "line {line}"),
            Self::Key { key, line } => write!(f, "{key} in line {line}"),
            Self::Model(fact) => write!(f, "{fact} of the model"),
            Self::Protocol => write!(f, "end of the protocol's scale"),
            Self::Rule(rule) => write!(f, "{rule}"),
            Self::Default => write!(f, "default"),
        }
    }
}

/// The limits of every motor, in the order of `settings.motors`; `text` is the file.
pub(crate) fn limits(document: &Document, settings: &Settings, text: &str) -> Vec<Vec<Limit>> {
    let motors = document.motors.iter().zip(&settings.motors);
    motors.map(|(item, motor)| Explained { text, keys: &item.keys, motor }.limits()).collect()
}

/// A motor, as it is written and as it is built.
struct Explained<'a> {
    text: &'a str,
    keys: &'a Motor,
    motor: &'a MotorSettings,
}

impl Explained<'_> {
    fn limits(&self) -> Vec<Limit> {
        let (keys, is) = (&self.keys.limits, &self.motor.limits);
        let rated = (&self.keys.keys.rated_torque_nm, self.motor.rated_torque);
        let [low, high] = is.position;
        let position = self.limit(&keys.position_rad, high, Origin::Default);
        vec![
            Limit { min: Some(low), ..position },
            self.limit(&keys.velocity_rad_s, is.velocity, self.velocity()),
            self.limit(&keys.torque_nm, is.torque, self.torque()),
            self.limit(rated.0, rated.1, self.rated_torque()),
            self.limit(&keys.kp_max, is.kp, Origin::Default),
            self.limit(&keys.kd_max, is.kd, Origin::Default),
            self.limit(&keys.torque_slew_nm_per_s, is.torque_slew, Origin::Rule("50 · torque-nm")),
            self.limit(&keys.kp_slew_per_s, is.kp_slew, Origin::Rule("20 · kp-max")),
            self.limit(&keys.kd_slew_per_s, is.kd_slew, Origin::Rule("20 · kd-max")),
            self.limit(&keys.temperature_derate_celsius, is.temperature_derate, self.derating()),
            self.limit(&keys.temperature_max_celsius, is.temperature, Origin::Default),
            self.limit(&keys.following_error_rad, is.following_error, Origin::Default),
        ]
    }

    /// The limit of a key, whose value comes from elsewhere when it is not written.
    fn limit<T>(&self, entry: &Entry<T>, max: impl Into<Option<f32>>, elsewhere: Origin) -> Limit {
        let origin = if entry.is_written { Origin::File { line: self.line(entry) } } else { elsewhere };
        Limit { key: entry.at.key, unit: entry.unit, min: None, max: max.into(), origin }
    }

    fn line<T>(&self, entry: &Entry<T>) -> usize {
        line(self.text.as_bytes(), entry.at.offset)
    }

    /// A fact of the motor: of its model, unless the file has another.
    fn fact<T>(&self, entry: &Entry<T>, fact: &'static str) -> Origin {
        match entry.is_written {
            true => Origin::Key { key: entry.at.key, line: self.line(entry) },
            false => Origin::Model(fact),
        }
    }

    /// The default is the least of three: without load, cautious, and the protocol's.
    fn velocity(&self) -> Origin {
        let (motor, keys) = (self.motor, &self.keys.keys);
        match motor.limits.velocity {
            velocity if velocity >= motor.max_velocity => {
                self.fact(&keys.max_velocity_rad_s, "velocity without load")
            }
            velocity if velocity >= CAUTIOUS_VELOCITY as f32 => Origin::Default,
            _ => Origin::Protocol,
        }
    }

    /// The default is the rated torque, as far as the protocol can carry it.
    fn torque(&self) -> Origin {
        if self.motor.limits.torque < self.motor.rated_torque {
            return Origin::Protocol;
        }
        let written = &self.keys.keys.rated_torque_nm;
        if written.is_written { self.fact(written, "") } else { self.rated_torque() }
    }

    /// That of the model, unless the file allows a smaller peak.
    fn rated_torque(&self) -> Origin {
        let peak = &self.keys.keys.peak_torque_nm;
        match self.motor.rated_torque < self.motor.peak_torque {
            false if peak.is_written => self.fact(peak, "peak torque"),
            _ => Origin::Model("rated torque"),
        }
    }

    fn derating(&self) -> Origin {
        match self.motor.limits.temperature_derate < DERATE_CELSIUS as f32 {
            true => Origin::Rule("10 below temperature-max-celsius"),
            false => Origin::Default,
        }
    }
}
