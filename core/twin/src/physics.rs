//! The physics of a configuration: from [`Settings`] to the bus and the motors of the simulator.
//!
//! The only place that does it. The daemon, `motord-sim` and the tests take it from here, and
//! change what they need.

use motord_bus::Duration;
use motord_protocol::imu::CanProtocol;
use motord_protocol::profile::{FaultReply, FaultReport, Healthy, Profile, Status, Temperature};
use motord_protocol::{Faults, Model};
use motord_settings::sensor::imu::{ImuCan, ImuSettings, ImuSimulation};
use motord_settings::settings::{MotorSettings, MotorSimulation, Settings};
use motord_simulator::{
    self as simulator, Dialect, DriveFacts, FaultFacts, ImuNodeDevice, ImuNodeSettings, SimulatedBus,
    TemperatureFacts,
};

/// The current of the largest torque code, A (MIT document 1.1).
const CURRENT_MAX: f64 = 225.0;

/// The simulated twin of a bus, with its motors. `bus` is its index in `settings`: a serial line if
/// it is one, else CAN. Everything that the configuration does not say is the simulator's default.
#[must_use]
pub fn physics(settings: &Settings, bus: usize) -> (simulator::BusSettings, Vec<simulator::MotorSettings>) {
    let twins = settings.motors.iter().zip(&settings.simulation).filter(|(motor, _)| motor.bus == bus);
    let turn = settings.buses[bus].every.get() * settings.cycle.period;
    let reporting = |twin| simulator::MotorSettings { report_period: turn, ..twin };
    let motors = twins.map(|(motor, simulation)| reporting(twin(motor, simulation))).collect();
    let imus = imus(settings, bus);
    let bus = &settings.buses[bus];
    let medium = if bus.is_line() { simulator::Medium::Serial } else { simulator::Medium::Can };
    let (name, bitrate, data_bitrate) = (bus.name.clone(), bus.kind.bitrate(), bus.kind.data_bitrate());
    (simulator::BusSettings { name, medium, bitrate, data_bitrate, imus, ..Default::default() }, motors)
}

/// The simulated twins of the IMUs on a bus.
fn imus(settings: &Settings, bus: usize) -> Vec<ImuNodeSettings> {
    let twin = |imu: &ImuSettings| {
        let ImuCan { device, simulation, .. } = imu.source.can().filter(|can| can.bus == bus)?;
        let address = device.address();
        let device = match device.protocol() {
            CanProtocol::Hipnuc => {
                let period = Duration::from_secs_f64(1.0 / imu.rate_hz);
                ImuNodeDevice::Hipnuc { node: address.node_id, period }
            }
            CanProtocol::Damiao => ImuNodeDevice::Damiao {
                firmware: address.firmware,
                id: address.can_id,
                reply_id: address.master_id,
            },
        };
        let ImuSimulation { noise, bias, delay, seed } = *simulation;
        Some(ImuNodeSettings { name: imu.name.clone(), device, noise, bias, delay, seed })
    };
    settings.sensors.imus.iter().filter_map(twin).collect()
}

/// The simulated bus of a configuration, with its motors at rest. `seed` decides everything that is
/// random in it.
#[must_use]
pub fn simulate(settings: &Settings, bus: usize, seed: u64) -> SimulatedBus {
    let (bus, motors) = physics(settings, bus);
    SimulatedBus::new(bus, motors, seed)
}

/// Torque constant of the rotor, N·m/A. That of a SteadyWin motor follows from its torque codes,
/// which the configuration may have changed; that of any other motor is its model's.
fn torque_constant(motor: &MotorSettings, model: Option<&Model>, gear_ratio: f64) -> f64 {
    match model {
        Some(model) if motor.protocol.family().ends_of(model).is_some() => f64::from(model.torque_constant),
        _ => motor.scales.torque.max() / (CURRENT_MAX * gear_ratio),
    }
}

/// Mechanics that few vendors publish: else those of the simulator's default, a GIM8108-8, scaled
/// to the model. An estimate: a real motor may have half or twice as much.
struct Mechanics {
    rotor_inertia: f64,
    viscous_friction: f64,
    coulomb_friction: f64,
}

impl Mechanics {
    /// Dry friction is a share of the rated torque. Viscous friction is another at the highest
    /// velocity.
    fn of(model: &Model, defaults: &simulator::MotorSettings) -> Self {
        let reference = Model::by_name(REFERENCE).unwrap_or(model);
        let torque = f64::from(model.rated_torque / reference.rated_torque);
        let velocity = f64::from(model.max_velocity / reference.max_velocity);
        let estimated = defaults.rotor_inertia * rotor_size(model) / rotor_size(reference);
        Self {
            rotor_inertia: model.rotor_inertia.map_or(estimated, f64::from),
            viscous_friction: defaults.viscous_friction * torque / velocity,
            coulomb_friction: defaults.coulomb_friction * torque,
        }
    }
}

/// The model that the simulator's defaults are.
const REFERENCE: &str = "GIM8108-8";
/// The inertia of similar rotors grows with this power of their torque.
const SIMILARITY: f64 = 5.0 / 3.0;
/// Height times diameter to the fourth power of a rotor that gives 1 N·m, mm⁵. It comes from the
/// reference, so that the sizes from names and from torques compare.
const SIZE_PER_TORQUE: f64 = 6.4e7;

/// Proportional to the rotor's inertia, mm⁵. Diameter and height are in most names, GIM8108: 81 mm
/// and 8 mm; else the peak torque of the rotor tells the size.
fn rotor_size(model: &Model) -> f64 {
    let letters = |c: char| !c.is_ascii_digit();
    let digits = model.name.trim_start_matches(letters).split(letters).next().unwrap_or_default();
    match digits.split_at_checked(digits.len().saturating_sub(2)) {
        Some((diameter, height)) if diameter.len() >= 2 => {
            let number = |text: &str| text.parse().unwrap_or(1.0_f64);
            number(diameter).powi(4) * number(height)
        }
        _ => SIZE_PER_TORQUE * f64::from(model.peak_torque / model.gear_ratio).powf(SIMILARITY),
    }
}

/// Inertia of the rotor of a model behind its gear, as it is simulated, kg·m²: the vendor's, or an
/// estimate. `None` for an unknown model.
#[must_use]
pub fn armature(model: &str) -> Option<f64> {
    let model = Model::by_name(model)?;
    let rotor = Mechanics::of(model, &simulator::MotorSettings::default()).rotor_inertia;
    Some(rotor * f64::from(model.gear_ratio).powi(2))
}

/// The simulated twin of a configured motor.
fn twin(motor: &MotorSettings, simulation: &MotorSimulation) -> simulator::MotorSettings {
    let defaults = simulator::MotorSettings::default();
    let model = Model::by_name(&motor.model);
    let of_model = || model.map_or(defaults.gear_ratio, |model| f64::from(model.gear_ratio));
    let gear_ratio = motor.constants.map_or_else(of_model, |constants| constants.gear_ratio);
    let family = motor.protocol.family();
    let ends = model.map_or(family.ends, |model| family.ends_of(model)).map(|_| motor.scales.ends());
    let twin = simulator::MotorSettings {
        name: motor.name.clone(),
        id: u16::from(motor.id),
        host_id: u16::try_from(motor.host_id.raw()).unwrap_or(u16::MAX),
        dialect: Dialect::by_name(motor.protocol.name()).unwrap_or(defaults.dialect),
        vendor: motor.profile.name,
        drive: Some(drive(motor.profile)),
        ends: ends.map(|ends| [ends.position, ends.velocity, ends.torque]),
        gain_ends: [motor.scales.kp.max(), motor.scales.kd.max()],
        torque_constant: torque_constant(motor, model, gear_ratio),
        gear_ratio,
        initial_position: simulation.initial_position,
        load_inertia: simulation.load_inertia,
        reply_latency: simulation.reply_latency,
        ..defaults
    };
    let twin = model.map_or(twin.clone(), |model| self::of_model(model, twin));
    let rotor_inertia =
        simulation.armature.map_or(twin.rotor_inertia, |armature| armature / gear_ratio.powi(2));
    simulator::MotorSettings {
        rotor_inertia,
        viscous_friction: simulation.viscous_friction.unwrap_or(twin.viscous_friction),
        coulomb_friction: simulation.coulomb_friction.unwrap_or(twin.coulomb_friction),
        ..twin
    }
}

/// With the properties of its model.
fn of_model(model: &Model, twin: simulator::MotorSettings) -> simulator::MotorSettings {
    let Mechanics { rotor_inertia, viscous_friction, coulomb_friction } = Mechanics::of(model, &twin);
    // A resistance of zero is not published.
    let is_published = model.phase_resistance > 0.0;
    simulator::MotorSettings {
        torque_peak: f64::from(model.peak_torque),
        velocity_max: f64::from(model.max_velocity),
        rotor_inertia,
        viscous_friction,
        coulomb_friction,
        winding_resistance: if is_published {
            model.phase_resistance.into()
        } else {
            twin.winding_resistance
        },
        pole_pairs: model.pole_pairs,
        supply_voltage: model.rated_voltage.into(),
        ..twin
    }
}

// The drive of a vendor, from its profile to the facts of the simulator, which shares no type with
// it.

/// The part whose temperature is that of the winding.
const WINDING: &str = "motor";

/// Returns the facts of a vendor's drive.
pub(crate) fn drive(profile: &Profile) -> DriveFacts {
    let special = profile.special;
    let named = |faults: &[Faults]| {
        let number = profile.fault_numbers().find(|(_, known)| faults.contains(known));
        number.map_or(0, |(number, _)| number)
    };
    DriveFacts {
        start: special.start,
        stop: special.stop,
        zero: special.zero,
        clear: special.clear,
        bytes: profile.reply.lengths[0],
        id_bits: profile.reply.id_mask,
        temperatures: profile.reply.temperatures.iter().map(temperature).collect(),
        faults: faults(&profile.faults),
        conditions: [
            named(&[Faults::OVER_VOLTAGE]),
            named(&[Faults::UNDER_VOLTAGE]),
            named(&[Faults::OVER_TEMPERATURE, Faults::MOTOR_OVER_TEMPERATURE]),
        ],
        has_registers: profile.has_registers,
    }
}

fn temperature(field: &Temperature) -> TemperatureFacts {
    TemperatureFacts {
        of_winding: field.of == WINDING,
        byte: field.at,
        bits: field.bits,
        codes_per_ten: (10.0 * field.per_celsius).round() as u32,
    }
}

fn faults(report: &FaultReport) -> FaultFacts {
    match *report {
        FaultReport::Asked(FaultReply { bytes: number, lengths: [bytes, _], .. }) => {
            FaultFacts::Asked { number, bytes }
        }
        FaultReport::InEveryReply(Status { at: byte, shift, healthy, .. }) => {
            let healthy = match healthy {
                Healthy::Mode { off, on } => [off, on],
                Healthy::Code(code) => [code; 2],
            };
            FaultFacts::Code { byte, shift, healthy }
        }
        FaultReport::Never => FaultFacts::Never,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_protocol::{FAMILIES, MotorProtocol};

    #[test]
    fn every_protocol_has_a_simulated_motor() {
        let unknown = FAMILIES.iter().filter(|(name, _)| Dialect::by_name(name).is_none());
        assert_eq!(unknown.collect::<Vec<_>>(), Vec::<&(&str, MotorProtocol)>::new());
    }
}
