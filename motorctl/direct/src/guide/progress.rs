//! The steps that are done, in a file beside the configuration: `motord.setup.toml` for
//! `motord.toml`. It is written before a motor or the configuration changes, and after each step,
//! so that the guide goes on after any interruption.

use super::edit::{DIRECTION, GEAR_RATIO, POSITION, TORQUE_CONSTANT, replace};
use crate::failure::DirectFailure;
use motord_configuration::{self as config, Wrong};
use motord_settings::settings::{MotorSettings, Settings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

const HEAD: &str = "\
# Written by `motorctl setup --guide`: the steps of each joint that are done, and what they replaced. The guide goes on from here.
# To set up a joint again, delete its [[joint]].
";

/// A step of a joint, in the order in which they are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Step {
    /// The motor has its id and host id.
    Address,
    /// The motor has the bit rate of its bus.
    BitRate,
    /// Torque constant and gear ratio of motor and configuration agree.
    Constants,
    /// The motor reports zero at the joint's mark.
    Zero,
    /// The configuration has the direction of the joint.
    Direction,
    /// The configuration has the range of the joint.
    Range,
    /// The motor speaks the configured protocol.
    Protocol,
    /// The joint has moved by itself. The last step.
    Motion,
}

impl Step {
    pub(super) const ALL: [Self; 8] = [
        Self::Address,
        Self::BitRate,
        Self::Constants,
        Self::Zero,
        Self::Direction,
        Self::Range,
        Self::Protocol,
        Self::Motion,
    ];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Address => "id",
            Self::BitRate => "bit rate",
            Self::Constants => "torque constant and gear ratio",
            Self::Zero => "zero",
            Self::Direction => "direction",
            Self::Range => "range",
            Self::Protocol => "protocol",
            Self::Motion => "first motion",
        }
    }
}

/// The values before the first change.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) struct Before {
    pub(super) id: Option<u8>,
    pub(super) host_id: Option<u16>,
    /// Bit/s of the interface at which the motor was found.
    pub(super) bit_rate: Option<u32>,
    /// Stored zero position of a motor in native mode.
    pub(super) zero: Option<i32>,
    /// Position, rad, from the former zero, at which the zero is now. Without the step, the guide
    /// was interrupted while it set it.
    pub(super) zero_at: Option<f64>,
    /// Values of the configuration, as TOML. A key that is not here was not written.
    #[serde(default)]
    pub(super) file: BTreeMap<String, String>,
}

/// The place and model of a motor in the configuration. With others, the steps of its joint are
/// void.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) struct Configured {
    /// The interface or device.
    bus: String,
    id: u8,
    host_id: u32,
    model: String,
}

impl Configured {
    pub(super) fn of(joint: &MotorSettings, settings: &Settings) -> Self {
        Self {
            bus: settings.buses[joint.bus].device().to_owned(),
            id: joint.id,
            host_id: joint.host_id.raw(),
            model: joint.model.to_string(),
        }
    }
}

/// The steps of a joint.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Record {
    pub(super) name: String,
    /// In the order in which they were done.
    #[serde(default)]
    pub(super) done: Vec<Step>,
    /// At the last step.
    pub(super) configured: Option<Configured>,
    #[serde(default)]
    pub(super) before: Before,
}

impl Record {
    pub(super) fn has(&self, step: Step) -> bool {
        self.done.contains(&step)
    }

    /// Records that the motor gets a zero where it reports `at`, rad. `stored` is its present zero
    /// in native mode.
    pub(super) fn begin_zero(&mut self, stored: Option<i32>, at: f64) {
        let Before { zero, zero_at, .. } = &mut self.before;
        // It was interrupted before the first change.
        let is_former = stored.is_some() && stored == *zero;
        *zero_at = Some(at + zero_at.filter(|_| !is_former).unwrap_or(0.0));
        *zero = zero.or(stored);
    }

    /// Records that a step of a motor in this place is done, as the last one.
    pub(super) fn mark(&mut self, step: Step, configured: Configured) {
        self.done.retain(|done| *done != step);
        self.done.push(step);
        self.configured = Some(configured);
    }

    /// Forgets a step and what it has replaced. An undone bit rate stays known: the motor stores it
    /// when it answers at that rate.
    pub(super) fn unmark(&mut self, step: Step) {
        self.done.retain(|done| *done != step);
        let before = &mut self.before;
        let keys: &[&str] = match step {
            Step::Address => {
                (before.id, before.host_id) = (None, None);
                &[]
            }
            Step::Zero => {
                (before.zero, before.zero_at) = (None, None);
                &[]
            }
            Step::Constants => &[TORQUE_CONSTANT, GEAR_RATIO],
            Step::Direction => &[DIRECTION],
            Step::Range => &[POSITION],
            Step::BitRate | Step::Protocol | Step::Motion => &[],
        };
        before.file.retain(|key, _| !keys.contains(&key.as_str()));
    }

    /// Forgets the motor. What the file had before the first change stays known.
    pub(super) fn begin_again(&mut self) {
        self.done.clear();
        self.before = Before { file: std::mem::take(&mut self.before.file), ..Before::default() };
    }
}

/// The file.
#[derive(Debug, PartialEq)]
pub(super) struct Progress {
    path: PathBuf,
    joints: Vec<Record>,
}

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    #[serde(default, rename = "joint")]
    joints: Vec<Record>,
}

impl Progress {
    /// Reads the file beside the configuration, if there is one.
    ///
    /// # Errors
    ///
    /// It cannot be read, or has mistakes.
    pub(super) fn load(config: &Path) -> Result<Self, DirectFailure> {
        let path = config.with_extension("setup.toml");
        let malformed = |reason: String| DirectFailure::Malformed {
            path: path.clone(),
            reason: format!("{reason}; delete it to begin with the first joint"),
        };
        let text = match config::text(&path) {
            Ok(text) => text,
            Err(problem) => match problem.wrong {
                Wrong::Unreadable(error) if error.kind() == ErrorKind::NotFound => String::new(),
                wrong => return Err(malformed(wrong.to_string())),
            },
        };
        let document: Document =
            toml::from_str(&text).map_err(|error| malformed(error.message().to_owned()))?;
        Ok(Self { path, joints: document.joints })
    }

    /// Forgets the steps of the joints that have another bus, address or model by now. Returns their
    /// names.
    ///
    /// # Errors
    ///
    /// The file cannot be written.
    pub(super) fn reopen(&mut self, settings: &Settings) -> Result<Vec<String>, DirectFailure> {
        let differs = |joint: &&MotorSettings| {
            let record = self.find(&joint.name).filter(|record| !record.done.is_empty());
            let configured = record.and_then(|record| record.configured.as_ref());
            configured.is_some_and(|configured| *configured != Configured::of(joint, settings))
        };
        let names: Vec<_> = settings.motors.iter().filter(differs).map(|joint| joint.name.clone()).collect();
        for name in &names {
            self.change(name, Record::begin_again)?;
        }
        Ok(names)
    }

    /// Returns the record of a joint, if the guide has begun with it.
    pub(super) fn find(&self, joint: &str) -> Option<&Record> {
        self.joints.iter().find(|record| record.name == joint)
    }

    pub(super) fn is_done(&self, joint: &str) -> bool {
        self.find(joint).is_some_and(|record| record.has(Step::Motion))
    }

    /// Returns whether a motor has taken a step of this joint.
    pub(super) fn has_begun(&self, joint: &str) -> bool {
        self.find(joint).is_some_and(|record| !record.done.is_empty())
    }

    /// Returns the joint whose step was done last.
    pub(super) fn last(&self) -> Option<&Record> {
        self.joints.last().filter(|record| !record.done.is_empty())
    }

    /// Changes the record of a joint, which then is the last one, and writes the file.
    ///
    /// # Errors
    ///
    /// It cannot be written.
    pub(super) fn change(
        &mut self,
        joint: &str,
        change: impl FnOnce(&mut Record),
    ) -> Result<(), DirectFailure> {
        let at = self.joints.iter().position(|record| record.name == joint);
        let new = || Record { name: joint.to_owned(), ..Record::default() };
        let mut record = at.map_or_else(new, |at| self.joints.remove(at));
        change(&mut record);
        self.joints.push(record);
        let document = Document { joints: self.joints.clone() };
        let text = toml::to_string(&document).map_err(|error| DirectFailure::Malformed {
            path: self.path.clone(),
            reason: error.to_string(),
        })?;
        replace(&self.path, &format!("{HEAD}\n{text}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_zero_adds_to_first() {
        let mut native = Record::default();
        native.begin_zero(Some(7), 0.5);
        // Interrupted before the change: the motor still has its former zero.
        native.begin_zero(Some(7), 0.25);
        assert_eq!((native.before.zero, native.before.zero_at), (Some(7), Some(0.25)));
        native.begin_zero(Some(9), 0.5);
        assert_eq!((native.before.zero, native.before.zero_at), (Some(7), Some(0.75)));
        let mut mit = Record::default();
        mit.begin_zero(None, 0.5);
        mit.begin_zero(None, -0.25);
        assert_eq!((mit.before.zero, mit.before.zero_at), (None, Some(0.25)));
        mit.unmark(Step::Zero);
        assert_eq!(mit, Record::default());
    }

    #[test]
    fn undone_step_forgets_what_it_replaced() {
        let mut record = Record { done: vec![Step::Direction, Step::Range], ..Record::default() };
        record.before.file = [DIRECTION, POSITION].map(|key| (key.to_owned(), "1".to_owned())).into();
        record.unmark(Step::Range);
        assert_eq!((record.done.as_slice(), record.before.file.len()), (&[Step::Direction][..], 1));
        assert!(record.before.file.contains_key(DIRECTION));
    }
}
