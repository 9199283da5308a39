//! Finding motors.

use crate::{START, bus, inject, link, motor};
use motord_bus::{
    Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Readiness, Sent, Unsupported, VirtualClock,
};
use motord_checker::protocol::mit::Meaning;
use motord_checker::protocol::ranges::Ranges;
use motord_protocol::commissioning::{
    Error, Family, Formats, LASTING, LISTEN, Link, Progress, Scan, Unprompted, identify, is_taken, scan,
};
use motord_simulator::{Behaviour, Dialect, Direction, InFault, Medium, MotorSettings, SharedBus};

/// Motors on four CAN buses and on a serial line, half of them in MIT.
fn robot() -> Vec<(Medium, SharedBus)> {
    let dialect = |id: u16| if id.is_multiple_of(2) { Dialect::Mit } else { Dialect::Gim };
    let of = |medium, ids: [u16; 3]| {
        let motors = ids.map(|id| motor(&format!("m{id}"), id, dialect(id)));
        (medium, bus(medium, motors.into()))
    };
    vec![
        of(Medium::Can, [1, 2, 3]),
        of(Medium::Can, [4, 5, 6]),
        of(Medium::Can, [1, 0x7F, 0xFE]),
        of(Medium::Can, [10, 11, 12]),
        of(Medium::Serial, [7, 8, 9]),
    ]
}

/// Checks the frame as a motor in MIT mode decodes it, with the checker's codec, and by the first
/// byte as a native one does.
fn assert_harmless(bytes: [u8; 8]) {
    let ranges = Ranges::steadywin(225.0);
    let hex = u64::from_be_bytes(bytes);
    match Meaning::of(bytes, &ranges) {
        Meaning::Stop => {}
        Meaning::Control { kp, kd, torque, .. } => {
            assert_eq!((kp, kd), (0.0, 0.0), "{hex:016X}");
            assert!(torque.abs() <= ranges.codes().torque, "{hex:016X}: {torque}");
        }
        other => panic!("{hex:016X} is {other:?}"),
    }
    // GIM document, Table 4: retrieve configuration; 0xFF is none of its commands.
    assert!([0x84, 0xFF].contains(&bytes[0]), "{hex:016X}");
}

#[test]
fn scan_finds_every_motor_and_moves_none() {
    for (medium, bus) in robot() {
        let mut link = link(&bus, medium);
        let mut steps = 0;
        let report = scan(&mut link, &Scan::default(), &mut |Progress { .. }| {
            steps += 1;
            true
        });
        let report = report.unwrap();
        let expected: Vec<_> =
            bus.lock().motors().iter().map(|motor| motor.name()[1..].parse().unwrap()).collect();
        assert_eq!(report.found.iter().map(|found| found.id).collect::<Vec<u8>>(), expected);
        for found in &report.found {
            let in_mit = medium == Medium::Can && found.id % 2 == 0;
            assert_eq!(found.family, if in_mit { Family::Mit } else { Family::Native }, "{found:?}");
            assert_eq!(found.host_id.unwrap().raw(), 0x100 + u32::from(found.id), "{found:?}");
        }
        let lasting = if medium == Medium::Can { &LASTING[..] } else { &[] };
        assert_eq!((steps, &report.lasting[..]), (254, lasting));
        let mut frames = 0;
        for recorded in bus.lock().take_record().filter(|recorded| recorded.direction == Direction::ToMotor) {
            // Only the question for the device has 29 bits (RobStride, type 0).
            match recorded.frame.id() {
                id if id.is_extended() => assert_eq!(id.raw() >> 8, 0xFD, "{:?}", recorded.frame),
                // MyActuator's question for the status, at 0x140 + id: no motor here has such an id.
                id if id.raw() > 0xFF => assert_eq!(recorded.frame.payload()[0], 0x9A, "{id:?}"),
                _ => assert_harmless(recorded.frame.payload().try_into().unwrap()),
            }
            frames += 1;
        }
        assert!(frames >= steps);
        assert!(bus.lock().motors().iter().all(|motor| motor.last_executed().is_none()));
    }
}

#[test]
fn two_motors_with_one_id_are_detected() {
    let motor = |host_id, initial_position| {
        let name = format!("m{host_id:x}");
        MotorSettings { name, host_id, initial_position, ..motor("", 1, Dialect::Mit) }
    };
    let ids = Scan { ids: 1..=2, ..Scan::default() };
    let apart = bus(Medium::Can, vec![motor(0x101, 0.1), motor(0x102, 0.2)]);
    let mut over_can = link(&apart, Medium::Can);
    let report = scan(&mut over_can, &ids, &mut |_| true).unwrap();
    assert_eq!(report.found.len(), 2);
    let refused = identify(&mut over_can, 1).unwrap_err();
    assert!(refused.to_string().contains("several motors"), "{refused}");

    let mut same = [motor(0x101, 0.1), motor(0x101, 0.2)];
    same[1].name = "other".into();
    let report = scan(&mut link(&bus(Medium::Can, same.into()), Medium::Can), &ids, &mut |_| true).unwrap();
    assert_eq!(report.collisions, [1]);
}

#[test]
fn silent_faulty_motor_is_found_by_fault_question() {
    for (in_fault, behaviour, found) in
        [(false, InFault::Silent, 0), (true, InFault::Silent, 1), (false, InFault::Refuses, 1)]
    {
        let behaviour = Behaviour { in_fault: behaviour, ..Behaviour::default() };
        let knee = MotorSettings { behaviour, ..motor("knee", 3, Dialect::Gim) };
        let bus = bus(Medium::Can, vec![knee]);
        let mut link = link(&bus, Medium::Can);
        inject(&bus, &link, "knee fault 2");
        let scan_settings = Scan { ids: 1..=5, in_fault, ..Scan::default() };
        let report = scan(&mut link, &scan_settings, &mut |_| true).unwrap();
        assert_eq!(report.found.len(), found, "{in_fault} {behaviour:?}");
        assert!(report.found.iter().all(|found| found.family == Family::Native));
    }
}

#[test]
fn nothing_is_sent_on_a_busy_bus() {
    let bus = bus(Medium::Can, vec![motor("knee", 3, Dialect::Gim)]);
    let mut link = link(&bus, Medium::Can);
    inject(&bus, &link, "can0 flood 1000");
    let refused = scan(&mut link, &Scan::default(), &mut |_| true);
    assert!(matches!(refused, Err(Error::InUse { .. })), "{refused:?}");
    let to_motor = bus.lock().take_record().filter(|frame| frame.direction == Direction::ToMotor).count();
    assert_eq!(to_motor, 0);
}

/// A bus with an ODrive beside its motors. It reports its encoder every 10 ms without a request,
/// and its axis every second while its heartbeat is on.
struct BesideOdrive {
    bus: SharedBus,
    node: u16,
    heartbeat: bool,
    reports: u64,
}

impl BesideOdrive {
    fn next_report(&self) -> Instant {
        START + Duration::from_millis(10 * self.reports + 5)
    }
}

impl Bus for BesideOdrive {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.bus.send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        while self.next_report() <= now {
            let (command, payload) = match self.reports % 100 {
                90 if self.heartbeat => (0x01, [0, 0, 0, 0, 8, 0, 0, 0]),
                _ => (0x09, [0, 0, 0x80, 0x3F, 0, 0, 0, 0]),
            };
            let report = Frame::classic(FrameId::new(self.node << 5 | command).unwrap(), payload);
            self.bus.lock().deliver(self.next_report(), Content::Frame(report));
            self.reports += 1;
        }
        self.bus.receive(now, inbox);
    }

    fn readiness(&self) -> Readiness<'_> {
        match self.bus.readiness() {
            Readiness::At(arrival) => Readiness::At(arrival.min(self.next_report())),
            _ => Readiness::At(self.next_report()),
        }
    }
}

/// Two motors beside an ODrive.
fn beside_odrive(node: u16) -> (SharedBus, Link) {
    beside_odrive_with(node, true)
}

fn beside_odrive_with(node: u16, heartbeat: bool) -> (SharedBus, Link) {
    let bus = bus(Medium::Can, vec![motor("knee", 40, Dialect::Mit), motor("hip", 41, Dialect::Gim)]);
    let beside = BesideOdrive { bus: bus.clone(), node, heartbeat, reports: 0 };
    (bus, Link::can(beside, VirtualClock::new(START)))
}

fn sent(bus: &SharedBus) -> Vec<u32> {
    let mut bus = bus.lock();
    let to_motor = bus.take_record().filter(|recorded| recorded.direction == Direction::ToMotor);
    to_motor.map(|recorded| recorded.frame.id().raw()).collect()
}

#[test]
fn odrive_is_named_and_neither_asked_nor_counted() {
    let (bus, mut link) = beside_odrive(0);
    let report = scan(&mut link, &Scan { ids: 1..=50, ..Scan::default() }, &mut |_| true).unwrap();
    assert_eq!(report.unprompted, [Unprompted::CanSimple { node: 0 }]);
    assert_eq!(report.found.iter().map(|found| found.id).collect::<Vec<_>>(), [40, 41]);
    assert_eq!((report.collisions.len(), report.skipped.len()), (0, 31));
    assert!(sent(&bus).iter().all(|id| *id >= 32), "its commands begin with id 0");
}

/// Goal: a CANSimple driver whose heartbeat is off is recognised by its encoder estimates (command
/// 0x009, every 10 ms).
#[test]
fn driver_without_heartbeat_is_named_and_not_asked() {
    for node in [0, 1] {
        let (bus, mut link) = beside_odrive_with(node, false);
        let report = scan(&mut link, &Scan { ids: 1..=50, ..Scan::default() }, &mut |_| true).unwrap();
        assert_eq!(report.unprompted, [Unprompted::CanSimple { node: node as u8 }]);
        assert!(sent(&bus).iter().all(|id| id >> 5 != u32::from(node)), "{:?}", report.skipped);
    }
}

#[test]
fn obeyed_ids_are_asked_on_request_only() {
    for obeyed in [false, true] {
        let (bus, mut link) = beside_odrive(0);
        let wanted = Scan { ids: 1..=0x3F, obeyed, ..Scan::default() };
        let report = scan(&mut link, &wanted, &mut |_| true).unwrap();
        assert_eq!((report.skipped.is_empty(), report.lasting.is_empty()), (obeyed, obeyed));
        let sent = sent(&bus);
        assert!([6, 0x1F, 0x3F].iter().all(|id| sent.contains(id) == obeyed), "{obeyed}");
        assert!(sent.contains(&40));
    }
}

#[test]
fn report_of_odrive_is_no_answer_to_ping() {
    for (id, expected) in [(40, Some(Family::Mit)), (41, Some(Family::Native)), (42, None)] {
        let (_bus, mut link) = beside_odrive(3);
        assert_eq!(identify(&mut link, id).unwrap().map(|found| found.family), expected, "{id}");
    }
}

#[test]
fn id_that_an_odrive_obeys_is_refused() {
    let (bus, mut link) = beside_odrive(0);
    link.listen(LISTEN).unwrap();
    for refused in [identify(&mut link, 6).map(drop), is_taken(&mut link, 6).map(drop)] {
        assert!(refused.unwrap_err().to_string().contains("CANSimple"));
    }
    assert_eq!(sent(&bus), []);
}

#[test]
fn ids_that_command_other_drivers_are_not_asked() {
    let bus = bus(Medium::Can, vec![motor("knee", 40, Dialect::Gim)]);
    let mut link = link(&bus, Medium::Can);
    let heartbeat = Frame::classic(FrameId::new(0x001).unwrap(), [0; 8]);
    bus.lock().deliver(START + Duration::from_millis(100), Content::Frame(heartbeat));
    let report = scan(&mut link, &Scan { ids: 1..=50, ..Scan::default() }, &mut |_| true).unwrap();
    assert_eq!(report.skipped, (1..32).collect::<Vec<u8>>());
    assert_eq!(report.found.len(), 1);
}

/// A bus on which id 50 is answered in CAN FD format, and id 51 with a 29-bit id. If it `reports`,
/// a frame with a 29-bit id arrives before each read.
struct OtherFormats {
    bus: SharedBus,
    reports: bool,
}

impl Bus for OtherFormats {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        for frame in frames {
            let answer = match frame.id().raw() {
                50 => Unsupported::Fd,
                51 => Unsupported::Extended,
                _ => continue,
            };
            self.bus.lock().deliver(now + Duration::from_micros(300), Content::Unsupported(answer));
        }
        self.bus.send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        if self.reports {
            self.bus.lock().deliver(now, Content::Unsupported(Unsupported::Extended));
        }
        self.bus.receive(now, inbox);
    }

    fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }
}

/// Goal: an answer in a format that motord does not use is named, and is no silence.
#[test]
fn answers_in_other_formats_are_named() {
    let bus = bus(Medium::Can, vec![motor("knee", 40, Dialect::Mit)]);
    let mut link = Link::can(OtherFormats { bus, reports: false }, VirtualClock::new(START));
    let report = scan(&mut link, &Scan { ids: 38..=60, ..Scan::default() }, &mut |_| true).unwrap();
    assert_eq!(report.found.iter().map(|found| found.id).collect::<Vec<_>>(), [40]);
    // Each silent id is asked twice.
    let of = |fd, extended| Formats { fd, extended, ..Formats::default() };
    let expected = [(50, of(2, 0)), (51, of(0, 2))];
    assert_eq!((report.formats, report.unasked_formats), (expected.to_vec(), Formats::default()));
    assert!(expected[0].1.advice().any(|advice| advice.contains("CAN FD")));
    assert!(expected[1].1.advice().any(|advice| advice.contains("29-bit")));
    assert_eq!(identify(&mut link, 50), Ok(None));
    assert!(link.formats().fd > 2);
}

/// Goal: a motor that reports unasked with 29-bit ids is no answer of every id.
#[test]
fn unasked_frames_of_other_formats_name_no_id() {
    let bus = bus(Medium::Can, vec![motor("knee", 40, Dialect::Mit)]);
    let mut link = Link::can(OtherFormats { bus, reports: true }, VirtualClock::new(START));
    let report = scan(&mut link, &Scan { ids: 38..=60, ..Scan::default() }, &mut |_| true).unwrap();
    assert_eq!(report.found.len(), 1);
    assert!(report.unasked_formats.extended > 0 && report.formats.is_empty(), "{report:?}");
}
