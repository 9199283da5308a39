//! A client that sends valid, invalid, extreme and outdated messages and requests, or nothing.

use super::checker::{Checker, WRONG_LEASE_VELOCITY};
use super::random::Random;
use super::{Robot, message};
use motord_bus::{Duration, Instant};
use motord_shared::{
    AdminReply, AdminRequest, JointSetpoint, Lease, Operation, SetpointMessage, SetpointMode,
};

/// Numbers that often cause failures, and some that limits must reduce.
pub const ABSURD: [f32; 12] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    f32::MIN_POSITIVE / 2.0,
    -0.0,
    1e9,
    -1e9,
    500.0,
    -12.5,
    12.5,
];

/// The default of `setpoint-horizon-max-ms`, ns.
const HORIZON_MAX_NS: u32 = 40_000_000;

/// The largest velocity of a setpoint that is not absurd, rad/s.
const SLOW: f32 = 16.0;

const MODES: [SetpointMode; 4] =
    [SetpointMode::Impedance, SetpointMode::Torque, SetpointMode::Speed, SetpointMode::Position];

/// A client that tries to own a group.
#[derive(Debug)]
pub struct FuzzClient {
    group: usize,
    /// The lease that the daemon granted; 0 without one.
    pub lease: u64,
    sequence: u64,
    claim: u32,
    /// Remaining cycles without a message.
    silent: usize,
    /// The horizon of the next messages, ns.
    horizon_ns: u32,
    /// The last message had a velocity above [`SLOW`].
    was_fast: bool,
    /// The setpoints of the next message.
    pub setpoints: Vec<JointSetpoint>,
}

impl FuzzClient {
    /// A client that wants `group`.
    pub fn new(group: usize) -> Self {
        Self {
            group,
            lease: 0,
            sequence: 0,
            claim: 0,
            silent: 0,
            horizon_ns: 0,
            was_fast: false,
            setpoints: Vec::new(),
        }
    }

    /// Returns whether this client owns the group in the daemon's newest state.
    pub fn owns(&self, robot: &mut Robot) -> bool {
        self.lease != 0 && robot.state().groups[self.group].lease == self.lease
    }

    /// Claims the group. The answer of the next cycle is for [`FuzzClient::receive_reply`].
    pub fn claim(&mut self, robot: &mut Robot) {
        let operation = Operation::Claim.code();
        self.claim = robot.post(AdminRequest { operation, group: self.group as u32, ..Default::default() });
    }

    /// Takes over the lease if the answer is for this client's claim.
    pub fn receive_reply(&mut self, robot: &mut Robot, ticket: u32, reply: &AdminReply) {
        if ticket == self.claim && reply.lease != 0 {
            (self.lease, self.sequence) = (reply.lease, 0);
            self.setpoints = robot.hold_group(self.group, 30.0, 1.0);
        }
    }

    /// Posts a random request at any time, and returns the ticket of its answer.
    pub fn request(&self, random: &mut Random, robot: &mut Robot, checker: &mut Checker) -> u32 {
        let operation = *random.pick(&[
            Operation::Enable,
            Operation::Enable,
            Operation::Disable,
            Operation::Reset,
            Operation::EmergencyStop,
            Operation::SetZero,
            Operation::ClearFault,
        ]);
        let request = AdminRequest {
            operation: operation.code(),
            group: self.group as u32,
            joint: random.below(robot.settings.motors.len()) as u32,
            lease: *random.pick(&[0, self.lease]),
            ..Default::default()
        };
        checker.asked(&request);
        robot.post(request)
    }

    /// Sends a valid message.
    pub fn follow(&mut self, robot: &mut Robot, checker: &mut Checker) {
        let message = self.message(robot);
        checker.good_setpoint(self.group, end(&message, robot.now()));
        self.deliver(robot, checker, &message);
        self.was_fast = false;
    }

    /// Sends a valid message, an invalid one, or nothing.
    pub fn misbehave(&mut self, random: &mut Random, robot: &mut Robot, checker: &mut Checker) {
        if self.silent > 0 {
            self.silent -= 1;
            return;
        }
        match random.below(40) {
            0..=1 => {}
            2 => {
                self.silent = if random.once_in(10) { 40 } else { random.below(19) };
                // The kernel reports the exit of every second process that stays silent for 40
                // cycles.
                let dies = self.silent == 40 && self.sequence.is_multiple_of(2);
                let lease = Lease::from_raw(self.lease).filter(|_| dies);
                lease.into_iter().for_each(|lease| robot.client.alarms().owner_ended(lease));
            }
            3 => {
                self.setpoints.iter_mut().for_each(|setpoint| setpoint.position += random.between(-3.0, 3.0));
            }
            4 => {
                let most = if random.once_in(10) { 50.0 } else { 2.0 };
                self.setpoints.iter_mut().for_each(|setpoint| setpoint.torque = random.between(-most, most));
            }
            5 => self.setpoints.iter_mut().for_each(|setpoint| setpoint.kp = random.between(0.0, 120.0)),
            6 => {
                self.setpoints
                    .iter_mut()
                    .for_each(|setpoint| setpoint.velocity = random.between(-SLOW, SLOW));
            }
            10 => self.change_modes(random, robot),
            11 => self.horizon_ns = *random.pick(&[0, 0, 1, 1_000_000, 25_000_000, HORIZON_MAX_NS]),
            7..=9 => {
                let mut message = self.message(robot);
                let is_good = corrupt(random, &mut message, robot.now());
                if message.joints.iter().any(|joint| joint.velocity > SLOW) {
                    (self.was_fast, message.horizon_ns) = (true, 0);
                }
                if is_good {
                    checker.good_setpoint(self.group, end(&message, robot.now()));
                }
                self.deliver(robot, checker, &message);
            }
            _ => self.follow(robot, checker),
        }
    }

    /// Chooses another mode for each motor that supports several.
    fn change_modes(&mut self, random: &mut Random, robot: &Robot) {
        for (setpoint, motor) in self.setpoints.iter_mut().zip(&robot.settings.groups[self.group].motors) {
            let mode = *random.pick(&MODES);
            if robot.settings.motors[*motor].accepts(mode) {
                setpoint.mode = mode.code();
            }
        }
    }

    /// Returns a valid message. It has no horizon while a motor may have a velocity above [`SLOW`],
    /// from which the way passes [`WRONG_LEASE_VELOCITY`]. A motor that takes turns keeps its
    /// velocity until the next.
    fn message(&mut self, robot: &mut Robot) -> SetpointMessage {
        self.sequence += 1;
        let message = message(self.lease, self.sequence, robot.now(), &self.setpoints);
        let state = robot.state();
        let mut motors = robot.settings.groups[self.group].motors.iter();
        let is_fast = self.was_fast || motors.any(|motor| state.joints[*motor].applied.velocity > SLOW);
        SetpointMessage { horizon_ns: if is_fast { 0 } else { self.horizon_ns }, ..message }
    }

    fn deliver(&self, robot: &mut Robot, checker: &mut Checker, message: &SetpointMessage) {
        if self.lease != 0 {
            checker.delivered(self.group);
        }
        robot.deliver_to(self.group, message);
    }
}

/// Returns the end of the horizon of a message that is sent at `now`: the timeout begins there.
fn end(message: &SetpointMessage, now: Instant) -> Instant {
    now + Duration::from_nanos(message.horizon_ns.into())
}

/// Changes a message so that the daemon must reject it or limit its values. Returns whether it
/// stays valid.
fn corrupt(random: &mut Random, message: &mut SetpointMessage, now: Instant) -> bool {
    let joint = random.below(3);
    let mut only_values = false;
    match random.below(11) {
        10 => message.horizon_ns = *random.pick(&[HORIZON_MAX_NS + 1, u32::MAX]),
        0..=4 => {
            let setpoint = &mut message.joints[joint];
            let absurd = *random.pick(&ABSURD);
            match random.below(5) {
                0 => setpoint.position = absurd,
                1 => setpoint.velocity = absurd,
                2 => setpoint.kp = absurd,
                3 => setpoint.kd = absurd,
                _ => setpoint.torque = absurd,
            }
            only_values = true;
        }
        5 => message.joints[joint].mode = random.draw() as u32,
        6 => message.joint_count = random.draw() as u32,
        7 => message.time_ns = *random.pick(&[0, u64::MAX, (now - Duration::from_millis(21)).as_nanos()]),
        8 => message.sequence = *random.pick(&[0, message.sequence / 2, 1 << 63, u64::MAX]),
        _ => {
            message.lease ^= 1 << (8 + random.below(56));
            message.joints.iter_mut().for_each(|joint| joint.velocity = WRONG_LEASE_VELOCITY);
        }
    }
    let JointSetpoint { position, velocity, kp, kd, torque, .. } = message.joints[joint];
    let finite = [position, velocity, kp, kd, torque].iter().all(|value| value.is_finite());
    only_values && finite && kp >= 0.0 && kd >= 0.0
}
