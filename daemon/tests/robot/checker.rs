//! Judges every cycle by what was on the wire and what was published: the invariants that hold whatever anybody does.
//!
//! | | |
//! |---|---|
//! | I1 | no start, zero or clear command that nobody asked for; never the all-zero frame |
//! | I2 | after decoding the bytes: position, velocity, gains, torque, their slews, and the torque they make together are within the limits |
//! | I3 | no motion when the owner's newest good setpoint is older than its timeout |
//! | I4 | a stopped motor hears stop and questions only, and only an active group moves |
//! | I5 | at most one command per motor, and one question for faults per bus, in a cycle |
//! | I6 | a state is fresh when a reply with it was on the wire in this cycle, and else says how old it is |
//! | I7 | only messages of the owner's lease move motors |
//! | I8 | counters never fall; every message is counted once; as many frames are on the wire as were counted |
//! | I9 | a latched cause is left by a reset only, and nothing starts while it is latched |
//! | I10 | a bus or a motor that fails stops its groups in time; no motion from the first cycle after a cause on; a motor
//! |     | that is not offline hears a command in every cycle, and damping ones before it goes limp |
//!
//! A frame is judged by the cycle that handed it over, however late it leaves.

mod cycle;
mod slope;
mod stop;

use super::{Meaning, Robot, Sent, Told};
use cycle::Cycle;
use motord_bus::{Duration, Instant};
use motord_core::settings::{MotorSettings, SafeStop};
use motord_shared::{
    AdminRequest, BusCondition, BusState, Cause, GroupState, JointState, Limit, MotorMode, Operation, Phase,
    StateMessage, message,
};
use slope::Slopes;
use std::collections::VecDeque;
use std::rc::Rc;
use stop::{Injections, Target};

/// The velocity, rad/s, that only messages without the owner's lease ask for (I7): the one value that reaches the wire
/// in the cycle that uses it.
pub const FOREIGN_VELOCITY: f32 = 18.0;

/// A fault that was not cleared by then is not cleared any more: a second, and a late cycle.
const CLEAR_TIME: Duration = Duration::from_millis(1020);
/// No frame is held back for longer by a jammed bus.
const MEMORY_CYCLES: usize = 8192;
/// Other traffic and a clock that goes backward delay no frame by more cycles on a bus that is well.
const DELAY_CYCLES: usize = 3;

/// What a test did to a group, and what was seen of it.
#[derive(Debug, Clone, Default)]
struct Watched {
    /// When its owner last sent a message that is good in every respect.
    good_setpoint: Option<Instant>,
    /// A message came since the last cycle.
    delivered: bool,
    /// A reset was asked for since the last cycle.
    reset: bool,
    /// An enable was asked for, and nothing has stopped the group since.
    enabled: bool,
}

/// What was seen so far.
#[derive(Debug)]
pub struct Checker {
    /// The newest last.
    cycles: VecDeque<Cycle>,
    begun: Instant,
    groups: Vec<Watched>,
    slopes: Vec<Slopes>,
    /// Set zero commands that each motor may still hear.
    zeros: Vec<u32>,
    /// Until when each motor may hear clear fault commands.
    clears: Vec<Instant>,
    sent: Vec<u32>,
    /// Buses that something keeps from carrying frames.
    blocked: Vec<bool>,
    /// Buses that the host was cut off from, until they are known to be well again.
    cut: Vec<bool>,
    injections: Injections,
    lossy: bool,
}

impl Checker {
    pub fn new(robot: &Robot) -> Self {
        let settings = &robot.settings;
        Self {
            cycles: VecDeque::new(),
            begun: robot.now(),
            groups: vec![Watched::default(); settings.groups.len()],
            slopes: vec![Slopes::default(); settings.motors.len()],
            zeros: vec![0; settings.motors.len()],
            clears: vec![Instant::ZERO; settings.motors.len()],
            sent: vec![0; settings.buses.len()],
            blocked: vec![false; settings.buses.len()],
            cut: vec![false; settings.buses.len()],
            injections: Injections::default(),
            lossy: false,
        }
    }

    /// Buses lose frames from now on, so that counters and the wire cannot be compared any more.
    pub fn allow_loss(&mut self) {
        self.lossy = true;
    }

    /// This was done to a bus.
    pub fn disturbed_bus(&mut self, robot: &mut Robot, bus: usize, fault: &str) {
        match fault {
            "gone" | "down" | "bus-off" => {
                (self.blocked[bus], self.cut[bus]) = (true, true);
                self.injections.begin(Target::Bus(bus), robot);
            }
            "no-ack" | "tx-full" | "tx-full 1" => {
                self.blocked[bus] = true;
                self.injections.end(Target::Bus(bus));
            }
            "ok" => {
                self.blocked[bus] = false;
                self.injections.end(Target::Bus(bus));
            }
            _ => {}
        }
    }

    /// This was done to a motor.
    pub fn disturbed_motor(&mut self, robot: &mut Robot, motor: usize, fault: &str) {
        match fault {
            "off" => self.injections.begin(Target::Motor(motor), robot),
            "ok" => self.injections.end(Target::Motor(motor)),
            _ => {}
        }
    }

    /// Somebody asked for this.
    pub fn asked(&mut self, request: &AdminRequest) {
        let group = request.group as usize;
        match Operation::try_from(request.operation) {
            Ok(Operation::Reset) => self.groups[group].reset = true,
            Ok(Operation::Enable) => self.groups[group].enabled = true,
            Ok(Operation::SetZero) => self.zeros[request.joint as usize] += 1,
            Ok(Operation::ClearFault) => self.clears[request.joint as usize] = self.begun + CLEAR_TIME,
            _ => {}
        }
    }

    /// The group's owner sends a message that is good in every respect.
    pub fn good_setpoint(&mut self, group: usize, now: Instant) {
        self.groups[group].good_setpoint = Some(now);
    }

    /// A message is under way that names the group.
    pub fn delivered(&mut self, group: usize) {
        self.groups[group].delivered = true;
    }

    /// Judges the cycle that `robot` has just run.
    pub fn judge(&mut self, robot: &mut Robot) {
        let mut cycles = std::mem::take(&mut self.cycles);
        let cycle = self.see(robot, cycles.back());
        let (sent, told) = (robot.take_sent(), robot.take_told());
        self.judge_counts(robot, &cycle, &sent);
        for (motor, settings) in robot.settings.motors.iter().enumerate() {
            self.judge_activation(motor, &cycle);
            judge_joint(settings, motor, &cycle, &told);
        }
        self.injections.judge(&cycle);
        judge_counters(&cycle.before, &cycle.state);
        for (group, watched) in self.groups.iter_mut().enumerate() {
            judge_group(watched, &cycle.before.groups[group], &cycle.state.groups[group]);
        }
        cycles.push_back(cycle);
        for frame in &sent {
            let cycle = cycles.iter_mut().rfind(|cycle| cycle.begun <= frame.ready);
            self.judge_frame(robot, cycle.expect("no frame waits longer than the checker remembers"), frame);
        }
        judge_stop(robot, &cycles);
        if cycles.len() > MEMORY_CYCLES {
            cycles.pop_front();
        }
        self.cycles = cycles;
    }

    /// The cycle that `robot` has just run, before its frames are known.
    fn see(&mut self, robot: &mut Robot, last: Option<&Cycle>) -> Cycle {
        let state = Rc::new(robot.state());
        let begun = Instant::from_nanos(state.tick_ns + state.wake_latency_ns);
        let elapsed = begun.since(self.begun).min(2 * super::PERIOD).as_secs_f64();
        self.begun = begun;
        let before = last.map_or_else(|| Rc::clone(&state), |last| Rc::clone(&last.state));
        let motors = robot.settings.motors.len();
        Cycle {
            elapsed,
            time: last.map_or(0.0, |last| last.time) + elapsed,
            good_setpoint: self.groups.iter().map(|group| group.good_setpoint).collect(),
            enabled: self.groups.iter().map(|group| group.enabled).collect(),
            held: (0..motors).map(|motor| held(motor, &before, &state, last)).collect(),
            well: (0..self.blocked.len()).map(|bus| self.is_well(bus, [&before, &state])).collect(),
            heard: vec![None; motors],
            frames: vec![0; self.blocked.len()],
            before,
            state,
            begun,
        }
    }

    /// Nothing keeps frames from the wire, and the cycle knows it. It may not give up a bus that was never cut off.
    fn is_well(&mut self, bus: usize, states: [&StateMessage; 2]) -> bool {
        let lost = [BusCondition::Off, BusCondition::Down, BusCondition::Gone].map(BusCondition::code);
        let given_up = states.iter().any(|state| lost.contains(&state.buses[bus].condition));
        assert!(self.cut[bus] || !given_up, "I10: bus {bus} was given up");
        self.cut[bus] &= given_up || self.blocked[bus];
        !given_up && !self.blocked[bus]
    }

    fn judge_counts(&mut self, robot: &Robot, cycle: &Cycle, sent: &[Sent]) {
        for bus in 0..robot.buses.len() {
            self.sent[bus] += sent.iter().filter(|frame| frame.bus == bus).count() as u32;
            // A question for faults is sent after the states were published.
            let unpublished = self.sent[bus].wrapping_sub(cycle.state.buses[bus].sent) as i32;
            assert!(unpublished <= 1, "I8: {unpublished} frames more on the wire than counted");
            assert!(self.lossy || unpublished >= 0, "I8: {unpublished} frames on the wire");
        }
    }

    /// Judges a frame by the cycle that handed it over.
    fn judge_frame(&mut self, robot: &Robot, cycle: &mut Cycle, frame: &Sent) {
        let motors = &robot.settings.motors;
        let motor = motors.iter().position(|motor| is_to(frame, motor)).expect("frames go to motors");
        cycle.frames[frame.bus] += 1;
        let most = 1 + motors.iter().filter(|motor| motor.bus == frame.bus).count();
        assert!(cycle.frames[frame.bus] <= most, "I5: more than {most} frames");
        let heard = &mut cycle.heard[motor];
        let first = heard.is_none() || frame.meaning == Meaning::GetFault;
        assert!(first, "I5: {:?} after {heard:?} for {}", frame.meaning, motors[motor].name);
        heard.get_or_insert(frame.meaning);
        self.judge_values(&motors[motor], cycle, motor, frame);
        self.judge_meaning(robot, cycle, motor, frame);
    }

    /// A motor that begins to follow setpoints begins with nothing, and from where it stands.
    fn judge_activation(&mut self, motor: usize, cycle: &Cycle) {
        let (before, now) = (&cycle.before.joints[motor], &cycle.state.joints[motor]);
        if before.mode == MotorMode::Starting.code() {
            self.slopes[motor] = Slopes::from(f64::from(before.position), cycle.time - cycle.elapsed);
        }
        let started = now.mode == MotorMode::Active.code() && before.mode != now.mode;
        assert!(!started || before.mode == MotorMode::Starting.code(), "I1: active without a start");
    }

    fn judge_meaning(&mut self, robot: &Robot, cycle: &Cycle, motor: usize, frame: &Sent) {
        let settings = &robot.settings.motors[motor];
        let group = robot.settings.groups.iter().position(|group| group.motors.contains(&motor));
        let group = group.expect("every motor is in a group");
        match frame.meaning {
            Meaning::Stop | Meaning::GetFault => {}
            Meaning::Start => {
                let asked = cycle.enabled[group] && cycle.touches(group, Phase::Starting);
                assert!(asked, "I1: start in {}", cycle.state.groups[group].phase);
            }
            Meaning::SetZero => {
                assert!(self.zeros[motor] > 0 && cycle.touches(group, Phase::Disarmed), "I1: set zero");
                self.zeros[motor] -= 1;
            }
            Meaning::ClearFault => {
                let asked = cycle.begun <= self.clears[motor] && cycle.touches(group, Phase::Disarmed);
                assert!(asked, "I1: clear fault");
            }
            Meaning::Control { .. } => {
                assert!(!cycle.is(group, Phase::Disarmed), "I4: {:?} to a stopped motor", frame.meaning);
                let reasons = [0, Cause::SetpointTimeout.code(), Cause::OwnerLost.code()];
                let holds = robot.settings.groups[group].safe_stop == SafeStop::Hold
                    && reasons.contains(&cycle.before.groups[group].cause)
                    && cycle.state.groups[group].phase == Phase::Damping.code()
                    && is_held(settings, &frame.meaning, cycle.held[motor]);
                if !frame.meaning.is_safe() && !holds {
                    judge_motion(robot.settings.safety.setpoint_timeout, cycle, group);
                }
            }
        }
    }

    fn judge_values(&mut self, settings: &MotorSettings, cycle: &Cycle, motor: usize, frame: &Sent) {
        assert_ne!(frame.bytes, [0; 8], "I1: the all-zero frame");
        let Meaning::Control { position, velocity, kp, kd, torque } = frame.meaning else { return };
        let (limits, direction) = (&settings.limits, f64::from(settings.transmission.direction()));
        let torque_code = 2.0 * settings.torque_scale.field().max() / 4095.0;
        let told = &cycle.before.joints[motor];
        let position = direction * position + f64::from(settings.transmission.offset());
        let (velocity, torque) = (direction * velocity, direction * torque);
        assert!((velocity - f64::from(FOREIGN_VELOCITY)).abs() > 0.05, "I7: a foreign setpoint was followed");
        assert!(kp <= f64::from(limits.kp) + 0.07, "I2: kp {kp}");
        assert!(kd <= f64::from(limits.kd.max(settings.damping_kd)) + 0.001, "I2: kd {kd}");
        assert!(velocity.abs() <= f64::from(limits.velocity) + 0.02, "I2: velocity {velocity}");
        assert!(torque.abs() <= f64::from(limits.torque) + torque_code, "I2: torque {torque}");
        if kp > 0.0 {
            let [low, high] = limits.position.map(f64::from);
            let entering = cycle.state.joints[motor].limits & Limit::PositionSlew.bit() != 0;
            let active = cycle.state.joints[motor].mode == MotorMode::Active.code();
            assert!(
                entering || !active || (low - 4e-4..=high + 4e-4).contains(&position),
                "I2: position {position}"
            );
        }
        if told.position.is_finite() {
            let (far, fast) = (position - f64::from(told.position), velocity - f64::from(told.velocity));
            let total = kp * far + kd * fast + torque;
            let codes = 0.07 * far.abs() + 4e-4 * kp + 7e-4 * fast.abs() + 0.017 * kd + torque_code;
            assert!(total.abs() <= f64::from(limits.torque) + codes, "I2: {total} N·m in all");
        }
        if told.applied.kp == 0.0 {
            self.slopes[motor].rest_at(f64::from(told.position), cycle.time - cycle.elapsed);
        }
        if cycle.state.joints[motor].mode == MotorMode::Active.code() {
            self.slopes[motor].judge(cycle.time, limits, position, [kp, kd, torque], torque_code);
        }
    }
}

/// Judges what motors heard in the newest cycle whose frames have left: those of a bus that was well all the while.
fn judge_stop(robot: &Robot, cycles: &VecDeque<Cycle>) {
    let Some(judged) = cycles.len().checked_sub(DELAY_CYCLES + 1).filter(|judged| *judged > 0) else {
        return;
    };
    let first = judged.saturating_sub(DELAY_CYCLES);
    let is_well = |bus: usize| cycles.range(first..).all(|cycle| cycle.well[bus]);
    stop::judge(&robot.settings, &cycles[judged - 1], &cycles[judged], is_well);
}

fn judge_motion(timeout: Duration, cycle: &Cycle, group: usize) {
    let (before, now) = (&cycle.before.groups[group], &cycle.state.groups[group]);
    assert_eq!(before.cause, 0, "I10: motion in the cycle after a cause");
    assert!(now.phase == Phase::Active.code() || now.cause != 0, "I4: motion in phase {}", now.phase);
    let good = cycle.good_setpoint[group].expect("I3: motion without any setpoint");
    let age = cycle.begun.since(good);
    assert!(age <= timeout, "I3: motion on a setpoint that is {age:?} old");
}

/// Where a motor stands that may be held from now on, or where it has been since it is damped, rad.
fn held(motor: usize, before: &StateMessage, state: &StateMessage, last: Option<&Cycle>) -> [f64; 2] {
    match last {
        Some(last) if before.joints[motor].mode == MotorMode::Damping.code() => last.held[motor],
        _ => [before, state].map(|state| f64::from(state.joints[motor].position)),
    }
}

/// The command holds the motor at one of these positions, rad.
fn is_held(motor: &MotorSettings, command: &Meaning, held: [f64; 2]) -> bool {
    let Meaning::Control { position, velocity, torque, .. } = *command else { return false };
    let position =
        f64::from(motor.transmission.direction()) * position + f64::from(motor.transmission.offset());
    let there = held.iter().any(|held| (position - held).abs() < 4e-4);
    there && velocity.abs() < 0.02 && torque.abs() < 0.2
}

fn is_to(frame: &Sent, motor: &MotorSettings) -> bool {
    frame.bus == motor.bus && frame.id == u16::from(motor.id)
}

fn judge_joint(settings: &MotorSettings, motor: usize, cycle: &Cycle, told: &[Told]) {
    let (before, now) = (&cycle.before.joints[motor], &cycle.state.joints[motor]);
    let fresh = now.flags & message::JOINT_FRESH != 0;
    assert_eq!(fresh, now.age_cycles == 0 && now.receive_ns > 0, "I6: {now:?}");
    assert_eq!(now.flags & message::JOINT_VALID != 0, now.position.is_finite(), "I6: {now:?}");
    if fresh {
        let said = told.iter().any(|told| says(told, settings, now));
        assert!(said, "I6: no reply said {now:?}");
    } else if cycle.state.cycle > cycle.before.cycle {
        assert_eq!(now.age_cycles, before.age_cycles + 1, "I6: the age of {now:?}");
        assert_eq!(now.receive_ns, before.receive_ns, "I6: {now:?}");
        let same = |now: f32, before: f32| now.to_bits() == before.to_bits() || now.is_nan();
        let kept = same(now.position, before.position) && same(now.velocity, before.velocity);
        assert!(kept, "I6: {now:?} from {before:?}");
    }
}

/// The reply is the motor's, came when `joint` says, and tells its position and velocity (MIT document 1.1).
fn says(told: &Told, motor: &MotorSettings, joint: &JointState) -> bool {
    let [id, high, low, rest @ ..] = told.frame.payload() else { return false };
    let position = f64::from(u16::from_be_bytes([*high, *low])) * 25.0 / 65535.0 - 12.5;
    let position =
        f64::from(motor.transmission.direction()) * position + f64::from(motor.transmission.offset());
    let [fast, slow, ..] = rest else { return false };
    let velocity = f64::from(u16::from_be_bytes([*fast, *slow]) >> 4) * 130.0 / 4095.0 - 65.0;
    let velocity = f64::from(motor.transmission.direction()) * velocity;
    let fault = rest.iter().all(|byte| *byte == 0);
    (told.bus, told.frame.id(), *id) == (motor.bus, motor.host_id, motor.id)
        && told.at.as_nanos() == joint.receive_ns
        && (position - f64::from(joint.position)).abs() < 1e-3
        && (velocity - f64::from(joint.velocity)).abs() < 1e-3
        && !fault
}

fn judge_group(watched: &mut Watched, before: &GroupState, now: &GroupState) {
    let (was, is) = (before.cause, now.cause);
    let kept = is == was || was == 0 || watched.reset && is == 0 || is == Cause::EmergencyStop.code();
    assert!(kept || watched.reset, "I9: cause {was} became {is}");
    let stopped = now.phase == Phase::Disarmed.code() || now.phase == Phase::Damping.code();
    assert!(is == 0 || stopped, "I9: phase {} with cause {is}", now.phase);
    let counted =
        |group: &GroupState| group.rejected.iter().fold(group.accepted, |sum, n| sum.wrapping_add(*n));
    let new = counted(now).wrapping_sub(counted(before));
    assert_eq!(new, u32::from(watched.delivered), "I8: messages counted in this cycle");
    if is != 0 || now.phase == Phase::Disarmed.code() {
        watched.enabled = false;
    }
    (watched.reset, watched.delivered) = (false, false);
}

fn judge_counters(before: &StateMessage, now: &StateMessage) {
    assert!(now.cycle >= before.cycle && now.overruns >= before.overruns, "I8: cycles");
    let counters = |bus: &BusState| {
        let BusState { sent, dropped, received, unknown, duplicate, malformed, errors, lost, .. } = *bus;
        [sent, dropped, received, unknown, duplicate, malformed, errors, lost]
    };
    for (before, now) in before.buses().iter().zip(now.buses()) {
        assert!(
            counters(before).iter().zip(counters(now)).all(|(before, now)| now >= *before),
            "I8: {now:?}"
        );
    }
    for (before, now) in before.joints().iter().zip(now.joints()) {
        assert!(now.missed >= before.missed && now.late >= before.late, "I8: {now:?}");
    }
}
