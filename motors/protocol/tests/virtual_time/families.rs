//! A scan of one bus with a motor of each family, beside frames of other nodes.

use crate::{START, bus, motor};
use motord_bus::{
    Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Readiness, Sent, Unsupported, VirtualClock,
};
use motord_checker::protocol::Protocol;
use motord_checker::protocol::mit::{Meaning, ReplyFormat};
use motord_checker::protocol::ranges::Ranges;
use motord_protocol::commissioning::{Family, LISTEN, Link, Report, Scan, scan};
use motord_simulator::{Dialect, Direction, Medium, Mode, Motor, MotorSettings, SharedBus};

/// Name, id and protocol of each motor. A scan leaves out the ids 30 and 31 of MIT motors.
const MOTORS: [(&str, u16, &str); 7] = [
    ("native", 3, "gim"),
    ("mit", 4, "mit"),
    ("damiao", 5, "mit"),
    ("ak", 6, "mit"),
    ("node", 9, "cansimple"),
    ("rmd", 30, "myactuator"),
    ("private", 31, "robstride"),
];

fn settings((name, id, protocol): (&str, u16, &str)) -> MotorSettings {
    let general = MotorSettings {
        initial_position: 0.1 * f64::from(id),
        ..motor(name, id, Dialect::by_name(protocol).unwrap())
    };
    let (vendor, host_id, ends) = match name {
        "damiao" => ("damiao", 0x10 + id, [12.5, 30.0, 10.0]),
        "ak" => ("cubemars", 0, [12.5, 50.0, 18.0]),
        "rmd" => ("myactuator", 0, [12.5, 45.0, 24.0]),
        "private" => ("robstride", 0xFD, [12.57, 44.0, 17.0]),
        _ => return general,
    };
    MotorSettings { vendor, host_id, ends: Some(ends), ..general }
}

/// Other nodes. From the beginning they send frames with 29-bit ids and in CAN FD format, and after
/// the scan has listened also frames like answers in MIT, one every 2 ms.
struct Noise {
    bus: SharedBus,
    frames: u64,
}

const NOISE: [u16; 2] = [0x6F1, 0x7A0];
const PERIOD: Duration = Duration::from_millis(2);

impl Noise {
    fn next(&self) -> Instant {
        START + PERIOD * self.frames as u32
    }

    fn content(&self) -> Content {
        let bytes = [self.frames as u8, 0x7F, 0xFF, 0x7F, 0xF7, 0xFF, 25, 0];
        let id = FrameId::new(NOISE[usize::from(self.frames.is_multiple_of(2))]).unwrap();
        match self.frames % 5 {
            0 => Content::Unsupported(Unsupported::Fd),
            1 => Content::Frame(Frame::classic(FrameId::extended(0x18FE_F1FD).unwrap(), bytes)),
            _ if self.next() <= START + LISTEN => {
                Content::Frame(Frame::classic(FrameId::extended(0x0CF0_04FD).unwrap(), bytes))
            }
            2 => Content::Frame(Frame::new(id, &bytes[..6]).unwrap()),
            _ => Content::Frame(Frame::classic(id, bytes)),
        }
    }
}

impl Bus for Noise {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.bus.send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        while self.next() <= now {
            self.bus.lock().deliver(self.next(), self.content());
            self.frames += 1;
        }
        self.bus.receive(now, inbox);
    }

    fn readiness(&self) -> Readiness<'_> {
        match self.bus.readiness() {
            Readiness::At(arrival) => Readiness::At(arrival.min(self.next())),
            _ => Readiness::At(self.next()),
        }
    }
}

/// The parts of a motor that no scan may change.
fn state(motor: &Motor) -> (String, u32, Mode, Option<Frame>, f64) {
    let executed = motor.last_executed().map(|(_, frame)| frame);
    (motor.memory(), motor.memory_revision(), motor.mode(), executed, motor.position())
}

fn states(bus: &SharedBus) -> Vec<(String, u32, Mode, Option<Frame>, f64)> {
    bus.lock().motors().iter().map(state).collect()
}

/// Returns the report of a scan that has changed no motor.
fn scanned(bus: &SharedBus, noise: bool) -> Report {
    let before = states(bus);
    let clock = VirtualClock::new(START);
    let mut link = match noise {
        true => Link::can(Noise { bus: bus.clone(), frames: 1 }, clock),
        false => Link::can(bus.clone(), clock),
    };
    let report = scan(&mut link, &Scan::default(), &mut |_| true).unwrap();
    assert_eq!(states(bus), before);
    report
}

/// Returns whether a motor reads a frame as a command.
fn is_to(frame: &Frame, id: u16, protocol: &Protocol) -> bool {
    let (raw, id) = (frame.id().raw(), u32::from(id));
    match protocol {
        Protocol::RobStride(_) => frame.id().is_extended() && raw & 0xFF == id,
        _ if frame.id().is_extended() => false,
        Protocol::Mit(_) | Protocol::Native => raw == id,
        Protocol::CanSimple(_) | Protocol::Odrive(_) => raw >> 5 == id,
        Protocol::MyActuator(_) => [0x140 + id, 0x400 + id, 0x280, 0x300].contains(&raw),
    }
}

/// Checks a frame to a motor with the checker's codec.
fn assert_harmless(frame: &Frame, protocol: &Protocol) {
    let meaning = protocol.order(frame);
    let is_harmless = match protocol {
        Protocol::Mit(_) => meaning == Meaning::Stop,
        // GIM document, table 4: 0x84 reads the configuration; 0xFF is none of its commands.
        Protocol::Native => matches!(meaning, Meaning::Other(0x84 | 0xFF)),
        // The questions for the device and for a parameter.
        Protocol::RobStride(_) => matches!(meaning, Meaning::Other(0 | 17)),
        Protocol::CanSimple(_) | Protocol::Odrive(_) => false,
        Protocol::MyActuator(_) => matches!(meaning, Meaning::GetFault | Meaning::GetIndicator),
    };
    assert!(is_harmless, "{frame:?} is {meaning:?} to {protocol:?}");
}

fn assert_found(report: &Report) {
    let mut found: Vec<_> = report.found.iter().map(|found| (found.id, found.family)).collect();
    found.sort_by_key(|(id, _)| *id);
    let expected = [
        (3, Family::Native),
        (4, Family::Mit),
        (5, Family::OtherMit { length: 8 }),
        (6, Family::OtherMit { length: 8 }),
        (9, Family::CanSimple),
        (30, Family::MyActuator),
    ];
    assert_eq!(found[..6], expected);
    assert!(matches!(found[6..], [(31, Family::RobStride { .. })]), "{found:?}");
    assert_eq!(report.collisions, []);
}

#[test]
fn scan_names_every_family_and_changes_none() {
    let bus = bus(Medium::Can, MOTORS.map(settings).into());
    let report = scanned(&bus, false);
    assert_found(&report);
    assert!(report.unasked.is_empty() && !report.unasked_formats.is_any(), "{report:?}");
    let ranges = Ranges::steadywin(225.0);
    let mut counts = [0; MOTORS.len()];
    for sent in bus.lock().take_record().filter(|sent| sent.direction == Direction::ToMotor) {
        for (count, (_, id, protocol)) in counts.iter_mut().zip(MOTORS) {
            let protocol = Protocol::named(protocol, ranges, ReplyFormat::STEADYWIN);
            if is_to(&sent.frame, id, &protocol) {
                assert_harmless(&sent.frame, &protocol);
                *count += 1;
            }
        }
    }
    assert!(counts.iter().zip(MOTORS).all(|(count, (.., name))| (*count == 0) == (name == "cansimple")));
}

/// Every other node's frame in MIT's form would be the answer of some id.
#[test]
fn frames_of_other_nodes_are_no_motors() {
    let bus = bus(Medium::Can, MOTORS.map(settings).into());
    let report = scanned(&bus, true);
    assert_found(&report);
    let mut unasked: Vec<u32> = report.unasked.iter().map(|id| id.raw()).collect();
    unasked.sort_unstable();
    assert_eq!(unasked, NOISE.map(u32::from));
    assert!(report.unasked_formats.fd > 0 && report.unasked_formats.extended > 0);
}

/// Node 1 obeys the ids 32 to 63 of MIT motors, and none of MyActuator's.
#[test]
fn ids_of_nodes_are_asked_for_other_families() {
    let motors = [("node", 1, "cansimple"), ("rmd", 32, "myactuator"), ("private", 33, "robstride")];
    let bus = bus(Medium::Can, motors.map(settings).into());
    let report = scanned(&bus, false);
    let ids: Vec<u8> = report.found.iter().map(|found| found.id).collect();
    assert_eq!((ids, report.skipped.len()), (vec![1, 32, 33], 32));
}

/// New motors of all vendors have the id 1.
#[test]
fn motors_of_several_families_may_share_an_id() {
    let motors = [("mit", 1, "mit"), ("rmd", 1, "myactuator"), ("private", 1, "robstride")];
    let bus = bus(Medium::Can, motors.map(settings).into());
    let found = scanned(&bus, false).found;
    assert_eq!(found.iter().map(|found| found.id).collect::<Vec<_>>(), [1, 1, 1]);
    assert!(found.iter().any(|found| found.family == Family::MyActuator));
}

/// Goal: two motors are found by their angles, when temperature and voltage are equal.
#[test]
fn equal_states_do_not_hide_a_motor() {
    let second = MotorSettings { name: "other".into(), initial_position: 0.7, ..settings(MOTORS[5]) };
    let bus = bus(Medium::Can, vec![settings(MOTORS[5]), second]);
    let report = scanned(&bus, false);
    assert!(report.found.len() == 2 || report.collisions == [30], "{report:?}");
}
