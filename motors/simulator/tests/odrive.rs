//! An ODrive, from the host's side. Frames by hand from the messages in ODrive's repository ros_odrive.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::{Bench, frames};
use core::f64::consts::TAU;
use motord_bus::{Bus, Duration, Frame, FrameId};
use motord_simulator::{Behaviour, Dialect, Mode, MotorSettings};

/// The first id of node 5.
const BASE: u16 = 0x0A0;
/// Control modes.
const TORQUE: u8 = 1;
const VELOCITY: u8 = 2;
const POSITION: u8 = 3;
/// 0.5 N·m of the rotor, 0x3F000000: 4 N·m behind the gear of 8.
const PUSH: [u8; 8] = [0, 0, 0, 0x3F, 0, 0, 0, 0];
/// The heartbeat of an idle axis without errors.
const IDLE: [u8; 8] = [0, 0, 0, 0, 1, 0, 0, 0];
/// The heartbeat of an axis in closed loop: the procedure is busy.
const CLOSED_LOOP: [u8; 8] = [0, 0, 0, 0, 8, 1, 0, 0];

fn settings() -> MotorSettings {
    MotorSettings { id: 5, dialect: Dialect::ODrive, initial_position: 1.0, ..MotorSettings::default() }
}

fn bench() -> Bench {
    Bench::begun(settings())
}

/// Returns the frames of the next `millis`.
fn pass(bench: &mut Bench, millis: u64) -> Vec<Frame> {
    (0..millis).flat_map(|_| frames(&bench.pass(Duration::from_millis(1)))).collect()
}

/// Sends a command, and returns the frames of the next millisecond.
fn send<const N: usize>(bench: &mut Bench, command: u16, payload: [u8; N]) -> Vec<Frame> {
    let id = FrameId::new(BASE | command).unwrap();
    assert_eq!(bench.bus.send(bench.now, &[Frame::classic(id, payload)]).accepted, 1);
    pass(bench, 1)
}

/// This control mode with passthrough, then closed loop.
fn enable(bench: &mut Bench, mode: u8) {
    send(bench, 0x0B, [mode, 0, 0, 0, 1, 0, 0, 0]);
    send(bench, 0x07, [8, 0, 0, 0, 0, 0, 0, 0]);
}

/// Returns the frames with this command in the next `millis`.
fn reports(bench: &mut Bench, command: u16, millis: u64) -> Vec<Vec<u8>> {
    let id = FrameId::new(BASE | command).unwrap();
    let all = pass(bench, millis);
    all.iter().filter(|frame| frame.id() == id).map(|frame| frame.payload().to_vec()).collect()
}

fn heartbeat(bench: &mut Bench) -> Vec<u8> {
    reports(bench, 0x01, 150)[0].clone()
}

/// 1 rad at the output is 8 / 2π turns of the rotor, 1.273240: 0x3FA2F983.
#[test]
fn estimates_are_those_of_the_rotor() {
    let sent = reports(&mut bench(), 0x09, 1000);
    let at_one_rad = [0x83, 0xF9, 0xA2, 0x3F, 0, 0, 0, 0];
    assert!((99..=101).contains(&sent.len()) && sent.iter().all(|sent| *sent == at_one_rad), "{sent:?}");
}

/// 1/128 N·m of the rotor, 0x3C000000, is less than the friction.
#[test]
fn torques_are_those_of_the_rotor() {
    let mut bench = bench();
    let sent = reports(&mut bench, 0x1C, 100);
    assert!((9..=11).contains(&sent.len()) && sent.iter().all(|sent| *sent == [0; 8]), "{sent:?}");
    enable(&mut bench, TORQUE);
    send(&mut bench, 0x0E, [0, 0, 0, 0x3C, 0, 0, 0, 0]);
    let sent = reports(&mut bench, 0x1C, 100);
    let both = [0, 0, 0, 0x3C, 0, 0, 0, 0x3C];
    assert!((9..=11).contains(&sent.len()) && sent.iter().all(|sent| *sent == both), "{sent:?}");
    assert_eq!(bench.motor().position(), 1.0);
}

/// 48 V: 0x42400000.
#[test]
fn supply_has_voltage_and_current() {
    let mut bench = bench();
    assert_eq!(reports(&mut bench, 0x17, 150)[0], [0, 0, 0x40, 0x42, 0, 0, 0, 0]);
    enable(&mut bench, TORQUE);
    send(&mut bench, 0x0E, PUSH);
    let sent = reports(&mut bench, 0x17, 150);
    let current = f32::from_le_bytes(sent[0][4..].try_into().unwrap());
    assert!(current > 0.1, "{sent:?}");
}

#[test]
fn heartbeat_has_state_and_errors() {
    let mut bench = bench();
    let sent = reports(&mut bench, 0x01, 1000);
    assert!((9..=11).contains(&sent.len()) && sent.iter().all(|sent| *sent == IDLE), "{sent:?}");
    enable(&mut bench, TORQUE);
    assert_eq!(heartbeat(&mut bench), CLOSED_LOOP);
    // Under-voltage is bit 9, over-temperature of the motor bit 13. An unknown fault is of the system.
    for (number, errors) in [("0x04", [0, 2]), ("0x08", [0, 0x20]), ("0x20", [2, 0])] {
        bench.inject(&format!("fault {number}"));
        let [low, high] = errors;
        assert_eq!(heartbeat(&mut bench), [low, high, 0, 0, 1, 3, 0, 0], "{number}");
        assert_eq!(heartbeat(&mut bench), [low, high, 0, 0, 1, 3, 0, 0], "{number}: it lasts");
        send(&mut bench, 0x18, [0]);
        assert_eq!(heartbeat(&mut bench), IDLE, "{number}");
    }
}

/// Clients end a frame after its value.
#[test]
fn bytes_left_out_are_zeros() {
    let mut bench = bench();
    enable(&mut bench, TORQUE);
    send(&mut bench, 0x0E, [0, 0, 0, 0x3F]);
    assert!((bench.motor().torque() - 4.0).abs() < 0.01);
    send(&mut bench, 0x07, [1]);
    assert_eq!(heartbeat(&mut bench), IDLE);
}

/// A report that its successor overtakes waits for none but that one.
#[test]
fn reordered_reports_are_all_sent() {
    let mut bench = bench();
    bench.inject("reorder");
    let sent = reports(&mut bench, 0x09, 1000).len();
    assert!((98..=101).contains(&sent), "{sent} in 1 s");
}

/// The error is bit 25.
#[test]
fn emergency_stop_disarms_until_cleared() {
    let mut bench = bench();
    enable(&mut bench, TORQUE);
    send(&mut bench, 0x0E, PUSH);
    send(&mut bench, 0x02, [0; 8]);
    assert_eq!((bench.motor().mode(), bench.motor().torque()), (Mode::Fault, 0.0));
    enable(&mut bench, TORQUE);
    assert_eq!(heartbeat(&mut bench), [0, 0, 0, 2, 1, 3, 0, 0]);
    send(&mut bench, 0x18, [0]);
    assert_eq!(heartbeat(&mut bench), IDLE);
    enable(&mut bench, TORQUE);
    assert_eq!(heartbeat(&mut bench), CLOSED_LOOP);
}

#[test]
fn low_supply_is_an_error_while_it_lasts() {
    let mut bench = bench();
    bench.inject("voltage 5");
    send(&mut bench, 0x18, [0]);
    assert_eq!(heartbeat(&mut bench), [0, 2, 0, 0, 1, 3, 0, 0]);
    bench.inject("voltage 48");
    send(&mut bench, 0x18, [0]);
    assert_eq!(heartbeat(&mut bench), IDLE);
}

/// 4 N·m less 0.15 N·m of friction at 0.01384 kg·m² are 278 rad/s².
#[test]
fn torque_input_accelerates_in_closed_loop() {
    let mut bench = bench();
    enable(&mut bench, TORQUE);
    send(&mut bench, 0x0E, PUSH);
    assert!((bench.motor().torque() - 4.0).abs() < 1e-6, "{}", bench.motor().torque());
    let before = bench.motor().velocity();
    pass(&mut bench, 20);
    let gained = bench.motor().velocity() - before;
    assert!((5.0..6.0).contains(&gained), "{gained}");
}

/// 8 turns/s of the rotor, 0x41000000, are 2π rad/s.
#[test]
fn velocity_input_reaches_its_speed() {
    let mut bench = bench();
    enable(&mut bench, VELOCITY);
    send(&mut bench, 0x0D, [0, 0, 0, 0x41, 0, 0, 0, 0]);
    pass(&mut bench, 500);
    assert!((bench.motor().velocity() - TAU).abs() < 0.1, "{}", bench.motor().velocity());
}

/// 4 N·m less friction against the speed loop of 6.92 N·m·s/rad.
#[test]
fn velocity_input_adds_its_torque() {
    let mut bench = bench();
    enable(&mut bench, VELOCITY);
    send(&mut bench, 0x0D, [0, 0, 0, 0, 0, 0, 0, 0x3F]);
    pass(&mut bench, 500);
    assert!((bench.motor().velocity() - 0.55).abs() < 0.05, "{}", bench.motor().velocity());
}

/// 2 turns of the rotor, 0x40000000, are a quarter turn of the output.
#[test]
fn position_input_reaches_its_position() {
    let mut bench = bench();
    enable(&mut bench, POSITION);
    pass(&mut bench, 100);
    assert!((bench.motor().position() - 1.0).abs() < 1e-6, "it holds without an input");
    send(&mut bench, 0x0C, [0, 0, 0, 0x40, 0, 0, 0, 0]);
    pass(&mut bench, 500);
    assert!((bench.motor().position() - TAU / 4.0).abs() < 0.01, "{}", bench.motor().position());
}

/// 1 turn/s of the rotor shifts the position loop by 0.026 rad, and 0.5 N·m by 0.080 rad.
#[test]
fn position_input_adds_its_feed_forwards() {
    for (feed_forward, shift) in [([0xE8, 3, 0xF4, 1], 0.1065), ([0x18, 0xFC, 0x0C, 0xFE], -0.1065)] {
        let mut bench = bench();
        enable(&mut bench, POSITION);
        let [a, b, c, d] = feed_forward;
        send(&mut bench, 0x0C, [0, 0, 0, 0x40, a, b, c, d]);
        pass(&mut bench, 500);
        let shifted = bench.motor().position() - TAU / 4.0;
        assert!((shifted - shift).abs() < 0.01, "{shifted}");
    }
}

#[test]
fn idle_axis_does_not_follow_inputs() {
    let mut bench = bench();
    send(&mut bench, 0x0B, [TORQUE, 0, 0, 0, 1, 0, 0, 0]);
    send(&mut bench, 0x0E, PUSH);
    pass(&mut bench, 50);
    assert_eq!((bench.motor().mode(), bench.motor().torque()), (Mode::Stopped, 0.0));
    assert_eq!(bench.motor().position(), 1.0);
}

#[test]
fn closed_loop_starts_with_the_stored_input() {
    for (remembers_control, torque) in [(true, 4.0), (false, 0.0)] {
        let behaviour = Behaviour { remembers_control, ..Behaviour::default() };
        let mut bench = Bench::begun(MotorSettings { behaviour, ..settings() });
        enable(&mut bench, TORQUE);
        send(&mut bench, 0x0E, PUSH);
        send(&mut bench, 0x07, [1, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!((bench.motor().mode(), bench.motor().torque()), (Mode::Stopped, 0.0));
        enable(&mut bench, TORQUE);
        assert!((bench.motor().torque() - torque).abs() < 1e-6, "{}", bench.motor().torque());
    }
}

#[test]
fn input_of_another_mode_waits_for_it() {
    let mut bench = bench();
    enable(&mut bench, VELOCITY);
    send(&mut bench, 0x0E, PUSH);
    pass(&mut bench, 20);
    assert_eq!((bench.motor().torque(), bench.motor().position()), (0.0, 1.0));
    send(&mut bench, 0x0B, [TORQUE, 0, 0, 0, 1, 0, 0, 0]);
    assert!((bench.motor().torque() - 4.0).abs() < 1e-6, "{}", bench.motor().torque());
    send(&mut bench, 0x0B, [0; 8]);
    assert_eq!(bench.motor().torque(), 0.0, "it has no control of voltages");
}

/// Not a number is 0x7FC00000, infinity 0x7F800000.
#[test]
fn input_without_a_finite_value_is_ignored() {
    let mut bench = bench();
    enable(&mut bench, TORQUE);
    send(&mut bench, 0x0E, PUSH);
    send(&mut bench, 0x0E, [0, 0, 0xC0, 0x7F, 0, 0, 0, 0]);
    send(&mut bench, 0x0E, [0, 0, 0x80, 0x7F, 0, 0, 0, 0]);
    assert!((bench.motor().torque() - 4.0).abs() < 1e-6, "{}", bench.motor().torque());
    send(&mut bench, 0x19, [0, 0, 0xC0, 0x7F, 0, 0, 0, 0]);
    assert!(bench.motor().position().is_finite());
}

#[test]
fn absolute_position_becomes_the_present_one() {
    let mut bench = bench();
    for position in [[0, 0, 0, 0x40, 0, 0, 0, 0], [0; 8]] {
        send(&mut bench, 0x19, position);
        assert_eq!(reports(&mut bench, 0x09, 25).last().unwrap()[..], position);
    }
}

/// The action 1 of a reboot stores the configuration.
#[test]
fn absolute_position_lasts_only_when_saved() {
    for (action, position) in [(0, 1.0), (1, 0.0)] {
        let mut bench = bench();
        send(&mut bench, 0x19, [0; 8]);
        send(&mut bench, 0x16, [action, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(pass(&mut bench, 250), [], "it restarts");
        pass(&mut bench, 250);
        assert!((bench.motor().position() - position).abs() < 1e-3, "{}", bench.motor().position());
    }
}

#[test]
fn reboot_forgets_inputs_and_needs_idle() {
    let mut bench = bench();
    enable(&mut bench, TORQUE);
    send(&mut bench, 0x0E, PUSH);
    send(&mut bench, 0x16, [0; 8]);
    assert_eq!(bench.motor().mode(), Mode::Running);
    send(&mut bench, 0x07, [1, 0, 0, 0, 0, 0, 0, 0]);
    send(&mut bench, 0x16, [0; 8]);
    pass(&mut bench, 500);
    enable(&mut bench, TORQUE);
    assert_eq!((bench.motor().mode(), bench.motor().torque()), (Mode::Running, 0.0));
}

/// All commands but emergency stop and reboot.
#[test]
fn no_command_is_answered() {
    let mut bench =
        Bench::begun(MotorSettings { report_period: Duration::ZERO, reports_torque: false, ..settings() });
    for command in (0..0x20).filter(|command| *command != 0x02 && *command != 0x16) {
        let answers = send(&mut bench, command, [0; 8]);
        assert!(answers.iter().all(|frame| frame.payload() == IDLE), "{command:#x}: {answers:?}");
    }
    assert_eq!(bench.motor().mode(), Mode::Stopped);
}

#[test]
fn reports_keep_their_periods() {
    let reporting = |millis, reports_torque| MotorSettings {
        report_period: Duration::from_millis(millis),
        reports_torque,
        ..settings()
    };
    let cases = [(10, true, [10, 100, 100, 10]), (4, true, [10, 250, 250, 10]), (4, false, [10, 250, 0, 0])];
    for (millis, reports_torque, counts) in cases {
        let mut bench = Bench::begun(reporting(millis, reports_torque));
        enable(&mut bench, TORQUE);
        let all = pass(&mut bench, 1000);
        for (command, expected) in [0x01, 0x09, 0x1C, 0x17].into_iter().zip(counts) {
            let id = u32::from(BASE | command);
            let count = all.iter().filter(|frame| frame.id().raw() == id).count();
            assert!(count.abs_diff(expected) <= usize::from(expected > 0), "{command:#x}: {count}");
        }
    }
}

/// Node 1 at 250 kbit/s, with heartbeat and estimates alone.
#[test]
fn factory_drive_needs_its_bit_rate() {
    let mut bench = Bench::begun(MotorSettings { is_new: true, ..settings() });
    assert_eq!(pass(&mut bench, 500), []);
    bench.inject_into("can0", "bitrate 250000");
    let all = pass(&mut bench, 500);
    let is_report = |frame: &Frame| matches!(frame.id().raw(), 0x21 | 0x29);
    assert!((50..=60).contains(&all.len()) && all.iter().all(is_report), "{all:?}");
}
