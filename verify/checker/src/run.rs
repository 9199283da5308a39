//! Checks every cycle of a simulated run by the frames on the wire and the published state.
//!
//! | | |
//! |---|---|
//! | I1 | no start, zero or clear command without a request; never the all-zero frame |
//! |    | a native motor receives only control, start, stop and queries, harmless to one in MIT mode |
//! | I2 | decoded position, velocity, gains, torque, slews and total torque are within the limits |
//! | I3 | no motion when the owner's newest good setpoint, from the end of its horizon, is older than its timeout |
//! | I4 | a stopped motor receives only stop, queries and reads of registers, and only an active group moves |
//! | I5 | at most one command per motor, and one fault request per bus, in a cycle |
//! | I6 | a state is fresh when a reply with it was on the wire in this cycle; otherwise it reports its age: also a state
//! |    | from a reply of this cycle whose request is older |
//! | I7 | only messages of the owner's lease move motors |
//! | I8 | counters never fall; every message is counted once; as many frames are on the wire as were counted |
//! | I9 | a latched cause is left by a reset only, and nothing starts while it is latched |
//! | I10 | a bus or a motor that fails stops its groups in time; no motion from the first cycle after a cause on; a motor
//! |     | that is not offline receives a command in every cycle, and damping ones before it goes limp. After a missed reply
//! |     | one cycle between two of the same mode may be without |
//!
//! The rules attribute a frame to the cycle that sent it, however late it is on the wire.
//!
//! The program that runs the robot reports its actions on the robot to the [`Checker`], and passes
//! it the result of every cycle. When a rule is broken, the checker panics with the name of the
//! rule.

mod cycle;
mod native;
mod reported;
mod slope;
mod stop;

pub use reported::Reply;

use crate::protocol::codec::Meaning;
use crate::protocol::ranges::Ranges;
use crate::robot::{Limits, Motor, Robot, SafeStop};
use crate::state::{Bus, Cause, Group, Mode, Phase, State};
use cycle::{Cycle, ReceivedCommand};
use motord_bus::{Duration, Frame, Instant};
use reported::Velocities;
use slope::Slopes;
use std::collections::VecDeque;
use std::rc::Rc;
use stop::{Injections, Target};

/// Velocity, rad/s, that only messages without the owner's lease contain, and that no way of a
/// horizon passes (I7). No slew delays the velocity of an impedance, so it reaches the wire in the
/// cycle that uses it.
pub const WRONG_LEASE_VELOCITY: f32 = 18.0;

/// Time after which a request to clear a fault causes no more frames: a second, and a late cycle.
const CLEAR_TIME: Duration = Duration::from_millis(1020);
/// Number of cycles in the checker's memory. A jammed bus delays no frame for longer.
const MEMORY_CYCLES: usize = 8192;

/// Largest distance from a value to its nearest code, in codes: half a code, and a margin for
/// single precision.
const NEAREST: f64 = 0.55;
/// Precision of a position in single precision, rad.
const HELD: f64 = 1e-5;

/// The requests and messages of a test to one group.
#[derive(Debug, Clone, Default)]
struct Watched {
    /// Time of its owner's last message that is good in every respect, or the end of its horizon.
    good_setpoint: Option<Instant>,
    /// A message arrived since the last cycle.
    delivered: bool,
    /// A reset was requested since the last cycle.
    reset: bool,
    /// An enable was requested, and nothing has stopped the group since.
    enabled: bool,
}

/// A frame to a motor, as recorded on the wire.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Time at which the cycle sent it.
    pub ready: Instant,
    /// Index of the bus.
    pub bus: usize,
    /// Id and bytes.
    pub frame: Frame,
}

/// Requests that permit commands to motors which are forbidden otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Request {
    Reset { group: usize },
    Enable { group: usize },
    SetZero { motor: usize },
    ClearFault { motor: usize },
}

/// A fault that a test injects into a bus, or ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BusFault {
    /// The host is disconnected from it, and must detect that.
    Cut,
    /// A fault keeps frames from the wire.
    Blocked,
    /// The bus is healthy again.
    Lifted,
}

/// A fault that a test injects into a motor, or ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotorFault {
    /// It is switched off, and the host must detect that.
    Off,
    /// The motor is healthy again.
    Lifted,
}

/// The invariant checker: its robot, and its record of the run so far.
#[derive(Debug)]
pub struct Checker {
    robot: Robot,
    /// The newest last.
    cycles: VecDeque<Cycle>,
    begun: Instant,
    groups: Vec<Watched>,
    slopes: Vec<Slopes>,
    /// By motor: the last control command, of native motors.
    last: Vec<native::Last>,
    /// By motor: the reported velocities, of native motors.
    velocities: Vec<Velocities>,
    /// By motor: number of set zero commands that it may still receive.
    zeros: Vec<u32>,
    /// By motor: time until which it may receive clear fault commands.
    clears: Vec<Instant>,
    sent: Vec<u32>,
    /// By bus: a fault keeps it from carrying frames.
    blocked: Vec<bool>,
    /// By bus: the host was disconnected from it, and it is not known to be healthy again.
    cut: Vec<bool>,
    injections: Injections,
    lossy: bool,
    /// Replies since the previous cycle, and those that were passed with that cycle.
    replies: [Vec<Reply>; 2],
}

impl Checker {
    /// Returns a checker that has observed nothing of `robot` until `now`.
    #[must_use]
    pub fn new(robot: Robot, now: Instant) -> Self {
        let (motors, groups, buses) = (robot.motors.len(), robot.groups.len(), robot.buses);
        Self {
            robot,
            cycles: VecDeque::new(),
            begun: now,
            groups: vec![Watched::default(); groups],
            slopes: vec![Slopes::default(); motors],
            last: vec![native::Last::default(); motors],
            velocities: vec![Velocities::default(); motors],
            zeros: vec![0; motors],
            clears: vec![Instant::ZERO; motors],
            sent: vec![0; buses],
            blocked: vec![false; buses],
            cut: vec![false; buses],
            injections: Injections::default(),
            lossy: false,
            replies: Default::default(),
        }
    }

    /// Permits lost frames from now on, so that counters and the wire cannot be compared any more.
    pub fn allow_loss(&mut self) {
        self.lossy = true;
    }

    /// Records a fault of a bus.
    pub fn disturb_bus(&mut self, bus: usize, fault: BusFault) {
        self.blocked[bus] = fault != BusFault::Lifted;
        self.cut[bus] |= fault == BusFault::Cut;
        match fault {
            BusFault::Cut => self.begin(Target::Bus(bus)),
            BusFault::Blocked | BusFault::Lifted => self.injections.end(Target::Bus(bus)),
        }
    }

    /// Records a fault of a motor.
    pub fn disturb_motor(&mut self, motor: usize, fault: MotorFault) {
        match fault {
            MotorFault::Off => self.begin(Target::Motor(motor)),
            MotorFault::Lifted => self.injections.end(Target::Motor(motor)),
        }
    }

    /// Begins a fault, which must stop the active groups with this target. Before the first cycle
    /// no group is active.
    fn begin(&mut self, target: Target) {
        if let Some(last) = self.cycles.back() {
            self.injections.begin(target, &self.robot, &last.state);
        }
    }

    /// Records a request.
    pub fn asked(&mut self, request: Request) {
        match request {
            Request::Reset { group } => self.groups[group].reset = true,
            Request::Enable { group } => self.groups[group].enabled = true,
            Request::SetZero { motor } => self.zeros[motor] += 1,
            Request::ClearFault { motor } => self.clears[motor] = self.begun + CLEAR_TIME,
        }
    }

    /// Records a message of the group's owner that is good in every respect. Its setpoints are
    /// reached at `end`: when it was sent, or at the end of its horizon.
    pub fn good_setpoint(&mut self, group: usize, end: Instant) {
        self.groups[group].good_setpoint = Some(end);
    }

    /// Records that a message that names the group is in flight.
    pub fn delivered(&mut self, group: usize) {
        self.groups[group].delivered = true;
    }

    /// Checks a cycle: its published state, and the frames since the previous cycle, in the order
    /// of the wire.
    ///
    /// # Panics
    ///
    /// When a rule is broken, with its name.
    pub fn check(&mut self, state: State, commands: &[Command], replies: &[Reply]) {
        self.replies.swap(0, 1);
        self.replies[0] = replies.to_vec();
        let mut cycles = std::mem::take(&mut self.cycles);
        let cycle = self.see(Rc::new(state), cycles.back());
        self.check_counts(&cycle, commands);
        for motor in 0..self.robot.motors.len() {
            self.check_activation(motor, &cycle);
            self.velocities[motor].receive(&self.robot.motors[motor], replies);
            self.check_joint(motor, &cycle);
            if !matches!(cycle.state.joints[motor].mode, Mode::Active | Mode::Damping) {
                let time = self.time(motor, &cycle);
                self.last[motor].rest(time);
            }
        }
        self.injections.check(&cycle);
        check_counters(&cycle.before, &cycle.state);
        for (group, watched) in self.groups.iter_mut().enumerate() {
            check_group(watched, &cycle.before.groups[group], &cycle.state.groups[group]);
        }
        cycles.push_back(cycle);
        for command in commands {
            let cycle = cycles.iter_mut().rfind(|cycle| cycle.begun <= command.ready);
            self.check_command(cycle.expect("no frame waits longer than the checker remembers"), command);
        }
        stop::check(&self.robot, &cycles);
        if cycles.len() > MEMORY_CYCLES {
            cycles.pop_front();
        }
        self.cycles = cycles;
    }

    /// Records a cycle before its frames are known.
    fn see(&mut self, state: Rc<State>, last: Option<&Cycle>) -> Cycle {
        let begun = state.begun;
        let elapsed = begun.since(self.begun).min(2 * self.robot.period).as_secs_f64();
        self.begun = begun;
        let before = last.map_or_else(|| Rc::clone(&state), |last| Rc::clone(&last.state));
        let motors = self.robot.motors.len();
        Cycle {
            elapsed,
            time: last.map_or(0.0, |last| last.time) + elapsed,
            good_setpoint: self.groups.iter().map(|group| group.good_setpoint).collect(),
            enabled: self.groups.iter().map(|group| group.enabled).collect(),
            held: (0..motors).map(|motor| held(motor, &before, &state, last)).collect(),
            well: (0..self.blocked.len()).map(|bus| self.is_well(bus, [&before, &state])).collect(),
            received: vec![None; motors],
            frames: vec![0; self.blocked.len()],
            before,
            state,
            begun,
        }
    }

    /// Returns `true` when no fault keeps frames from the wire and the cycle serves the bus. A cycle
    /// may give up a bus only after a disconnection.
    fn is_well(&mut self, bus: usize, states: [&State; 2]) -> bool {
        let [before, now] = states.map(|state| &state.buses[bus]);
        let given_up = before.given_up || now.given_up;
        let held = before.held || now.held;
        assert!(self.cut[bus] || !given_up, "I10: bus {bus} was given up");
        // Where motors take turns, the host detects a disconnection only with its next frame: the
        // bus may be healthy by then.
        let uses = self.robot.turn(bus) == 1 || now.sent != before.sent;
        self.cut[bus] &= given_up || self.blocked[bus] || !uses;
        !given_up && !held && !self.blocked[bus]
    }

    fn check_counts(&mut self, cycle: &Cycle, commands: &[Command]) {
        for bus in 0..self.robot.buses {
            self.sent[bus] += commands.iter().filter(|command| command.bus == bus).count() as u32;
            // A fault request is sent after the states were published.
            let unpublished = self.sent[bus].wrapping_sub(cycle.state.buses[bus].sent) as i32;
            assert!(unpublished <= 1, "I8: {unpublished} frames more on the wire than counted");
            assert!(self.lossy || unpublished >= 0, "I8: {unpublished} frames on the wire");
        }
    }

    /// Checks a frame by the cycle that sent it.
    fn check_command(&mut self, cycle: &mut Cycle, command: &Command) {
        let Command { bus, frame, .. } = *command;
        let motors = &self.robot.motors;
        let motor = motors.iter().position(|motor| motor.bus == bus && motor.commands.matches(frame.id()));
        let (motor, order) = match motor {
            Some(motor) => {
                let codec = motors[motor].protocol.codec();
                codec.check(&frame);
                (motor, codec.order(&frame).on_joint(motors[motor].direction, motors[motor].offset))
            }
            None => {
                let motor = self.robot.register_reader(bus, &frame);
                (motor.expect("frames go to motors"), Meaning::GetRegister)
            }
        };
        cycle.frames[bus] += 1;
        let most = 1 + motors.iter().filter(|motor| motor.bus == bus).count();
        assert!(cycle.frames[bus] <= most, "I5: more than {most} frames");
        let before = &cycle.received[motor];
        let first = before.is_none() || order.is_question();
        assert!(first, "I5: {order:?} after {before:?} for {}", motors[motor].name);
        let received = ReceivedCommand::of(order, motor, [&cycle.before, &cycle.state]);
        cycle.received[motor].get_or_insert(received);
        self.check_values(cycle, motor, order);
        self.check_order(cycle, motor, received);
    }

    /// Checks that a motor begins to follow setpoints without gains and torque, and at its present
    /// position.
    fn check_activation(&mut self, motor: usize, cycle: &Cycle) {
        let (before, now) = (&cycle.before.joints[motor], &cycle.state.joints[motor]);
        if before.mode == Mode::Starting {
            self.slopes[motor] = Slopes::from(f64::from(before.position), cycle.time - cycle.elapsed);
        }
        let started = now.mode == Mode::Active && before.mode != now.mode;
        assert!(!started || before.mode == Mode::Starting, "I1: active without a start");
    }

    fn check_order(&mut self, cycle: &Cycle, motor: usize, received: ReceivedCommand) {
        let order = received.order;
        let excluded =
            [&cycle.before, &cycle.state].iter().all(|state| state.joints[motor].mode == Mode::Excluded);
        let rests = matches!(order, Meaning::Stop | Meaning::GetIndicator);
        assert!(!excluded || rests, "I4: {order:?} to an excluded motor");
        let group = self.robot.groups.iter().position(|group| group.motors.contains(&motor));
        let group = group.expect("every motor is in a group");
        match order {
            Meaning::Stop | Meaning::GetFault | Meaning::GetIndicator => {}
            Meaning::GetRegister => {
                let stopped = |state: &Rc<State>| {
                    !matches!(state.joints[motor].mode, Mode::Starting | Mode::Active | Mode::Damping)
                };
                assert!(
                    stopped(&cycle.before) && stopped(&cycle.state),
                    "I4: {order:?} to a motor that moves"
                );
            }
            Meaning::Start => {
                let asked = cycle.enabled[group] && cycle.touches(group, Phase::Starting);
                assert!(asked, "I1: start in {:?}", cycle.state.groups[group].phase);
            }
            Meaning::Mode => assert!(!cycle.is(group, Phase::Disarmed), "I4: a mode for a stopped motor"),
            Meaning::SetZero => {
                assert!(self.zeros[motor] > 0 && cycle.touches(group, Phase::Disarmed), "I1: set zero");
                self.zeros[motor] -= 1;
            }
            Meaning::ClearFault => {
                let asked = cycle.begun <= self.clears[motor] && cycle.touches(group, Phase::Disarmed);
                assert!(asked, "I1: clear fault");
            }
            Meaning::Other(command) => panic!("I1: command {command:#04X} to a native motor"),
            Meaning::Control { .. } | Meaning::Torque(_) | Meaning::Speed(_) | Meaning::Position(_) => {
                assert!(!cycle.is(group, Phase::Disarmed), "I4: {order:?} to a stopped motor");
                if !received.is_safe && !self.holds(cycle, group, motor, order) {
                    check_motion(self.robot.setpoint_timeout, cycle, group);
                }
            }
        }
    }

    /// Returns `true` when the command holds a motor of a group that holds after its owner is late
    /// or lost.
    fn holds(&self, cycle: &Cycle, group: usize, motor: usize, order: Meaning) -> bool {
        let causes = [Cause::None, Cause::SetpointTimeout, Cause::OwnerLost];
        self.robot.groups[group].safe_stop == SafeStop::Hold
            && causes.contains(&cycle.before.groups[group].cause)
            && cycle.state.groups[group].phase == Phase::Damping
            && is_held(&self.robot.motors[motor], order, cycle.held[motor])
    }

    /// Checks the limits of every value, and of its slope while the motor follows setpoints.
    fn check_values(&mut self, cycle: &Cycle, motor: usize, order: Meaning) {
        let Motor { protocol, limits, damping_kd, .. } = &self.robot.motors[motor];
        let [before, now] = [&cycle.before, &cycle.state].map(|state| &state.joints[motor]);
        let active = now.mode == Mode::Active;
        let (Some(codes), Meaning::Control { position, kp, kd, torque, .. }) =
            (protocol.codec().codes(), order)
        else {
            return self.check_native(cycle, motor, order);
        };
        check_gains([kp, kd], [limits.kp.most, limits.kd.most.max(*damping_kd)], &codes);
        check_impedance(order, limits, self.states(cycle, motor), &codes);
        if kp > 0.0 && active && !now.slews {
            let [low, high] = limits.position;
            let noise = NEAREST * codes.position;
            assert!((low - noise..=high + noise).contains(&position), "I2: position {position}");
        }
        if before.applied_kp == 0.0 {
            self.slopes[motor].rest_at(f64::from(before.position), cycle.time - cycle.elapsed);
        }
        if active {
            self.slopes[motor].check(cycle.time, limits, position, [kp, kd, torque], &codes);
        }
    }

    /// Returns the states that a command of the cycle may have begun from, rad and rad/s: the published
    /// one, and newer ones that arrived before the cycle.
    fn states(&self, cycle: &Cycle, motor: usize) -> impl Iterator<Item = [f64; 2]> {
        let (before, settings) = (&cycle.before.joints[motor], &self.robot.motors[motor]);
        let (begun, known) = (cycle.begun, before.receive_ns);
        let replies = self.replies.iter().flatten();
        let newer = replies.filter(move |reply| reply.at <= begun && reply.at.as_nanos() > known);
        let newer = newer.filter_map(move |reply| reported::state(reply, settings));
        std::iter::once([f64::from(before.position), f64::from(before.velocity)]).chain(newer)
    }

    /// Returns the time of a command for slews, s. A late cycle counts as at most two periods,
    /// except for a motor that takes turns.
    fn time(&self, motor: usize, cycle: &Cycle) -> f64 {
        if self.robot.motors[motor].has_turns() { cycle.begun.as_nanos() as f64 / 1e9 } else { cycle.time }
    }

    fn check_native(&mut self, cycle: &Cycle, motor: usize, order: Meaning) {
        let (limits, time) = (&self.robot.motors[motor].limits, self.time(motor, cycle));
        let joints = [&cycle.before, &cycle.state].map(|state| &state.joints[motor]);
        let [_, now] = joints;
        let both = |mode: Mode| joints.iter().all(|joint| joint.mode == mode);
        let active = both(Mode::Active);
        native::check_value(order, limits, active && !now.slews);
        match order {
            _ if order.is_question() || order == Meaning::Mode => {}
            Meaning::Torque(_) | Meaning::Speed(_) | Meaning::Position(_) if active => {
                let fast = f64::from(now.applied_velocity);
                let is_wrong = matches!(order, Meaning::Torque(_)) && is_wrong_lease(fast);
                assert!(!is_wrong, "I7: a setpoint with the wrong lease was followed");
                let settings = &self.robot.motors[motor];
                let turn = (settings.turn * self.robot.period).as_secs_f64();
                let turn = settings.has_turns().then_some(turn);
                let velocities: Vec<f64> = self.states(cycle, motor).map(|[_, velocity]| velocity).collect();
                self.last[motor].check(order, (time, turn), limits, joints, &velocities);
            }
            Meaning::Speed(_) if both(Mode::Damping) => {
                // A line may lose frames that were sent.
                let has_turns = self.robot.motors[motor].has_turns();
                let applied = if has_turns { f64::from(joints[0].applied_velocity) } else { 0.0 };
                self.last[motor].check_braking(order, time, limits, applied);
            }
            _ => self.last[motor].forget(),
        }
    }

    fn check_joint(&self, motor: usize, cycle: &Cycle) {
        let (before, now) = (&cycle.before.joints[motor], &cycle.state.joints[motor]);
        // The state of a motor that takes turns does not age while it waits for its turn.
        let has_turns = self.robot.motors[motor].has_turns();
        let is_new = now.age_cycles == 0 && now.receive_ns > 0;
        assert!(now.fresh == is_new || has_turns && is_new, "I6: {now:?}");
        assert_eq!(now.valid, now.position.is_finite(), "I6: {now:?}");
        let same = |now: f32, before: f32| now.to_bits() == before.to_bits() || now.is_nan();
        let kept = same(now.position, before.position) && same(now.velocity, before.velocity);
        // The daemon has just found out that the last state was older than its reply.
        let is_backdated = kept && now.receive_ns < before.receive_ns && now.age_cycles > before.age_cycles;
        let is_late = now.valid && !is_new && now.receive_ns != before.receive_ns && !is_backdated;
        if now.fresh {
            let (settings, velocities) = (&self.robot.motors[motor], &self.velocities[motor]);
            let is_later = now.receive_ns > before.receive_ns || cycle.state.cycle == cycle.before.cycle;
            assert!(is_later, "I6: told twice: {now:?}");
            // A reply may arrive after the last read of a cycle.
            let mut replies = self.replies.iter().flatten().filter(|reply| reply.at >= cycle.before.begun);
            let is_reported = replies.any(|reply| {
                reply.at.as_nanos() == now.receive_ns
                    && reported::reports(reply, settings, before, now, velocities)
            });
            assert!(is_reported, "I6: no reply of {} said {now:?}", settings.name);
        } else if is_late {
            // The reply is on the wire, and at least as much newer than its state.
            let mut replies = self.replies.iter().flatten();
            let (settings, velocities) = (&self.robot.motors[motor], &self.velocities[motor]);
            let is_reported =
                replies.any(|reply| reported::reports(reply, settings, before, now, velocities));
            assert!(is_reported, "I6: no reply of {} said {now:?}", settings.name);
            let old = cycle.begun.as_nanos().saturating_sub(now.receive_ns);
            let least = u64::from(now.age_cycles - 1) * self.robot.period.as_nanos() as u64;
            assert!(old >= least, "I6: not as old as it says: {now:?}");
        } else if now.valid && cycle.state.cycle > cycle.before.cycle {
            let is_kept = has_turns && now.age_cycles == before.age_cycles;
            let is_aged = now.age_cycles == before.age_cycles + 1 && now.receive_ns == before.receive_ns;
            assert!(is_kept || is_aged || is_backdated, "I6: the age of {now:?} after {before:?}");
            assert!(kept, "I6: {now:?} from {before:?}");
        }
    }
}

fn check_gains([kp, kd]: [f64; 2], [kp_most, kd_most]: [f64; 2], codes: &Ranges) {
    assert!(kp <= kp_most + NEAREST * codes.kp, "I2: kp {kp}");
    assert!(kd <= kd_most + NEAREST * codes.kd, "I2: kd {kd}");
}

/// Checks the velocity and the torque of an impedance, and its total torque at the last state: the
/// published one, or a newer one.
fn check_impedance(order: Meaning, limits: &Limits, states: impl Iterator<Item = [f64; 2]>, codes: &Ranges) {
    let Meaning::Control { position, velocity, kp, kd, torque, .. } = order else { return };
    assert!(!is_wrong_lease(velocity), "I7: a setpoint with the wrong lease was followed");
    assert!(velocity.abs() <= limits.velocity + NEAREST * codes.velocity, "I2: velocity {velocity}");
    assert!(torque.abs() <= limits.torque.most + codes.torque, "I2: torque {torque}");
    let excess = |[at, speed]: [f64; 2]| {
        let (far, fast) = (position - at, velocity - speed);
        let total = kp * far + kd * fast + torque;
        // Velocity and torque are up to a code off: their errors are carried.
        let noise = NEAREST * (codes.kp * far.abs() + codes.position * kp + codes.kd * fast.abs())
            + codes.velocity * kd
            + codes.torque;
        total.abs() - (limits.torque.most + noise)
    };
    // An unknown state has no bound.
    let least = states.map(excess).fold(f64::NAN, f64::min);
    assert!(least.is_nan() || least <= 0.0, "I2: {least} N·m more than the limit in all");
}

fn is_wrong_lease(velocity: f64) -> bool {
    (velocity - f64::from(WRONG_LEASE_VELOCITY)).abs() <= 0.05
}

fn check_motion(timeout: Duration, cycle: &Cycle, group: usize) {
    let (before, now) = (&cycle.before.groups[group], &cycle.state.groups[group]);
    assert_eq!(before.cause, Cause::None, "I10: motion in the cycle after a cause");
    assert!(now.phase == Phase::Active || now.cause != Cause::None, "I4: motion in phase {:?}", now.phase);
    let good = cycle.good_setpoint[group].expect("I3: motion without any setpoint");
    let age = cycle.begun.since(good);
    assert!(age <= timeout, "I3: motion on a setpoint that is {age:?} old");
}

/// Returns the positions at which a motor may be held, rad: its present one, and the one at which
/// its damping began.
fn held(motor: usize, before: &State, state: &State, last: Option<&Cycle>) -> [f64; 2] {
    match last {
        Some(last) if before.joints[motor].mode == Mode::Damping => last.held[motor],
        _ => [before, state].map(|state| f64::from(state.joints[motor].position)),
    }
}

/// Returns `true` when the command holds the motor at one of these positions, rad.
fn is_held(motor: &Motor, order: Meaning, held: [f64; 2]) -> bool {
    let (Meaning::Control { position, neutral: true, .. } | Meaning::Position(position)) = order else {
        return false;
    };
    held.iter().any(|held| (position - held).abs() < motor.protocol.position_code().max(HELD))
}

fn check_group(watched: &mut Watched, before: &Group, now: &Group) {
    let (was, is) = (before.cause, now.cause);
    let kept = is == was || was == Cause::None || is == Cause::EmergencyStop;
    assert!(kept || watched.reset, "I9: cause {was:?} became {is:?}");
    let stopped = matches!(now.phase, Phase::Disarmed | Phase::Damping);
    assert!(is == Cause::None || stopped, "I9: phase {:?} with cause {is:?}", now.phase);
    let new = now.messages.wrapping_sub(before.messages);
    assert_eq!(new, u32::from(watched.delivered), "I8: messages counted in this cycle");
    if is != Cause::None || now.phase == Phase::Disarmed {
        watched.enabled = false;
    }
    (watched.reset, watched.delivered) = (false, false);
}

fn check_counters(before: &State, now: &State) {
    assert!(now.cycle >= before.cycle && now.missed_ticks >= before.missed_ticks, "I8: cycles");
    for (before, now) in before.buses.iter().zip(&now.buses) {
        assert!(never_fell(before, now), "I8: {now:?}");
    }
    for (before, now) in before.joints.iter().zip(&now.joints) {
        assert!(now.missed >= before.missed && now.late >= before.late, "I8: {now:?}");
    }
}

fn never_fell(before: &Bus, now: &Bus) -> bool {
    before.counters.iter().zip(&now.counters).all(|(before, now)| now >= before)
}
