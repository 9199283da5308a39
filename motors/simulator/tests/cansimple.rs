//! A motor with a CANSimple driver, from the host's side. Frames by hand from chapter 4 of the
//! manual of the GIM6010-8 and from the vendor's SDK.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::{Bench, frames};
use motord_bus::{Bus, Duration, Frame, FrameId};
use motord_simulator::{Behaviour, Dialect, Mode, MotorSettings};

/// The first id of node 5.
const BASE: u16 = 0x0A0;

fn settings() -> MotorSettings {
    MotorSettings {
        id: 5,
        dialect: Dialect::CanSimple,
        initial_position: 1.0,
        behaviour: Behaviour { truncates: false, ..Behaviour::default() },
        ..MotorSettings::default()
    }
}

fn bench() -> Bench {
    Bench::begun(settings())
}

/// Sends a command, and returns the frames of the next millisecond with its id.
fn send(bench: &mut Bench, command: u16, payload: u64) -> Vec<Vec<u8>> {
    let id = FrameId::new(BASE | command).unwrap();
    assert_eq!(bench.bus.send(bench.now, &[Frame::classic(id, payload.to_be_bytes())]).accepted, 1);
    let answers = frames(&bench.pass(Duration::from_millis(1)));
    answers.iter().filter(|frame| frame.id() == id).map(|frame| frame.payload().to_vec()).collect()
}

/// Mode of impedances, then closed loop.
fn enable(bench: &mut Bench) {
    send(bench, 0x0B, 0x0300_0000_0900_0000);
    send(bench, 0x07, 0x0800_0000_0000_0000);
}

/// Returns the frames with this command in the next `millis`.
fn reports(bench: &mut Bench, command: u16, millis: u64) -> Vec<Vec<u8>> {
    let id = FrameId::new(BASE | command).unwrap();
    let of = |bench: &mut Bench| frames(&bench.pass(Duration::from_millis(1)));
    let all: Vec<Frame> = (0..millis).flat_map(|_| of(bench)).collect();
    all.iter().filter(|frame| frame.id() == id).map(|frame| frame.payload().to_vec()).collect()
}

/// 1 rad at the output is 8 / 2π turns of the rotor, 1.273240: 0x3FA2F983.
const AT_ONE_RAD: [u8; 8] = [0x83, 0xF9, 0xA2, 0x3F, 0, 0, 0, 0];

#[test]
fn estimates_are_those_of_the_rotor() {
    let mut bench = bench();
    assert_eq!(send(&mut bench, 0x09, 0), [AT_ONE_RAD]);
    let sent = reports(&mut bench, 0x09, 1000);
    assert!((99..=101).contains(&sent.len()) && sent.iter().all(|sent| *sent == AT_ONE_RAD), "{sent:?}");
}

/// An answer that waits holds the reports back.
#[test]
fn held_back_estimates_are_not_made_up() {
    let mut bench = bench();
    bench.inject("delayed 2ms");
    for _ in 0..500 {
        send(&mut bench, 0x03, 0);
    }
    bench.inject("ok");
    bench.pass(Duration::from_millis(5));
    let sent = reports(&mut bench, 0x09, 100);
    assert!((9..=11).contains(&sent.len()), "{}", sent.len());
}

#[test]
fn heartbeat_has_state_and_errors() {
    let mut bench = bench();
    let idle = [0, 0, 0, 0, 1, 0, 0, 0];
    let sent = reports(&mut bench, 0x01, 1000);
    assert!((9..=11).contains(&sent.len()) && sent.iter().all(|sent| *sent == idle), "{sent:?}");
    enable(&mut bench);
    assert_eq!(reports(&mut bench, 0x01, 150)[0], [0, 0, 0, 0, 8, 0, 0, 0]);
    // Axis 0x40 is the motor, and its bit 17 the temperature.
    for (number, axis, errors) in [("0x04", [2, 0], 0_u64), ("0x08", [0x40, 1], 1 << 17)] {
        bench.inject(&format!("fault {number}"));
        let [bits, flag] = axis;
        assert_eq!(reports(&mut bench, 0x01, 150)[0], [bits, 0, 0, 0, 1, flag, 0, 0], "{number}");
        assert_eq!(send(&mut bench, 0x03, 0), [errors.to_le_bytes()], "{number}");
        send(&mut bench, 0x18, 0);
        assert_eq!(reports(&mut bench, 0x01, 150)[0], idle, "{number}");
    }
}

#[test]
fn axis_needs_the_mode_of_impedances() {
    let mut bench = bench();
    send(&mut bench, 0x07, 0x0800_0000_0000_0000);
    assert_eq!(bench.motor().mode(), Mode::Stopped);
    enable(&mut bench);
    assert_eq!(bench.motor().mode(), Mode::Running);
    send(&mut bench, 0x07, 0x0100_0000_0000_0000);
    assert_eq!(bench.motor().mode(), Mode::Stopped);
}

/// Kp 50 is 0x19A of 500, kd 1 is 0x333 of 5. 1.2 rad is 13.7 · 65535 / 25 = 35913.2, 0x8C49. 5 N·m is
/// 55 · 40.95 = 2252.3, 0x8CC.
#[test]
fn running_axis_follows_impedance_and_answers() {
    let mut bench = bench();
    assert_eq!(send(&mut bench, 0x08, 0x8C49_7FF1_9A33_37FF), [[0; 0]; 0], "idle");
    enable(&mut bench);
    for _ in 0..500 {
        assert_eq!(send(&mut bench, 0x08, 0x8C49_7FF1_9A33_37FF).len(), 1);
    }
    let position = bench.motor().position();
    assert!((position - 1.2).abs() < 0.02, "{position}");
    let answers = send(&mut bench, 0x08, 0x8C49_8000_0000_08CC);
    let [answer] = &answers[..] else { panic!("{answers:?}") };
    assert_eq!((answer.len(), answer[0]), (6, 5));
    assert!((common::position(answer) - position).abs() < 1e-3, "{answer:?}");
    assert!((bench.motor().torque() - 5.0).abs() < 0.1, "{}", bench.motor().torque());
}

#[test]
fn node_id_lasts_only_when_saved() {
    for (saves, node) in [(false, 5), (true, 9)] {
        let mut bench = bench();
        send(&mut bench, 0x06, 0x0900_0000_0000_0000);
        assert!(send(&mut bench, 0x09, 0).is_empty(), "it has another id");
        if saves {
            let id = FrameId::new(0x13F).unwrap();
            bench.bus.send(bench.now, &[Frame::classic(id, [0; 8])]);
            bench.pass(Duration::from_millis(1));
        }
        bench.inject("power-cycle");
        let all: Vec<Frame> = (0..600).flat_map(|_| frames(&bench.pass(Duration::from_millis(1)))).collect();
        let nodes: Vec<_> = all.iter().map(|frame| frame.id().raw() >> 5).collect();
        assert!(nodes.len() > 10 && nodes[3..].iter().all(|sender| *sender == node), "{nodes:?}");
    }
}

#[test]
fn zero_lasts_when_saved_and_may_shift() {
    for shift in [0.0, 0.11] {
        let mut bench = Bench::begun(MotorSettings { zero_shift: shift, ..settings() });
        send(&mut bench, 0x19, 0);
        assert!(bench.motor().position().abs() < 1e-3, "{}", bench.motor().position());
        send(&mut bench, 0x1F, 0);
        bench.inject("power-cycle");
        bench.pass(Duration::from_millis(500));
        assert!((bench.motor().position() + shift).abs() < 1e-3, "{}", bench.motor().position());
    }
}

/// Node 1 at 500 kbit/s.
#[test]
fn factory_driver_needs_its_bit_rate() {
    let mut bench = Bench::begun(MotorSettings { is_new: true, ..settings() });
    let all: Vec<Frame> = (0..500).flat_map(|_| frames(&bench.pass(Duration::from_millis(1)))).collect();
    assert_eq!(all, []);
    bench.inject_into("can0", "bitrate 500000");
    let all: Vec<Frame> = (0..500).flat_map(|_| frames(&bench.pass(Duration::from_millis(1)))).collect();
    assert!(!all.is_empty() && all.iter().all(|frame| frame.id().raw() >> 5 == 1), "{all:?}");
}
