//! Every fault verb has its documented effect.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::{Bench, NEUTRAL, PUSH, START, STOP, frames, position};
use motord_bus::frame::ControllerState;
use motord_bus::{Bus, Content, Duration, Frame, FrameId, Inbox, Refusal, Unsupported};
use motord_simulator::{Direction, FaultVerb, InjectError, Mode, MotorSettings};

fn running() -> Bench {
    let mut bench = Bench::new(MotorSettings { initial_position: 4.0, ..MotorSettings::default() });
    bench.ask(START);
    bench.ask(NEUTRAL);
    bench
}

fn push(bench: &mut Bench) -> Vec<u8> {
    bench.ask(PUSH)
}

fn neutral() -> Frame {
    Frame::classic(FrameId::new(1).unwrap(), NEUTRAL)
}

#[test]
fn off_motor_is_deaf_and_mute_but_continues() {
    let mut bench = running();
    push(&mut bench);
    bench.inject("off");
    assert!(bench.is_silent(NEUTRAL));
    assert!(bench.motor().torque() > 1.0);
    bench.inject("on");
    bench.ask(NEUTRAL);
    assert!(bench.motor().torque().abs() < 0.1 && bench.motor().mode() == Mode::Running);
}

#[test]
fn stuck_reports_one_place_while_the_shaft_turns() {
    let mut bench = running();
    bench.inject("stuck");
    let before = push(&mut bench);
    bench.pass(Duration::from_millis(100));
    let after = push(&mut bench);
    assert_eq!(position(&before), position(&after));
    assert!(bench.motor().position() > 4.1 && after[3] > 0x80, "velocity is reported");
}

#[test]
fn garbage_has_only_right_id_and_length() {
    let mut bench = running();
    let sane = push(&mut bench);
    bench.inject("garbage");
    let answers: Vec<Frame> = (0..8).flat_map(|_| bench.answers(PUSH)).collect();
    assert!(answers.iter().all(|answer| answer.id().raw() == 0x101 && answer.payload().len() == 6));
    assert!(answers.iter().any(|answer| answer.payload()[0] != sane[0]));
}

#[test]
fn wrong_is_well_formed_and_false() {
    let mut bench = running();
    bench.inject("wrong");
    let answer = bench.ask(NEUTRAL);
    assert_eq!(answer[0], 1);
    assert!((position(&answer) - 5.0).abs() < 0.01, "a radian off");
}

#[test]
fn slow_refreshes_the_state_only_so_often() {
    let mut bench = running();
    bench.inject("slow 10ms");
    let states: Vec<Vec<u8>> = (0..20).map(|_| push(&mut bench)).collect();
    assert_eq!((&states[1], &states[9], &states[11]), (&states[0], &states[0], &states[10]));
    assert_ne!(states[0], states[10]);
}

#[test]
fn delayed_answers_come_in_a_later_cycle() {
    let mut bench = running();
    bench.inject("delayed 2ms");
    assert!(bench.is_silent(NEUTRAL));
    assert_eq!(frames(&bench.pass(Duration::from_micros(1500))).len(), 1);
}

#[test]
fn intermittent_loses_its_share_of_the_answers() {
    let mut bench = running();
    bench.inject("intermittent 30%");
    let answered: usize = (0..1000).map(|_| bench.answers(NEUTRAL).len()).sum();
    assert!((650..750).contains(&answered), "{answered}");
}

#[test]
fn duplicate_sends_every_answer_twice() {
    let mut bench = running();
    bench.inject("duplicate");
    let answers = bench.answers(NEUTRAL);
    assert_eq!((answers.len(), answers[0]), (2, answers[1]));
}

#[test]
fn reorder_sends_every_other_answer_after_its_successor() {
    let mut bench = running();
    let angle = |answer: &Frame| position(answer.payload());
    bench.ask(PUSH);
    bench.inject("reorder");
    assert!(bench.is_silent(PUSH));
    let answers = bench.answers(PUSH);
    assert!(answers.len() == 2 && angle(&answers[0]) > angle(&answers[1]));
    assert!(bench.is_silent(PUSH), "and so on");
    bench.inject("ok");
    assert_eq!(bench.answers(PUSH).len(), 2, "the held answer arrives finally");
}

#[test]
fn short_answers_lack_two_bytes() {
    let mut bench = running();
    bench.inject("short");
    assert_eq!(bench.ask(NEUTRAL).len(), 4);
}

#[test]
fn power_cycle_ends_stopped_in_another_turn() {
    let mut bench = running();
    push(&mut bench);
    bench.inject("power-cycle");
    assert!(bench.is_silent(NEUTRAL));
    assert!(frames(&bench.pass(Duration::from_millis(300))).is_empty());
    let moved = bench.motor().position();
    let state = bench.ask(NEUTRAL);
    assert_eq!(bench.motor().mode(), Mode::Stopped);
    assert!(
        (position(&state) - moved).abs() < 0.05 && moved < 0.0,
        "4 rad are reported as -2.28 rad: {moved}"
    );
}

#[test]
fn load_pushes_a_limp_shaft() {
    let mut bench = running();
    bench.inject("load -5");
    bench.pass(Duration::from_millis(100));
    assert!(bench.motor().velocity() < -1.0);
    bench.inject("ok");
    bench.pass(Duration::from_secs(20));
    assert_eq!(bench.motor().velocity(), 0.0);
}

#[test]
fn bus_off_drops_frames_until_restart() {
    let mut bench = running();
    bench.bus.send(bench.now, &[neutral()]);
    bench.inject_into("can0", "bus-off");
    let arrivals = bench.pass(Duration::from_millis(1));
    let state = |content: &Content| match content {
        Content::Error(error) => error.state(),
        _ => None,
    };
    assert_eq!(arrivals.iter().map(|a| state(&a.content)).collect::<Vec<_>>(), [Some(ControllerState::Off)]);
    assert!(bench.is_silent(PUSH));
    assert_eq!(bench.motor().torque(), bench.motor().torque().clamp(-0.1, 0.1));
    bench.inject_into("can0", "ok");
    let arrivals = bench.arrivals(NEUTRAL);
    assert_eq!(state(&arrivals[0].content), Some(ControllerState::Active));
    assert_eq!(frames(&arrivals).len(), 1, "nothing old is sent");
}

#[test]
fn full_queue_accepts_only_what_fits() {
    let mut bench = running();
    bench.inject_into("can0", "tx-full 1");
    let sent = bench.bus.send(bench.now, &[neutral(); 3]);
    assert_eq!((sent.accepted, sent.refusal), (1, Some(Refusal::Full)));
    assert_eq!(frames(&bench.pass(Duration::from_millis(1))).len(), 1);
    bench.inject_into("can0", "ok");
    assert_eq!(frames(&bench.pass(Duration::from_millis(1))).len(), 0);
}

#[test]
fn missing_acknowledge_fills_queue_and_delays_sending() {
    let mut bench = running();
    bench.inject_into("can0", "no-ack");
    assert_eq!(bench.bus.send(bench.now, &[neutral(); 11]).refusal, Some(Refusal::Full));
    assert!(frames(&bench.pass(Duration::from_millis(500))).is_empty());
    bench.bus.take_record().for_each(drop);
    bench.inject_into("can0", "ok");
    bench.pass(Duration::from_millis(5));
    let late = bench.bus.take_record().filter(|recorded| recorded.direction == Direction::ToMotor);
    assert_eq!(late.count(), 10);
}

#[test]
fn down_or_gone_interface_reports_and_receives_nothing() {
    for (verb, refusal) in [("down", Refusal::Down), ("gone", Refusal::Gone)] {
        let mut bench = running();
        bench.bus.send(bench.now, &[neutral()]);
        bench.inject_into("can0", verb);
        assert_eq!(bench.bus.send(bench.now, &[neutral()]).refusal, Some(refusal));
        assert_eq!(bench.pass(Duration::from_millis(5)), []);
        bench.inject_into("can0", "ok");
        assert_eq!(bench.ask(NEUTRAL).len(), 6);
    }
}

#[test]
fn flood_keeps_rate_and_passes_motors() {
    let mut bench = running();
    bench.inject_into("can0", "flood 4000");
    let arrivals: Vec<_> = (0..100).flat_map(|_| bench.answers(NEUTRAL)).collect();
    let flooding = arrivals.iter().filter(|frame| frame.id().raw() >= 0x7F0).count();
    assert!((390..=400).contains(&flooding), "{flooding}");
    assert!(arrivals.len() - flooding >= 99);
}

#[test]
fn reports_and_unsupported_frames_reach_the_host_once() {
    let mut bench = running();
    for verb in ["warning", "passive", "active", "extended", "remote", "fd"] {
        bench.inject_into("can0", verb);
    }
    let arrivals = bench.pass(Duration::from_millis(1));
    let states: Vec<_> = arrivals
        .iter()
        .filter_map(|arrival| match arrival.content {
            Content::Error(error) => error.state(),
            _ => None,
        })
        .collect();
    assert_eq!(states, [ControllerState::Warning, ControllerState::Passive, ControllerState::Active]);
    let unsupported = [Unsupported::Extended, Unsupported::Remote, Unsupported::Fd].map(Content::Unsupported);
    assert!(arrivals[3..].iter().map(|arrival| arrival.content).eq(unsupported));
    bench.inject_into("can0", "overflow 5");
    let mut inbox = Inbox::new();
    bench.bus.receive(bench.now, &mut inbox);
    assert_eq!(inbox.lost, 5);
}

#[test]
fn inapplicable_fault_is_refused() {
    let mut bench = running();
    let mut inject = |line: &str| {
        let verb: FaultVerb = line.parse().unwrap();
        bench.bus.inject(bench.now, &verb)
    };
    assert_eq!(inject("nobody off"), Err(InjectError::NoSuchTarget));
    assert_eq!(inject("joint bus-off"), Err(InjectError::NotForMotors));
    assert_eq!(inject("can0 stuck"), Err(InjectError::NotForBuses));
}

/// Otherwise it answers while its bus has no power.
#[test]
fn motor_without_power_does_not_restart() {
    let mut bench = Bench::new(MotorSettings::default());
    bench.inject("power-off");
    bench.inject("restart");
    assert!((0..1000).all(|_| bench.is_silent(STOP)));
    bench.inject("ok");
    assert!((0..1000).any(|_| !bench.is_silent(STOP)));
}
