//! RobStride motors in their private protocol.

use crate::{bus, inject, link, motor};
use motord_bus::{Duration, FrameId};
use motord_protocol::Faults;
use motord_protocol::commissioning::{
    Error, Family, LASTING, Link, Mit, Private, Question, ReportedProtocol, Scan, identify, is_taken, scan,
    survey,
};
use motord_protocol::profile::ROBSTRIDE;
use motord_protocol::robstride::{WideScales, parameter};
use motord_protocol::{Model, Scales};
use motord_simulator::{Dialect, Direction, Medium, Mode, MotorSettings, SharedBus};

fn scales() -> Scales {
    Model::by_name("RS02").unwrap().scales().unwrap()
}

fn robstride(name: &str, id: u16, dialect: Dialect) -> MotorSettings {
    MotorSettings {
        vendor: "robstride",
        host_id: if dialect == Dialect::RobStride { 0xFD } else { 0x40 + id },
        ends: Some([12.57, 44.0, 17.0]),
        initial_position: 0.5,
        ..motor(name, id, dialect)
    }
}

fn factory(name: &str) -> MotorSettings {
    MotorSettings { is_new: true, ..robstride(name, 9, Dialect::Mit) }
}

fn with(motors: Vec<MotorSettings>) -> (SharedBus, Link) {
    let bus = bus(Medium::Can, motors);
    let link = link(&bus, Medium::Can);
    (bus, link)
}

/// Goal: a scan names motors of each protocol on one bus, and changes none. Method: two RobStride
/// motors, one of them at an id that is left out for CANSimple drivers, and SteadyWin's.
#[test]
fn scan_names_private_motors_beside_others() {
    let (bus, mut link) = with(vec![
        factory("new"),
        robstride("set", 3, Dialect::Mit),
        motor("hip", 4, Dialect::Mit),
        motor("knee", 5, Dialect::Gim),
        robstride("foot", u16::from(LASTING[0]), Dialect::RobStride),
    ]);
    let memory =
        |bus: &SharedBus| bus.lock().motors().iter().map(motord_simulator::Motor::memory).collect::<Vec<_>>();
    let before = memory(&bus);
    let report = scan(&mut link, &Scan::default(), &mut |_| true).unwrap();
    let found: Vec<_> = report.found.iter().map(|found| (found.id, found.family)).collect();
    let serial = |id: u8| {
        report.found.iter().find_map(|found| match found.family {
            Family::RobStride { serial } if found.id == id => Some(serial),
            _ => None,
        })
    };
    assert!(serial(1).is_some() && serial(0x1E).is_some() && serial(1) != serial(0x1E), "{found:?}");
    let others = [(3, Family::OtherMit { length: 8 }), (4, Family::Mit), (5, Family::Native)];
    assert_eq!((&found[1..4], found.len()), (&others[..], 5));
    assert_eq!(report.found[0].host_id, Some(FrameId::from(0xFD)));
    assert_eq!((memory(&bus), report.unasked_formats.is_any()), (before, false));
    assert!(bus.lock().motors().iter().all(|motor| motor.mode() == Mode::Stopped));
    let mut bus = bus.lock();
    let sent = bus.take_record().filter(|sent| sent.direction == Direction::ToMotor);
    // A question for the device, or for the parameter of the host id.
    let is_harmless = |id: u32| matches!(id >> 24, 0 | 0x11);
    let private: Vec<_> = sent.map(|sent| sent.frame.id()).filter(|id| id.is_extended()).collect();
    assert!(private.len() > 100 && private.iter().all(|id| is_harmless(id.raw())), "{private:?}");
}

#[test]
fn two_private_motors_with_one_id_are_detected() {
    let (_bus, mut link) = with(vec![factory("one"), factory("other")]);
    let report = scan(&mut link, &Scan { ids: 1..=2, ..Scan::default() }, &mut |_| true).unwrap();
    assert!(report.found.len() == 2 || report.collisions == [1], "{report:?}");
    assert!(identify(&mut link, 1).is_err());
}

#[test]
fn new_id_is_confirmed_and_lasts() {
    let (bus, mut link) = with(vec![factory("new"), robstride("knee", 3, Dialect::RobStride)]);
    assert_eq!(is_taken(&mut link, 3), Ok(true));
    assert_eq!(is_taken(&mut link, 7), Ok(false));
    let mut motor = Private::new(&mut link, 1);
    motor.set_id(7).unwrap();
    assert!(motor.stop().is_ok());
    inject(&bus, &link, "new power-cycle");
    link.pause(Duration::from_millis(400));
    assert_eq!(identify(&mut link, 1), Ok(None));
    assert!(matches!(identify(&mut link, 7), Ok(Some(_))));
    let silent = Private::new(&mut link, 20).set_id(21).unwrap_err();
    assert!(matches!(silent, Error::Unconfirmed { id: 21, .. }), "{silent}");
}

#[test]
fn protocol_changes_to_mit_and_back() {
    let (bus, mut link) = with(vec![factory("new")]);
    Private::new(&mut link, 1).change_to_mit().unwrap();
    let before = identify(&mut link, 1).unwrap().unwrap();
    assert!(matches!(before.family, Family::RobStride { .. }), "it changes with the next power-on");
    inject(&bus, &link, "new power-cycle");
    link.pause(Duration::from_millis(400));
    let found = identify(&mut link, 1).unwrap().unwrap();
    assert_eq!(found.family, Family::OtherMit { length: 8 });
    Mit::new(&mut link, 1, found.host_id, scales()).with_profile(&ROBSTRIDE).change_to_private().unwrap();
    inject(&bus, &link, "new power-cycle");
    link.pause(Duration::from_millis(400));
    assert!(matches!(identify(&mut link, 1).unwrap().unwrap().family, Family::RobStride { .. }));
}

#[test]
fn zero_and_timeout_are_stored() {
    let (bus, mut link) = with(vec![robstride("knee", 3, Dialect::RobStride)]);
    let wide = WideScales::of(&scales());
    let mut knee = Private::new(&mut link, 3);
    let [before, ..] = knee.stop().unwrap().scaled(&wide);
    let [after, ..] = knee.set_zero().unwrap().scaled(&wide);
    assert!((before - 0.5).abs() < 1e-3 && after.abs() < 1e-3, "{before} {after}");
    assert_eq!(knee.read(parameter::TIMEOUT), Ok(Some([0; 4])));
    knee.store("canTimeout", parameter::TIMEOUT, 4000).unwrap();
    inject(&bus, &link, "knee power-cycle");
    link.pause(Duration::from_millis(400));
    let mut knee = Private::new(&mut link, 3);
    assert_eq!(knee.read(parameter::TIMEOUT), Ok(Some(4000_u32.to_le_bytes())));
    assert_eq!(knee.read(0x7FFF), Ok(None));
    assert_eq!(knee.version(), Ok(Some([0, 1, 2, 3])));
    let unknown = knee.store("nothing", 0x7FFF, 1).unwrap_err();
    assert!(matches!(unknown, Error::Unconfirmed { .. }), "{unknown}");
}

/// An over-voltage is in the fault register only.
#[test]
fn faults_are_read_and_cleared() {
    for (number, faults) in [("0x04", Faults::UNDER_VOLTAGE), ("0x08", Faults::OVER_VOLTAGE)] {
        let (bus, mut link) = with(vec![robstride("knee", 3, Dialect::RobStride)]);
        inject(&bus, &link, &format!("knee fault {number}"));
        let mut knee = Private::new(&mut link, 3);
        assert_eq!(knee.fault(), Ok(faults), "{number}");
        knee.clear_fault().unwrap();
        assert_eq!(knee.fault(), Ok(Faults::NONE), "{number}");
    }
}

#[test]
fn survey_reports_private_protocol() {
    let (_bus, mut link) = with(vec![robstride("knee", 3, Dialect::RobStride)]);
    let reported = survey(&mut link, 3, Question::Both, []).unwrap().unwrap().reported("knee", "can");
    assert_eq!((reported.protocol, reported.host_id), (ReportedProtocol::RobStride, Some(0xFD)));
    let found = survey(&mut link, 3, Question::PrivateFirst, []).unwrap().unwrap().found;
    assert!(matches!(found.family, Family::RobStride { .. }));
    assert_eq!(survey(&mut link, 4, Question::PrivateFirst, []).unwrap(), None);
}

#[test]
fn silent_private_motor_is_an_error() {
    let (_bus, mut link) = with(vec![motor("hip", 4, Dialect::Mit)]);
    let mut absent = Private::new(&mut link, 4);
    assert!(matches!(absent.stop(), Err(Error::Silent { id: 4, .. })));
    assert!(matches!(absent.change_to_mit(), Err(Error::Silent { id: 4, .. })));
    assert_eq!((absent.version(), absent.read(parameter::HOST)), (Ok(None), Ok(None)));
}
