//! Checks `[motor.limits]` against the capability of the motor and the scale of its protocol.

use motord_protocol::drive::Transmission;
use motord_protocol::{Field, Scales};
use motord_settings::defaults::ROUNDING;
use motord_settings::settings::{
    BeyondRange, CAUTIOUS_POSITION, CAUTIOUS_VELOCITY, GAIN_SLEW_PER_S, LimitSettings, MARGIN, MotorSettings,
    Settings, TORQUE_SLEW_PER_S,
};

use crate::document::{Document, MotorTables};
use crate::entry::{At, Entry, degrees};
use crate::findings::Findings;
use crate::keys::Limits;
use crate::origin::{Limit, Origin};
use crate::problem::{Wrong, line};

/// Largest position of a motor whose position code wraps round, rad.
const UNWRAPPED_POSITION: f64 = 1000.0;
/// Default derating begins at this temperature, °C, and at least [`DERATING_CELSIUS`] below the
/// maximum.
const DERATE_CELSIUS: f64 = 70.0;
const DERATING_CELSIUS: f64 = 10.0;

/// The facts of a motor that bound its limits, output side. Infinite where the model is not known.
pub(super) struct Capability {
    pub(super) transmission: Transmission,
    pub(super) beyond_range: BeyondRange,
    /// The ranges of its codes.
    pub(super) scales: Option<Scales>,
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

    /// The value of the largest code.
    fn end(&self, field: fn(&Scales) -> Field) -> f64 {
        self.scales.as_ref().map_or(f64::INFINITY, |scales| field(scales).max())
    }

    /// Returns the range of the motor, rad.
    fn position_scale(&self) -> Scale {
        match self.beyond_range {
            BeyondRange::Stop => Scale::with_margin(self.end(|scales| scales.position)),
            BeyondRange::Wrap => Scale { end: UNWRAPPED_POSITION, usable: UNWRAPPED_POSITION },
        }
    }
}

/// Returns the limits, joint side. Reports limits beyond the motor or its protocol.
pub(super) fn limits(keys: &Limits, capability: &Capability, findings: &mut Findings<'_>) -> LimitSettings {
    let torque_scale = Scale::with_margin(capability.end(|scales| scales.torque));
    let torque = keys.torque_nm.value.unwrap_or(capability.rated_torque.min(torque_scale.usable));
    torque_scale.check(&keys.torque_nm, torque, findings);
    if keys.torque_nm.is_written && torque <= torque_scale.usable {
        check_peak(keys.torque_nm.at, torque, capability.peak_torque, findings);
    }
    let velocity_scale = Scale::with_margin(capability.end(|scales| scales.velocity));
    let fastest = capability.max_velocity.min(CAUTIOUS_VELOCITY).min(velocity_scale.usable);
    let velocity = keys.velocity_rad_s.value.unwrap_or(fastest);
    velocity_scale.check(&keys.velocity_rad_s, velocity, findings);
    if velocity > capability.max_velocity && velocity <= velocity_scale.usable {
        let wrong = Wrong::FasterThanMotor { value: velocity, fastest: rounded(capability.max_velocity) };
        findings.warn(keys.velocity_rad_s.at, wrong);
    }
    let (kp, kd) = (keys.kp_max.value, keys.kd_max.value);
    Scale::with_margin(capability.end(|scales| scales.kp)).check(&keys.kp_max, kp, findings);
    // The whole scale of kd is usable: no frame is a special one while velocity and kp keep away
    // from their ends.
    let kd_end = capability.end(|scales| scales.kd);
    Scale { end: kd_end, usable: kd_end }.check(&keys.kd_max, kd, findings);
    let [derate, temperature] = temperatures(keys, findings);
    LimitSettings {
        position: position(keys, capability, findings).map(|position| position as f32),
        velocity: velocity as f32,
        torque: torque as f32,
        kp: kp as f32,
        kd: kd as f32,
        torque_slew: keys.torque_slew_nm_per_s.value.unwrap_or(TORQUE_SLEW_PER_S * torque) as f32,
        kp_slew: keys.kp_slew_per_s.value.unwrap_or(GAIN_SLEW_PER_S * kp) as f32,
        kd_slew: keys.kd_slew_per_s.value.unwrap_or(GAIN_SLEW_PER_S * kd) as f32,
        temperature_derate: derate as f32,
        temperature: temperature as f32,
        following_error: keys.following_error_rad.value.map(|error| error as f32),
        torque_response: keys.torque_response_percent.value as f32 / 100.0,
    }
}

/// The range of the protocol's codes on either side of zero, and the usable part of it.
struct Scale {
    end: f64,
    usable: f64,
}

impl Scale {
    const fn with_margin(end: f64) -> Self {
        Self { end, usable: end * (1.0 - MARGIN) }
    }

    /// Reports a limit that its motor cannot reach.
    fn check<T>(&self, entry: &Entry<T>, value: f64, findings: &mut Findings<'_>) {
        if let Err(wrong) = self.verify(value, value, String::new()) {
            findings.error(entry.at, wrong);
        }
    }

    /// Checks the `value` of a limit, which is `at_motor` for the motor.
    fn verify(&self, value: f64, at_motor: f64, degrees: String) -> Result<(), Wrong> {
        let &Self { end, usable } = self;
        match at_motor.abs() {
            size if size > end => Err(Wrong::BeyondScale { value, end, usable, degrees }),
            size if size > usable * (1.0 + ROUNDING) => Err(Wrong::NoMargin { value, end, usable }),
            _ => Ok(()),
        }
    }
}

pub(super) fn check_peak(at: At, value: f64, peak: f64, findings: &mut Findings<'_>) {
    if value > peak {
        findings.error(at, Wrong::BeyondPeak { value, peak });
    }
}

/// The lowest and the highest position, rad.
fn position(keys: &Limits, capability: &Capability, findings: &mut Findings<'_>) -> [f64; 2] {
    let entry = &keys.position_rad;
    let offset = f64::from(capability.transmission.offset());
    let default = [-CAUTIOUS_POSITION, CAUTIOUS_POSITION].map(|position| position + offset);
    let Some(position) = entry.value else {
        if !entry.is_written {
            let [low, high] = default.map(rounded);
            findings.warn(entry.at, Wrong::NoPositionLimits { low, high });
        }
        return default;
    };
    if let Err(wrong) = check_position(position, capability) {
        findings.error(entry.at, wrong);
        return default;
    }
    let far = position.into_iter().find(|position| !degrees(*position).is_empty());
    if let (Some(value), BeyondRange::Stop) = (far, capability.beyond_range) {
        findings.warn(entry.at, Wrong::ManyTurns { value, degrees: degrees(value) });
    }
    position
}

/// Without the digits that only come from `f32`.
fn rounded(value: f64) -> f64 {
    (1000.0 * value).round() / 1000.0
}

fn check_position([low, high]: [f64; 2], capability: &Capability) -> Result<(), Wrong> {
    let scale = capability.position_scale();
    for value in [low, high] {
        if !value.is_finite() {
            let expected = format!("from {} to {} rad", -scale.usable, scale.usable);
            return Err(Wrong::NotFinite { value, expected });
        }
        scale.verify(value, capability.to_motor(value), degrees(value))?;
    }
    if low < high { Ok(()) } else { Err(Wrong::PositionOrder { low, high }) }
}

/// The begin of derating, and the temperature without torque, °C.
fn temperatures(keys: &Limits, findings: &mut Findings<'_>) -> [f64; 2] {
    let max = keys.temperature_max_celsius.value;
    let entry = &keys.temperature_derate_celsius;
    let derate = entry.value.unwrap_or(DERATE_CELSIUS.min(max - DERATING_CELSIUS));
    if derate >= max {
        findings.error(entry.at, Wrong::DerateOrder { derate, max });
    }
    [derate, max]
}

/// The effective limits of every motor and where they come from, in the order of `settings.motors`;
/// `text` is the file.
pub(crate) fn explained(document: &Document, settings: &Settings, text: &str) -> Vec<Vec<Limit>> {
    let motors = document.motors.iter().zip(&settings.motors);
    motors.map(|(item, motor)| Explained { text, keys: &item.keys, motor }.limits()).collect()
}

/// A motor, as it is written and as it is built.
struct Explained<'a> {
    text: &'a str,
    keys: &'a MotorTables,
    motor: &'a MotorSettings,
}

impl Explained<'_> {
    fn limits(&self) -> Vec<Limit> {
        let (keys, is) = (&self.keys.limits, &self.motor.limits);
        let rated = (&self.keys.keys.rated_torque_nm, self.motor.winding.rated_torque);
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
            self.limit(
                &keys.torque_response_percent,
                keys.torque_response_percent.value as f32,
                Origin::Default,
            ),
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

    /// The default is the rated torque, limited to the range of the protocol.
    fn torque(&self) -> Origin {
        if self.motor.limits.torque < self.motor.winding.rated_torque {
            return Origin::Protocol;
        }
        let written = &self.keys.keys.rated_torque_nm;
        if written.is_written { self.fact(written, "") } else { self.rated_torque() }
    }

    /// The default is the rated torque of the model, unless the file gives a smaller peak torque.
    fn rated_torque(&self) -> Origin {
        let peak = &self.keys.keys.peak_torque_nm;
        match self.motor.winding.rated_torque < self.motor.winding.peak_torque {
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
