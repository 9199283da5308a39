//! Encodes the messages of a cycle from shared memory to Protobuf.

use crate::events::{Event, Level};
use crate::{foxglove, motord};
use motord_shared::description::RobotDescription;
use motord_shared::message::{
    FLAG_CONFIG_CHANGED, FLAG_EMERGENCY_STOP, FLAG_OVERRUN, FLAG_REALTIME, FLAG_SHUTDOWN, IMU_FRESH,
    IMU_LOST, IMU_VALID, JOINT_FRESH, JOINT_VALID,
};
use motord_shared::{
    Applied, BusCondition, BusState, Cause, GroupState, ImuState, Indicator, JointIndicators, JointSetpoint,
    JointState, MotorMode, Phase, SetpointMode, StateMessage,
};

/// Returns the name of a code; an invalid number represents itself.
fn name<T: TryFrom<u32> + ToString>(code: u32) -> String {
    T::try_from(code).map_or_else(|_| code.to_string(), |known| known.to_string())
}

/// Returns the value of a row's kind in Protobuf.
macro_rules! encoded {
    ([Measured] $joint:ident $name:ident) => {
        ($joint.flags & JOINT_VALID != 0).then_some($joint.$name)
    };
    ([Optional] $joint:ident $name:ident) => {
        Some($joint.$name).filter(|value| value.is_finite())
    };
    ([Command] $joint:ident $name:ident) => {
        Some(command(&$joint.$name))
    };
    ([Code $code:ident] $joint:ident $name:ident) => {
        name::<$code>($joint.$name)
    };
    ($kind:tt $joint:ident $name:ident) => {
        $joint.$name
    };
}

macro_rules! define {
    ({ $({ $kind:tt $name:ident $proto:ident })+ } { $({ $flag:ident $bits:ident $number:literal })+ }) => {
        pub(crate) fn joint(cycle: u64, joint: &JointState, setpoint: Option<&JointSetpoint>) -> motord::Joint {
            motord::Joint {
                cycle,
                setpoint: setpoint.map(self::setpoint),
                $($proto: encoded!($kind joint $name),)+
                $($flag: joint.flags & $bits != 0,)+
            }
        }
    };
}

motord_shared::joint_state!(recording define);

fn setpoint(setpoint: &JointSetpoint) -> motord::Setpoint {
    let JointSetpoint { position, velocity, kp, kd, torque, mode } = *setpoint;
    motord::Setpoint { position, velocity, kp, kd, torque, mode: name::<SetpointMode>(mode) }
}

fn command(applied: &Applied) -> motord::Command {
    let Applied { position, velocity, kp, kd, torque } = *applied;
    motord::Command { position, velocity, kp, kd, torque }
}

pub(crate) fn imu(cycle: u64, imu: &ImuState) -> motord::Imu {
    let ImuState { orientation, temperature, flags, missing, rejected, sequence, receive_ns, .. } = *imu;
    let is_valid = flags & IMU_VALID != 0;
    let [w, x, y, z] = orientation;
    motord::Imu {
        cycle,
        sequence,
        orientation: is_valid.then_some(motord::Quaternion { w, x, y, z }),
        angular_velocity: is_valid.then(|| vector(imu.angular_velocity)),
        acceleration: is_valid.then(|| vector(imu.acceleration)),
        temperature: Some(temperature).filter(|value| value.is_finite()),
        fresh: flags & IMU_FRESH != 0,
        valid: is_valid,
        lost: flags & IMU_LOST != 0,
        contradictions: imu.contradictions(),
        missing,
        rejected,
        receive_ns,
    }
}

fn vector([x, y, z]: [f32; 3]) -> motord::Vector {
    motord::Vector { x, y, z }
}

pub(crate) fn group(cycle: u64, group: &GroupState, robot: &RobotDescription) -> motord::Group {
    let joint = robot.joints.get(group.cause_joint as usize);
    motord::Group {
        cycle,
        phase: name::<Phase>(group.phase),
        cause: if group.cause == 0 { String::new() } else { name::<Cause>(group.cause) },
        cause_joint: joint.map(|joint| joint.name.clone()).unwrap_or_default(),
        cause_pid: group.cause_pid,
        lease: group.lease,
        sequence: group.sequence,
        setpoint_age_ns: group.setpoint_age_ns,
        answered_cycle: group.answered_cycle,
        used_cycle: group.used_cycle,
        accepted: group.accepted,
        late: group.late,
        rejected: group.rejected.to_vec(),
        setpoint_horizon_ns: group.setpoint_horizon_ns.into(),
    }
}

pub(crate) fn bus(cycle: u64, bus: &BusState) -> motord::Bus {
    let condition = name::<BusCondition>(bus.condition);
    let BusState { sent, dropped, received, unexpected_id, duplicate, malformed, errors, lost, .. } = *bus;
    motord::Bus {
        cycle,
        condition,
        sent,
        dropped,
        received,
        unexpected_id,
        duplicate,
        malformed,
        errors,
        lost,
    }
}

pub(crate) fn cycle(state: &StateMessage, sequence: u64) -> motord::Cycle {
    let has = |flag: u32| state.flags & flag != 0;
    let StateMessage { cycle, tick_ns, wake_latency_ns, publish_ns, overruns, boot_id, .. } = *state;
    motord::Cycle {
        cycle,
        tick_ns,
        wake_latency_ns,
        publish_ns,
        overruns,
        emergency_stop: has(FLAG_EMERGENCY_STOP),
        realtime: has(FLAG_REALTIME),
        overrun: has(FLAG_OVERRUN),
        shutting_down: has(FLAG_SHUTDOWN),
        config_changed: has(FLAG_CONFIG_CHANGED),
        boot_id,
        sequence,
    }
}

pub(crate) fn indicators(indicators: &JointIndicators) -> motord::Indicators {
    let known = |indicator: &Indicator| {
        let value = indicators.values.get(indicator.code() as usize).copied()?;
        value.is_finite().then(|| (indicator.name().to_owned(), value))
    };
    motord::Indicators { values: Indicator::ALL.iter().filter_map(known).collect() }
}

pub(crate) fn log(event: &Event, unix_ns: u64) -> foxglove::Log {
    let level = match event.level {
        Level::Debug => foxglove::log::Level::Debug,
        Level::Info => foxglove::log::Level::Info,
        Level::Warning => foxglove::log::Level::Warning,
        Level::Error => foxglove::log::Level::Error,
    };
    let seconds = i64::try_from(unix_ns / 1_000_000_000).unwrap_or(i64::MAX);
    let timestamp = prost_types::Timestamp { seconds, nanos: (unix_ns % 1_000_000_000) as i32 };
    foxglove::Log {
        timestamp: Some(timestamp),
        level: level.into(),
        message: format!("{} {}", event.subject, event.text).trim_start().to_owned(),
        name: event.subject.clone(),
    }
}
