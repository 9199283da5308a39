//! IMUs on a CAN bus: samples, missing replies, loss, and frames that are none.

use motord_bus::Duration;
use motord_core::control::Event;
use motord_harness::robot::{self, Robot};
use motord_settings::settings::Settings;
use motord_shared::message::{IMU_FRESH, IMU_LOST, IMU_VALID};
use motord_shared::{BusCondition, Cause, ImuState, Phase};

/// A motor beside a HiPNUC, and a DM-IMU-L1 alone, each as `imus` says.
fn settings(imus: &str) -> Settings {
    let motors = robot::motor(1, "knee", "leg", "");
    robot::settings(&format!(
        "[[bus]]\nname = 'leg'\ntype = 'simulated'\n[[bus]]\nname = 'body'\ntype = 'simulated'\n{motors}{imus}"
    ))
}

const HIPNUC: &str = "[[imu]]\nname = 'head'\ntype = 'hipnuc-can'\nbus = 'leg'\nrate-hz = 200\n";
const DAMIAO: &str = "[[imu]]\nname = 'base'\ntype = 'damiao'\nbus = 'body'\nrate-hz = 500\n";

fn robot(imus: &str) -> Robot {
    Robot::new(settings(imus), 1)
}

fn imu(robot: &mut Robot, index: usize) -> ImuState {
    robot.state().imus()[index]
}

/// The cycles of `steps` with a fresh sample.
fn fresh(robot: &mut Robot, index: usize, steps: usize) -> Vec<usize> {
    let is_fresh = |step: usize| {
        robot.step();
        (imu(robot, index).flags & IMU_FRESH != 0).then_some(step)
    };
    (0..steps).filter_map(is_fresh).collect()
}

fn inject(robot: &Robot, bus: usize, verb: &str) {
    robot.buses[bus].inject(robot.now(), &verb.parse().expect("a verb")).expect("it is obeyed");
}

/// The frames of a level DM-IMU-L1, by hand: 0 has the codes 0x8000, 9.8 of ±235.2 m/s² 0x8555.
const LEVEL: [[u8; 8]; 3] = [
    [1, 35, 0x00, 0x80, 0x00, 0x80, 0x55, 0x85],
    [2, 0, 0x00, 0x80, 0x00, 0x80, 0x00, 0x80],
    [4, 0xFF, 0xFE, 0x00, 0x08, 0x00, 0x20, 0x00],
];

#[test]
fn requested_sample_is_published_in_its_cycle() {
    let mut robot = robot(DAMIAO);
    let cycles = fresh(&mut robot, 0, 100);
    assert_eq!(cycles, (0..100).step_by(2).collect::<Vec<_>>(), "in every second cycle");
    let state = imu(&mut robot, 0);
    assert_eq!((state.flags, state.sequence, state.missing, state.rejected), (IMU_VALID, 50, 0, 0));
    assert!((state.acceleration[2] - 9.8).abs() < 0.1, "{:?}", state.acceleration);
    assert_eq!(state.temperature, 35.0);
    robot.step();
    let (newest, tick) = (imu(&mut robot, 0).receive_ns, robot.state().tick_ns);
    assert!((tick..tick + 1_000_000).contains(&newest), "it was received in this cycle");
}

#[test]
fn sent_samples_are_published_at_their_rate() {
    let mut robot = robot(HIPNUC);
    robot.steps(20);
    let before = imu(&mut robot, 0).sequence;
    assert_eq!(fresh(&mut robot, 0, 1000).len(), 200);
    let state = imu(&mut robot, 0);
    assert_eq!((state.sequence - before, state.missing, state.rejected), (200, 0, 0));
    let norm: f32 = state.orientation.iter().map(|part| part * part).sum();
    assert!((norm - 1.0).abs() < 1e-5 && state.temperature.is_nan());
    let bus = robot.bus(0);
    assert_eq!((bus.unexpected_id, bus.malformed, bus.duplicate), (0, 0, 0));
    assert_eq!(robot.joint(0).missed, 0);
}

/// The orientation of the body is that of the simulated motion, whichever device measures it.
#[test]
fn both_devices_measure_one_motion() {
    let mut robot = robot(&format!("{HIPNUC}{DAMIAO}"));
    for _ in 0..200 {
        robot.steps(5);
        let [one, other] = [0, 1].map(|index| imu(&mut robot, index));
        if one.sequence == 0 {
            continue;
        }
        let dot: f32 = one.orientation.iter().zip(other.orientation).map(|(a, b)| a * b).sum();
        assert!(dot > 0.9999, "{:?} {:?}", one.orientation, other.orientation);
        for (one, other) in one.angular_velocity.iter().zip(other.angular_velocity) {
            assert!((one - other).abs() < 0.05, "{one} {other}");
        }
    }
}

/// A sensor measures noise at rest: equal samples for a second are no measurements.
#[test]
fn repeated_sample_is_rejected_and_imu_lost() {
    for (imus, bus, name) in [(HIPNUC, 0, "head"), (DAMIAO, 1, "base")] {
        let mut robot = robot(imus);
        robot.steps(3000);
        let before = imu(&mut robot, 0);
        assert_eq!((before.flags & IMU_LOST, before.rejected), (0, 0), "{name} sways");
        inject(&robot, bus, &format!("{name} stuck"));
        robot.steps(900);
        assert_eq!(imu(&mut robot, 0).flags & IMU_LOST, 0, "{name}: less than a second");
        robot.steps(600);
        let stuck = imu(&mut robot, 0);
        assert_ne!(stuck.flags & IMU_LOST, 0, "{name} repeats one sample");
        assert!(stuck.rejected > 20, "{name}: {}", stuck.rejected);
        inject(&robot, bus, &format!("{name} ok"));
        robot.steps(20);
        assert_eq!(imu(&mut robot, 0).flags & IMU_LOST, 0, "{name} measures again");
    }
}

#[test]
fn missing_reply_is_counted_and_soon_not_awaited() {
    let mut robot = robot(DAMIAO);
    robot.steps(100);
    inject(&robot, 1, "base off");
    let before = imu(&mut robot, 0);
    robot.steps(20);
    assert_eq!(imu(&mut robot, 0).missing - before.missing, 9, "the last is still open");
    let late = |robot: &mut Robot| {
        robot.step();
        let state = robot.state();
        state.publish_ns - state.tick_ns > 700_000
    };
    // One request in 100 ms.
    let waits = (0..1000).filter(|_| late(&mut robot)).count();
    assert!((9..=12).contains(&waits), "{waits} cycles waited until the reply deadline");
    inject(&robot, 1, "base ok");
    robot.steps(101);
    assert_eq!(fresh(&mut robot, 0, 100).len(), 50);
    assert_eq!(robot.joint(0).missed, 0);
}

/// The first sample after a silence is that of a rare request; the next must not come as late.
#[test]
fn imu_that_returns_is_not_lost_again() {
    let mut robot = robot(DAMIAO);
    inject(&robot, 1, "base off");
    robot.steps(500);
    robot.take_events();
    inject(&robot, 1, "base ok");
    robot.steps(300);
    let changes: Vec<_> =
        robot.take_events().into_iter().filter(|event| matches!(event, Event::Sensor { .. })).collect();
    assert_eq!(changes, [Event::Sensor { sensor: 0, is_lost: false }]);
}

#[test]
fn silent_imu_is_lost_after_its_time() {
    for (imus, bus, verb, lost_after) in [(HIPNUC, 0, "head off", 15), (DAMIAO, 1, "base off", 6)] {
        let mut robot = robot(imus);
        robot.steps(50);
        assert!((0..20).any(|_| !fresh(&mut robot, 0, 1).is_empty()), "{verb}");
        inject(&robot, bus, verb);
        robot.take_events();
        let received = imu(&mut robot, 0).receive_ns;
        let is_lost = |robot: &mut Robot| {
            robot.step();
            imu(robot, 0).flags & IMU_LOST != 0
        };
        assert!((0..100).any(|_| is_lost(&mut robot)), "{verb}");
        let silent = Duration::from_nanos(robot.state().publish_ns - received);
        let limit = Duration::from_millis(lost_after);
        assert!(silent > limit && silent < limit + 2 * robot::PERIOD, "{verb}: {silent:?}");
        let lost = Event::Sensor { sensor: 0, is_lost: true };
        assert!(robot.take_events().contains(&lost));
    }
}

#[test]
fn loss_of_required_imu_damps_next_cycle() {
    let mut robot = robot(&format!("{HIPNUC}when-lost = 'stop'\n"));
    robot.steps(20);
    let joints = robot.activate();
    inject(&robot, 0, "head off");
    let is_lost = |robot: &mut Robot| {
        robot.follow(&joints);
        imu(robot, 0).flags & IMU_LOST != 0
    };
    assert!((0..21).any(|_| is_lost(&mut robot)), "a period, lost-after and a cycle");
    assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::ImuLost)));
}

#[test]
fn imu_of_broken_bus_is_lost_at_once() {
    for (fault, condition) in [("body bus-off", BusCondition::Off), ("body gone", BusCondition::Gone)] {
        let mut robot = robot(DAMIAO);
        robot.steps(50);
        inject(&robot, 1, fault);
        robot.steps(2);
        assert_eq!(robot.bus(1).condition, condition.code(), "{fault}");
        assert_eq!(imu(&mut robot, 0).flags, IMU_VALID | IMU_LOST, "{fault}");
        let missing = imu(&mut robot, 0).missing;
        robot.steps(50);
        assert_eq!(imu(&mut robot, 0).flags, IMU_VALID | IMU_LOST);
        inject(&robot, 1, "body ok");
        robot.reopen(1);
        robot.steps(3);
        assert_eq!(imu(&mut robot, 0).flags & IMU_LOST, 0, "{fault}");
        assert!(fresh(&mut robot, 0, 100).len() >= 49);
        assert!(imu(&mut robot, 0).missing <= missing + 1, "what was not sent is not missing");
    }
}

/// A sample that arrived just before, and is read after the refusal.
#[test]
fn unread_sample_of_broken_bus_is_not_used() {
    let mut robot = robot(HIPNUC);
    robot.steps(20);
    robot.deliver_frame(0, 0x188, &[0, 0, 0, 0, 0xE8, 3]);
    robot.deliver_frame(0, 0x288, &[0; 6]);
    robot.deliver_frame(0, 0x488, &[0x10, 0x27, 0, 0, 0, 0, 0, 0]);
    inject(&robot, 0, "leg down");
    robot.steps(2);
    assert_eq!(imu(&mut robot, 0).flags, IMU_VALID | IMU_LOST);
    inject(&robot, 0, "leg ok");
    robot.steps(8);
    assert_eq!(imu(&mut robot, 0).flags & IMU_LOST, 0);
}

/// On a bus without motors, only the refusal of a frame shows that the interface is unplugged.
#[test]
fn unplugged_bus_of_lone_sender_is_noticed() {
    let alone = HIPNUC.replace("'leg'", "'body'");
    let mut robot = robot(&alone);
    robot.steps(50);
    inject(&robot, 1, "body gone");
    robot.steps(250);
    assert_eq!(robot.bus(1).condition, BusCondition::Gone.code());
    inject(&robot, 1, "body ok");
    robot.reopen(1);
    robot.steps(10);
    assert_eq!(imu(&mut robot, 0).flags & IMU_LOST, 0);
}

#[test]
fn frames_that_are_no_sample_are_rejected() {
    let mut robot = robot(DAMIAO);
    inject(&robot, 1, "base off");
    robot.steps(100);
    let before = (imu(&mut robot, 0), robot.bus(1));
    let (short, register, norm) = (&LEVEL[0][..7], [9, 0, 0, 0, 0, 0, 0, 0], [4, 0, 0, 0, 0, 0, 0, 0]);
    for payload in [short, &LEVEL[1], &norm, &register, &[]] {
        robot.deliver_frame(1, 0x11, payload);
        robot.step();
    }
    let after = (imu(&mut robot, 0), robot.bus(1));
    assert_eq!(after.0.rejected - before.0.rejected, 4);
    assert_eq!(after.0.sequence, before.0.sequence);
    let counted = |bus: &motord_shared::BusState| (bus.unexpected_id, bus.malformed, bus.duplicate);
    assert_eq!(counted(&after.1), counted(&before.1), "they are from a known device");
}

#[test]
fn garbage_is_rejected_and_never_published() {
    for (imus, bus, verb) in [(HIPNUC, 0, "head garbage"), (DAMIAO, 1, "base garbage")] {
        let mut robot = robot(imus);
        robot.steps(50);
        inject(&robot, bus, verb);
        robot.steps(10);
        let before = imu(&mut robot, 0);
        robot.steps(100);
        let after = imu(&mut robot, 0);
        assert_eq!((after.sequence, after.orientation), (before.sequence, before.orientation), "{verb}");
        assert!(after.rejected >= before.rejected + 19, "{verb}: {}", after.rejected);
    }
}

/// Frames of a sample without a request: a device that sends by itself as well, or an attacker.
#[test]
fn unasked_sample_is_rejected() {
    let mut robot = robot(DAMIAO);
    robot.steps(51);
    let before = imu(&mut robot, 0);
    assert_eq!(before.flags & IMU_FRESH, IMU_FRESH, "the next cycle asks nothing");
    LEVEL.iter().for_each(|payload| robot.deliver_frame(1, 0x11, payload));
    robot.step();
    let after = imu(&mut robot, 0);
    assert_eq!((after.sequence, after.rejected), (before.sequence, before.rejected + 3));
}

#[test]
fn heartbeat_is_no_frame_with_unexpected_id() {
    let mut robot = robot(HIPNUC);
    robot.steps(20);
    let before = robot.bus(0);
    robot.deliver_frame(0, 0x708, &[5]);
    robot.step();
    assert_eq!((robot.bus(0).unexpected_id, before.unexpected_id), (0, 0));
    robot.deliver_frame(0, 0x709, &[5]);
    robot.step();
    assert_eq!(robot.bus(0).unexpected_id, 1, "of another node");
}

#[test]
fn lost_frames_of_sender_are_counted_missing() {
    let mut robot = robot(HIPNUC);
    robot.steps(50);
    inject(&robot, 0, "head intermittent 50%");
    let before = imu(&mut robot, 0);
    robot.steps(5000);
    let after = imu(&mut robot, 0);
    let (received, missing) = (after.sequence - before.sequence, u64::from(after.missing - before.missing));
    assert!((400..600).contains(&received), "{received}");
    assert!((995..=1001).contains(&(received + missing)), "{received} + {missing}");
}
