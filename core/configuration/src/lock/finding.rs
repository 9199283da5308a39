//! Compares what a motor reports about itself with its configuration.

use super::Lock;
use motord_protocol::commissioning::{ReportedMotor, ReportedProtocol};
use motord_protocol::register::{self, END_NAMES};
use motord_protocol::{DriveConstants, Ends};
use motord_settings::settings::{MotorSettings, Settings};
use std::fmt::{self, Display};

/// Largest relative difference of torque constants. The vendor's figures of one motor differ by
/// this much.
const TORQUE_CONSTANT_TOLERANCE: f64 = 0.05;
/// The motor stores an integer: other gear ratios cannot be stored (GIM document, table 7).
const GEAR_RATIO_TOLERANCE: f64 = 0.5;

/// One value of one motor.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// The motor's name.
    pub motor: String,
    /// The value, such as `torque-constant`.
    pub value: &'static str,
    /// As configured.
    pub configured: String,
    /// As the motor reports; `None` when it cannot be read.
    pub reported: Option<String>,
    /// The result of the comparison.
    pub verdict: Verdict,
    /// How to make them agree.
    pub cure: String,
}

/// The result of comparing a motor with its configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// They agree.
    Agrees,
    /// They differ: the motor must not be armed.
    Differs,
    /// It cannot be read: a person must check it.
    Unknown,
}

impl fmt::Display for Finding {
    /// Writes a sentence for a person.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { motor, value, configured, reported, cure, .. } = self;
        match reported {
            Some(reported) => {
                write!(
                    f,
                    "{motor}: {value} is {reported} in the motor, {configured} in the configuration: {cure}"
                )
            }
            None => {
                write!(f, "{motor}: {value} is {configured} in the configuration, and cannot be read: {cure}")
            }
        }
    }
}

/// Returns every value of a motor that can be compared. `reported` is `None` for a motor that does
/// not answer.
#[must_use]
pub fn findings(
    settings: &Settings,
    motor: &MotorSettings,
    reported: Option<&ReportedMotor>,
) -> Vec<Finding> {
    let Some(reported) = reported else {
        return vec![Finding {
            motor: motor.name.clone(),
            value: "answer",
            configured: format!("id {}", motor.id),
            reported: None,
            verdict: Verdict::Unknown,
            cure: format!(
                "check its power, wiring, id and protocol{}; `motorctl scan --bus {}` lists the motors that answer",
                factory_bit_rate(settings, motor),
                settings.buses[motor.bus].device()
            ),
        }];
    };
    let compare = Compare { motor, bus: settings.buses[motor.bus].device(), reported };
    let mut findings = compare.address(&settings.buses[motor.bus].name);
    if let Some(constants) = motor.constants {
        findings.extend(compare.constants(&constants));
    }
    findings
}

/// Returns the bit rate that a motor has from the factory, in words, if its bus has another one.
fn factory_bit_rate(settings: &Settings, motor: &MotorSettings) -> String {
    let bitrate = settings.buses[motor.bus].kind.bitrate();
    match motor.protocol.family().factory_bitrate {
        Some(factory) if factory != bitrate => format!(
            ", and its bit rate: from the factory it has {factory} bit/s, and this bus has {bitrate} bit/s (set it with the vendor's \
             tool)"
        ),
        _ => String::new(),
    }
}

/// Keys of the ends that a motor reports, in the order of its registers.
const END_KEYS: [&str; 3] = ["position-end-rad", "velocity-end-rad-s", "torque-end-nm"];

/// Returns the lines of a configuration for the ends that `motor` reports, rad, rad/s and N·m, if
/// the configuration or the model has others.
#[must_use]
pub fn end_lines(motor: &MotorSettings, reported: [f32; 3]) -> Option<String> {
    let Ends { position, velocity, torque, .. } = motor.scales.ends();
    let is_other = |(end, reported): (f64, f32)| (f64::from(reported) / end - 1.0).abs() > 1e-3;
    let is_usable = reported.iter().all(|end| end.is_finite() && *end > 0.0);
    let differs = is_usable && [position, velocity, torque].into_iter().zip(reported).any(is_other);
    let lines = || END_KEYS.iter().zip(reported).map(|(key, end)| format!("{key} = {end:?}"));
    differs.then(|| lines().collect::<Vec<_>>().join("\n"))
}

/// Compares the ends of a motor's codes, rad, rad/s and N·m, as it reports them with those that are
/// written, or, if none are, with the limits of its joint. A motor with other ends moves with
/// another velocity or torque than it is sent, and nothing on the wire shows that.
#[must_use]
pub fn end_findings(motor: &MotorSettings, reported: [f32; 3]) -> Vec<Finding> {
    let Ends { position, velocity, torque, .. } = motor.scales.ends();
    let ends = [position, velocity, torque];
    let finding = |index: usize| {
        let (value, register, key) = (END_NAMES[index], register::ENDS[index], END_KEYS[index]);
        let (range, end, reported) = (motor.registers[index], ends[index], reported[index]);
        // A range that is narrow was written.
        let is_written = range.most < 1.1 * range.least;
        let least = (1000.0 * f64::from(range.least)).ceil() / 1000.0;
        let (configured, cure) = match is_written {
            true => (
                format!("{end}"),
                format!(
                    "the motor scales by its register: if it is the right motor, write {key} = {reported:?}; otherwise write {end} \
                     to register {register} ({value}) with the vendor's tool"
                ),
            ),
            false => (
                format!("at least {least} by the limits"),
                format!(
                    "lower the limits of the joint, or write {end} to register {register} ({value}) with the vendor's tool"
                ),
            ),
        };
        Finding {
            motor: motor.name.clone(),
            value,
            configured,
            reported: Some(format!("{reported:?}")),
            verdict: if range.contains(reported) { Verdict::Agrees } else { Verdict::Differs },
            cure,
        }
    };
    (0..ends.len()).map(finding).collect()
}

/// Returns every difference between motors and configuration. Motors without an entry in the lock
/// are no mismatch.
#[must_use]
pub fn mismatches(settings: &Settings, lock: &Lock) -> Vec<Finding> {
    let locked = settings.motors.iter().filter_map(|motor| Some((motor, lock.motor(&motor.name)?)));
    let all = locked.flat_map(|(motor, reported)| findings(settings, motor, Some(reported)));
    all.filter(|finding| finding.verdict == Verdict::Differs).collect()
}

struct Compare<'a> {
    motor: &'a MotorSettings,
    /// The interface or device.
    bus: &'a str,
    reported: &'a ReportedMotor,
}

impl Compare<'_> {
    fn finding(
        &self,
        value: &'static str,
        configured: String,
        reported: Option<String>,
        agrees: bool,
        cure: String,
    ) -> Finding {
        let verdict = match (&reported, agrees) {
            (None, _) => Verdict::Unknown,
            (Some(_), true) => Verdict::Agrees,
            (Some(_), false) => Verdict::Differs,
        };
        Finding { motor: self.motor.name.clone(), value, configured, reported, verdict, cure }
    }

    /// Bus, ids and protocol.
    fn address(&self, bus: &str) -> Vec<Finding> {
        let Self { motor, reported, .. } = self;
        let setup = |key: &str, reported: &dyn Display| {
            format!(
                "write `{key} = {reported}`; or, only if you exchanged motors on purpose, run `motorctl setup` again"
            )
        };
        let host_id = motor.host_id.raw();
        vec![
            self.finding(
                "bus",
                bus.into(),
                Some(reported.bus.clone()),
                reported.bus == bus,
                setup("bus", &format!("\"{}\"", reported.bus)),
            ),
            self.finding(
                "id",
                motor.id.to_string(),
                Some(reported.id.to_string()),
                reported.id == motor.id,
                setup("id", &reported.id),
            ),
            self.finding(
                "host-id",
                format!("{host_id:#x}"),
                reported.host_id.map(|id| format!("{id:#x}")),
                reported.host_id == Some(host_id),
                self.host_id_cure(),
            ),
            self.protocol(),
        ]
    }

    /// On a serial line a host id is one byte, so another one of the motor cannot be configured.
    fn host_id_cure(&self) -> String {
        let host_id = self.motor.host_id.raw();
        let set = self.set("host-id", host_id);
        match self.reported.host_id.unwrap_or(host_id) {
            reported if self.bus.starts_with('/') && reported > u8::MAX.into() => set,
            reported => format!("write `host-id = {reported:#x}`, or {set}"),
        }
    }

    fn protocol(&self) -> Finding {
        let Self { motor, reported, bus } = self;
        let agrees = reported.protocol == (motor.protocol.family().reported)(motor.profile);
        let cure = match reported.protocol {
            ReportedProtocol::RobStride | ReportedProtocol::OtherMit if motor.profile.name == "robstride" => {
                let wanted = motor.protocol.name();
                format!(
                    "write the other protocol; or change the motor with `motorctl protocol {wanted} --config FILE --joint {}`, and power it off and on",
                    motor.name
                )
            }
            ReportedProtocol::Gim | ReportedProtocol::Mit
                if motor.profile.speaks(motord_protocol::gim::FAMILY.name) =>
            {
                let wanted = motor.protocol.name();
                format!(
                    "`motorctl protocol {wanted} --bus {bus} --id {}`, or write the other protocol",
                    motor.id
                )
            }
            ReportedProtocol::CanSimple if motor.profile.speaks(motord_protocol::odrive::FAMILY.name) => {
                "an ODrive speaks only its CANSimple: write `protocol = \"odrive\"`".into()
            }
            ReportedProtocol::CanSimple if motor.profile.speaks(motord_protocol::cansimple::FAMILY.name) => {
                "its driver speaks only CANSimple: write `protocol = \"cansimple\"`".into()
            }
            ReportedProtocol::MyActuator
                if motor.profile.speaks(motord_protocol::myactuator::FAMILY.name) =>
            {
                "the motor has only MyActuator's protocol: write `protocol = \"myactuator\"`".into()
            }
            _ => "the model is not the one that is connected: write the right one".into(),
        };
        self.finding(
            "protocol",
            motor.protocol.name().into(),
            Some(reported.protocol.word().into()),
            agrees,
            cure,
        )
    }

    /// The constants that decide what a torque and an angle are.
    fn constants(&self, constants: &DriveConstants) -> Vec<Finding> {
        let DriveConstants { torque_constant, gear_ratio, pole_pairs } = *constants;
        let near = |reported: f64, wanted: f64, tolerance: f64| (reported - wanted).abs() <= tolerance;
        let torque_tolerance = TORQUE_CONSTANT_TOLERANCE * torque_constant;
        vec![
            self.constant("torque-constant", torque_constant, "torque-constant-nm-per-a", |reported| {
                near(reported, torque_constant, torque_tolerance)
            }),
            self.constant("gear-ratio", gear_ratio, "gear-ratio", |reported| {
                near(reported, gear_ratio, GEAR_RATIO_TOLERANCE)
            }),
            self.constant("pole-pairs", pole_pairs.into(), "model", |reported| {
                near(reported, pole_pairs.into(), 0.0)
            }),
        ]
    }

    fn constant(&self, value: &'static str, wanted: f64, key: &str, agrees: impl Fn(f64) -> bool) -> Finding {
        let reported = self.reported.values.get(value).copied();
        let cure = match reported {
            None => "compare with the label of the motor: it cannot be read in this protocol".into(),
            Some(_) if key == "model" => "the model is another one: write the right one".into(),
            Some(reported) => format!(
                "write `{key} = {}` if the motor is right, or {}",
                rounded(reported),
                self.set(value, rounded(wanted))
            ),
        };
        self.finding(value, rounded(wanted), reported.map(rounded), reported.is_some_and(agrees), cure)
    }

    /// The command that changes the motor.
    fn set(&self, item: &str, value: impl fmt::Display) -> String {
        format!("`motorctl config set {item} {value} --bus {} --id {}`", self.bus, self.motor.id)
    }
}

/// Formats with at most four decimals, without trailing zeros: the constants are floats in the
/// motor.
fn rounded(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
