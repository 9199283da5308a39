//! A native GIM motor from the host's side: every command of the document.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::{Bench, GET_FAULT, NEUTRAL, STOP};
use motord_bus::Duration;
use motord_simulator::{Behaviour, Dialect, DurationEnd, InFault, Mode, MotorSettings};

const SUCCESS: u8 = 0x00;
const FAILURE: u8 = 0x01;
const UNKNOWN_COMMAND: u8 = 0x02;
const READ_ONLY: u8 = 0x04;
const UNKNOWN_REGISTER: u8 = 0x05;
const DATA_FORMAT: u8 = 0x07;

fn settings() -> MotorSettings {
    MotorSettings { dialect: Dialect::Gim, ..MotorSettings::default() }
}

fn bench() -> Bench {
    Bench::new(settings())
}

fn refusing() -> Bench {
    Bench::new(MotorSettings {
        behaviour: Behaviour { in_fault: InFault::Refuses, ..Behaviour::default() },
        ..settings()
    })
}

fn bare(command: u8) -> [u8; 8] {
    [command, 0, 0, 0, 0, 0, 0, 0]
}

fn control(command: u8, value: f32, duration_ms: u32) -> [u8; 8] {
    let [v0, v1, v2, v3] = value.to_le_bytes();
    let [d0, d1, d2, _] = duration_ms.to_le_bytes();
    [command, v0, v1, v2, v3, d0, d1, d2]
}

fn modify(kind: u8, id: u8, data: [u8; 4]) -> [u8; 8] {
    let [d0, d1, d2, d3] = data;
    [0x83, kind, id, 0, d0, d1, d2, d3]
}

fn indicator(bench: &mut Bench, id: u8) -> f64 {
    let answer = bench.ask([0xB4, id, 0, 0, 0, 0, 0, 0]);
    assert_eq!(answer[..4], [0xB4, id, SUCCESS, 0]);
    f32::from_le_bytes(answer[4..].try_into().unwrap()).into()
}

#[test]
fn start_and_stop_answer_with_their_result() {
    let mut bench = bench();
    assert_eq!(bench.ask(bare(0x91)), bare(0x91));
    assert_eq!(bench.motor().mode(), Mode::Running);
    assert_eq!(bench.ask(bare(0x92)), bare(0x92));
    assert_eq!(bench.motor().mode(), Mode::Stopped);
}

#[test]
fn control_before_start_fails_and_moves_nothing() {
    let mut bench = bench();
    for command in [0x93, 0x94, 0x95] {
        assert_eq!(bench.ask(control(command, 5.0, 0)), [command, FAILURE, 0, 0, 0, 0, 0, 0]);
    }
    assert_eq!(bench.motor().velocity(), 0.0);
}

#[test]
fn a_torque_lasts_as_long_as_its_duration() {
    let mut bench = bench();
    bench.ask(bare(0x91));
    let state = bench.ask(control(0x93, 1.5, 10));
    // 25 °C, and half a code below zero in position, speed and torque.
    assert_eq!(state, [0x93, SUCCESS, 25, 0xFF, 0x7F, 0x7F, 0xF7, 0xFF]);
    assert!((bench.motor().torque() - 1.5).abs() < 1e-6);
    bench.pass(Duration::from_millis(8));
    assert!((bench.motor().torque() - 1.5).abs() < 1e-6);
    bench.pass(Duration::from_millis(2));
    assert_eq!((bench.motor().torque(), bench.motor().mode()), (0.0, Mode::Running));
}

#[test]
fn a_duration_of_zero_has_no_end() {
    let mut bench = bench();
    bench.ask(bare(0x91));
    bench.ask(control(0x93, 0.5, 0));
    bench.pass(Duration::from_secs(3));
    assert!((bench.motor().torque() - 0.5).abs() < 1e-6);
    assert_eq!(bench.ask(bare(0x97)), bare(0x97));
    assert_eq!(bench.motor().torque(), 0.0);
}

#[test]
fn speed_is_reached_and_limited_as_configured() {
    let mut bench = bench();
    bench.ask(bare(0x91));
    bench.ask(control(0x94, -60.0, 0));
    bench.pass(Duration::from_secs(1));
    assert!((indicator(&mut bench, 0x14) + 60.0).abs() < 1.0);
    assert!((bench.motor().velocity() + core::f64::consts::TAU).abs() < 0.1);
    bench.ask(modify(0x00, 0x02, 30_i32.to_le_bytes()));
    bench.ask(control(0x94, 1e30, 0));
    bench.pass(Duration::from_secs(1));
    assert!((indicator(&mut bench, 0x14) - 30.0).abs() < 1.0);
}

fn holding() -> Bench {
    let behaviour = Behaviour { duration_end: DurationEnd::HoldsCommand, ..Behaviour::default() };
    Bench::new(MotorSettings { behaviour, ..settings() })
}

#[test]
fn position_is_reached_at_end_of_duration() {
    let mut bench = holding();
    bench.ask(bare(0x91));
    bench.ask(control(0x95, 20.0, 2000));
    bench.pass(Duration::from_millis(1000));
    assert!((bench.motor().position() - 10.0).abs() < 0.5, "{}", bench.motor().position());
    bench.pass(Duration::from_millis(1500));
    assert!((bench.motor().position() - 20.0).abs() < 0.01, "targets are multi-turn");
    bench.pass(Duration::from_secs(5));
    assert!((indicator(&mut bench, 0x13) - 20.0).abs() < 0.01);
}

/// Goal: a controller may send a position in every cycle, however short its cycles are, and the
/// shaft follows. Method: the target moves at 3 rad/s, in steps of 1 ms and of 10 ms. A critically
/// damped loop lags 2 / 60 s behind.
#[test]
fn repeated_position_command_is_followed_at_its_speed() {
    for period in [1, 10] {
        let mut bench = bench();
        bench.ask(bare(0x91));
        let mut target = 0.0;
        for _ in 0..1000 / period {
            target += 3.0 * period as f32 / 1000.0;
            bench.ask(control(0x95, target, 0));
            bench.pass(Duration::from_millis(period));
        }
        let lag = f64::from(target) - bench.motor().position();
        assert!((0.0..0.15).contains(&lag), "{lag} rad behind, at a command in {period} ms");
    }
}

#[test]
fn command_ends_limp_or_continues_after_duration() {
    for (command, value) in [(0x93, 1.5), (0x94, 60.0), (0x95, 1.0)] {
        for (mut bench, is_limp) in [(bench(), true), (holding(), false)] {
            // A load that only a drive can hold.
            bench.inject("load 0.3");
            bench.ask(bare(0x91));
            bench.ask(control(command, value, 50));
            bench.pass(Duration::from_millis(40));
            assert_ne!(bench.motor().torque(), 0.0);
            bench.pass(Duration::from_millis(100));
            assert_eq!(bench.motor().torque() == 0.0, is_limp, "{command:#X}");
            assert_eq!(bench.motor().mode(), Mode::Running);
        }
    }
}

#[test]
fn a_value_that_is_no_number_is_refused() {
    let mut bench = bench();
    bench.ask(bare(0x91));
    for value in [f32::NAN, f32::INFINITY] {
        assert_eq!(bench.ask(control(0x93, value, 0))[1], DATA_FORMAT);
    }
    assert_eq!(bench.motor().torque(), 0.0);
}

#[test]
fn every_item_is_readable_and_one_unwritable() {
    let assigned = (0x00..=0x02).chain(0x06..=0x09).chain(0x0C..=0x1A).chain([0x1C, 0x20]);
    let ints: Vec<u8> = assigned.collect();
    for id in 0..=u8::MAX {
        let answer = bench().ask([0x84, 0x00, id, 0, 0, 0, 0, 0]);
        let expected = if ints.contains(&id) { SUCCESS } else { UNKNOWN_REGISTER };
        assert_eq!(answer[..4], [0x84, 0x00, id, expected]);
        let written = bench().ask(modify(0x00, id, [1, 0, 0, 0]));
        let expected = if id == 0x15 { READ_ONLY } else { expected };
        assert_eq!(written, [0x83, 0x00, id, expected, 0, 0, 0, 0]);
    }
    for id in 0..=u8::MAX {
        let expected = if id <= 0x05 { SUCCESS } else { UNKNOWN_REGISTER };
        assert_eq!(bench().ask([0x84, 0x01, id, 0, 0, 0, 0, 0])[3], expected);
        assert_eq!(bench().ask(modify(0x01, id, 1.0_f32.to_le_bytes()))[3], expected);
    }
    assert_eq!(bench().ask([0x84, 0x02, 0, 0, 0, 0, 0, 0])[3], DATA_FORMAT);
}

#[test]
fn written_value_is_read_back_little_endian() {
    let mut bench = bench();
    bench.ask(modify(0x00, 0x08, [1, 2, 3, 4]));
    assert_eq!(bench.ask([0x84, 0x00, 0x08, 0, 0, 0, 0, 0]), [0x84, 0, 0x08, 0, 1, 2, 3, 4]);
    bench.ask(modify(0x01, 0x03, 0.11667_f32.to_le_bytes()));
    assert_eq!(bench.ask([0x84, 0x01, 0x03, 0, 0, 0, 0, 0])[4..], 0.11667_f32.to_le_bytes());
    bench.ask([0xA1, 0x04, 0, 0, 0xE8, 0x03, 0, 0]);
    assert_eq!(bench.ask([0xA2, 0x04, 0, 0, 0, 0, 0, 0]), [0xA2, 0x04, 0, 0, 0xE8, 0x03, 0, 0]);
    assert_eq!(bench.ask([0xA2, 0x09, 0, 0, 0, 0, 0, 0])[2], UNKNOWN_REGISTER);
    assert_eq!(bench.ask(bare(0x82)), bare(0x82));
}

#[test]
fn wrong_torque_constant_gives_wrong_torque() {
    let mut bench = bench();
    bench.ask(modify(0x01, 0x03, 0.25_f32.to_le_bytes()));
    bench.ask(bare(0x91));
    bench.ask(control(0x93, 2.0, 0));
    assert!(
        (bench.motor().torque() - 1.0).abs() < 1e-6,
        "the motor's real torque is half of the computed one"
    );
}

#[test]
fn new_id_counts_from_next_command() {
    let mut bench = bench();
    assert_eq!(bench.answers(modify(0x00, 0x12, [9, 0, 0, 0]))[0].id().raw(), 0x101);
    assert!(bench.is_silent(bare(0xB2)));
    bench.address(9);
    assert_eq!(bench.answers(modify(0x00, 0x13, [0x34, 0x02, 0, 0]))[0].id().raw(), 0x101);
    assert_eq!(bench.answers(bare(0xB2))[0].id().raw(), 0x234);
}

#[test]
fn protocol_change_is_immediate_and_irreversible_over_can() {
    let mut bench = bench();
    assert_eq!(bench.ask(modify(0x00, 0x1C, [1, 0, 0, 0]))[3], SUCCESS);
    assert_eq!(bench.ask(STOP).len(), 6);
    assert_eq!(bench.ask(modify(0x00, 0x1C, [0, 0, 0, 0])).len(), 6, "a control frame by now");
    assert_eq!(bench.ask(GET_FAULT).len(), 6);
}

#[test]
fn mit_frame_is_gim_command_of_first_byte() {
    assert_eq!(bench().ask(NEUTRAL), [0x7F, UNKNOWN_COMMAND, 0, 0, 0, 0, 0, 0]);
    assert_eq!(bench().ask(STOP), [0xFF, UNKNOWN_COMMAND, 0, 0, 0, 0, 0, 0]);
    let mut bench = bench();
    // MIT: 6.4 rad, no stiffness, damping or torque.
    assert!(bench.is_silent([0xC1, 0x88, 0x80, 0x00, 0x00, 0x00, 0x08, 0x00]));
    assert_eq!(bench.motor().mode(), Mode::Firmware);
}

#[test]
fn a_wrong_baud_rate_makes_the_motor_deaf() {
    let mut bench = bench();
    bench.ask(modify(0x00, 0x18, [5, 0, 0, 0]));
    assert!(bench.is_silent(bare(0xB2)));
}

#[test]
fn reset_configuration_forgets_commissioned_id_and_protocol() {
    let mut bench = Bench::new(MotorSettings { id: 5, ..settings() });
    bench.ask(bare(0x81));
    assert!(bench.is_silent(bare(0xB2)));
    bench.address(1);
    assert_eq!(bench.answers(bare(0xB2))[0].id().raw(), 0);
}

#[test]
fn zero_position_is_angle_within_one_turn() {
    let mut bench = Bench::new(MotorSettings { initial_position: 7.0, ..settings() });
    // A quarter of a turn is 16384 codes.
    bench.ask(modify(0x00, 0x14, [0x00, 0x40, 0, 0]));
    let expected = 7.0 - core::f64::consts::TAU - core::f64::consts::FRAC_PI_2;
    assert!((bench.motor().position() - expected).abs() < 1e-9, "{}", bench.motor().position());
}

#[test]
fn faults_are_told_and_acknowledged() {
    let mut bench = refusing();
    bench.ask(bare(0x91));
    bench.inject("fault 0x80");
    assert_eq!(bench.ask(bare(0xB2)), [0xB2, SUCCESS, 0x80, 0, 0, 0, 0, 0]);
    assert_eq!(bench.ask(control(0x93, 1.0, 0))[1], FAILURE);
    assert_eq!(bench.ask([0x84, 0, 0x12, 0, 0, 0, 0, 0])[3], FAILURE, "any command is declined");
    assert_eq!(bench.ask(bare(0xB3)), bare(0xB3));
    assert_eq!(bench.ask(bare(0x91))[1], SUCCESS);
}

#[test]
fn a_motor_in_fault_may_also_be_silent() {
    let mut bench = bench();
    bench.inject("fault 0x10");
    assert!(bench.is_silent(bare(0x91)) && bench.is_silent(bare(0xB1)));
    assert_eq!(bench.ask(bare(0xB2))[2], 0x10);
    bench.ask(bare(0xB3));
    assert_eq!(bench.ask(bare(0xB1)), [0xB1, SUCCESS, 0, 0, 0x03, 0x02, 0x01, 0x00]);
}

#[test]
fn answer_temperature_is_signed_and_follows_winding() {
    let mut bench = bench();
    bench.ask(bare(0x91));
    for (celsius, byte) in [("-5", 0xFB), ("90.5", 90)] {
        bench.inject(&format!("temperature {celsius}"));
        assert_eq!(bench.ask(control(0x93, 0.0, 0))[2], byte);
    }
}

#[test]
fn indicators_are_numbers_that_agree() {
    let mut bench = bench();
    bench.ask(bare(0x91));
    bench.ask(control(0x94, 60.0, 0));
    bench.pass(Duration::from_secs(1));
    assert!((0x00..=0x15).all(|id| indicator(&mut bench, id).is_finite()));
    assert_eq!(indicator(&mut bench, 0x00), 48.0);
    let (iq, torque) = (indicator(&mut bench, 0x09), bench.motor().torque());
    assert!((iq - torque / (0.125 * 8.0)).abs() < 1e-3, "{iq} A, {torque} N·m");
    let phases: f64 = [0x04, 0x05, 0x06].map(|id| indicator(&mut bench, id)).iter().sum();
    assert!(phases.abs() < 0.5, "the phases have been read while the rotor turned: {phases}");
    let output = indicator(&mut bench, 0x15);
    assert!((output - torque * core::f64::consts::TAU).abs() < 0.1, "{output} W");
    assert_eq!(bench.ask([0xB4, 0x16, 0, 0, 0, 0, 0, 0])[2], UNKNOWN_REGISTER);
}

/// Goal: the items of the configuration and the indicators describe one motor. Method: at a
/// constant speed the voltage of the q axis is the drop at half the line-to-line resistance (item
/// 0x00), and the back EMF; item 0x02 is its effective line-to-line value in V at 1000 rpm of the
/// rotor. The torque is that of item 0x03.
#[test]
fn items_and_indicators_describe_one_motor() {
    let mut bench = bench();
    bench.ask(bare(0x91));
    for _ in 0..3 {
        bench.ask(control(0x94, 60.0, 0));
        bench.pass(Duration::from_millis(500));
    }
    let item = |bench: &mut Bench, id: u8| {
        let answer = bench.ask([0x84, 0x01, id, 0, 0, 0, 0, 0]);
        f64::from(f32::from_le_bytes(answer[4..8].try_into().unwrap()))
    };
    let [resistance, back_emf, constant] = [0x00, 0x02, 0x03].map(|id| item(&mut bench, id));
    let ratio = f64::from(bench.ask([0x84, 0x00, 0x11, 0, 0, 0, 0, 0])[4]);
    let [iq, vq, speed] = [0x09, 0x0D, 0x14].map(|id| indicator(&mut bench, id));
    let effective = (vq - resistance / 2.0 * iq) * 1.5_f64.sqrt();
    let per_thousand = effective / (speed * ratio / 1000.0);
    assert!(speed > 50.0, "{speed}");
    assert!(
        (per_thousand / back_emf - 1.0).abs() < 1e-3,
        "{per_thousand} V by the indicators, {back_emf} V by the item"
    );
    let torque = bench.motor().torque();
    assert!((iq * constant * ratio - torque).abs() < 1e-3 * torque.abs().max(1.0), "{iq} A, {torque} N·m");
}

#[test]
fn calibration_turns_shaft_and_answers_at_end() {
    let mut bench = bench();
    assert!(bench.is_silent([0xB5, 0x01, 0, 0, 0, 0, 0, 0]));
    bench.pass(Duration::from_secs(2));
    assert_eq!(bench.ask(bare(0x91))[1], FAILURE);
    assert!(bench.motor().mode() == Mode::Calibrating && bench.motor().position() > 1.0);
    let end = common::frames(&bench.pass(Duration::from_secs(4)));
    assert_eq!(end[0].payload(), [0xB4, 0x01, SUCCESS, 0, 0, 0, 0, 0]);
    assert_eq!(bench.motor().mode(), Mode::Stopped);
    assert_eq!(bench.ask([0xB5, 0x02, 0, 0, 0, 0, 0, 0])[2], UNKNOWN_REGISTER);
    bench.ask(bare(0x91));
    assert_eq!(bench.ask(bare(0xB5))[2], FAILURE, "a running motor is not calibrated");
}

#[test]
fn firmware_mode_leaves_bus_until_power_cycle() {
    let mut bench = bench();
    assert!(bench.is_silent(bare(0xC1)) && bench.is_silent(bare(0xB2)));
    bench.inject("power-cycle");
    bench.pass(Duration::from_millis(300));
    assert_eq!(bench.ask(bare(0xB2))[1], SUCCESS);
}

#[test]
fn position_torque_speed_control_is_not_supported() {
    assert_eq!(bench().ask(bare(0x96)), [0x96, UNKNOWN_COMMAND, 0, 0, 0, 0, 0, 0]);
}
