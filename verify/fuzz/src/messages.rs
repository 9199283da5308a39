//! The bytes that arrive through shared memory: any values, in every field.

use crate::input::Input;
use crate::robot::{self, Robot, Sent};
use motord_checker::protocol::mit::Meaning;
use motord_client::State;
use motord_shared::limits::{BUSES_MAX, GROUPS_MAX, INDICATOR_JOINTS_MAX, JOINTS_MAX};
use motord_shared::message::JOINT_VALID;
use motord_shared::{
    AdminRequest, Applied, GroupState, Indicator, JointIndicators, JointSetpoint, JointState, Lease,
    Operation, Phase, Refusal, Rejection, SetpointMessage, StateMessage,
};

/// Most cycles of one run.
const CYCLES_MAX: usize = 16;

/// Sends setpoints of an owner with a valid lease to a moving robot: each field is correct, or any
/// bytes. Every command must be within the limits of its joint, and the states must stay numbers.
pub fn setpoints(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let mut robot = Robot::active(robot::legs());
    for _ in 0..CYCLES_MAX {
        if input.is_empty() {
            break;
        }
        let good = robot.message();
        let message = setpoint(&mut input, good);
        robot.client.deliver(0, &message);
        robot.step();
        check(&mut robot);
    }
}

/// Sends requests of any client, with any bytes in every field, between the owner's setpoints. Each
/// must have one answer, with a code that clients know. A robot that was not enabled must not move.
pub fn requests(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let mut robot = if input.any() { Robot::active(robot::legs()) } else { Robot::new(robot::mixed()) };
    let mut was_active = robot.phase() == Some(Phase::Active);
    let mut zero_asked = false;
    for _ in 0..CYCLES_MAX {
        if input.is_empty() {
            break;
        }
        for _ in 0..input.any::<u8>() % 4 {
            let request = request(&mut input, robot.client.lease(0));
            was_active |= request.operation == Operation::Enable.code();
            zero_asked |= request.operation == Operation::SetZero.code();
            robot.post(request);
        }
        robot.follow();
        for reply in robot.take_answers() {
            assert!(reply.refusal == 0 || Refusal::try_from(reply.refusal).is_ok(), "{reply:?}");
        }
        let still = |sent: &Sent| sent.is_harmless() || zero_asked && sent.meaning() == Meaning::SetZero;
        assert!(was_active || robot.take_sent().iter().all(still), "it was not enabled");
        check(&mut robot);
    }
}

/// Returns a message in which each field is that of the correct message, or any value.
fn setpoint(input: &mut Input<'_>, good: SetpointMessage) -> SetpointMessage {
    let corrupted = input.any::<u8>();
    let mut field = |bit: u8, good: u64| if corrupted >> bit & 1 == 1 { input.any() } else { good };
    let mut message = SetpointMessage {
        lease: field(0, good.lease),
        sequence: field(1, good.sequence),
        time_ns: field(2, good.time_ns),
        cycle: field(3, good.cycle),
        joint_count: field(4, good.joint_count.into()) as u32,
        horizon_ns: field(5, good.horizon_ns.into()) as u32,
        joints: good.joints,
    };
    if corrupted >> 6 & 1 == 1 {
        let joint = usize::from(input.any::<u8>()) % 3;
        message.joints[joint] = values(input);
    }
    message
}

fn values(input: &mut Input<'_>) -> JointSetpoint {
    JointSetpoint {
        position: input.any(),
        velocity: input.any(),
        kp: input.any(),
        kd: input.any(),
        torque: input.any(),
        mode: if input.any::<u8>() < 200 { 0 } else { input.any() },
    }
}

fn request(input: &mut Input<'_>, lease: Option<Lease>) -> AdminRequest {
    let is_true = input.any::<u8>() < 128;
    AdminRequest {
        lease: if is_true { lease.map_or(0, Lease::raw) } else { input.any() },
        operation: if input.any::<u8>() < 240 { u32::from(input.any::<u8>() % 16) } else { input.any() },
        group: if input.any::<u8>() < 200 { input.pick(&[0, 1, u32::MAX]) } else { input.any() },
        joint: if input.any::<u8>() < 200 { u32::from(input.any::<u8>() % 5) } else { input.any() },
        pid: input.any(),
        pid_namespace: input.any(),
        argument: if input.any::<u8>() < 128 { 0.0 } else { input.any() },
    }
}

/// Checks that the commands since the last call are within the limits of their joints, and that
/// published values are numbers.
fn check(robot: &mut Robot) {
    for sent in robot.take_sent() {
        assert_ne!(sent.bytes, [0; 8], "all zero is full negative torque");
        let Some(Meaning::Control { position, velocity, kp, kd, torque, .. }) = sent.mit_meaning() else {
            continue;
        };
        let (limits, scales) = (&sent.motor.limits, &sent.motor.scales);
        // Half a code of rounding, and the error of the torque that is carried over.
        let code = |field: &motord_protocol::Field, codes: f64| field.max() * 2.0 / codes;
        let ends = [
            (position.abs(), 3.0 + code(&scales.position, 65535.0)),
            (velocity.abs(), f64::from(limits.velocity) + code(&scales.velocity, 4095.0)),
            (kp, f64::from(limits.kp) + code(&scales.kp, 4095.0)),
            (kd, f64::from(limits.kd.max(sent.motor.damping_kd)) + code(&scales.kd, 4095.0)),
            (torque.abs(), f64::from(limits.torque) + code(&scales.torque, 4095.0)),
        ];
        assert!(ends.iter().all(|(value, end)| value <= end), "{sent:?}: {ends:?}");
    }
    for joint in robot.client.state().joints() {
        let Applied { position, velocity, kp, kd, torque } = joint.applied;
        let is_reported = joint.flags & JOINT_VALID != 0;
        let is_finite = [joint.position, joint.velocity, joint.torque].iter().all(|value| value.is_finite());
        let applied = [position, velocity, kp, kd, torque].iter().all(|value| value.is_finite());
        assert!(applied && is_finite == is_reported, "{joint:?}");
    }
}

/// Reads the states as a client does: any bytes in every field. No bytes that a daemon can write
/// make a client panic, and every index that it gets is within its arrays.
pub fn states(bytes: &[u8]) {
    let state = State::from(&state(&mut Input::new(bytes)));
    let _head = (state.age(), state.time(), state.wake_latency(), state.realtime(), state.shutting_down());
    for joint in state.joints() {
        let _values = (joint.position(), joint.velocity(), joint.torque(), joint.is_excluded());
        let _named = (joint.faults.to_string(), joint.faults.iter().count(), joint.limits.iter().count());
    }
    for group in state.groups() {
        assert!(group.cause_joint.is_none_or(|joint| state.joint(joint).is_some()));
        let _refused: u32 = Rejection::ALL.iter().map(|reason| group.rejected(*reason) & 1).sum();
    }
    for index in 0..JOINTS_MAX + 1 {
        let values = state.indicators(index).map(|indicators| indicators.iter().count());
        assert!(values.is_none_or(|count| count <= Indicator::ALL.len()));
        let _absent =
            (state.joint(index).is_none(), state.group(index).is_none(), state.bus(index).is_none());
    }
    assert!(state.buses().count() <= BUSES_MAX);
}

fn state(input: &mut Input<'_>) -> StateMessage {
    let mut message = StateMessage {
        boot_id: input.any(),
        cycle: input.any(),
        tick_ns: input.any(),
        wake_latency_ns: input.any(),
        publish_ns: input.any(),
        overruns: input.any(),
        flags: input.any(),
        joint_count: input.any(),
        group_count: input.any(),
        bus_count: input.any(),
        indicator_count: input.any(),
        ..StateMessage::default()
    };
    // Entries past the end of the bytes are zero: a short input is a whole message.
    message.groups[..GROUPS_MAX].iter_mut().for_each(|group| *group = group_state(input));
    message.buses[..BUSES_MAX].iter_mut().for_each(|bus| bus.condition = input.any());
    message.indicators[..INDICATOR_JOINTS_MAX].iter_mut().for_each(|entry| *entry = indicators(input));
    message.joints[..JOINTS_MAX].iter_mut().for_each(|joint| *joint = joint_state(input));
    message
}

fn group_state(input: &mut Input<'_>) -> GroupState {
    GroupState {
        lease: input.any(),
        sequence: input.any(),
        setpoint_age_ns: input.any(),
        setpoint_horizon_ns: input.any(),
        answered_cycle: input.any(),
        used_cycle: input.any(),
        phase: input.any(),
        cause: input.any(),
        cause_joint: input.any(),
        cause_pid: input.any(),
        ..GroupState::default()
    }
}

fn indicators(input: &mut Input<'_>) -> JointIndicators {
    let mut indicators = JointIndicators { joint: input.any(), ..JointIndicators::default() };
    indicators.values.iter_mut().for_each(|value| *value = input.any());
    indicators
}

fn joint_state(input: &mut Input<'_>) -> JointState {
    JointState {
        position: input.any(),
        velocity: input.any(),
        torque: input.any(),
        temperature: input.any(),
        limits: input.any(),
        mode: input.any(),
        fault: input.any(),
        flags: input.any(),
        age_cycles: input.any(),
        receive_ns: input.any(),
        ..JointState::default()
    }
}
