//! Motors with CANSimple drivers.

use crate::{bus, inject, link, motor};
use motord_bus::{Duration, FrameId};
use motord_protocol::commissioning::{
    Axis, Error, Family, LASTING, Link, Question, ReportedProtocol, Scan, identify_node, scan, survey,
};
use motord_protocol::mit::Impedance;
use motord_protocol::{Faults, Scales, cansimple};
use motord_simulator::{Dialect, Direction, Medium, Mode, MotorSettings, SharedBus};

const RATIO: f32 = 8.0;

fn node(name: &str, id: u16) -> MotorSettings {
    MotorSettings { initial_position: 0.5, ..motor(name, id, Dialect::CanSimple) }
}

fn with(motors: Vec<MotorSettings>) -> (SharedBus, Link) {
    let bus = bus(Medium::Can, motors);
    let link = link(&bus, Medium::Can);
    (bus, link)
}

/// Goal: a scan names drivers by what they send, and sends them nothing. Method: two of them beside a
/// motor in MIT, whose id is none of theirs.
#[test]
fn scan_names_nodes_and_sends_them_nothing() {
    let (bus, mut link) = with(vec![node("knee", 3), node("ankle", 1), motor("hip", 4, Dialect::Mit)]);
    let report = scan(&mut link, &Scan::default(), &mut |_| true).unwrap();
    let mut found: Vec<_> = report.found.iter().map(|found| (found.id, found.family)).collect();
    found.sort_by_key(|(id, _)| *id);
    assert_eq!(found, [(1, Family::CanSimple), (3, Family::CanSimple), (4, Family::Mit)]);
    let mut bus = bus.lock();
    let sent = bus.take_record().filter(|sent| sent.direction == Direction::ToMotor);
    let standard: Vec<u32> =
        sent.map(|sent| sent.frame.id()).filter(|id| !id.is_extended()).map(FrameId::raw).collect();
    assert!(standard.iter().all(|id| !matches!(id >> 5, 1 | 3)), "{standard:?}");
    assert!(LASTING.iter().all(|id| !standard.contains(&u32::from(*id))), "{standard:?}");
}

/// None of the frames by which a motor is found saves, restarts or moves it.
#[test]
fn node_without_heartbeat_is_found_by_its_estimates() {
    let (bus, mut link) = with(vec![node("knee", 3)]);
    let found = identify_node(&mut link, 3).unwrap().unwrap();
    assert_eq!((found.family, found.host_id), (Family::CanSimple, FrameId::new(0x068)));
    assert_eq!(identify_node(&mut link, 4), Ok(None));
    assert_eq!(identify_node(&mut link, 64), Ok(None));
    let mut bus = bus.lock();
    let sent = bus.take_record().filter(|sent| sent.direction == Direction::ToMotor);
    let commands: Vec<u32> = sent.map(|sent| sent.frame.id().raw() & 0x1F).collect();
    assert!(!commands.is_empty() && commands.iter().all(|command| *command == 0x09), "{commands:?}");
}

#[test]
fn new_node_id_is_confirmed_and_lasts() {
    let (bus, mut link) = with(vec![node("knee", 1), node("hip", 3)]);
    let mut motor = Axis::new(&mut link, 1);
    motor.stop().unwrap();
    motor.set_node(7).unwrap();
    inject(&bus, &link, "knee power-cycle");
    link.pause(Duration::from_millis(400));
    assert_eq!(identify_node(&mut link, 1), Ok(None));
    assert!(matches!(identify_node(&mut link, 7), Ok(Some(_))));
    let silent = Axis::new(&mut link, 20).set_node(21).unwrap_err();
    assert!(matches!(silent, Error::Unconfirmed { id: 21, .. }), "{silent}");
}

#[test]
fn zero_is_stored_and_compared_after_power_cycle() {
    let shifted = MotorSettings { zero_shift: 0.11, ..node("knee", 3) };
    let (bus, mut link) = with(vec![shifted]);
    let mut knee = Axis::new(&mut link, 3);
    let [before, _] = knee.estimates().unwrap().at_output(RATIO);
    let [after, _] = knee.set_zero().unwrap().at_output(RATIO);
    assert!((before - 0.5).abs() < 1e-3 && after.abs() < 1e-3, "{before} {after}");
    inject(&bus, &link, "knee power-cycle");
    link.pause(Duration::from_millis(400));
    let [later, _] = Axis::new(&mut link, 3).estimates().unwrap().at_output(RATIO);
    assert!((later + 0.11).abs() < 1e-3, "{later}");
}

#[test]
fn axis_starts_neutral_follows_and_stops() {
    let (bus, mut link) = with(vec![node("knee", 3)]);
    let mut knee = Axis::new(&mut link, 3);
    let scales = Scales::of(&cansimple::ENDS);
    knee.start(&scales).unwrap();
    assert_eq!(bus.lock().motors()[0].mode(), Mode::Running);
    assert!((bus.lock().motors()[0].position() - 0.5).abs() < 0.01, "it did not move");
    let wanted = Impedance { position: 0.7, kp: 40.0, kd: 1.0, ..Impedance::default() };
    let mut position = 0.0;
    for _ in 0..300 {
        let state = Axis::new(&mut link, 3).control(&wanted, &scales).unwrap();
        [position, ..] = state.scaled(&scales);
        link.pause(Duration::from_millis(1));
    }
    assert!((position - 0.7).abs() < 0.05, "{position}");
    Axis::new(&mut link, 3).stop().unwrap();
    assert_eq!(bus.lock().motors()[0].mode(), Mode::Stopped);
    let infinite = Axis::new(&mut link, 3).control(&Impedance { torque: f32::INFINITY, ..wanted }, &scales);
    assert!(matches!(infinite, Err(Error::Protocol { id: 3, .. })));
}

#[test]
fn errors_are_read_and_cleared() {
    for (number, faults) in [("0x04", Faults::UNDER_VOLTAGE), ("0x08", Faults::MOTOR_OVER_TEMPERATURE)] {
        let (bus, mut link) = with(vec![node("knee", 3)]);
        inject(&bus, &link, &format!("knee fault {number}"));
        let mut knee = Axis::new(&mut link, 3);
        assert_eq!(knee.fault(), Ok(faults), "{number}");
        knee.clear_fault().unwrap();
        assert_eq!(knee.fault(), Ok(Faults::NONE), "{number}");
        assert_eq!(knee.supply().unwrap().map(|[volts, _]| volts), Some(48.0));
    }
}

/// Also behind a link that has listened, whose drivers answer no request of another family.
#[test]
fn survey_reports_node() {
    let (_bus, mut link) = with(vec![node("knee", 3)]);
    link.listen(Scan::default().listen).unwrap();
    let reported = survey(&mut link, 3, Question::Node, []).unwrap().unwrap().reported("knee", "can");
    assert_eq!((reported.protocol, reported.host_id), (ReportedProtocol::CanSimple, Some(0x068)));
    assert_eq!(survey(&mut link, 4, Question::Node, []).unwrap(), None);
}

#[test]
fn silent_node_is_an_error() {
    let (_bus, mut link) = with(vec![motor("hip", 4, Dialect::Mit)]);
    let mut absent = Axis::new(&mut link, 2);
    assert!(matches!(absent.stop(), Err(Error::Silent { id: 2, .. })));
    assert!(matches!(absent.estimates(), Err(Error::Silent { id: 2, .. })));
    assert!(matches!(absent.fault(), Err(Error::Silent { id: 2, .. })));
    assert_eq!(absent.supply(), Ok(None));
}

/// Each of two drivers with one node id reads the estimates of the other one as a request.
#[test]
fn two_nodes_with_one_id_are_not_alone() {
    let other = MotorSettings { initial_position: 0.9, ..node("other", 3) };
    let (_bus, mut link) = with(vec![node("knee", 3), node("ankle", 1), motor("hip", 4, Dialect::Mit)]);
    assert_eq!([3, 1, 7].map(|id| Axis::new(&mut link, id).is_alone().unwrap()), [true; 3]);
    let (_bus, mut link) = with(vec![node("knee", 3), other]);
    assert_eq!(Axis::new(&mut link, 3).is_alone(), Ok(false));
}
