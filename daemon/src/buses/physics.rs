//! The physics of a configuration: from [`Settings`] to the bus and the motors of the simulator.
//!
//! The only place that does it. The daemon, `motord-sim` and the tests take it from here, and change what they need.

use motord_core::settings::{BusKind, MotorProtocol, MotorSettings, Settings};
use motord_protocol::Model;
use motord_simulator::{self as simulator, Dialect, SimulatedBus};

/// The current of the largest torque code, A (MIT document 1.1).
const CURRENT_MAX: f64 = 225.0;

/// The simulated twin of a bus, with its motors. `bus` is its index in `settings`: a serial line if it is
/// one, else CAN. Everything that the configuration does not say is the simulator's default.
#[must_use]
pub fn physics(settings: &Settings, bus: usize) -> (simulator::BusSettings, Vec<simulator::MotorSettings>) {
    let motors = settings.motors.iter().filter(|motor| motor.bus == bus).map(twin).collect();
    let bus = &settings.buses[bus];
    let kind = match bus.kind {
        BusKind::Serial { .. } => simulator::BusKind::Serial,
        BusKind::SocketCan { .. } | BusKind::Simulated { .. } => simulator::BusKind::Can,
    };
    let (name, bitrate) = (bus.name.clone(), bus.kind.bitrate());
    (simulator::BusSettings { name, kind, bitrate, ..Default::default() }, motors)
}

/// The simulated bus of a configuration, with its motors at rest. `seed` decides everything that is random in it.
#[must_use]
pub fn simulate(settings: &Settings, bus: usize, seed: u64) -> SimulatedBus {
    let (bus, motors) = physics(settings, bus);
    SimulatedBus::new(bus, motors, seed)
}

/// Of the rotor, N·m/A: what the codes of a SteadyWin motor say, which the configuration may have changed; else its model's.
fn torque_constant(motor: &MotorSettings, model: Option<&Model>, gear_ratio: f64) -> f64 {
    match model {
        Some(Model { torque_constant, ends: Some(_), .. }) => f64::from(*torque_constant),
        _ => motor.scales.torque.max() / (CURRENT_MAX * gear_ratio),
    }
}

/// The simulated twin of a configured motor.
fn twin(motor: &MotorSettings) -> simulator::MotorSettings {
    let defaults = simulator::MotorSettings::default();
    let model = Model::by_name(&motor.model);
    let gear_ratio = model.map_or(defaults.gear_ratio, |model| f64::from(model.gear_ratio));
    simulator::MotorSettings {
        name: motor.name.clone(),
        id: u16::from(motor.id),
        host_id: motor.host_id.raw(),
        dialect: match motor.protocol {
            MotorProtocol::Mit => Dialect::Mit,
            MotorProtocol::Gim => Dialect::Gim,
        },
        vendor: motor.profile.name,
        ends: model.and_then(|model| model.ends),
        torque_constant: torque_constant(motor, model, gear_ratio),
        gear_ratio,
        torque_peak: model.map_or(defaults.torque_peak, |model| f64::from(model.peak_torque)),
        velocity_max: model.map_or(defaults.velocity_max, |model| f64::from(model.max_velocity)),
        initial_position: motor.simulation.initial_position,
        load_inertia: motor.simulation.load_inertia,
        reply_latency: motor.simulation.reply_latency,
        ..defaults
    }
}
