//! MyActuator motors.

use crate::{bus, inject, link, motor};
use motord_bus::FrameId;
use motord_protocol::commissioning::{
    Error, Family, Link, Question, ReportedProtocol, Rmd, Scan, identify_by, scan, survey,
};
use motord_protocol::mit::Impedance;
use motord_protocol::{Ends, Faults, Scales};
use motord_simulator::{Dialect, Direction, Medium, Mode, MotorSettings, SharedBus};

fn rmd(name: &str, id: u16) -> MotorSettings {
    MotorSettings {
        initial_position: 0.5,
        vendor: "myactuator",
        ends: Some([12.5, 45.0, 24.0]),
        ..motor(name, id, Dialect::MyActuator)
    }
}

fn with(motors: Vec<MotorSettings>) -> (SharedBus, Link) {
    let bus = bus(Medium::Can, motors);
    let link = link(&bus, Medium::Can);
    (bus, link)
}

fn scales() -> Scales {
    Scales::of(&Ends::new(12.5, 45.0, 24.0))
}

/// Goal: a scan names the motors, moves none, and sends none an impedance. Method: two of them beside a
/// motor in MIT.
#[test]
fn scan_names_motors_and_moves_none() {
    let (bus, mut link) = with(vec![rmd("knee", 3), rmd("ankle", 32), motor("hip", 4, Dialect::Mit)]);
    let report = scan(&mut link, &Scan::default(), &mut |_| true).unwrap();
    let found: Vec<_> = report.found.iter().map(|found| (found.id, found.family, found.host_id)).collect();
    let host = |raw| FrameId::new(raw);
    assert_eq!(found[0], (3, Family::MyActuator, host(0x503)));
    assert_eq!((found[1].0, found[1].1), (4, Family::Mit));
    assert_eq!(found[2], (32, Family::MyActuator, host(0x520)));
    let mut bus = bus.lock();
    let sent: Vec<_> = bus.take_record().filter(|sent| sent.direction == Direction::ToMotor).collect();
    assert!(sent.iter().all(|sent| sent.frame.id().is_extended() || sent.frame.id().raw() < 0x400));
    assert!(bus.motors().iter().all(|motor| motor.mode() == Mode::Stopped));
}

/// Node 10 of CANSimple obeys 0x140 to 0x15F: 0x142 is its emergency stop, 0x146 its node id.
#[test]
fn reporting_node_is_not_asked_for_a_status() {
    let node = motor("node", 10, Dialect::CanSimple);
    let (bus, mut link) = with(vec![node]);
    let report = scan(&mut link, &Scan::default(), &mut |_| true).unwrap();
    assert_eq!(report.found.len(), 1);
    let mut bus = bus.lock();
    let sent = bus.take_record().filter(|sent| sent.direction == Direction::ToMotor);
    let ids: Vec<u32> =
        sent.map(|sent| sent.frame.id()).filter(|id| !id.is_extended()).map(FrameId::raw).collect();
    assert!(ids.iter().all(|id| id >> 5 != 10), "{ids:X?}");
}

#[test]
fn two_motors_with_one_id_are_found() {
    // Equal answers are one frame on the wire.
    let (bus, mut link) = with(vec![rmd("knee", 3), rmd("ankle", 3)]);
    inject(&bus, &link, "knee temperature 40");
    let report = scan(&mut link, &Scan { ids: 3..=3, ..Scan::default() }, &mut |_| true).unwrap();
    assert!(report.found.len() == 2 || report.collisions == [3], "{report:?}");
}

#[test]
fn zero_acts_after_the_restart() {
    let (bus, mut link) = with(vec![rmd("knee", 3), motor("hip", 4, Dialect::Mit)]);
    let mut knee = Rmd::new(&mut link, 3);
    knee.stop().unwrap();
    assert!((knee.angle().unwrap() - 0.5).abs() < 1e-3);
    assert!(knee.set_zero().unwrap().abs() < 1e-3);
    assert!(bus.lock().motors()[0].position().abs() < 1e-3);
}

#[test]
fn new_id_is_confirmed_after_the_restart() {
    let (_bus, mut link) = with(vec![rmd("knee", 3), motor("hip", 4, Dialect::Mit)]);
    let mut knee = Rmd::new(&mut link, 3);
    knee.stop().unwrap();
    knee.set_id(7).unwrap();
    assert_eq!(identify_by(&mut link, 3, Question::MotorStatus), Ok(None));
    assert!(matches!(identify_by(&mut link, 7, Question::MotorStatus), Ok(Some(_))));
    assert_eq!(identify_by(&mut link, 33, Question::MotorStatus), Ok(None));
}

#[test]
fn motor_starts_neutral_follows_and_stops() {
    let (bus, mut link) = with(vec![rmd("knee", 3)]);
    let mut knee = Rmd::new(&mut link, 3);
    let [at, ..] = knee.start(&scales()).unwrap().scaled(&scales());
    assert!((at - 0.5).abs() < 1e-3, "{at}");
    let wanted = Impedance { position: 0.6, kp: 40.0, kd: 1.0, ..Impedance::default() };
    for _ in 0..300 {
        Rmd::new(&mut link, 3).control(&wanted, &scales()).unwrap();
        link.pause(motord_bus::Duration::from_millis(1));
    }
    assert!((bus.lock().motors()[0].position() - 0.6).abs() < 0.05);
    Rmd::new(&mut link, 3).stop().unwrap();
    assert_eq!(bus.lock().motors()[0].mode(), Mode::Stopped);
    let infinite = Impedance { torque: f32::INFINITY, ..wanted };
    let refused = Rmd::new(&mut link, 3).control(&infinite, &scales());
    assert!(matches!(refused, Err(Error::Protocol { id: 3, .. })));
}

#[test]
fn motor_with_error_is_not_started() {
    let (bus, mut link) = with(vec![rmd("knee", 3)]);
    inject(&bus, &link, "knee fault 0x04");
    let mut knee = Rmd::new(&mut link, 3);
    assert!(matches!(knee.start(&scales()), Err(Error::Protocol { id: 3, .. })));
    assert_eq!(knee.fault(), Ok(Faults::UNDER_VOLTAGE));
    knee.clear_fault().unwrap();
    assert_eq!(knee.fault(), Ok(Faults::NONE));
    assert!(bus.lock().motors()[0].last_executed().is_none());
}

#[test]
fn survey_reports_motor() {
    let (_bus, mut link) = with(vec![rmd("knee", 3)]);
    let reported = survey(&mut link, 3, Question::MotorStatus, []).unwrap().unwrap().reported("knee", "can");
    assert_eq!((reported.protocol, reported.host_id), (ReportedProtocol::MyActuator, Some(0x503)));
    assert_eq!(survey(&mut link, 4, Question::MotorStatus, []).unwrap(), None);
    assert_eq!(Rmd::new(&mut link, 3).version(), Ok(0x0001_0203));
    assert!(matches!(Rmd::new(&mut link, 4).version(), Err(Error::Silent { id: 4, .. })));
}
