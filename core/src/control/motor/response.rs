//! Finds a motor that answers and gives no torque: its drive restarted, or switched itself off.
//!
//! Without a status in its states only the torque shows that. A motor is off when it was commanded
//! a torque and reports almost none of it, in each of [`STATES`] states or more and for [`TIME`].
//!
//! | not compared | because |
//! |---|---|
//! | less than the floor: a tenth of the rated torque, and four codes | friction, offsets and the rounding of codes are as large |
//! | a joint that turns fast in the direction of the torque | a healthy motor gives no torque at its speed without load, which a lower supply lowers |
//! | commands that changed sign or fell below the floor in the last [`COMMANDS`] | a reply may answer each of them |
//! | speed and position setpoints of native motors | the drive decides the torque |
//!
//! A motor that reports at least the floor is not off, however much it was commanded: a drive
//! limits and derates its torque by itself.
//!
//! Real-time: constant time; no allocation, no system call.

use motord_bus::{Duration, Instant};
use motord_protocol::Scales;
use motord_protocol::drive::{Impedance, JointSide, Measured, Setpoint};
use motord_settings::settings::MotorSettings;
use motord_shared::SetpointMode;

/// A reply may answer the newest command, the one before, and one two turns earlier: a reply may
/// have the state before its command, and answers may be late by two turns.
const COMMANDS: usize = 4;
/// A motor that reports less than this share of its rated torque bears no load. Dry friction is
/// about 2 % of the rated torque, and the shares that are known by measurement are below 5 %.
const FLOOR_SHARE: f32 = 0.1;
/// The least floor, in codes of torque: a report of zero is up to two codes off.
const FLOOR_CODES: f32 = 4.0;
/// Share of the velocity without load up to which torques are compared. A motor with a fifth of its
/// rated voltage still turns as fast.
const VELOCITY_SHARE: f32 = 0.2;
const TIME: Duration = Duration::from_millis(50);
const STATES: u32 = 5;

/// The torques that a motor is commanded, and the states that lack them.
#[derive(Debug)]
pub(super) struct Response {
    /// The last commands, a ring.
    commands: [Setpoint; COMMANDS],
    /// Index of the newest command.
    newest: usize,
    /// The first of the latest states in a row without the commanded torque, and their number.
    lacking: Option<(Instant, u32)>,
    /// Share of the commanded torque that a motor must report; 0 compares nothing.
    share: f32,
    /// Torques below are not compared, N·m.
    floor: f32,
    /// Speeds above, in the direction of the torque, are not compared, rad/s.
    velocity_max: f32,
    /// The size of one code of position, velocity, stiffness, damping and torque.
    steps: Impedance<JointSide>,
}

impl Response {
    pub(super) fn of(settings: &MotorSettings) -> Self {
        let mut response = Self {
            commands: [Setpoint::NEUTRAL; COMMANDS],
            newest: 0,
            lacking: None,
            share: settings.limits.torque_response,
            floor: 0.0,
            velocity_max: VELOCITY_SHARE * settings.max_velocity,
            steps: Impedance::NEUTRAL,
        };
        response.measure_codes(&settings.scales, settings);
        response
    }

    /// Uses the codes of these ends of position, velocity and torque, which the motor reported.
    #[cold]
    pub(super) fn rescale(&mut self, settings: &MotorSettings, ends: [f32; 3]) {
        self.measure_codes(&settings.scales.with_ends(ends), settings);
    }

    fn measure_codes(&mut self, scales: &Scales, settings: &MotorSettings) {
        let [position, velocity, kp, kd, torque] =
            [scales.position, scales.velocity, scales.kp, scales.kd, scales.torque]
                .map(|field| field.step() as f32);
        self.floor = (FLOOR_SHARE * settings.winding.rated_torque).max(FLOOR_CODES * torque);
        self.steps = Impedance::new(position, velocity, kp, kd, torque);
    }

    /// Forgets commands and states.
    pub(super) const fn forget(&mut self) {
        self.commands = [Setpoint::NEUTRAL; COMMANDS];
        self.lacking = None;
    }

    /// Records a command after all limits, as it is sent.
    #[inline]
    pub(super) const fn command(&mut self, sent: &Setpoint) {
        self.newest = (self.newest + 1) % COMMANDS;
        self.commands[self.newest] = *sent;
    }

    /// Takes a state that was current at `at`. Returns whether the motor is off.
    #[inline]
    pub(super) fn is_off(&mut self, state: &Measured<JointSide>, at: Instant) -> bool {
        if !self.lacks_torque(state) {
            self.lacking = None;
            return false;
        }
        let (since, states) = self.lacking.map_or((at, 1), |(since, states)| (since, states + 1));
        self.lacking = Some((since, states));
        states >= STATES && at.since(since) >= TIME
    }

    /// Most states are decided without a call: their torque, or the one asked for, is below the
    /// floor.
    #[inline(always)]
    fn lacks_torque(&self, state: &Measured<JointSide>) -> bool {
        let torque = state.torque;
        if torque.abs() >= self.floor {
            return false;
        }
        let newest = known_torque(&self.commands[self.newest], state);
        newest.abs() > self.floor && self.lacks_all(state, newest.signum())
    }

    /// Returns whether `state` lacks the torque with this sign that each of the last commands asks
    /// for.
    #[inline(never)]
    fn lacks_all(&self, state: &Measured<JointSide>, sign: f32) -> bool {
        let Measured { velocity, torque, .. } = *state;
        let commanded = self.commanded(sign, state);
        let turns_on = sign * velocity > self.velocity_max;
        !turns_on && commanded > self.floor && torque.abs() < self.share * commanded
    }

    /// Returns the least torque with this sign that any of the last commands asks for at `state`,
    /// N·m. Negative where one of them has the other sign.
    fn commanded(&self, sign: f32, state: &Measured<JointSide>) -> f32 {
        let least = |least: f32, command: &Setpoint| {
            least.min(sign * known_torque(command, state) - self.rounding(command, state))
        };
        self.commands.iter().fold(f32::INFINITY, least)
    }

    /// Returns the largest change of the torque of `command` by the rounding of its codes, N·m.
    fn rounding(&self, command: &Setpoint, state: &Measured<JointSide>) -> f32 {
        let Impedance { position, velocity, kp, kd, .. } = command.values;
        let code = &self.steps;
        let spring = kp * code.position + code.kp * (position - state.position).abs();
        let damper = kd * code.velocity + code.kd * (velocity - state.velocity).abs();
        let is_impedance = command.mode == SetpointMode::Impedance;
        let spring = if is_impedance && kp > 0.0 { spring } else { 0.0 };
        let damper = if is_impedance && kd > 0.0 { damper } else { 0.0 };
        spring + damper + code.torque
    }
}

/// Returns the torque that `command` asks for at `state`, N·m: 0 in a mode whose torque the drive
/// decides.
#[inline]
fn known_torque(command: &Setpoint, state: &Measured<JointSide>) -> f32 {
    if command.mode == SetpointMode::Impedance {
        return command.values.predicted_torque(state.position, state.velocity);
    }
    if command.mode == SetpointMode::Torque { command.values.torque } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_protocol::drive::JointSide;

    /// Goal: a healthy joint at rest is not off, though its codes are coarser than those of its
    /// model. Method: DM-J3507 with a velocity end of 200 rad/s instead of 50; at rest its velocity
    /// is half a code off, so its damping asks for a torque that nothing gives.
    #[test]
    fn reported_ends_decide_the_rounding_of_codes() {
        let text = "[[bus]]\nname = 'a'\ntype = 'simulated'\n[[motor]]\nname = 'hip'\nbus = 'a'\nid = 1\n\
                    protocol = 'mit'\nmodel = 'DM-J3507-2EC'\n\
                    limits = { position-rad = [-1.0, 1.0], velocity-rad-s = 10.0, torque-nm = 1.0 }\n";
        let settings = motord_harness::robot::settings(text);
        let motor = &settings.motors[0];
        let damping = Setpoint::impedance(Impedance::<JointSide>::new(0.0, 0.0, 0.0, 5.0, 0.0));
        let state = Measured::new(0.0, 200.0 / 4095.0, 0.0, None);
        let is_off = |mut response: Response| {
            (0..COMMANDS).for_each(|_| response.command(&damping));
            (0..100).any(|cycle| response.is_off(&state, Instant::from_nanos(cycle * 1_000_000)))
        };
        let mut rescaled = Response::of(motor);
        rescaled.rescale(motor, [12.566, 200.0, 5.0]);
        assert_eq!([is_off(Response::of(motor)), is_off(rescaled)], [true, false]);
    }
}
