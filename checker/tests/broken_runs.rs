//! Goal: the rules for simulated runs accept a robot that obeys them, and refuse one that breaks any one of them.
//! Method: one motor whose every cycle is written by hand, first well and then with one thing wrong.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use motord_bus::{Duration, Frame, FrameId, Instant};
use motord_checker::codec::{Ranges, Reply};
use motord_checker::robot::{Group, Limits, Motor, Robot, SafeStop};
use motord_checker::run::{self, BusFault, Checker, Command, MotorFault, Request};
use motord_checker::state::{self, Bus, Cause, Joint, Mode, Phase, State};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Commands at 0.000 19 rad, a code of the middle: neutral; damping 0.2; 0.24 N·m/rad and 0.2; and the special ones.
const NEUTRAL: u64 = 0x8000_8000_0000_0800;
const DAMPING: u64 = 0x8000_8000_000A_4800;
const STIFF: u64 = 0x8000_8000_020A_4800;
const START: u64 = 0xFFFF_FFFF_FFFF_FFFC;
const STOP: u64 = 0xFFFF_FFFF_FFFF_FFFD;
const SET_ZERO: u64 = 0xFFFF_FFFF_FFFF_FFFE;
const CLEAR_FAULT: u64 = 0xFFFF_FFFF_FFFF_FFFB;
const GET_FAULT: u64 = 0xFFFF_FFFF_FFFF_00FB;

/// A robot of one motor with replies of this kind.
fn robot(reply: Reply) -> Robot {
    let limits = Limits {
        position: [-1.0, 1.0],
        velocity: 20.0,
        torque: 10.0,
        kp: 100.0,
        kd: 3.0,
        torque_slew: 100.0,
        kp_slew: 1000.0,
        kd_slew: 1000.0,
    };
    let motor = Motor {
        name: "hip".into(),
        bus: 0,
        id: 1,
        reply_id: 0x101,
        ranges: Ranges::steadywin(20.0),
        reply,
        direction: 1.0,
        offset: 0.0,
        damping_kd: 0.2,
        limits,
    };
    Robot {
        motors: vec![motor],
        groups: vec![Group { motors: vec![0], safe_stop: SafeStop::Damp }],
        buses: 1,
        period: Duration::from_millis(1),
        setpoint_timeout: Duration::from_millis(20),
        lost_cycles: 10,
    }
}

/// A robot whose cycles are written one by one.
struct Script {
    checker: Checker,
    state: State,
}

/// A cycle as it should be; tests change one thing.
struct Next {
    state: State,
    commands: Vec<u64>,
    reply: Vec<u8>,
}

impl Script {
    fn new() -> Self {
        Self::of(robot(Reply::STEADYWIN))
    }

    fn of(robot: Robot) -> Self {
        let joint = Joint {
            position: 0.000_19,
            velocity: 0.015_87,
            applied_kp: 0.0,
            slews: false,
            fresh: true,
            valid: true,
            mode: Mode::Idle,
            age_cycles: 0,
            missed: 0,
            late: 0,
            receive_ns: 0,
        };
        let group = state::Group { phase: Phase::Disarmed, cause: Cause::None, messages: 0 };
        let state = State {
            cycle: 0,
            missed_ticks: 0,
            begun: Instant::from_nanos(1_000_000_000),
            joints: vec![joint],
            groups: vec![group],
            buses: vec![Bus { given_up: false, sent: 0, counters: [0; 8] }],
        };
        Self { checker: Checker::new(robot, state.begun), state }
    }

    /// The next cycle: this command, and a good reply to it.
    fn next(&self, phase: Phase, mode: Mode, command: u64) -> Next {
        let mut state = self.state.clone();
        state.cycle += 1;
        state.begun = state.begun + Duration::from_millis(1);
        state.groups[0].phase = phase;
        state.joints[0].mode = mode;
        state.joints[0].receive_ns = state.begun.as_nanos() + 500_000;
        state.buses[0].sent += 1;
        Next { state, commands: vec![command], reply: vec![1, 0x80, 0, 0x80, 0x08, 0] }
    }

    fn judge(&mut self, next: Next) {
        let Next { state, commands, reply } = next;
        let frame = |bytes: u64| Frame::full(FrameId::new(1).unwrap(), bytes.to_be_bytes());
        let command = |bytes: &u64| Command { ready: state.begun, bus: 0, frame: frame(*bytes) };
        let commands: Vec<_> = commands.iter().map(command).collect();
        let at = Instant::from_nanos(state.joints[0].receive_ns);
        let frame = Frame::new(FrameId::new(0x101).unwrap(), &reply).unwrap();
        self.checker.judge(state.clone(), &commands, &[run::Reply { at, bus: 0, frame }]);
        self.state = state;
    }

    fn cycle(&mut self, phase: Phase, mode: Mode, command: u64) {
        let next = self.next(phase, mode, command);
        self.judge(next);
    }

    /// Asked for, started, and followed for some cycles.
    fn active() -> Self {
        let mut robot = Self::new();
        robot.cycle(Phase::Disarmed, Mode::Idle, STOP);
        robot.checker.asked(Request::Enable { group: 0 });
        robot.cycle(Phase::Starting, Mode::Starting, START);
        robot.cycle(Phase::Starting, Mode::Starting, NEUTRAL);
        for _ in 0..10 {
            robot.follow(STIFF);
        }
        robot
    }

    fn setpoint(&mut self) {
        self.checker.good_setpoint(0, self.state.begun);
        self.checker.delivered(0);
    }

    /// A cycle with a new setpoint.
    fn following(&mut self, command: u64) -> Next {
        self.setpoint();
        let mut next = self.next(Phase::Active, Mode::Active, command);
        next.state.groups[0].messages += 1;
        next
    }

    fn follow(&mut self, command: u64) {
        let next = self.following(command);
        self.judge(next);
    }

    /// Some cycles later: so many that the frames of the cycle before are judged as a stop.
    fn later(&mut self, phase: Phase, mode: Mode, command: u64) {
        for _ in 0..5 {
            self.cycle(phase, mode, command);
        }
    }
}

/// The checker says that this rule is broken.
fn refuses(rule: &str, story: impl FnOnce()) {
    let said = catch_unwind(AssertUnwindSafe(story)).expect_err(rule);
    let said = said
        .downcast_ref::<String>()
        .cloned()
        .or_else(|| said.downcast_ref::<&str>().map(ToString::to_string));
    let said = said.unwrap();
    assert!(said.contains(rule), "expected {rule}: {said}");
}

/// A robot that is active does this in its next cycle.
fn refuses_next(rule: &str, change: impl FnOnce(&mut Next)) {
    refuses(rule, || {
        let mut robot = Script::active();
        let mut next = robot.following(STIFF);
        change(&mut next);
        robot.judge(next);
    });
}

#[test]
fn a_robot_that_starts_follows_is_damped_and_stopped_is_accepted() {
    let mut robot = Script::active();
    let mut next = robot.next(Phase::Damping, Mode::Damping, DAMPING);
    next.state.groups[0].cause = Cause::EmergencyStop;
    robot.judge(next);
    robot.later(Phase::Damping, Mode::Damping, DAMPING);
    robot.later(Phase::Disarmed, Mode::Idle, STOP);
}

#[test]
fn i1_commands_that_nobody_asked_for() {
    refuses("I1: start", || Script::new().cycle(Phase::Starting, Mode::Starting, START));
    refuses("I1: set zero", || Script::new().cycle(Phase::Disarmed, Mode::Idle, SET_ZERO));
    refuses("I1: clear fault", || Script::new().cycle(Phase::Disarmed, Mode::Idle, CLEAR_FAULT));
    refuses("I1: the all-zero frame", || Script::new().cycle(Phase::Disarmed, Mode::Idle, 0));
    refuses("I1: active without a start", || {
        let mut robot = Script::new();
        robot.cycle(Phase::Disarmed, Mode::Idle, STOP);
        robot.follow(NEUTRAL);
    });
}

#[test]
fn i1_a_question_to_a_motor_that_takes_it_for_a_command() {
    refuses("I1: a question", || {
        let reply = Reply { report: None, ..Reply::STEADYWIN };
        Script::of(robot(reply)).cycle(Phase::Disarmed, Mode::Idle, GET_FAULT);
    });
}

#[test]
fn i2_values_beyond_their_limits() {
    for (rule, command) in [
        ("I2: kp", 0x8000_8003_340A_4800),
        ("I2: kd", 0x8000_8000_02FF_F800),
        ("I2: velocity", 0x8000_FFF0_020A_4800),
        ("I2: torque", 0x8000_8000_020A_4E00),
        ("I2: torque rose", 0x8000_8000_020A_48A0),
        ("I2: position", 0xA000_8000_020A_4800),
        ("I2: the position stepped", 0x8100_8000_020A_4800),
        ("I7", 0x8000_A370_020A_4800),
    ] {
        refuses_next(rule, |next| next.commands[0] = command);
    }
}

#[test]
fn i3_and_i4_motion_without_a_reason() {
    refuses("I3", || {
        let mut robot = Script::active();
        for _ in 0..30 {
            robot.cycle(Phase::Active, Mode::Active, STIFF);
        }
    });
    refuses("I4", || Script::new().cycle(Phase::Disarmed, Mode::Idle, DAMPING));
    refuses("I4", || {
        let mut robot = Script::new();
        robot.checker.asked(Request::Enable { group: 0 });
        robot.cycle(Phase::Starting, Mode::Starting, STIFF);
    });
}

#[test]
fn i5_i6_and_i8_frames_states_and_counters() {
    refuses_next("I8", |next| next.commands.extend([GET_FAULT, GET_FAULT]));
    refuses_next("I5", |next| {
        next.commands.push(STIFF);
        next.state.buses[0].sent += 1;
    });
    refuses_next("I6", |next| next.reply[1] = 0x81);
    refuses_next("I6", |next| next.reply[0] = 2);
    refuses_next("I6", |next| next.state.joints[0].fresh = false);
    refuses_next("I6", |next| next.state.joints[0].valid = false);
    refuses_next("I8", |next| next.state.groups[0].messages += 1);
    refuses_next("I8", |next| next.state.cycle = 1);
    refuses_next("I8", |next| next.state.buses[0].sent += 1);
}

#[test]
fn i9_and_i10_causes_and_stops() {
    let stopped = || {
        let mut robot = Script::active();
        let mut next = robot.next(Phase::Damping, Mode::Damping, DAMPING);
        next.state.groups[0].cause = Cause::SetpointTimeout;
        robot.judge(next);
        robot
    };
    refuses("I9: cause", || {
        let mut robot = stopped();
        let mut next = robot.next(Phase::Damping, Mode::Damping, DAMPING);
        next.state.groups[0].cause = Cause::None;
        robot.judge(next);
    });
    refuses("I9: phase", || {
        let mut robot = stopped();
        robot.cycle(Phase::Active, Mode::Damping, DAMPING);
    });
    refuses("I10: motion", || {
        let mut robot = stopped();
        robot.cycle(Phase::Damping, Mode::Damping, STIFF);
    });
    refuses("I10: hip heard Some", || {
        let mut robot = stopped();
        robot.later(Phase::Damping, Mode::Damping, NEUTRAL);
    });
    refuses("I10: hip heard nothing", || {
        let mut robot = stopped();
        for _ in 0..5 {
            let mut next = robot.next(Phase::Damping, Mode::Damping, DAMPING);
            next.commands.clear();
            next.state.buses[0].sent -= 1;
            robot.judge(next);
        }
    });
    refuses("I10: a group was stopped without damping", || {
        let mut robot = Script::active();
        robot.later(Phase::Disarmed, Mode::Idle, STOP);
    });
}

#[test]
fn i10_faults_that_nobody_notices() {
    refuses("I10: nobody noticed", || {
        let mut robot = Script::active();
        robot.checker.disturb_bus(0, BusFault::Cut);
        (0..5).for_each(|_| robot.follow(STIFF));
    });
    refuses("I10: nobody noticed", || {
        let mut robot = Script::active();
        robot.checker.disturb_motor(0, MotorFault::Off);
        (0..20).for_each(|_| robot.follow(STIFF));
    });
    refuses_next("I10: bus 0 was given up", |next| next.state.buses[0].given_up = true);
}
