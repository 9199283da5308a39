//! The rules that all forms of a command share: pure functions of a message, its group, the clock and
//! the settings.

use crate::config::Commands;
use crate::group::{Group, JointGains};
use crate::refusal::Refusal;
use std::time::Duration;

/// Seconds and nanoseconds of the wall clock, as a message has them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Stamp {
    pub(crate) sec: i32,
    pub(crate) nanosec: u32,
}

/// The stamp of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stamped {
    /// The message has a header.
    Header(Stamp),
    /// The form has no header: the time at which its DDS writer sent it counts.
    Writer,
}

/// Stiffness and damping of a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Gains<'a> {
    /// Those of the message, in the order of its names.
    Message { kp: &'a [f64], kd: &'a [f64] },
    /// Those of the configuration: the form has none.
    Configured,
}

/// The things that a command is checked against.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rules<'a> {
    pub(crate) group: &'a Group,
    pub(crate) gains: Option<&'a JointGains>,
    pub(crate) commands: &'a Commands,
    pub(crate) horizon_max: Duration,
    /// ns since 1970.
    pub(crate) now_ns: u64,
}

/// Checks that a command is young.
pub(crate) fn check_stamp(stamp: Stamped, sent_ns: Option<u64>, rules: &Rules) -> Result<(), Refusal> {
    let of_writer = || sent_ns.ok_or(Refusal::ZeroStamp);
    let stamp_ns = match stamp {
        Stamped::Writer => of_writer()?,
        Stamped::Header(Stamp { sec: 0, nanosec: 0 }) if rules.commands.allow_zero_stamp => of_writer()?,
        Stamped::Header(Stamp { sec: 0, nanosec: 0 }) => return Err(Refusal::ZeroStamp),
        Stamped::Header(Stamp { sec, nanosec }) => {
            let sec = u64::try_from(sec).map_err(|_| Refusal::InvalidStamp)?;
            if nanosec >= 1_000_000_000 {
                return Err(Refusal::InvalidStamp);
            }
            sec * 1_000_000_000 + u64::from(nanosec)
        }
    };
    let milliseconds = |ns: u64| ns as f64 / 1e6;
    if milliseconds(rules.now_ns.saturating_sub(stamp_ns)) > rules.commands.max_age_ms {
        return Err(Refusal::Old);
    }
    if milliseconds(stamp_ns.saturating_sub(rules.now_ns)) > rules.commands.max_ahead_ms {
        return Err(Refusal::Future);
    }
    Ok(())
}

/// Returns for each name its index in the group. Each joint is named exactly once.
pub(crate) fn slots(names: Option<&[String]>, group: &Group) -> Result<Vec<usize>, Refusal> {
    let count = group.joints.len();
    let Some(names) = names else { return Ok((0..count).collect()) };
    let (mut seen, mut slots) = (vec![false; count], Vec::with_capacity(count));
    for name in names {
        let slot = group.joints.iter().position(|joint| joint.name == *name);
        let slot = slot.ok_or(Refusal::UnknownJoint)?;
        if std::mem::replace(&mut seen[slot], true) {
            return Err(Refusal::RepeatedJoint);
        }
        slots.push(slot);
    }
    if slots.len() == count { Ok(slots) } else { Err(Refusal::MissingJoint) }
}

/// Returns `numbers` as the daemon takes them. There must be `count` finite ones.
pub(crate) fn values(numbers: &[f64], count: usize, length: Refusal) -> Result<Vec<f32>, Refusal> {
    if numbers.len() != count {
        return Err(length);
    }
    let value = |number: &f64| match *number as f32 {
        value if value.is_nan() => Err(Refusal::NotANumber),
        value if value.is_infinite() => Err(Refusal::Infinite),
        value => Ok(value),
    };
    numbers.iter().map(value).collect()
}

/// Works like [`values`]; zeros stand for an empty list.
pub(crate) fn values_or_zeros(numbers: &[f64], count: usize, length: Refusal) -> Result<Vec<f32>, Refusal> {
    if numbers.is_empty() { Ok(vec![0.0; count]) } else { values(numbers, count, length) }
}

/// Returns stiffness and damping in the order of the message.
pub(crate) fn gains(gains: Gains, slots: &[usize], rules: &Rules) -> Result<(Vec<f32>, Vec<f32>), Refusal> {
    let count = slots.len();
    let (kp, kd) = match gains {
        Gains::Message { kp, kd } => {
            (values(kp, count, Refusal::KpLength)?, values(kd, count, Refusal::KdLength)?)
        }
        Gains::Configured => {
            let gains = rules.gains.ok_or(Refusal::NoGains)?;
            let in_order = |numbers: &[f64]| slots.iter().map(|slot| numbers[*slot] as f32).collect();
            (in_order(&gains.kp), in_order(&gains.kd))
        }
    };
    match kp.iter().chain(&kd).any(|gain| *gain < 0.0) {
        true => Err(Refusal::NegativeGain),
        false => Ok((kp, kd)),
    }
}
