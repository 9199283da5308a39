//! `[motor.limits]`: within what the motor can do and what its protocol can tell.

use motord_protocol::mit;
use toml::Spanned;

use crate::config::problem::Wrong;
use crate::config::range::Range;
use crate::config::source::Span;
use crate::config::written::Number;
use crate::config::{Findings, range, written};
use motord_core::joint::Transmission;
use motord_core::settings::{BeyondRange, LimitSettings};

/// Limits keep this fraction of the protocol's scale away from its end. A control frame whose position, velocity and kp
/// are all at their ends can be a special frame (MIT document 1.1), and a reply at its end may be one that was clamped.
const MARGIN: f64 = 0.005;

const VELOCITY: Scale = Scale::with_margin(mit::VELOCITY.max());
const KP: Scale = Scale::with_margin(mit::KP.max());
/// Usable as a whole: no frame is special by its kd while velocity and kp keep away from their ends.
const KD: Scale = Scale { end: mit::KD.max(), usable: mit::KD.max() };

/// What the motor and its protocol can do, output side.
pub(super) struct Capability {
    pub(super) transmission: Transmission,
    pub(super) beyond_range: BeyondRange,
    /// The torque of the largest code, N·m.
    pub(super) full_scale_torque: f64,
    /// N·m.
    pub(super) rated_torque: f64,
    /// N·m.
    pub(super) peak_torque: f64,
    /// rad/s.
    pub(super) max_velocity: f64,
}

impl Capability {
    /// The motor's angle at a joint's `position`, rad.
    pub(super) fn to_motor(&self, position: f64) -> f64 {
        self.transmission.position_to_motor(position as f32).into()
    }

    /// How far the motor may turn, rad.
    fn position_scale(&self) -> Scale {
        match self.beyond_range {
            BeyondRange::Stop => Scale::with_margin(mit::POSITION.max()),
            BeyondRange::Wrap => {
                Scale { end: range::UNWRAPPED_POSITION_RAD, usable: range::UNWRAPPED_POSITION_RAD }
            }
        }
    }
}

/// The limits, joint side: reported and replaced by the default where one is beyond what the motor can do.
pub(super) fn limits(
    written: &written::Limits,
    capability: &Capability,
    findings: &mut Findings<'_>,
) -> LimitSettings {
    let &Capability { full_scale_torque, rated_torque, peak_torque, max_velocity, .. } = capability;
    let torque_scale = Scale::with_margin(full_scale_torque);
    let torque = range::TORQUE_NM.or(rated_torque.min(torque_scale.usable));
    let torque = scaled(&written.torque_nm, torque, &torque_scale, findings);
    judge_peak(&written.torque_nm, torque, peak_torque, findings);
    let velocity = range::VELOCITY_RAD_S.or(max_velocity.min(range::VELOCITY_RAD_S.default));
    let velocity = scaled(&written.velocity_rad_s, velocity, &VELOCITY, findings);
    let kp = scaled(&written.kp_max, range::KP_MAX, &KP, findings);
    let kd = scaled(&written.kd_max, range::KD_MAX, &KD, findings);
    let torque_slew = range::TORQUE_SLEW_NM_PER_S.or(range::TORQUE_SLEW_PER_S * torque);
    let kp_slew = range::KP_SLEW_PER_S.or(range::GAIN_SLEW_PER_S * kp);
    let kd_slew = range::KD_SLEW_PER_S.or(range::GAIN_SLEW_PER_S * kd);
    let [derate, max] = temperatures(written, findings);
    LimitSettings {
        position: position(&written.position_rad, capability, findings),
        velocity: velocity as f32,
        torque: torque as f32,
        kp: kp as f32,
        kd: kd as f32,
        torque_slew: findings.number(&written.torque_slew_nm_per_s, torque_slew) as f32,
        kp_slew: findings.number(&written.kp_slew_per_s, kp_slew) as f32,
        kd_slew: findings.number(&written.kd_slew_per_s, kd_slew) as f32,
        temperature_derate: derate as f32,
        temperature: max as f32,
        following_error: written
            .following_error_rad
            .as_ref()
            .map(|_| findings.number(&written.following_error_rad, range::FOLLOWING_ERROR_RAD) as f32),
    }
}

/// How far the protocol's codes reach on either side of zero, and how far a limit may.
struct Scale {
    end: f64,
    usable: f64,
}

impl Scale {
    const fn with_margin(end: f64) -> Self {
        Self { end, usable: end * (1.0 - MARGIN) }
    }

    /// Whether a limit may be this `value`, which is `at_motor` for the motor. Leaves to others what is no number.
    fn judge(&self, value: f64, at_motor: f64) -> Result<(), Wrong> {
        let &Self { end, usable } = self;
        match at_motor.abs() {
            _ if !value.is_finite() => Ok(()),
            size if size > end => Err(Wrong::BeyondScale { value, end, usable }),
            size if size > usable => Err(Wrong::NoMargin { value, end, usable }),
            _ => Ok(()),
        }
    }
}

/// The number, when it is at least the minimum of `range` and within `scale`; else the default.
fn scaled(written: &Number, range: Range, scale: &Scale, findings: &mut Findings<'_>) -> f64 {
    let Some(number) = written else { return range.default };
    let value = *number.get_ref();
    if let Err(wrong) = scale.judge(value, value) {
        findings.error(number.span(), wrong);
        return range.default;
    }
    findings.number(written, Range { max: scale.usable, ..range })
}

pub(super) fn judge_peak(written: &Number, value: f64, peak: f64, findings: &mut Findings<'_>) {
    if let Some(written) = written
        && value > peak
    {
        findings.error(written.span(), Wrong::BeyondPeak { value, peak });
    }
}

fn position(
    written: &Option<Spanned<Vec<f64>>>,
    capability: &Capability,
    findings: &mut Findings<'_>,
) -> [f32; 2] {
    let cautious = [-range::CAUTIOUS_POSITION_RAD, range::CAUTIOUS_POSITION_RAD];
    let default = cautious.map(|position| position + f64::from(capability.transmission.offset()));
    let position = written.as_ref().map_or(Ok(default), |written| judge_position(written, capability));
    let position = position.unwrap_or_else(|(place, wrong)| {
        findings.error(place, wrong);
        default
    });
    position.map(|position| position as f32)
}

fn judge_position(written: &Spanned<Vec<f64>>, capability: &Capability) -> Result<[f64; 2], (Span, Wrong)> {
    let refuse = |wrong| (written.span(), wrong);
    let &[low, high] = written.get_ref().as_slice() else {
        return Err(refuse(Wrong::PositionCount(written.get_ref().len())));
    };
    let scale = capability.position_scale();
    for value in [low, high] {
        if !value.is_finite() {
            let (min, max) = (-scale.usable, scale.usable);
            return Err(refuse(Wrong::NotFinite { value, min, max }));
        }
        scale.judge(value, capability.to_motor(value)).map_err(refuse)?;
    }
    if low < high { Ok([low, high]) } else { Err(refuse(Wrong::PositionOrder { low, high })) }
}

/// Where derating begins, and where no torque is left, °C. The defaults give way to what is written.
fn temperatures(written: &written::Limits, findings: &mut Findings<'_>) -> [f64; 2] {
    let max = findings.number(&written.temperature_max_celsius, range::TEMPERATURE_MAX_CELSIUS);
    let derate = range::TEMPERATURE_DERATE_CELSIUS;
    let derate = derate.or(derate.default.min(max - range::DERATING_CELSIUS));
    let derate = findings.number(&written.temperature_derate_celsius, derate);
    if let Some(written) = &written.temperature_derate_celsius
        && derate >= max
    {
        findings.error(written.span(), Wrong::DerateOrder { derate, max });
    }
    [derate, max]
}
