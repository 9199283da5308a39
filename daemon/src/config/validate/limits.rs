//! `[motor.limits]`: within what the motor can do and what its protocol can tell.

use motord_protocol::mit;
use toml::Spanned;

use super::super::problem::Wrong;
use super::super::range::Range;
use super::super::settings::{BeyondRange, LimitSettings};
use super::super::source::Span;
use super::super::written::Number;
use super::super::{Findings, range, written};

/// Limits keep this fraction of the protocol's scale away from its end. A control frame whose position, velocity and kp
/// are all at their ends can be a special frame (MIT document 1.1), and a reply at its end may be one that was clamped.
const MARGIN: f64 = 0.005;

/// What the motor and its protocol can do, output side.
pub(super) struct Capability {
    /// Joint angle = direction · motor angle + offset.
    pub(super) direction: f64,
    /// rad.
    pub(super) offset: f64,
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
        (position - self.offset) * self.direction
    }

    /// The farthest the motor may turn, rad.
    fn position_end(&self) -> f64 {
        match self.beyond_range {
            BeyondRange::Stop => mit::POSITION.max(),
            BeyondRange::Wrap => range::UNWRAPPED_POSITION_RAD,
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
    let torque = range::TORQUE_NM.or(rated_torque.min(peak_torque).min(usable(full_scale_torque)));
    let torque = scaled(&written.torque_nm, torque, full_scale_torque, MARGIN, findings);
    judge_peak(&written.torque_nm, torque, peak_torque, findings);
    let velocity = range::VELOCITY_RAD_S.or(max_velocity.min(range::VELOCITY_RAD_S.default));
    let velocity = scaled(&written.velocity_rad_s, velocity, mit::VELOCITY.max(), MARGIN, findings);
    let kp = scaled(&written.kp_max, range::KP_MAX, mit::KP.max(), MARGIN, findings);
    // The whole of kd is usable: no frame is special by its kd while velocity and kp keep away from their ends.
    let kd = scaled(&written.kd_max, range::KD_MAX, mit::KD.max(), 0.0, findings);
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

/// The largest value that keeps its margin from `end`.
fn usable(end: f64) -> f64 {
    end * (1.0 - MARGIN)
}

/// The number, when it is in `range` and, with the margin kept, within the protocol's `end`; else the default.
fn scaled(written: &Number, range: Range, end: f64, margin: f64, findings: &mut Findings<'_>) -> f64 {
    let range = Range { max: end * (1.0 - margin), ..range };
    match written {
        Some(number) if beyond(*number.get_ref(), number.span(), end, range.max, findings) => range.default,
        _ => findings.number(written, range),
    }
}

/// Reports a value that is farther out than `usable`, and whether it was.
fn beyond(value: f64, place: Span, end: f64, usable: f64, findings: &mut Findings<'_>) -> bool {
    if !value.is_finite() || value.abs() <= usable {
        return false;
    }
    let wrong = match value.abs() > end {
        true => Wrong::BeyondScale { value, end, usable },
        false => Wrong::NoMargin { value, end, usable },
    };
    findings.error(place, wrong);
    true
}

fn judge_peak(written: &Number, value: f64, peak: f64, findings: &mut Findings<'_>) {
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
    let default = cautious.map(|position| (position + capability.offset) as f32);
    let Some(written) = written else { return default };
    let [low, high] = match written.get_ref()[..] {
        [low, high] => [low, high],
        ref others => {
            findings.error(written.span(), Wrong::PositionCount(others.len()));
            return default;
        }
    };
    let end = capability.position_end();
    let (min, max) = (-usable(end), usable(end));
    for value in [low, high] {
        if !value.is_finite() {
            findings.error(written.span(), Wrong::NotFinite { value, min, max });
            return default;
        }
        if beyond(capability.to_motor(value), written.span(), end, max, findings) {
            return default;
        }
    }
    if low >= high {
        findings.error(written.span(), Wrong::PositionOrder { low, high });
        return default;
    }
    [low as f32, high as f32]
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
