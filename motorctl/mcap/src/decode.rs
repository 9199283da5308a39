//! Decodes the messages of a cycle from Protobuf to those of shared memory. A file may contain
//! anything: an unknown code name becomes an invalid number.

use crate::motord;
use motord_shared::description::RobotDescription;
use motord_shared::limits::INDICATORS_MAX;
use motord_shared::message::{
    FLAG_CONFIG_CHANGED, FLAG_EMERGENCY_STOP, FLAG_OVERRUN, FLAG_REALTIME, FLAG_SHUTDOWN,
    IMU_CONTRADICTIONS_SHIFT, IMU_FRESH, IMU_LOST, IMU_VALID, JOINT_FRESH, JOINT_VALID, NO_JOINT,
};
use motord_shared::{
    Applied, BusCondition, BusState, Cause, GroupState, ImuState, Indicator, JointSetpoint, JointState,
    MotorMode, Phase, SetpointMode, StateMessage,
};

/// Number for a code name that this version does not know.
const UNKNOWN: u32 = u32::MAX;

/// Decodes the name of a code. A number represents itself.
macro_rules! code {
    ($type:ident, $word:expr) => {{
        let word: &str = $word;
        let known = $type::ALL.iter().find(|known| known.name() == word).map(|known| known.code());
        known.or_else(|| word.parse().ok()).unwrap_or(UNKNOWN)
    }};
}

/// Decodes the value of a row's kind.
macro_rules! decoded {
    ([Measured], $value:expr) => {
        $value.unwrap_or_default()
    };
    ([Optional], $value:expr) => {
        $value.unwrap_or(f32::NAN)
    };
    ([Command], $command:expr) => {
        applied($command.unwrap_or_default())
    };
    ([Code $code:ident], $word:expr) => {
        code!($code, &$word)
    };
    ($kind:tt, $value:expr) => {
        $value
    };
}

macro_rules! define {
    ({ $({ $kind:tt $name:ident $proto:ident })+ } { $({ $flag:ident $bits:ident $number:literal })+ }) => {
        pub(crate) fn joint(joint: &motord::Joint) -> (JointState, Option<JointSetpoint>) {
            // The quantities of a joint without a reply are absent.
            let mut flags = if joint.position.is_some() { JOINT_VALID } else { 0 };
            $(flags |= if joint.$flag { $bits } else { 0 };)+
            #[allow(clippy::needless_update, reason = "a layout may have reserved fields")]
            let state = JointState { $($name: decoded!($kind, joint.$proto),)+ flags, ..JointState::default() };
            (state, joint.setpoint.as_ref().map(setpoint))
        }
    };
}

motord_shared::joint_state!(recording define);

fn applied(command: motord::Command) -> Applied {
    let motord::Command { position, velocity, kp, kd, torque } = command;
    Applied { position, velocity, kp, kd, torque }
}

fn setpoint(setpoint: &motord::Setpoint) -> JointSetpoint {
    let motord::Setpoint { position, velocity, kp, kd, torque, ref mode } = *setpoint;
    JointSetpoint { position, velocity, kp, kd, torque, mode: code!(SetpointMode, mode) }
}

pub(crate) fn imu(imu: &motord::Imu) -> ImuState {
    let flags = [(imu.fresh, IMU_FRESH), (imu.valid, IMU_VALID), (imu.lost, IMU_LOST)];
    ImuState {
        orientation: imu.orientation.map_or([f32::NAN; 4], |value| [value.w, value.x, value.y, value.z]),
        angular_velocity: imu.angular_velocity.map_or([f32::NAN; 3], vector),
        acceleration: imu.acceleration.map_or([f32::NAN; 3], vector),
        temperature: imu.temperature.unwrap_or(f32::NAN),
        flags: flags
            .iter()
            .filter(|(is_set, _)| *is_set)
            .fold(imu.contradictions << IMU_CONTRADICTIONS_SHIFT, |flags, (_, flag)| flags | flag),
        missing: imu.missing,
        rejected: imu.rejected,
        sequence: imu.sequence,
        receive_ns: imu.receive_ns,
        // Of use to publishers only.
        publisher: 0,
    }
}

fn vector(motord::Vector { x, y, z }: motord::Vector) -> [f32; 3] {
    [x, y, z]
}

pub(crate) fn group(group: &motord::Group, robot: &RobotDescription) -> GroupState {
    let joint = robot.joints.iter().position(|joint| joint.name == group.cause_joint);
    let mut state = GroupState {
        lease: group.lease,
        sequence: group.sequence,
        setpoint_age_ns: group.setpoint_age_ns,
        answered_cycle: group.answered_cycle,
        used_cycle: group.used_cycle,
        phase: code!(Phase, &group.phase),
        cause: if group.cause.is_empty() { 0 } else { code!(Cause, &group.cause) },
        cause_joint: joint.map_or(NO_JOINT, |joint| joint as u32),
        cause_pid: group.cause_pid,
        accepted: group.accepted,
        late: group.late,
        setpoint_horizon_ns: u32::try_from(group.setpoint_horizon_ns).unwrap_or(u32::MAX),
        ..GroupState::default()
    };
    for (slot, count) in state.rejected.iter_mut().zip(&group.rejected) {
        *slot = *count;
    }
    state
}

pub(crate) fn bus(bus: &motord::Bus) -> BusState {
    let motord::Bus { sent, dropped, received, unexpected_id, duplicate, malformed, errors, lost, .. } = *bus;
    let condition = code!(BusCondition, &bus.condition);
    BusState { condition, sent, dropped, received, unexpected_id, duplicate, malformed, errors, lost }
}

/// Writes the fields of the whole cycle into `state`.
pub(crate) fn cycle(cycle: &motord::Cycle, state: &mut StateMessage) {
    let flags = [
        (cycle.emergency_stop, FLAG_EMERGENCY_STOP),
        (cycle.realtime, FLAG_REALTIME),
        (cycle.overrun, FLAG_OVERRUN),
        (cycle.shutting_down, FLAG_SHUTDOWN),
        (cycle.config_changed, FLAG_CONFIG_CHANGED),
    ];
    state.flags = flags.iter().filter(|(is_set, _)| *is_set).fold(0, |flags, (_, flag)| flags | flag);
    state.boot_id = cycle.boot_id;
    state.cycle = cycle.cycle;
    state.tick_ns = cycle.tick_ns;
    state.wake_latency_ns = cycle.wake_latency_ns;
    state.publish_ns = cycle.publish_ns;
    state.overruns = cycle.overruns;
}

pub(crate) fn indicators(indicators: &motord::Indicators) -> [f32; INDICATORS_MAX] {
    let mut values = [f32::NAN; INDICATORS_MAX];
    for indicator in Indicator::ALL {
        let value = indicators.values.get(indicator.name());
        if let (Some(value), Some(slot)) = (value, values.get_mut(indicator.code() as usize)) {
            *slot = *value;
        }
    }
    values
}
