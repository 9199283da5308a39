//! Answers whose bytes are a fault report and a state of the same motor.

use super::reply_with;
use motord_bus::{Duration, Instant};
use motord_core::drive::{Drive, Received};
use motord_harness::robot::{self, PERIOD, Robot};
use motord_protocol::drive::{Command, Reported};
use motord_shared::{Cause, JointSetpoint, MotorMode};

/// A state of motor 1 at rest at -3.88 rad. As a fault report: hotter than permitted, not started,
/// current above its limit.
const STATE: [u8; 6] = [1, 0x58, 0x40, 0x80, 8, 0];
/// A fault report with the faults of [`STATE`], from a drive that fills the bytes without a meaning
/// (MIT document 1.2).
const FILLED: [u8; 6] = [1, 0x58, 0xA0, 0x12, 0x34, 0x56];
const FAULTS: u32 = 0x58;

/// A drive, and the time.
struct Bench {
    drive: Drive,
    now: Instant,
}

impl Bench {
    fn new() -> Self {
        let drive = Drive::new(&robot::three_motors().motors[0], Duration::ZERO, false);
        Self { drive, now: Instant::from_nanos(1_000_000_000) }
    }

    /// Sends a command of the next cycle, and returns what its `answers` mean.
    fn turn(&mut self, command: &Command, answers: &[[u8; 6]]) -> Vec<Received> {
        self.now = self.now + PERIOD;
        self.drive.request(command, self.now).expect("it is a frame");
        let at = self.now + Duration::from_micros(300);
        answers.iter().map(|answer| self.drive.receive(&reply_with(answer), at)).collect()
    }

    /// Asks for the faults so often without an answer that the form of the reports is no longer
    /// known.
    fn gap(&mut self) {
        for _ in 0..12 {
            self.turn(&Command::GetFault, &[]);
            self.now = self.now + Duration::from_millis(500);
            self.turn(&Command::Stop, &[]);
            self.now = self.now + Duration::from_millis(500);
        }
    }
}

fn fault_of(received: &[Received]) -> Option<u32> {
    received.iter().find_map(|received| match received {
        Received::Reply(Reported::Fault(faults)) => Some(faults.0),
        _ => None,
    })
}

/// Goal: one answer that may be a state is no fault, whenever it arrives. Method: directly after
/// the start, and after a gap.
#[test]
fn single_ambiguous_answer_is_no_fault() {
    for has_gap in [false, true] {
        let mut bench = Bench::new();
        if has_gap {
            bench.gap();
        }
        let answer = bench.turn(&Command::GetFault, &[STATE]);
        assert_eq!(fault_of(&answer), None, "{has_gap}: {answer:?}");
    }
}

/// Goal: a motor at rest whose states are one turn late never reports a fault. Method: its late
/// states fill the place of each answer; its reports are lost.
#[test]
fn late_states_of_resting_motor_are_no_faults() {
    let mut bench = Bench::new();
    bench.gap();
    for turn in 0..200 {
        let answer = bench.turn(&Command::GetFault, &[STATE]);
        assert_eq!(fault_of(&answer), None, "{turn}: {answer:?}");
        bench.turn(&Command::Stop, &[STATE]);
    }
}

/// Goal: two late states in a row are no fault when the burst continues. Method: a burst after a
/// gap.
#[test]
fn burst_of_states_is_no_fault() {
    let mut bench = Bench::new();
    bench.gap();
    for _ in 0..20 {
        let answers = [bench.turn(&Command::GetFault, &[STATE, STATE]), bench.turn(&Command::Stop, &[])];
        assert_eq!(fault_of(&answers.concat()), None);
    }
}

/// Goal: a real fault of a drive with such reports is acted on. Method: the motor answers only
/// questions for its faults.
#[test]
fn repeated_ambiguous_report_is_a_fault() {
    let mut bench = Bench::new();
    let first = bench.turn(&Command::GetFault, &[FILLED]);
    assert_eq!(fault_of(&first), None, "{first:?}");
    bench.turn(&Command::Stop, &[]);
    let second = bench.turn(&Command::GetFault, &[FILLED]);
    assert_eq!(fault_of(&second), Some(FAULTS), "{second:?}");
}

#[test]
fn ambiguous_reports_that_differ_are_no_fault() {
    let mut bench = Bench::new();
    for turn in 0..50_u8 {
        let answer = bench.turn(&Command::GetFault, &[[1, 0x40 + turn % 2, 0xA0, 0x12, 0x34, 0x56]]);
        assert_eq!(fault_of(&answer), None, "{answer:?}");
        bench.turn(&Command::Stop, &[]);
    }
}

#[test]
fn unambiguous_report_needs_no_second_one() {
    let mut bench = Bench::new();
    bench.turn(&Command::GetFault, &[STATE]);
    let report = [1, 0x40, 0, 0, 0, 0];
    let answers = [bench.turn(&Command::Stop, &[report]), bench.turn(&Command::GetFault, &[report])];
    assert_eq!(fault_of(&answers.concat()), Some(0x40), "{answers:?}");
}

/// Goal: the answer for a register, which another program asked for, is no position. Method: the
/// bytes of DM_CAN.py.
#[test]
fn register_answer_is_no_state() {
    let text = include_str!("../../../config/mixed-simulated.toml");
    let settings = robot::settings(text);
    let motor = settings.motors.iter().find(|motor| motor.profile.has_registers).expect("one is by Damiao");
    let mut bench = Bench { drive: Drive::new(motor, Duration::ZERO, false), ..Bench::new() };
    let answer = [motor.id, 0, 0x33, 21, 0, 0, 0x48, 0x41];
    bench.turn(&Command::Stop, &[]);
    let at = bench.now + Duration::from_micros(300);
    assert_eq!(bench.drive.receive(&reply_with(&answer), at), Received::Malformed);
    let state = [motor.id, 0x80, 0, 0x80, 8, 0, 25, 25];
    assert!(matches!(bench.drive.receive(&reply_with(&state), at), Received::Reply(Reported::State(..))));
}

/// Goal: no motor that returns with late replies is in fault. Method: three motors of a robot that
/// was off for 6 s; the delay of one varies, as does its position.
#[test]
fn late_states_after_long_gap_are_no_faults() {
    for delay in (1..=12).chain([20, 50, 90]).chain((101..480).step_by(21)) {
        let mut robot = Robot::new(robot::three_motors(), delay);
        robot.steps(100);
        robot.disturb("thigh off");
        robot.steps(6000);
        robot.disturb("thigh ok");
        robot.disturb(&format!("thigh delayed {delay}ms"));
        for verb in ["thigh delayed 1ms", "thigh delayed 3ms", "thigh ok"] {
            for cycle in 0..1200 {
                robot.step();
                let fault = (robot.joint(1).fault, robot.mode(1) == MotorMode::Fault);
                assert_eq!(fault, (0, false), "delayed by {delay} ms, before {verb}, cycle {cycle}");
            }
            robot.disturb(verb);
        }
    }
}

/// Cycles from a fault of the knee to the stop for it. `filled`: the drive fills the bytes of its
/// reports that have no meaning.
fn cycles_to_fault(filled: bool, bits: u32, seed: u64) -> u32 {
    let mut robot = Robot::built(robot::three_motors(), seed, |_, motors| {
        motors.iter_mut().for_each(|motor| motor.behaviour.stale_bytes = filled);
    });
    let joints: Vec<JointSetpoint> = robot.activate();
    for _ in 0..seed {
        robot.follow(&joints);
    }
    robot.disturb(&format!("knee fault {bits:#04x}"));
    for cycle in 1..100 {
        robot.follow(&joints);
        if robot.cause().is_some() {
            assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorFault), 2), "{bits:#x}");
            assert_eq!(robot.joint(2).fault, bits);
            return cycle;
        }
    }
    panic!("fault {bits:#x} stops nothing");
}

/// Goal: the second question delays the reaction to a fault by at most two cycles. Method: each
/// fault bit, at several times.
#[test]
fn ambiguous_report_delays_stop_by_two_cycles() {
    for seed in 1..20 {
        for bit in 0..7 {
            let [plain, filled] = [false, true].map(|filled| cycles_to_fault(filled, 1 << bit, seed));
            assert!(filled <= plain + 2, "bit {bit}, seed {seed}: {filled} cycles, else {plain}");
        }
    }
}
