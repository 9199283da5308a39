//! Goal: the rules for simulated runs accept a robot that obeys them, and refuse one that breaks
//! any of them. Method: one motor whose every cycle is written by hand, first correct and then with
//! one error.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use motord_bus::{Duration, Frame, FrameId, IdFilter, Instant};
use motord_checker::protocol::Protocol;
use motord_checker::protocol::mit::{Mit, ReplyFormat};
use motord_checker::protocol::ranges::Ranges;
use motord_checker::robot::{Bound, Group, Limits, Motor, Robot, SafeStop};
use motord_checker::run::{self, BusFault, Checker, Command, MotorFault, Request};
use motord_checker::state::{self, Bus, Cause, Joint, Mode, Phase, State};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Commands at 0.000 19 rad, a code of the middle: neutral; damping 0.2; 0.24 N·m/rad and 0.2; and
/// the special ones.
const NEUTRAL: u64 = 0x8000_8000_0000_0800;
const DAMPING: u64 = 0x8000_8000_000A_4800;
const STIFF: u64 = 0x8000_8000_020A_4800;
const START: u64 = 0xFFFF_FFFF_FFFF_FFFC;
const STOP: u64 = 0xFFFF_FFFF_FFFF_FFFD;
const SET_ZERO: u64 = 0xFFFF_FFFF_FFFF_FFFE;
const CLEAR_FAULT: u64 = 0xFFFF_FFFF_FFFF_FFFB;
const GET_FAULT: u64 = 0xFFFF_FFFF_FFFF_00FB;

/// Native commands (GIM document 3.2), padded so that a motor in MIT mode reads only zeros. A
/// torque of 0.05 N·m; a speed of zero.
const NATIVE_START: u64 = 0x9100_8000_0000_0800;
const NATIVE_STOP: u64 = 0x9200_8000_0000_0800;
const NATIVE_FAULT: u64 = 0xB200_8000_0000_0800;
const NATIVE_CLEAR: u64 = 0xB300_8000_0000_0800;
const ANGLE: u64 = 0xB413_8000_0000_0800;
const TORQUE: u64 = 0x93CD_CC4C_3D00_0000;
const BRAKE: u64 = 0x9400_0000_0000_0000;

/// Returns a native control command with a value.
fn native(command: u8, value: f32) -> u64 {
    let [a, b, c, d] = value.to_le_bytes();
    u64::from_be_bytes([command, a, b, c, d, 0, 0, 0])
}

/// Returns MIT with replies of this form.
fn mit(reply: ReplyFormat) -> Protocol {
    Protocol::Mit(Mit { ranges: Ranges::steadywin(20.0), reply })
}

/// Returns a robot of one motor with this protocol.
fn robot(protocol: Protocol) -> Robot {
    let limits = Limits {
        position: [-1.0, 1.0],
        velocity: 20.0,
        torque: Bound { most: 10.0, slew: 100.0 },
        kp: Bound { most: 100.0, slew: 1000.0 },
        kd: Bound { most: 3.0, slew: 1000.0 },
    };
    let motor = Motor {
        name: "hip".into(),
        bus: 0,
        id: 1,
        commands: IdFilter::exact(FrameId::from(1)).into(),
        replies: IdFilter::exact(FrameId::new(0x101).unwrap()).into(),
        protocol,
        turn: 1,
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
    /// The reply of the motor to every command.
    reply: Vec<u8>,
}

/// A correct cycle, of which tests change one property.
struct Next {
    state: State,
    commands: Vec<u64>,
    reply: Vec<u8>,
}

impl Script {
    fn new() -> Self {
        Self::of(robot(mit(ReplyFormat::STEADYWIN)))
    }

    fn of(robot: Robot) -> Self {
        let joint = Joint {
            position: 0.000_19,
            velocity: 0.015_87,
            applied_kp: 0.0,
            applied_kd: 0.0,
            applied_velocity: 0.0,
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
            buses: vec![Bus { given_up: false, held: false, sent: 0, counters: [0; 8] }],
        };
        let reply = vec![1, 0x80, 0, 0x80, 0x08, 0];
        Self { checker: Checker::new(robot, state.begun), state, reply }
    }

    /// Returns a robot with a native motor that turns at 2.0476 rad/s: the code 0x840.
    fn native() -> Self {
        let mut script = Self::of(robot(Protocol::Native));
        script.state.joints[0].velocity = 2.047_62;
        script.reply = vec![0x93, 0, 25, 0x00, 0x80, 0x84, 0x08, 0x00];
        script
    }

    /// The same with a command in one of three cycles, active for some time and then stopped.
    fn damped_in_turns() -> Self {
        let mut robot = robot(Protocol::Native);
        robot.motors[0].turn = 3;
        let Self { state, reply, .. } = Self::native();
        let script = Self { checker: Checker::new(robot, state.begun), state, reply };
        script.activated([NATIVE_STOP, NATIVE_START, ANGLE, TORQUE]).stopped_by(BRAKE)
    }

    /// Adds a turn while it is damped: it waits for two cycles, then receives these commands.
    /// Waiting does not raise its age.
    fn turn(&mut self, phase: Phase, mode: Mode, commands: &[u64]) {
        for commands in [&[], &[], commands] {
            let before = self.state.joints[0];
            let mut next = self.next(phase, mode, BRAKE);
            next.commands = commands.to_vec();
            next.state.buses[0].sent = self.state.buses[0].sent + commands.len() as u32;
            next.state.joints[0].fresh = true;
            if commands.is_empty() {
                next.state.joints[0] = Joint { mode, fresh: false, ..before };
            }
            self.check(next);
        }
    }

    /// Returns the next cycle: this command, and a correct reply to it.
    fn next(&self, phase: Phase, mode: Mode, command: u64) -> Next {
        let mut state = self.state.clone();
        state.cycle += 1;
        state.begun = state.begun + Duration::from_millis(1);
        state.groups[0].phase = phase;
        state.joints[0].mode = mode;
        state.joints[0].receive_ns = state.begun.as_nanos() + 500_000;
        state.buses[0].sent += 1;
        Next { state, commands: vec![command], reply: self.reply.clone() }
    }

    fn check(&mut self, next: Next) {
        let Next { state, commands, reply } = next;
        let frame = |bytes: u64| Frame::classic(FrameId::new(1).unwrap(), bytes.to_be_bytes());
        let command = |bytes: &u64| Command { ready: state.begun, bus: 0, frame: frame(*bytes) };
        let commands: Vec<_> = commands.iter().map(command).collect();
        let at = Instant::from_nanos(state.joints[0].receive_ns);
        let frame = Frame::new(FrameId::new(0x101).unwrap(), &reply).unwrap();
        self.checker.check(state.clone(), &commands, &[run::Reply { at, bus: 0, frame }]);
        self.state = state;
    }

    fn cycle(&mut self, phase: Phase, mode: Mode, command: u64) {
        let next = self.next(phase, mode, command);
        self.check(next);
    }

    /// Returns a robot that was requested, started, and has followed setpoints for some cycles.
    fn active() -> Self {
        Self::new().activated([STOP, START, NEUTRAL, STIFF])
    }

    /// The same of a native motor.
    fn active_native() -> Self {
        Self::native().activated([NATIVE_STOP, NATIVE_START, ANGLE, TORQUE])
    }

    fn activated(mut self, [stop, start, neutral, follow]: [u64; 4]) -> Self {
        self.cycle(Phase::Disarmed, Mode::Idle, stop);
        self.checker.asked(Request::Enable { group: 0 });
        self.cycle(Phase::Starting, Mode::Starting, start);
        self.cycle(Phase::Starting, Mode::Starting, neutral);
        for _ in 0..10 {
            self.follow(follow);
        }
        self
    }

    /// Stops the robot by a request, and damps it by this command.
    fn stopped_by(mut self, command: u64) -> Self {
        let mut next = self.next(Phase::Damping, Mode::Damping, command);
        next.state.groups[0].cause = Cause::EmergencyStop;
        self.check(next);
        self
    }

    fn setpoint(&mut self) {
        self.checker.good_setpoint(0, self.state.begun);
        self.checker.delivered(0);
    }

    /// Returns a cycle with a new setpoint.
    fn following(&mut self, command: u64) -> Next {
        self.setpoint();
        let mut next = self.next(Phase::Active, Mode::Active, command);
        next.state.groups[0].messages += 1;
        next
    }

    fn follow(&mut self, command: u64) {
        let next = self.following(command);
        self.check(next);
    }

    /// Adds cycles until the frames of the cycle before count as a stop.
    fn later(&mut self, phase: Phase, mode: Mode, command: u64) {
        for _ in 0..5 {
            self.cycle(phase, mode, command);
        }
    }
}

/// Asserts that the checker reports this rule as broken.
fn refuses(rule: &str, story: impl FnOnce()) {
    let printed = catch_unwind(AssertUnwindSafe(story)).expect_err(rule);
    let printed = printed
        .downcast_ref::<String>()
        .cloned()
        .or_else(|| printed.downcast_ref::<&str>().map(ToString::to_string));
    let printed = printed.unwrap();
    assert!(printed.contains(rule), "expected {rule}: {printed}");
}

/// Asserts this for the next cycle of an active robot.
fn refuses_next(rule: &str, change: impl FnOnce(&mut Next)) {
    refuses(rule, || {
        let mut robot = Script::active();
        let mut next = robot.following(STIFF);
        change(&mut next);
        robot.check(next);
    });
}

#[test]
fn start_follow_damp_stop_is_accepted() {
    let mut robot = Script::active();
    let mut next = robot.next(Phase::Damping, Mode::Damping, DAMPING);
    next.state.groups[0].cause = Cause::EmergencyStop;
    robot.check(next);
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
fn i1_question_misread_as_command_is_refused() {
    refuses("I1: a question", || {
        let reply = ReplyFormat { report: None, ..ReplyFormat::STEADYWIN };
        Script::of(robot(mit(reply))).cycle(Phase::Disarmed, Mode::Idle, GET_FAULT);
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
        robot.check(next);
        robot
    };
    refuses("I9: cause", || {
        let mut robot = stopped();
        let mut next = robot.next(Phase::Damping, Mode::Damping, DAMPING);
        next.state.groups[0].cause = Cause::None;
        robot.check(next);
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
            robot.check(next);
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

#[test]
fn native_start_follow_damp_stop_is_accepted() {
    let mut robot = Script::active_native();
    // 19.1 rpm are 2 rad/s, which is the present speed of the joint.
    for command in [native(0x94, 19.1), native(0x95, 0.5), native(0x95, 0.51), TORQUE] {
        robot.follow(command);
    }
    let mut next = robot.following(TORQUE);
    next.commands.push(0xB400_8000_0000_0800);
    next.state.buses[0].sent += 1;
    robot.check(next);
    let mut robot = robot.stopped_by(BRAKE);
    robot.cycle(Phase::Damping, Mode::Damping, native(0x94, 19.0));
    robot.cycle(Phase::Damping, Mode::Damping, native(0x94, 18.9));
    robot.later(Phase::Damping, Mode::Damping, BRAKE);
    robot.later(Phase::Disarmed, Mode::Idle, NATIVE_STOP);
    robot.later(Phase::Disarmed, Mode::Idle, ANGLE);
}

#[test]
fn i1_unrequested_native_commands_are_refused() {
    let idle = |rule: &str, command: u64| {
        refuses(rule, || Script::native().cycle(Phase::Disarmed, Mode::Idle, command));
    };
    idle("I1: start", NATIVE_START);
    idle("I1: clear fault", NATIVE_CLEAR);
    idle("I1: the all-zero frame", 0);
    for command in [0x81, 0x82, 0x83, 0x84, 0x96, 0x97, 0xA1, 0xA2, 0xB1, 0xB5, 0xC1, 0xFF_u64] {
        let rule = format!("I1: command {command:#04X} to a native motor");
        idle(&rule, (command << 56) | 0x0000_8000_0000_0800);
    }
    // Zeros after the command byte are full negative torque and speed in MIT mode.
    for command in [0x92, 0xB2, 0xB4_u64] {
        idle("in MIT mode", command << 56);
    }
}

/// The robot has torques of 10 N·m, 100 N·m/s, 20 rad/s and ±1 rad.
#[test]
fn i2_and_i7_native_values_beyond_their_limits() {
    let next = |rule: &str, before: &[u64], command: u64| {
        refuses(rule, || {
            let mut robot = Script::active_native();
            before.iter().for_each(|command| robot.follow(*command));
            robot.follow(command);
        });
    };
    for (rule, before, command) in [
        ("I2: torque", &[][..], native(0x93, 10.01)),
        ("I2: torque", &[], native(0x93, f32::NAN)),
        ("I2: the torque stepped", &[], native(0x93, 0.16)),
        ("I2: the torque stepped", &[], native(0x93, -0.06)),
        ("I2: velocity", &[], native(0x94, 192.0)),
        ("I2: the speed stepped", &[], native(0x94, 25.0)),
        ("I2: the speed stepped", &[native(0x94, 19.0)], native(0x94, 18.0)),
        ("I2: position", &[], native(0x95, 1.01)),
        ("I2: position", &[], native(0x95, f32::INFINITY)),
        ("I2: the position stepped", &[native(0x95, 0.5)], native(0x95, 0.53)),
    ] {
        next(rule, before, command);
    }
    refuses("I7", || {
        let mut robot = Script::active_native();
        let mut next = robot.following(TORQUE);
        next.state.joints[0].applied_velocity = 18.0;
        robot.check(next);
    });
}

#[test]
fn i3_and_i4_native_motion_without_a_reason() {
    refuses("I3", || {
        let mut robot = Script::active_native();
        for _ in 0..30 {
            robot.cycle(Phase::Active, Mode::Active, TORQUE);
        }
    });
    refuses("I4", || Script::native().cycle(Phase::Disarmed, Mode::Idle, BRAKE));
    // 25 rpm are 2.6 rad/s, which is faster than the joint turns.
    for command in [TORQUE, native(0x94, 25.0), native(0x95, 0.0)] {
        refuses("I4", || {
            let mut robot = Script::native();
            robot.checker.asked(Request::Enable { group: 0 });
            robot.cycle(Phase::Starting, Mode::Starting, command);
        });
    }
}

#[test]
fn i5_i6_double_commands_and_invented_states_refused() {
    let next = |rule: &str, change: fn(&mut Next)| {
        refuses(rule, || {
            let mut robot = Script::active_native();
            let mut next = robot.following(TORQUE);
            change(&mut next);
            robot.check(next);
        });
    };
    next("I5", |next| next.commands.push(TORQUE));
    next("I6", |next| next.reply[1] = 1);
    next("I6", |next| next.reply[4] = 0x81);
    next("I6", |next| next.reply[5] = 0x85);
    next("I6", |next| next.reply[0] = 0x92);
    // The angle of the shaft, and a velocity that was never reported and is not that of the state
    // before.
    let angle = [0xB4, 0x13, 0, 0, 0, 0, 0, 0];
    let mut robot = Script::active_native();
    let mut fine = robot.following(TORQUE);
    (fine.reply, fine.state.joints[0].position) = (angle.to_vec(), 0.0);
    robot.check(fine);
    refuses("I6", || {
        let mut robot = Script::active_native();
        let mut next = robot.following(TORQUE);
        (next.reply, next.state.joints[0].position) = (angle.to_vec(), 0.0);
        next.state.joints[0].velocity += 0.5;
        robot.check(next);
    });
}

#[test]
fn i10_undamped_native_motor_is_refused() {
    // Torques against its motion and with it; a speed beyond its own, and a reversed one; a
    // position at which it was not held.
    for command in [native(0x93, -0.5), TORQUE, native(0x94, 25.0), native(0x94, -1.0), native(0x95, 0.1)] {
        refuses("I10: motion", || {
            let mut robot = Script::active_native().stopped_by(BRAKE);
            robot.cycle(Phase::Damping, Mode::Damping, command);
        });
    }
    refuses("I10: a speed that brakes was", || {
        let mut robot = Script::active_native().stopped_by(BRAKE);
        (0..2).for_each(|_| robot.cycle(Phase::Damping, Mode::Damping, native(0x94, 19.0)));
    });
    refuses("while it is damped", || {
        let mut robot = Script::active_native().stopped_by(BRAKE);
        robot.later(Phase::Damping, Mode::Damping, native(0x93, 0.0));
    });
    refuses("I10: hip heard nothing", || {
        let mut robot = Script::active_native().stopped_by(BRAKE);
        for _ in 0..5 {
            let mut next = robot.next(Phase::Damping, Mode::Damping, BRAKE);
            next.commands.clear();
            next.state.buses[0].sent -= 1;
            robot.check(next);
        }
    });
    // A fault request may replace one command, not all.
    refuses("while it is damped", || {
        let mut robot = Script::active_native().stopped_by(BRAKE);
        robot.later(Phase::Damping, Mode::Damping, NATIVE_FAULT);
    });
    refuses("I10: nobody noticed", || {
        let mut robot = Script::active_native();
        robot.checker.disturb_motor(0, MotorFault::Off);
        (0..20).for_each(|_| robot.follow(TORQUE));
    });
}

#[test]
fn motor_in_turns_is_judged_by_them() {
    let mut robot = Script::damped_in_turns();
    (0..10).for_each(|_| robot.turn(Phase::Damping, Mode::Damping, &[BRAKE]));
    (0..10).for_each(|_| robot.turn(Phase::Disarmed, Mode::Idle, &[NATIVE_STOP]));
    refuses("I10: hip heard nothing", || {
        let mut robot = Script::damped_in_turns();
        (0..10).for_each(|_| robot.turn(Phase::Damping, Mode::Damping, &[]));
    });
    refuses("while it is damped", || {
        let mut robot = Script::damped_in_turns();
        (0..10).for_each(|_| robot.turn(Phase::Damping, Mode::Damping, &[native(0x93, 0.0)]));
    });
    // Requests alone do not damp.
    refuses("went limp", || {
        let mut robot = Script::damped_in_turns();
        (0..10).for_each(|_| robot.turn(Phase::Damping, Mode::Damping, &[NATIVE_FAULT]));
        (0..10).for_each(|_| robot.turn(Phase::Disarmed, Mode::Idle, &[NATIVE_STOP]));
    });
    refuses("I6: the age", || {
        let mut robot = Script::damped_in_turns();
        let mut next = robot.next(Phase::Damping, Mode::Damping, BRAKE);
        (next.state.joints[0].fresh, next.state.joints[0].age_cycles) = (false, 2);
        next.state.joints[0].receive_ns = robot.state.joints[0].receive_ns;
        robot.check(next);
    });
}
