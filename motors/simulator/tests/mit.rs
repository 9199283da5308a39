//! An MIT motor from the host's side.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::{Bench, CLEAR_FAULT, GET_FAULT, NEUTRAL, PUSH, SET_ZERO, START, STOP, position};
use motord_bus::{Bus, Content, Duration, Frame, FrameId};
use motord_simulator::{
    Behaviour, BeyondRange, HostLoss, InFault, Mode, MotorSettings, ReplyTiming, RobStrideFirmware,
};

fn with(behaviour: Behaviour) -> Bench {
    Bench::new(MotorSettings { behaviour, ..MotorSettings::default() })
}

fn bench() -> Bench {
    with(Behaviour::default())
}

/// Returns a control frame with kp 40 (code 328), kd 0.8 (code 655), no velocity, no torque.
fn hold(position: f64) -> [u8; 8] {
    let [p1, p0] = (((position + 12.5) * 65535.0 / 25.0).round() as u16).to_be_bytes();
    [p1, p0, 0x80, 0x01, 0x48, 0x28, 0xF8, 0x00]
}

#[test]
fn a_motor_moves_only_between_start_and_stop() {
    let mut bench = bench();
    bench.ask(PUSH);
    assert_eq!((bench.motor().velocity(), bench.motor().mode()), (0.0, Mode::Stopped));
    bench.ask(NEUTRAL);
    bench.ask(START);
    bench.ask(PUSH);
    assert!(bench.motor().velocity() > 0.5 && bench.motor().mode() == Mode::Running);
    bench.ask(STOP);
    assert_eq!((bench.motor().torque(), bench.motor().mode()), (0.0, Mode::Stopped));
}

#[test]
fn a_remembered_control_frame_kicks_at_the_start() {
    let mut bench = bench();
    bench.ask(PUSH);
    assert!(bench.motor().last_executed().is_none());
    bench.ask(START);
    assert!(bench.motor().velocity() > 0.5);

    let mut forgetful = with(Behaviour { remembers_control: false, ..Behaviour::default() });
    forgetful.ask(PUSH);
    forgetful.ask(START);
    assert_eq!(forgetful.motor().velocity(), 0.0);
}

/// Goal: RobStride's two forms of a state (manuals of 2025-11-25 and of 2026-04-10): stopped,
/// running, in fault.
#[test]
fn robstride_firmware_decides_the_status_beside_temperature() {
    for (firmware, status) in [
        (RobStrideFirmware::Manual2025, [Some(0), Some(0), None]),
        (RobStrideFirmware::Manual2026, [Some(0), Some(0x80), Some(0x20)]),
    ] {
        let behaviour = Behaviour { firmware, ..Behaviour::default() };
        let ends = Some([12.57, 33.0, 14.0]);
        let mut bench =
            Bench::new(MotorSettings { vendor: "robstride", ends, behaviour, ..MotorSettings::default() });
        let read = |bench: &mut Bench| {
            let answers = bench.answers(NEUTRAL);
            answers.first().map(|answer| (answer.payload()[6] & 0xF0, answer.payload()[7]))
        };
        let stopped = read(&mut bench);
        bench.ask(START);
        let running = read(&mut bench);
        bench.inject("fault 0x01");
        let replies = [stopped, running, read(&mut bench)];
        // 25.0 degrees are 250 tenths.
        assert_eq!(replies, status.map(|status| status.map(|status| (status, 250))), "{firmware:?}");
    }
}

#[test]
fn a_held_position_is_reached() {
    let mut bench = bench();
    bench.ask(START);
    let mut state = bench.ask(NEUTRAL);
    for _ in 0..500 {
        state = bench.ask(hold(0.5));
    }
    assert!((position(&state) - 0.5).abs() < 0.005, "{}", position(&state));
    assert_eq!(bench.motor().last_executed().unwrap().1.payload(), hold(0.5));
}

#[test]
fn answer_holds_state_around_its_command() {
    let torque = |timing| {
        let mut bench = with(Behaviour { reply_timing: timing, ..Behaviour::default() });
        bench.ask(START);
        let state = bench.ask(PUSH);
        u16::from(state[4] & 0x0F) << 8 | u16::from(state[5])
    };
    assert_eq!((torque(ReplyTiming::BeforeCommand), torque(ReplyTiming::AfterCommand)), (2047, 2148));
}

#[test]
fn codes_are_truncated_or_rounded() {
    let mut rounding = with(Behaviour { truncates: false, ..Behaviour::default() });
    assert_eq!(rounding.ask(STOP), [1, 0x80, 0x00, 0x80, 0x08, 0x00]);
    assert_eq!(bench().ask(STOP), [1, 0x7F, 0xFF, 0x7F, 0xF7, 0xFF]);
}

#[test]
fn set_zero_makes_the_place_zero() {
    let mut bench = Bench::new(MotorSettings { initial_position: 2.0, ..MotorSettings::default() });
    assert!((position(&bench.ask(STOP)) - 2.0).abs() < 1e-3);
    bench.ask(SET_ZERO);
    assert!(position(&bench.ask(STOP)).abs() < 1e-3);
}

#[test]
fn set_zero_while_running_moves_the_target_along() {
    let mut bench = Bench::new(MotorSettings { initial_position: 1.0, ..MotorSettings::default() });
    bench.ask(hold(1.0));
    bench.ask(START);
    bench.ask(SET_ZERO);
    bench.pass(Duration::from_secs(2));
    assert!((bench.motor().position() - 1.0).abs() < 0.01, "the shaft has turned by a radian");
}

#[test]
fn a_motor_may_be_silent_after_set_zero() {
    let silence = Duration::from_millis(1500);
    let mut bench = with(Behaviour { zeroing_silence: silence, ..Behaviour::default() });
    bench.ask(SET_ZERO);
    assert!(bench.is_silent(STOP));
    bench.pass(silence);
    assert!(position(&bench.ask(STOP)).abs() < 1e-3);
}

#[test]
fn a_position_beyond_the_range_wraps_or_clamps() {
    let reported = |beyond_range| {
        let behaviour = Behaviour { beyond_range, ..Behaviour::default() };
        let mut bench =
            Bench::new(MotorSettings { initial_position: 13.0, behaviour, ..MotorSettings::default() });
        position(&bench.ask(STOP))
    };
    assert_eq!(reported(BeyondRange::Clamps), 12.5);
    assert!((reported(BeyondRange::Wraps) - (13.0 - 25.0)).abs() < 1e-3);
}

#[test]
fn fault_stops_motor_until_cleared() {
    let behaviour = Behaviour { in_fault: InFault::Refuses, ..Behaviour::default() };
    let mut bench = with(behaviour);
    bench.ask(START);
    bench.ask(PUSH);
    bench.inject("fault 0x40");
    assert_eq!(bench.ask(GET_FAULT), [1, 0x40, 0, 0, 0, 0]);
    assert_eq!(bench.ask(PUSH).len(), 6, "it answers with its state");
    bench.ask(START);
    assert_eq!((bench.motor().mode(), bench.motor().torque()), (Mode::Fault, 0.0));
    assert_eq!(bench.ask(CLEAR_FAULT)[0], 1);
    assert_eq!(bench.ask(GET_FAULT), [1, 0, 0, 0, 0, 0]);
    assert_eq!(bench.motor().mode(), Mode::Stopped);
}

#[test]
fn silent_faulty_motor_still_reports_fault() {
    let mut bench = bench();
    bench.inject("fault 0x06");
    assert!(bench.is_silent(NEUTRAL) && bench.is_silent(START));
    assert_eq!(bench.ask(GET_FAULT), [1, 0x06, 0, 0, 0, 0]);
}

#[test]
fn a_fault_whose_cause_remains_comes_back() {
    let mut bench = bench();
    for (cause, bit) in [("voltage 60", 0x02), ("voltage 8", 0x04)] {
        bench.inject(cause);
        bench.pass(Duration::from_millis(1));
        bench.ask(CLEAR_FAULT);
        assert_eq!(bench.ask(GET_FAULT)[1], bit, "{cause}");
        bench.inject("ok");
        bench.ask(CLEAR_FAULT);
        assert_eq!(bench.ask(GET_FAULT)[1], 0);
    }
}

#[test]
fn full_torque_against_a_stop_overheats_the_winding() {
    let blocked = MotorSettings { viscous_friction: 1e6, ..MotorSettings::default() };
    let mut bench = Bench::new(blocked);
    bench.ask(START);
    bench.ask([0xFF, 0xFF, 0x80, 0x00, 0x00, 0x00, 0x0F, 0xFF]);
    bench.pass(Duration::from_secs(20));
    assert_eq!((bench.motor().mode(), bench.motor().fault()), (Mode::Fault, 0x08));
}

#[test]
fn lost_host_leaves_last_command_or_limp() {
    let torque = |host_loss| {
        let mut bench = with(Behaviour { host_loss, ..Behaviour::default() });
        bench.ask(START);
        bench.ask(PUSH);
        bench.pass(Duration::from_millis(50));
        bench.motor().torque()
    };
    assert!(torque(HostLoss::KeepsCommand) > 1.0);
    assert_eq!(torque(HostLoss::GoesLimp { after: Duration::from_millis(25) }), 0.0);
}

#[test]
fn gim_zero_frame_is_full_negative_torque() {
    let mut bench = bench();
    bench.ask(START);
    // The native stop command.
    bench.ask([0x92, 0, 0, 0, 0, 0, 0, 0]);
    assert!(bench.motor().torque() < -20.0, "{}", bench.motor().torque());
}

#[test]
fn stalled_host_finds_a_stable_motor() {
    let mut bench = bench();
    bench.ask(START);
    // kp 500, kd 5 at 1 rad, from 0.
    bench.ask([0x8A, 0x3D, 0x80, 0x0F, 0xFF, 0xFF, 0xF8, 0x00]);
    bench.pass(Duration::from_secs(2));
    assert!((bench.motor().position() - 1.0).abs() < 1e-2, "{}", bench.motor().position());
    assert!(bench.motor().velocity().abs() < 1e-3, "{}", bench.motor().velocity());
}

/// x(t) = rest + (x(0) - rest) cos(ωt), from the moment at which the drive receives the frame.
#[test]
fn an_undamped_spring_swings_as_its_closed_form() {
    let free = MotorSettings { viscous_friction: 0.0, coulomb_friction: 0.0, ..MotorSettings::default() };
    let inertia = free.rotor_inertia * free.gear_ratio * free.gear_ratio + free.load_inertia;
    let mut bench = Bench::new(MotorSettings { initial_position: 0.5, ..free });
    bench.ask(START);
    // Position, velocity and torque in the middle, kp 164.
    bench.ask([0x80, 0x00, 0x80, 0x00, 0xA4, 0x00, 0x08, 0x00]);
    let received = bench.motor().last_executed().unwrap().0;
    let kp = 164.0 * 500.0 / 4095.0;
    let rest = 32768.0 * 25.0 / 65535.0 - 12.5 + (2048.0 * 450.0 / 4095.0 - 225.0) / kp;
    let omega = f64::sqrt(kp / inertia);
    let mut worst = 0.0_f64;
    for _ in 0..1_500 {
        bench.pass(Duration::from_millis(1));
        let closed = rest + (0.5 - rest) * (omega * bench.now.since(received).as_secs_f64()).cos();
        worst = worst.max((bench.motor().position() - closed).abs());
    }
    assert!(worst < 0.002, "{worst} rad");
}

/// The bytes of DM_CAN.py (`read_motor_param`, `write_motor_param`, `save_motor_param`,
/// `refresh_motor_status`), and IEEE 754: 12.5 is 0x41480000, 8 is 0x41000000, 10 is 0x41200000, 28
/// is 0x41E00000.
#[test]
fn damiao_registers_answer_with_vendor_bytes() {
    let ends = Some([12.5, 8.0, 28.0]);
    let mut bench = Bench::new(MotorSettings {
        vendor: "damiao",
        ends,
        id: 1,
        host_id: 0x11,
        ..MotorSettings::default()
    });
    let mut ask = |payload: [u8; 8]| {
        let request = Frame::classic(FrameId::new(0x7FF).unwrap(), payload);
        assert_eq!(bench.bus.send(bench.now, &[request]).accepted, 1);
        let arrivals = bench.pass(Duration::from_millis(1));
        arrivals.iter().find_map(|arrival| match arrival.content {
            Content::Frame(frame) => Some((frame.id().raw(), frame.payload().to_vec())),
            _ => None,
        })
    };
    let is = |bytes: [u8; 8]| Some((0x11, bytes.to_vec()));
    assert_eq!(ask([1, 0, 0x33, 21, 0, 0, 0, 0]), is([1, 0, 0x33, 21, 0, 0, 0x48, 0x41]));
    assert_eq!(ask([1, 0, 0x33, 22, 0, 0, 0, 0]), is([1, 0, 0x33, 22, 0, 0, 0x00, 0x41]));
    assert_eq!(ask([1, 0, 0x33, 23, 0, 0, 0, 0]), is([1, 0, 0x33, 23, 0, 0, 0xE0, 0x41]));
    assert_eq!(ask([1, 0, 0x33, 7, 0, 0, 0, 0]), is([1, 0, 0x33, 7, 0x11, 0, 0, 0]));
    assert_eq!(ask([1, 0, 0x55, 22, 0, 0, 0x20, 0x41]), is([1, 0, 0x55, 22, 0, 0, 0x20, 0x41]));
    assert_eq!(ask([1, 0, 0x33, 22, 0, 0, 0, 0]), is([1, 0, 0x33, 22, 0, 0, 0x20, 0x41]));
    assert_eq!(ask([1, 0, 0x55, 22, 0, 0, 0xC0, 0x7F]), is([1, 0, 0x55, 22, 0, 0, 0x20, 0x41]), "no number");
    assert_eq!(ask([1, 0, 0xAA, 0, 0, 0, 0, 0]).unwrap().1[..3], [1, 0, 0xAA]);
    let (id, state) = ask([1, 0, 0xCC, 0, 0, 0, 0, 0]).unwrap();
    assert_eq!((id, state.len(), state[0]), (0x11, 8, 0x01), "a state: disabled, id 1");
    assert_eq!(ask([2, 0, 0x33, 21, 0, 0, 0, 0]), None, "another motor");
    assert_eq!(ask([1, 0, 0x33, 99, 0, 0, 0, 0]), None, "a register that it lacks");
}

/// Goal: a Damiao motor begins with ESC_ID 1 and MST_ID 0 in MIT. Written ids take effect after their
/// answer, and last without power once they are stored. Bytes of DM_CAN.py, as above.
#[test]
fn damiao_ids_last_once_stored() {
    let new = MotorSettings { vendor: "damiao", is_new: true, id: 9, ..MotorSettings::default() };
    let mut bench = Bench::new(MotorSettings { ends: Some([12.5, 8.0, 28.0]), ..new });
    let ask = |bench: &mut Bench, to: u16, payload: [u8; 8]| {
        let request = Frame::classic(FrameId::new(to).unwrap(), payload);
        assert_eq!(bench.bus.send(bench.now, &[request]).accepted, 1);
        let arrivals = bench.pass(Duration::from_millis(1));
        arrivals.iter().find_map(|arrival| match arrival.content {
            Content::Frame(frame) => Some((frame.id().raw(), frame.payload().to_vec())),
            _ => None,
        })
    };
    let write = |bench: &mut Bench| {
        let host_id = [1, 0, 0x55, 7, 0x13, 0, 0, 0];
        assert_eq!(ask(bench, 0x7FF, host_id), Some((0, host_id.to_vec())));
        let id = [1, 0, 0x55, 8, 3, 0, 0, 0];
        assert_eq!(ask(bench, 0x7FF, id), Some((0x13, id.to_vec())));
        assert_eq!(ask(bench, 1, STOP), None);
        assert_eq!(ask(bench, 3, STOP).map(|(id, state)| (id, state[0])), Some((0x13, 3)));
    };
    write(&mut bench);
    bench.inject("power-cycle");
    bench.pass(Duration::from_millis(300));
    assert_eq!(ask(&mut bench, 1, STOP).map(|(id, state)| (id, state[0])), Some((0, 1)), "not stored");
    write(&mut bench);
    ask(&mut bench, 3, START);
    assert_eq!(ask(&mut bench, 0x7FF, [3, 0, 0xAA, 1, 0, 0, 0, 0]), None, "an enabled motor stores nothing");
    ask(&mut bench, 3, STOP);
    assert!(ask(&mut bench, 0x7FF, [3, 0, 0xAA, 1, 0, 0, 0, 0]).is_some());
    bench.inject("power-cycle");
    bench.pass(Duration::from_millis(300));
    assert_eq!(ask(&mut bench, 3, STOP).map(|(id, state)| (id, state[0])), Some((0x13, 3)));
}
