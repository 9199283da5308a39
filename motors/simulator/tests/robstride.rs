//! A RobStride motor in its private protocol, from the host's side. Frames by hand from the
//! vendor's manuals of 2026-04-28.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::{Bench, frames};
use motord_bus::{Bus, Duration, Frame, FrameId};
use motord_simulator::{Behaviour, Dialect, Mode, MotorSettings};

/// An RS02 with id 5 at 1 rad.
fn bench() -> Bench {
    Bench::new(MotorSettings {
        id: 5,
        host_id: 0xFD,
        dialect: Dialect::RobStride,
        vendor: "robstride",
        ends: Some([12.57, 44.0, 17.0]),
        initial_position: 1.0,
        behaviour: Behaviour { truncates: false, ..Behaviour::default() },
        ..MotorSettings::default()
    })
}

fn send(bench: &mut Bench, id: u32, payload: u64) -> Vec<Frame> {
    let frame = Frame::classic(FrameId::extended(id).unwrap(), payload.to_be_bytes());
    assert_eq!(bench.bus.send(bench.now, &[frame]).accepted, 1);
    frames(&bench.pass(Duration::from_millis(1)))
}

/// Returns id and payload of the only answer.
fn ask(bench: &mut Bench, id: u32, payload: u64) -> (u32, u64) {
    let answers = send(bench, id, payload);
    let [answer] = answers[..] else { panic!("one answer expected, not {answers:?}") };
    assert!(answer.id().is_extended() && answer.is_classic());
    (answer.id().raw(), u64::from_be_bytes(answer.payload().try_into().unwrap()))
}

/// 1 rad is 13.57 · 65535 / 25.14 = 35374.3, zero is 32767.5, and 25.0 °C is 0xFA.
const AT_ONE_RAD: u64 = 0x8A2E_8000_8000_00FA;

#[test]
fn commands_are_answered_by_states() {
    let mut bench = bench();
    assert_eq!(ask(&mut bench, 0x0400_FD05, 0), (0x0200_05FD, AT_ONE_RAD), "stop");
    assert_eq!(ask(&mut bench, 0x0300_FD05, 0), (0x0280_05FD, AT_ONE_RAD), "enable");
    assert_eq!(bench.motor().mode(), Mode::Running);
    assert_eq!(ask(&mut bench, 0x0400_4105, 0).0, 0x0200_0541, "another host");
    assert_eq!(ask(&mut bench, 0x0600_FD05, 0x0100_0000_0000_0000).0, 0x0200_05FD);
    assert!(bench.motor().position().abs() < 1e-3, "{}", bench.motor().position());
}

/// Kp 50 is 0x199A, kd 1 is 0x3333. 4.25 N·m is 0x9FFF in the id.
#[test]
fn enabled_drive_follows_impedance_and_torque() {
    let mut bench = bench();
    send(&mut bench, 0x0180_0005, 0x8A2E_8000_199A_3333);
    assert!(bench.motor().last_executed().is_none(), "disabled");
    ask(&mut bench, 0x0300_FD05, 0);
    // 1.2 rad is 35895.7.
    for _ in 0..500 {
        ask(&mut bench, 0x0180_0005, 0x8C38_8000_199A_3333);
    }
    assert!((bench.motor().position() - 1.2).abs() < 0.01, "{}", bench.motor().position());
    ask(&mut bench, 0x019F_FF05, 0x8C38_8000_0000_0000);
    assert!((bench.motor().torque() - 4.25).abs() < 0.1, "{}", bench.motor().torque());
}

#[test]
fn fault_is_in_id_and_in_one_report() {
    for (number, bits) in [(0x04, 0x01), (0x10, 0x02), (0x01, 0x04), (0x80, 0x08), (0x4000, 0x10), (0x08, 0)]
    {
        let mut bench = bench();
        bench.inject(&format!("fault {number:#x}"));
        let answers = send(&mut bench, 0x0400_FD05, 0);
        let ids: Vec<_> = answers.iter().map(|frame| frame.id().raw()).collect();
        assert_eq!(ids, [0x0200_05FD | bits << 16, 0x1500_05FD], "{number:#x}");
        assert_eq!(answers[1].payload()[..4], u32::to_le_bytes(number));
        assert_eq!(send(&mut bench, 0x0400_FD05, 0).len(), 1, "reported once");
        let cleared = ask(&mut bench, 0x0400_FD05, 0x0100_0000_0000_0000);
        assert_eq!((cleared.0, bench.motor().fault()), (0x0200_05FD, 0));
    }
}

#[test]
fn parameters_are_read_and_stored() {
    let mut bench = bench();
    assert_eq!(ask(&mut bench, 0x1100_FD05, 0x2870_0000_0000_0000), (0x1100_05FD, 0x2870_0000_0000_0000));
    assert_eq!(ask(&mut bench, 0x1200_FD05, 0x2870_0000_9001_0000).0, 0x0200_05FD);
    assert_eq!(ask(&mut bench, 0x1100_FD05, 0x2870_0000_0000_0000).1, 0x2870_0000_9001_0000);
    assert_eq!(ask(&mut bench, 0x1100_FD05, 0x0A20_0000_0000_0000).1, 0x0A20_0000_0500_0000, "its id");
    assert_eq!(ask(&mut bench, 0x1100_FD05, 0xFF7F_0000_0000_0000).0, 0x1101_05FD, "unknown");
    bench.inject("power-cycle");
    bench.pass(Duration::from_millis(400));
    assert_eq!(ask(&mut bench, 0x1100_FD05, 0x2870_0000_0000_0000).1, 0x2870_0000_0000_0000, "lost");
    ask(&mut bench, 0x1200_FD05, 0x2870_0000_9001_0000);
    assert!(send(&mut bench, 0x1600_FD05, 0x0102_0304_0506_0708).is_empty(), "save");
    bench.inject("power-cycle");
    bench.pass(Duration::from_millis(400));
    assert_eq!(ask(&mut bench, 0x1100_FD05, 0x2870_0000_0000_0000).1, 0x2870_0000_9001_0000);
}

/// 400 units of 50 µs are 20 ms.
#[test]
fn drive_without_commands_disables_itself() {
    let mut bench = bench();
    ask(&mut bench, 0x1200_FD05, 0x2870_0000_9001_0000);
    ask(&mut bench, 0x0300_FD05, 0);
    bench.pass(Duration::from_millis(15));
    ask(&mut bench, 0x0180_0005, 0x8000_8000_0000_0000);
    bench.pass(Duration::from_millis(15));
    assert_eq!(ask(&mut bench, 0x0180_0005, 0x8000_8000_0000_0000).0, 0x0280_05FD);
    bench.pass(Duration::from_millis(25));
    assert_eq!(ask(&mut bench, 0x0180_0005, 0x8000_8000_0000_0000).0, 0x0200_05FD);
}

#[test]
fn device_version_and_id_are_reported() {
    let mut bench = bench();
    let (id, serial) = ask(&mut bench, 0x0000_FD05, 0);
    assert_eq!(id, 0x0000_05FE);
    assert_eq!(ask(&mut bench, 0x0400_FD05, 0x00C4_0000_0000_0000), (0x0200_05FD, 0x00C4_5600_0102_0300));
    assert_eq!(ask(&mut bench, 0x0706_FD05, 0), (0x0000_06FE, serial));
    assert!(send(&mut bench, 0x0000_FD05, 0).is_empty());
    assert_eq!(ask(&mut bench, 0x0000_FD06, 0), (0x0000_06FE, serial));
}

/// Protocol 2 is MIT. It takes effect when the power returns.
#[test]
fn protocol_changes_with_next_power_on() {
    let mut bench = bench();
    let (id, _) = ask(&mut bench, 0x1900_FD05, 0x0102_0304_0506_0200);
    assert_eq!(id, 0x0000_05FE);
    assert_eq!(ask(&mut bench, 0x0400_FD05, 0).0, 0x0200_05FD, "not yet");
    bench.inject("power-cycle");
    bench.pass(Duration::from_millis(400));
    assert!(send(&mut bench, 0x0400_FD05, 0).is_empty());
    assert_eq!(bench.ask(common::STOP)[0], 5);
}

#[test]
fn reports_are_sent_every_ten_milliseconds() {
    let mut bench = bench();
    assert!(
        send(&mut bench, 0x1800_FD05, 0x0102_0304_0506_0100).iter().all(|frame| frame.id().raw() >> 24 == 24)
    );
    let frames: Vec<_> = (0..100).flat_map(|_| send(&mut bench, 0x0400_FD05, 0)).collect();
    let reports = frames.iter().filter(|frame| frame.id().raw() == 0x1800_05FD).count();
    assert!((9..=11).contains(&reports), "{reports}");
    assert_eq!(frames.len(), 100 + reports);
}

#[test]
fn frames_of_another_form_are_ignored() {
    let mut bench = bench();
    let short = Frame::new(FrameId::extended(0x0300_FD05).unwrap(), &[0; 7]).unwrap();
    bench.bus.send(bench.now, &[short]);
    assert!(frames(&bench.pass(Duration::from_millis(1))).is_empty());
    assert!(bench.is_silent(common::START), "an id of 11 bits");
    assert!(send(&mut bench, 0x0300_FD06, 0).is_empty(), "another motor");
    for kind in [5_u32, 8, 9, 16, 19, 20, 21, 23, 26, 31] {
        assert!(send(&mut bench, kind << 24 | 0xFD05, 0).is_empty(), "type {kind}");
    }
    assert_eq!(bench.motor().mode(), Mode::Stopped);
}
