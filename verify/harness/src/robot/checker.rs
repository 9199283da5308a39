//! Converts the robot's data to the types of the invariant checker.

use super::Robot;
use super::ranges::protocol;
use motord_bus::Instant;
use motord_checker::robot::{Bound, Group, Limits, Motor, SafeStop};
use motord_checker::run::{self, BusFault, MotorFault, Request};
use motord_checker::state::{self, Bus, Joint, Mode, Phase, State};
use motord_checker::vendor::Vendor;
use motord_settings::settings::{self, MotorSettings, Settings};
use motord_shared::{
    AdminRequest, BusCondition, BusState, Cause, GroupState, JointState, Limit, MotorMode, Operation,
    StateMessage, message,
};

pub use motord_checker::run::WRONG_LEASE_VELOCITY;
pub use motord_checker::vendor::VENDORS;

/// The checker of one robot.
#[derive(Debug)]
pub struct Checker(run::Checker);

impl Checker {
    /// Begins to check `robot`.
    pub fn new(robot: &Robot) -> Self {
        Self(run::Checker::new(description(robot), robot.now()))
    }

    /// Buses lose frames from now on: counters no longer match the wire.
    pub fn allow_loss(&mut self) {
        self.0.allow_loss();
    }

    /// Notes a fault of a bus.
    pub fn disturbed_bus(&mut self, bus: usize, fault: &str) {
        match fault {
            "gone" | "down" | "bus-off" => self.0.disturb_bus(bus, BusFault::Cut),
            "no-ack" | "tx-full" | "tx-full 1" | "blocked" => self.0.disturb_bus(bus, BusFault::Blocked),
            "ok" => self.0.disturb_bus(bus, BusFault::Lifted),
            _ => {}
        }
    }

    /// Notes a fault of a motor.
    pub fn disturbed_motor(&mut self, motor: usize, fault: &str) {
        match fault {
            "off" => self.0.disturb_motor(motor, MotorFault::Off),
            "ok" => self.0.disturb_motor(motor, MotorFault::Lifted),
            _ => {}
        }
    }

    /// Notes a request.
    pub fn asked(&mut self, request: &AdminRequest) {
        let (group, motor) = (request.group as usize, request.joint as usize);
        self.0.asked(match Operation::try_from(request.operation) {
            Ok(Operation::Reset) => Request::Reset { group },
            Ok(Operation::Enable) => Request::Enable { group },
            Ok(Operation::SetZero) => Request::SetZero { motor },
            Ok(Operation::ClearFault) => Request::ClearFault { motor },
            _ => return,
        });
    }

    /// Notes a valid message of the group's owner.
    pub fn good_setpoint(&mut self, group: usize, end: Instant) {
        self.0.good_setpoint(group, end);
    }

    /// Notes any message that names the group.
    pub fn delivered(&mut self, group: usize) {
        self.0.delivered(group);
    }

    /// Checks the cycle that `robot` has just run.
    pub fn check(&mut self, robot: &mut Robot) {
        let state = published(&robot.state());
        let commands: Vec<_> = robot.take_sent().iter().map(super::Sent::command).collect();
        self.0.check(state, &commands, &robot.take_replies());
    }
}

fn description(robot: &Robot) -> motord_checker::robot::Robot {
    let settings = &robot.settings;
    motord_checker::robot::Robot {
        motors: settings.motors.iter().map(|motor| self::motor(motor, settings)).collect(),
        groups: settings.groups.iter().map(group).collect(),
        buses: settings.buses.len(),
        period: super::PERIOD,
        setpoint_timeout: settings.safety.setpoint_timeout,
        lost_cycles: settings.safety.lost_cycles,
    }
}

fn motor(settings: &MotorSettings, robot: &Settings) -> Motor {
    let bus = &robot.buses[settings.bus];
    let addresses = settings.addresses();
    Motor {
        name: settings.name.clone(),
        bus: settings.bus,
        id: settings.id,
        commands: addresses.receives(),
        // A reply on a line is recorded under the id of the motor that was asked.
        replies: if bus.is_line() { addresses.commands } else { addresses.replies },
        protocol: protocol(settings),
        turn: bus.every.get(),
        direction: f64::from(settings.transmission.direction()),
        offset: f64::from(settings.transmission.offset()),
        damping_kd: f64::from(settings.damping_kd),
        limits: limits(&settings.limits),
    }
}

/// Returns the simulation's command for `fault` of a motor of `vendor`: a drive raises a number of
/// its vendor's list.
#[must_use]
pub fn of_vendor(fault: &'static str, vendor: &str) -> &'static str {
    match fault {
        "fault over-voltage" => Vendor::named(vendor).over_voltage,
        "fault over-current" => Vendor::named(vendor).over_current,
        _ => fault,
    }
}

fn limits(settings: &settings::LimitSettings) -> Limits {
    let bound = |most: f32, slew: f32| Bound { most: most.into(), slew: slew.into() };
    Limits {
        position: settings.position.map(f64::from),
        velocity: settings.velocity.into(),
        torque: bound(settings.torque, settings.torque_slew),
        kp: bound(settings.kp, settings.kp_slew),
        kd: bound(settings.kd, settings.kd_slew),
    }
}

fn group(settings: &settings::GroupSettings) -> Group {
    let safe_stop = match settings.safe_stop {
        settings::SafeStop::Hold => SafeStop::Hold,
        settings::SafeStop::Stop => SafeStop::Stop,
        settings::SafeStop::Damp => SafeStop::Damp,
    };
    Group { motors: settings.motors.clone(), safe_stop }
}

fn published(state: &StateMessage) -> State {
    State {
        cycle: state.cycle,
        missed_ticks: state.overruns,
        begun: Instant::from_nanos(state.tick_ns + state.wake_latency_ns),
        joints: state.joints().iter().map(joint).collect(),
        groups: state.groups().iter().map(group_state).collect(),
        buses: state.buses().iter().map(bus).collect(),
    }
}

fn joint(joint: &JointState) -> Joint {
    Joint {
        position: joint.position,
        velocity: joint.velocity,
        applied_kp: joint.applied.kp,
        applied_kd: joint.applied.kd,
        applied_velocity: joint.applied.velocity,
        slews: joint.limits & Limit::PositionSlew.bit() != 0,
        fresh: joint.flags & message::JOINT_FRESH != 0,
        valid: joint.flags & message::JOINT_VALID != 0,
        mode: match MotorMode::try_from(joint.mode).expect("modes are known") {
            MotorMode::Offline => Mode::Offline,
            MotorMode::Idle => Mode::Idle,
            MotorMode::Starting => Mode::Starting,
            MotorMode::Active => Mode::Active,
            MotorMode::Damping => Mode::Damping,
            MotorMode::Fault => Mode::Fault,
            MotorMode::Excluded => Mode::Excluded,
        },
        age_cycles: joint.age_cycles,
        missed: joint.missed,
        late: joint.late,
        receive_ns: joint.receive_ns,
    }
}

fn group_state(group: &GroupState) -> state::Group {
    let messages = group.rejected.iter().fold(group.accepted, |sum, count| sum.wrapping_add(*count));
    state::Group {
        phase: match motord_shared::Phase::try_from(group.phase).expect("phases are known") {
            motord_shared::Phase::Disarmed => Phase::Disarmed,
            motord_shared::Phase::Starting => Phase::Starting,
            motord_shared::Phase::Active => Phase::Active,
            motord_shared::Phase::Damping => Phase::Damping,
        },
        cause: match Cause::try_from(group.cause) {
            Err(_) if group.cause == 0 => state::Cause::None,
            Ok(Cause::SetpointTimeout) => state::Cause::SetpointTimeout,
            Ok(Cause::OwnerLost | Cause::OwnerDied) => state::Cause::OwnerLost,
            Ok(Cause::EmergencyStop) => state::Cause::EmergencyStop,
            _ => state::Cause::Other(group.cause),
        },
        messages,
    }
}

fn bus(bus: &BusState) -> Bus {
    let BusState { sent, dropped, received, unexpected_id, duplicate, malformed, errors, lost, .. } = *bus;
    let lost_conditions =
        [BusCondition::Off, BusCondition::Down, BusCondition::Gone, BusCondition::Exchanged]
            .map(BusCondition::code);
    Bus {
        given_up: lost_conditions.contains(&bus.condition),
        held: bus.condition == BusCondition::Held.code(),
        sent,
        counters: [sent, dropped, received, unexpected_id, duplicate, malformed, errors, lost],
    }
}
