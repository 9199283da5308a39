//! A MyActuator motor, from the host's side. Frames by hand from the protocol document V4.2.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::{Bench, frames};
use motord_bus::{Bus, Duration, Frame, FrameId};
use motord_simulator::{Behaviour, Dialect, Mode, MotorSettings};

fn bench() -> Bench {
    let settings = MotorSettings {
        id: 5,
        dialect: Dialect::MyActuator,
        vendor: "myactuator",
        initial_position: 1.0,
        ends: Some([12.5, 45.0, 24.0]),
        behaviour: Behaviour { truncates: false, ..Behaviour::default() },
        ..MotorSettings::default()
    };
    let mut bench = Bench::new(settings);
    bench.pass(Duration::from_millis(1));
    bench
}

/// Sends a frame, and returns the frames of the next millisecond.
fn send(bench: &mut Bench, id: u16, payload: u64) -> Vec<Frame> {
    let frame = Frame::classic(FrameId::new(id).unwrap(), payload.to_be_bytes());
    assert_eq!(bench.bus.send(bench.now, &[frame]).accepted, 1);
    frames(&bench.pass(Duration::from_millis(1)))
}

/// Returns the payload of the only answer, which has this id.
fn ask(bench: &mut Bench, id: u16, payload: u64, from: u16) -> [u8; 8] {
    let answers = send(bench, id, payload);
    let [answer] = answers[..] else { panic!("{answers:?}") };
    assert_eq!(answer.id().raw(), u32::from(from));
    answer.payload().try_into().unwrap()
}

/// 1.2 rad is 35913.2 of 65535, 0x8C49; kp 50 is 0x19A, kd 1 is 0x333; velocity and torque are next to
/// zero.
const TO_1_2_RAD: u64 = 0x8C49_7FF1_9A33_37FF;

#[test]
fn first_impedance_runs_the_motor() {
    let mut bench = bench();
    assert_eq!(bench.motor().mode(), Mode::Stopped);
    for _ in 0..500 {
        let [number, ..] = ask(&mut bench, 0x405, TO_1_2_RAD, 0x505);
        assert_eq!(number, 5);
    }
    assert_eq!(bench.motor().mode(), Mode::Running);
    assert!((bench.motor().position() - 1.2).abs() < 0.02, "{}", bench.motor().position());
    assert_eq!(ask(&mut bench, 0x145, 0x80 << 56, 0x245), [0x80, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(bench.motor().mode(), Mode::Stopped);
}

/// The frame that enables a motor in MIT.
#[test]
fn enable_of_mit_is_full_torque() {
    let mut bench = bench();
    send(&mut bench, 0x405, 0xFFFF_FFFF_FFFF_FFFC);
    assert!(bench.motor().torque() > 10.0, "{}", bench.motor().torque());
}

/// 1 rad is 57.30°; 48.0 V are 480, 0x1E0; 25 °C.
#[test]
fn questions_move_nothing() {
    let mut bench = bench();
    assert_eq!(ask(&mut bench, 0x145, 0x92 << 56, 0x245), [0x92, 0, 0, 0, 0x62, 0x16, 0, 0]);
    assert_eq!(ask(&mut bench, 0x145, 0x9A << 56, 0x245), [0x9A, 25, 0, 1, 0xE0, 1, 0, 0]);
    assert_eq!(ask(&mut bench, 0x145, 0x9C << 56, 0x245), [0x9C, 25, 0, 0, 0, 0, 57, 0]);
    assert_eq!(ask(&mut bench, 0x280, 0x92 << 56, 0x245), [0x92, 0, 0, 0, 0x62, 0x16, 0, 0]);
    assert_eq!((bench.motor().mode(), bench.motor().position()), (Mode::Stopped, 1.0));
}

#[test]
fn errors_are_in_the_status_alone() {
    let mut bench = bench();
    ask(&mut bench, 0x405, TO_1_2_RAD, 0x505);
    bench.inject("fault 0x10");
    let [.., low, high] = ask(&mut bench, 0x145, 0x9A << 56, 0x245);
    assert_eq!([low, high], [0x10, 0]);
    ask(&mut bench, 0x405, TO_1_2_RAD, 0x505);
    assert_eq!((bench.motor().mode(), bench.motor().torque()), (Mode::Fault, 0.0));
}

#[test]
fn zero_and_id_act_after_a_restart() {
    let mut bench = bench();
    ask(&mut bench, 0x145, 0x64 << 56, 0x245);
    ask(&mut bench, 0x145, 0x2005_0000_0700_0000, 0x245);
    assert!((bench.motor().position() - 1.0).abs() < 1e-9);
    assert_eq!(send(&mut bench, 0x145, 0x76 << 56), [], "it restarts");
    bench.pass(Duration::from_secs(2));
    assert!(bench.motor().position().abs() < 1e-3, "{}", bench.motor().position());
    assert_eq!(send(&mut bench, 0x145, 0x9A << 56), []);
    assert_eq!(ask(&mut bench, 0x147, 0x9A << 56, 0x247)[0], 0x9A);
}
