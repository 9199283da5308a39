//! Transactions with simulated motors, on virtual time: native on CAN, MIT on CAN, native on a serial line.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use motord_bus::{Duration, Instant};
use motord_checker::codec::{Meaning, Ranges};
use motord_commissioning::{
    Apply, CALIBRATION_MAX, Confirmation, Error, Event, Failed, Family, Link, Mit, Native, Progress, Scan,
    VirtualTime, changes, identify, is_taken, scan,
};
use motord_protocol::gim::{
    Access, CONFIGURATION, Calibration, ConfigurationItem, ExecutionTime, Finite, INDICATORS, PARAMETERS,
    Refusal, Value,
};
use motord_protocol::{Faults, Scales};
use motord_simulator::{
    Behaviour, BusKind, BusSettings, Dialect, Direction, FaultVerb, InFault, Mode, MotorSettings, SharedBus,
    SimulatedBus,
};

const START: Instant = Instant::from_nanos(1_000_000_000);
const SECOND: ExecutionTime = ExecutionTime::from_millis(1000).unwrap();

fn motor(name: &str, id: u16, dialect: Dialect) -> MotorSettings {
    MotorSettings { name: name.into(), id, host_id: 0x100 + id, dialect, ..MotorSettings::default() }
}

fn bus(kind: BusKind, motors: Vec<MotorSettings>) -> SharedBus {
    let bitrate = if kind == BusKind::Can { 1_000_000 } else { 921_600 };
    let settings = BusSettings { kind, bitrate, record: 100_000, ..BusSettings::default() };
    SharedBus::new(SimulatedBus::new(settings, motors, 7))
}

fn link(bus: &SharedBus, kind: BusKind) -> Link {
    match kind {
        BusKind::Can => Link::can(bus.clone(), VirtualTime::new(START)),
        BusKind::Serial => Link::serial(bus.clone(), VirtualTime::new(START)),
    }
}

/// One native motor, on both kinds of wire.
fn on_both_wires(test: impl Fn(&SharedBus, &mut Link)) {
    for kind in [BusKind::Can, BusKind::Serial] {
        let bus = bus(kind, vec![motor("knee", 3, Dialect::Gim)]);
        let mut link = link(&bus, kind);
        test(&bus, &mut link);
    }
}

fn mode(bus: &SharedBus) -> Mode {
    bus.lock().motors()[0].mode()
}

fn inject(bus: &SharedBus, link: &Link, verb: &str) {
    let verb: FaultVerb = verb.parse().unwrap();
    bus.lock().inject(link.now(), &verb).unwrap();
}

#[test]
fn every_readable_value_is_read_on_both_wires() {
    on_both_wires(|_, link| {
        let mut knee = Native::new(link, 3, None);
        for item in &CONFIGURATION {
            let value = knee.configuration(item.key()).unwrap();
            assert_eq!(value.value_type(), item.value_type, "{}", item.name);
        }
        for parameter in &PARAMETERS {
            knee.parameter(parameter.id).unwrap();
        }
        for indicator in &INDICATORS {
            assert!(knee.indicator(indicator.id).unwrap().is_finite(), "{}", indicator.name);
        }
        assert_eq!(knee.version().unwrap(), 0x0001_0203);
    });
}

#[test]
fn every_writable_value_round_trips_on_both_wires() {
    on_both_wires(|_, link| {
        let mut knee = Native::new(link, 3, None);
        // The items that change the link have tests of their own.
        let is_link = |name: &str| ["can-id", "host-id", "can-protocol", "can-baud-rate"].contains(&name);
        let writable = |item: &&ConfigurationItem| item.access == Access::ReadWrite && !is_link(item.name);
        for item in CONFIGURATION.iter().filter(writable) {
            let item = item.key().item().unwrap();
            let value = match knee.configuration(item.key()).unwrap() {
                Value::Integer(value) => Value::Integer(value + 1),
                Value::Float(value) => Value::Float(Finite::new(value.get() * 1.5 + 0.25).unwrap()),
            };
            assert_eq!(
                knee.set_configuration(item, value),
                Ok(Confirmation::ReadBack(value)),
                "{}",
                item.name
            );
        }
        for parameter in &PARAMETERS {
            knee.set_parameter(parameter.id, 77).unwrap();
            assert_eq!(knee.parameter(parameter.id), Ok(77));
        }
        knee.refresh().unwrap();
    });
}

#[test]
fn refusal_uses_the_words_of_the_document() {
    on_both_wires(|_, link| {
        let mut knee = Native::new(link, 3, None);
        let item = ConfigurationItem::POWER_OFF_POSITION.item().unwrap();
        let refused = knee.set_configuration(item, Value::Integer(5)).unwrap_err();
        assert!(matches!(refused, Error::Refused { refusal: Refusal::ReadOnly, .. }), "{refused:?}");
        let said = refused.to_string();
        assert_eq!(said, "motor 3, modify configuration: the motor refused: read-only register (RES 0x04)");
        assert!(matches!(
            knee.indicator(0x40),
            Err(Error::Refused { refusal: Refusal::UnknownRegister, .. })
        ));
        // Before it was started a motor refuses control.
        let torque = knee.torque(Finite::new(1.0).unwrap(), SECOND);
        assert!(matches!(torque, Err(Error::Refused { refusal: Refusal::Failure, .. })), "{torque:?}");
    });
}

#[test]
fn motor_starts_follows_and_stops_on_both_wires() {
    on_both_wires(|bus, link| {
        let mut knee = Native::new(link, 3, None);
        assert_eq!(knee.read_scales().unwrap()[1], 8.0);
        knee.start().unwrap();
        assert_eq!(mode(bus), Mode::Running);
        let finite = |value| Finite::new(value).unwrap();
        knee.torque(finite(0.5), SECOND).unwrap();
        knee.link().pause(Duration::from_millis(50));
        assert!(bus.lock().motors()[0].velocity() > 0.0);
        knee.speed(finite(-30.0), SECOND).unwrap();
        knee.link().pause(Duration::from_millis(200));
        let state = knee.position(finite(0.2), SECOND).unwrap();
        assert!((state.velocity + 3.1).abs() < 0.2, "{state:?}");
        knee.stop_control().unwrap();
        assert_eq!(mode(bus), Mode::Running);
        knee.stop().unwrap();
        assert_eq!(mode(bus), Mode::Stopped);
    });
}

#[test]
fn fault_is_read_when_nothing_else_answers() {
    on_both_wires(|bus, link| {
        inject(bus, link, "knee fault 2");
        let mut knee = Native::new(link, 3, None);
        assert!(matches!(knee.version(), Err(Error::Silent { .. })));
        assert_eq!(knee.fault().unwrap().faults(), Faults::OVER_VOLTAGE);
        knee.acknowledge_fault().unwrap();
        assert!(knee.fault().unwrap().faults().is_none());
        assert!(knee.version().is_ok());
    });
}

#[test]
fn changed_ids_are_read_back_at_new_place() {
    on_both_wires(|_, link| {
        let mut knee = Native::new(link, 3, None);
        let host = ConfigurationItem::HOST_ID.item().unwrap();
        let own = ConfigurationItem::CAN_ID.item().unwrap();
        let written = |raw| Ok(Confirmation::ReadBack(Value::Integer(raw)));
        assert_eq!(knee.set_configuration(host, Value::Integer(0x42)), written(0x42));
        assert_eq!(knee.set_configuration(own, Value::Integer(9)), written(9));
        assert_eq!(knee.address().id, 9);
        assert_eq!(knee.address().host_id.unwrap().raw(), 0x42);
        assert!(knee.is_there().unwrap());
        assert!(!Native::new(link, 3, None).is_there().unwrap());
    });
}

/// Longer than an answer may take at first.
#[test]
fn withheld_answer_is_awaited_longer_each_time() {
    on_both_wires(|bus, link| {
        inject(bus, link, "knee delayed 70ms");
        assert!(is_taken(link, 3).unwrap());
        let mut knee = Native::new(link, 3, None);
        assert_eq!(knee.version(), Ok(0x0001_0203));
        let rated = ConfigurationItem::by_name("rated-current").unwrap();
        let written = Value::Integer(21);
        assert_eq!(knee.set_configuration(rated, written), Ok(Confirmation::ReadBack(written)));
        assert!(!is_taken(link, 4).unwrap());
    });
}

#[test]
fn unconfirmed_write_reports_either_value_possible() {
    on_both_wires(|bus, link| {
        inject(bus, link, "knee off");
        let own = ConfigurationItem::CAN_ID.item().unwrap();
        let lost = Native::new(link, 3, None).set_configuration(own, Value::Integer(9)).unwrap_err();
        assert!(matches!(lost, Error::Unconfirmed { id: 9, item: "can-id", .. }), "{lost}");
    });
}

#[test]
fn motor_changes_to_mit_and_back_over_serial() {
    let item = ConfigurationItem::PROTOCOL.item().unwrap();
    let can = bus(BusKind::Can, vec![motor("knee", 3, Dialect::Gim)]);
    let mut over_can = link(&can, BusKind::Can);
    let mut knee = Native::new(&mut over_can, 3, None);
    assert_eq!(knee.set_configuration(item, Value::Integer(1)), Ok(Confirmation::AnswersInMit));
    assert_eq!(identify(&mut over_can, 3).unwrap().unwrap().family, Family::Mit);

    let serial = bus(BusKind::Serial, vec![motor("knee", 3, Dialect::Mit)]);
    let mut over_serial = link(&serial, BusKind::Serial);
    let mut knee = Native::new(&mut over_serial, 3, None);
    assert_eq!(knee.configuration(item.key()), Ok(Value::Integer(1)));
    let back = Confirmation::ReadBack(Value::Integer(0));
    assert_eq!(knee.set_configuration(item, Value::Integer(0)), Ok(back));
}

#[test]
fn motor_with_other_bit_rate_is_unreachable() {
    let bus = bus(BusKind::Can, vec![motor("knee", 3, Dialect::Gim)]);
    let mut link = link(&bus, BusKind::Can);
    let rate = ConfigurationItem::by_name("can-baud-rate").unwrap();
    let written = Native::new(&mut link, 3, None).set_configuration(rate, Value::Integer(5));
    assert_eq!(written, Ok(Confirmation::Unreachable));
}

#[test]
fn calibration_reports_progress_and_can_be_aborted() {
    on_both_wires(|bus, link| {
        let mut seen = Vec::new();
        let mut knee = Native::new(link, 3, None);
        knee.calibrate(Calibration::ENCODER, &mut |elapsed| {
            seen.push(elapsed);
            true
        })
        .unwrap();
        assert!(seen.len() >= 9 && seen[8] >= Duration::from_secs(4), "{seen:?}");
        let broken_off = knee.calibrate(Calibration::PHASE_ORDER, &mut |_| false);
        assert_eq!(broken_off, Err(Error::Interrupted));
        assert_eq!(mode(bus), Mode::Stopped);
    });
}

#[test]
fn unanswered_calibration_is_stopped() {
    for kind in [BusKind::Can, BusKind::Serial] {
        let calibration_time = CALIBRATION_MAX + Duration::from_secs(60);
        let knee = MotorSettings { calibration_time, ..motor("knee", 3, Dialect::Gim) };
        let bus = bus(kind, vec![knee]);
        let mut link = link(&bus, kind);
        let unanswered = Native::new(&mut link, 3, None).calibrate(Calibration::ENCODER, &mut |_| true);
        assert_eq!(unanswered, Err(Error::Silent { id: 3, request: "calibration" }));
        assert_eq!(mode(&bus), Mode::Stopped, "{kind:?}");
    }
}

#[test]
fn firmware_mode_is_confirmed_by_silence() {
    on_both_wires(|bus, link| {
        Native::new(link, 3, None).enter_firmware_mode().unwrap();
        assert_eq!(mode(bus), Mode::Firmware);
    });
}

#[test]
fn lost_answers_are_requested_again_when_harmless() {
    on_both_wires(|bus, link| {
        inject(bus, link, "knee intermittent 60%");
        let mut knee = Native::new(link, 3, None);
        let reads = (0..50).filter(|_| knee.version().is_ok()).count();
        assert!((30..50).contains(&reads), "{reads}");
        let starts = (0..50).filter(|_| knee.start().is_ok()).count();
        assert!((8..35).contains(&starts), "{starts}");
    });
}

#[test]
fn write_with_lost_answer_is_confirmed_by_reading() {
    on_both_wires(|bus, link| {
        inject(bus, link, "knee intermittent 50%");
        let item = ConfigurationItem::by_name("rated-current").unwrap();
        let mut confirmed = 0;
        for value in 0..40 {
            let value = Value::Integer(value);
            match Native::new(link, 3, None).set_configuration(item, value) {
                Ok(confirmation) => {
                    assert_eq!(confirmation, Confirmation::ReadBack(value));
                    confirmed += 1;
                }
                Err(error) => assert!(matches!(error, Error::Unconfirmed { .. }), "{error}"),
            }
        }
        assert!(confirmed > 30, "{confirmed}");
    });
}

#[test]
fn mit_motor_stops_starts_zeroes_and_reports_fault() {
    let hip = MotorSettings { initial_position: 0.7, ..motor("hip", 4, Dialect::Mit) };
    let bus = bus(BusKind::Can, vec![hip]);
    let mut link = link(&bus, BusKind::Can);
    let scales = Scales::by_current(0.125, 8.0).unwrap();
    let mut hip = Mit::new(&mut link, 4, None, scales);
    assert!((hip.stop().unwrap().position - 0.7).abs() < 1e-3);
    assert!(hip.set_zero().unwrap().position.abs() < 1e-3);
    hip.start().unwrap();
    assert_eq!(mode(&bus), Mode::Running);
    assert!(hip.fault().unwrap().is_none());
    inject(&bus, &link, "hip fault 8");
    let mut hip = Mit::new(&mut link, 4, None, scales);
    assert!(matches!(hip.stop(), Err(Error::Silent { .. })));
    assert_eq!(hip.fault(), Ok(Faults::OVER_TEMPERATURE));
    hip.clear_fault().unwrap();
    assert!(hip.fault().unwrap().is_none());
}

/// Motors on four CAN buses and on a serial line, half of them in MIT.
fn robot() -> Vec<(BusKind, SharedBus)> {
    let dialect = |id: u16| if id.is_multiple_of(2) { Dialect::Mit } else { Dialect::Gim };
    let of = |kind, ids: [u16; 3]| {
        let motors = ids.map(|id| motor(&format!("m{id}"), id, dialect(id)));
        (kind, bus(kind, motors.into()))
    };
    vec![
        of(BusKind::Can, [1, 2, 3]),
        of(BusKind::Can, [4, 5, 6]),
        of(BusKind::Can, [1, 90, 0xFE]),
        of(BusKind::Can, [10, 11, 12]),
        of(BusKind::Serial, [7, 8, 9]),
    ]
}

/// Judged by the checker's codec as a motor in MIT mode hears it, and by the first byte as a native one does.
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
    for (kind, bus) in robot() {
        let mut link = link(&bus, kind);
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
            let in_mit = kind == BusKind::Can && found.id % 2 == 0;
            assert_eq!(found.family, if in_mit { Family::Mit } else { Family::Native }, "{found:?}");
            assert_eq!(found.host_id.unwrap().raw(), 0x100 + u32::from(found.id), "{found:?}");
        }
        assert_eq!(steps, 254);
        let mut frames = 0;
        for recorded in bus.lock().take_record().filter(|recorded| recorded.direction == Direction::ToMotor) {
            assert_harmless(recorded.frame.payload().try_into().unwrap());
            frames += 1;
        }
        assert!(frames >= 254);
        assert!(bus.lock().motors().iter().all(|motor| motor.last_executed().is_none()));
    }
}

#[test]
fn two_motors_with_one_id_are_detected() {
    let twin = |host_id, initial_position| {
        let name = format!("m{host_id:x}");
        MotorSettings { name, host_id, initial_position, ..motor("", 1, Dialect::Mit) }
    };
    let ids = Scan { ids: 1..=2, ..Scan::default() };
    let apart = bus(BusKind::Can, vec![twin(0x101, 0.1), twin(0x102, 0.2)]);
    let mut over_can = link(&apart, BusKind::Can);
    let report = scan(&mut over_can, &ids, &mut |_| true).unwrap();
    assert_eq!(report.found.len(), 2);
    let refused = identify(&mut over_can, 1).unwrap_err();
    assert!(refused.to_string().contains("several motors"), "{refused}");

    let mut same = [twin(0x101, 0.1), twin(0x101, 0.2)];
    same[1].name = "other".into();
    let report = scan(&mut link(&bus(BusKind::Can, same.into()), BusKind::Can), &ids, &mut |_| true).unwrap();
    assert_eq!(report.collisions, [1]);
}

#[test]
fn silent_faulty_motor_is_found_by_fault_question() {
    for (in_fault, behaviour, found) in
        [(false, InFault::Silent, 0), (true, InFault::Silent, 1), (false, InFault::Refuses, 1)]
    {
        let behaviour = Behaviour { in_fault: behaviour, ..Behaviour::default() };
        let knee = MotorSettings { behaviour, ..motor("knee", 3, Dialect::Gim) };
        let bus = bus(BusKind::Can, vec![knee]);
        let mut link = link(&bus, BusKind::Can);
        inject(&bus, &link, "knee fault 2");
        let scan_settings = Scan { ids: 1..=5, in_fault, ..Scan::default() };
        let report = scan(&mut link, &scan_settings, &mut |_| true).unwrap();
        assert_eq!(report.found.len(), found, "{in_fault} {behaviour:?}");
        assert!(report.found.iter().all(|found| found.family == Family::Native));
    }
}

#[test]
fn nothing_is_sent_on_a_busy_bus() {
    let bus = bus(BusKind::Can, vec![motor("knee", 3, Dialect::Gim)]);
    let mut link = link(&bus, BusKind::Can);
    inject(&bus, &link, "can0 flood 1000");
    let refused = scan(&mut link, &Scan::default(), &mut |_| true);
    assert!(matches!(refused, Err(Error::InUse { .. })), "{refused:?}");
    let to_motor = bus.lock().take_record().filter(|frame| frame.direction == Direction::ToMotor).count();
    assert_eq!(to_motor, 0);
}

#[test]
fn ids_that_command_other_drivers_are_not_asked() {
    use motord_bus::{Content, Frame, FrameId};
    let bus = bus(BusKind::Can, vec![motor("knee", 40, Dialect::Gim)]);
    let mut link = link(&bus, BusKind::Can);
    let heartbeat = Frame::classic(FrameId::new(0x001).unwrap(), [0; 8]);
    bus.lock().deliver(START + Duration::from_millis(100), Content::Frame(heartbeat));
    let report = scan(&mut link, &Scan { ids: 1..=50, ..Scan::default() }, &mut |_| true).unwrap();
    assert_eq!(report.skipped, (1..32).collect::<Vec<u8>>());
    assert_eq!(report.found.len(), 1);
}

/// Goal: a dump, a reset of the configuration, and an application of the dump leave no difference.
#[test]
fn configuration_survives_factory_reset_on_both_wires() {
    on_both_wires(|bus, link| {
        let mut knee = Native::new(link, 3, None);
        let item = ConfigurationItem::by_name("rated-current").unwrap();
        knee.set_configuration(item, Value::Integer(33)).unwrap();
        let dump = dump(&mut knee);
        knee.reset_configuration().unwrap();
        assert!(!knee.is_there().unwrap(), "the factory's id is 1");

        let mut fresh = Native::new(link, 1, None);
        let present = self::dump(&mut fresh);
        let changes = changes(&present, &dump);
        assert!(changes.iter().any(|change| change.item.name == "can-id"), "{changes:?}");
        let mut journal = Vec::new();
        let apply = Apply { changes: &changes };
        apply
            .run(&mut fresh, &mut |event| -> Result<(), ()> {
                journal.push(event);
                Ok(())
            })
            .unwrap();
        // The items are stored together; the host id and the id are, too, before the motor is reached in another way.
        let refreshes = journal.iter().filter(|event| **event == Event::Refreshing).count();
        assert_eq!((refreshes, journal.len()), (3, 2 * changes.len() + 3));
        inject(bus, link, "knee power-cycle");
        link.pause(Duration::from_secs(1));
        let after = self::dump(&mut Native::new(link, 3, None));
        assert_eq!(motord_commissioning::changes(&after, &dump), []);
    });
}

fn dump(motor: &mut Native<'_>) -> Vec<(&'static ConfigurationItem, Value)> {
    let items = CONFIGURATION.iter().map(|item| item.key().item().unwrap());
    items.map(|item| (item, motor.configuration(item.key()).unwrap())).collect()
}

#[test]
fn refusal_ends_writing_and_journal_shows_progress() {
    on_both_wires(|_, link| {
        let mut knee = Native::new(link, 3, None);
        let before = dump(&mut knee);
        let wanted: Vec<_> = before
            .iter()
            .map(|&(item, value)| match item.name {
                "pole-pairs" | "under-voltage" => (item, Value::Integer(13)),
                // No gear has a ratio of 0: the simulated motor refuses it.
                "gear-ratio" => (item, Value::Integer(0)),
                _ => (item, value),
            })
            .collect();
        let changes = changes(&before, &wanted);
        let mut journal = Vec::new();
        let apply = Apply { changes: &changes };
        let failed = apply
            .run(&mut knee, &mut |event| -> Result<(), ()> {
                journal.push(event);
                Ok(())
            })
            .unwrap_err();
        let Failed::Motor { source, written, count } = failed else { panic!("{failed:?}") };
        assert!(matches!(source, Error::Refused { refusal: Refusal::DataFormat, .. }), "{source}");
        assert_eq!((written, count), (1, 3));
        assert!(matches!(journal.last(), Some(Event::Writing(change)) if change.item.name == "gear-ratio"));
        let after = dump(&mut knee);
        let differing: Vec<_> =
            motord_commissioning::changes(&before, &after).iter().map(|c| c.item.name).collect();
        assert_eq!(differing, ["pole-pairs"]);
    });
}

#[test]
fn unwritable_journal_ends_application_before_write() {
    on_both_wires(|_, link| {
        let mut knee = Native::new(link, 3, None);
        let before = dump(&mut knee);
        let wanted: Vec<_> = before.iter().map(|&(item, _)| (item, Value::Integer(13))).collect();
        let changes: Vec<_> =
            changes(&before, &wanted).into_iter().filter(|change| change.item.name == "pole-pairs").collect();
        let failed = Apply { changes: &changes }.run(&mut knee, &mut |_| Err("full"));
        assert!(matches!(failed, Err(Failed::Journal("full"))), "{failed:?}");
        assert_eq!(dump(&mut knee), before);
    });
}

/// A reply that equals the request is nobody's answer: an adapter echoes, and stale bytes may be anything.
#[test]
fn an_echo_is_never_an_answer() {
    use motord_bus::{Bus, Content, Frame, Inbox, Readiness, Sent};
    /// Gives back every frame, and has no motors.
    #[derive(Default)]
    struct Echo(Vec<Frame>);
    impl Bus for Echo {
        fn send(&mut self, _now: Instant, frames: &[Frame]) -> Sent {
            self.0.extend_from_slice(frames);
            Sent::all(frames.len())
        }
        fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
            for frame in self.0.drain(..) {
                inbox.push(motord_bus::Arrival { at: now, content: Content::Frame(frame) }).unwrap();
            }
        }
        fn readiness(&self) -> Readiness<'_> {
            if self.0.is_empty() { Readiness::Never } else { Readiness::At(START) }
        }
    }
    for mut link in [
        Link::can(Echo::default(), VirtualTime::new(START)),
        Link::serial(Echo::default(), VirtualTime::new(START)),
    ] {
        assert_eq!(identify(&mut link, 1), Ok(None));
        let mut motor = Native::new(&mut link, 1, None);
        assert!(matches!(motor.start(), Err(Error::Silent { .. })));
        assert!(matches!(motor.stop(), Err(Error::Silent { .. })));
        assert!(matches!(motor.version(), Err(Error::Silent { .. })));
        assert!(matches!(motor.reset_configuration(), Err(Error::Silent { .. })));
        assert!(matches!(
            motor.torque(Finite::default(), ExecutionTime::default()),
            Err(Error::Silent { .. })
        ));
    }
}

/// GIM document, Table 9.
#[test]
fn every_fault_is_cleared_on_both_wires() {
    on_both_wires(|bus, link| {
        for bit in [0x01_u8, 0x02, 0x04, 0x08, 0x10, 0x40, 0x80] {
            inject(bus, link, &format!("knee fault {bit}"));
            let mut knee = Native::new(link, 3, None);
            let fault = knee.fault().unwrap();
            assert_eq!((fault.0, fault.faults().unknown()), (bit, 0));
            knee.acknowledge_fault().unwrap();
            assert!(knee.fault().unwrap().faults().is_none());
        }
    });
}

/// Goal: each result code of Table 5, where each command has it, becomes an error with the document's word; the others keep
/// their number. Method: a bus that answers every request with one result.
#[test]
fn every_result_code_is_error_on_both_wires() {
    use motord_bus::{Arrival, Bus, Content, Frame, FrameId, Inbox, Readiness, Sent};
    struct Refuser(u8, Option<Frame>);
    impl Bus for Refuser {
        fn send(&mut self, _now: Instant, frames: &[Frame]) -> Sent {
            let mut bytes: [u8; 8] = frames[0].payload().try_into().unwrap();
            let place = match bytes[0] {
                0x83 | 0x84 => 3,
                0xA1 | 0xA2 | 0xB4 => 2,
                _ => 1,
            };
            bytes[place] = self.0;
            self.1 = Some(Frame::classic(FrameId::new(3).unwrap(), bytes));
            Sent::all(1)
        }
        fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
            if let Some(frame) = self.1.take() {
                inbox.push(Arrival { at: now, content: Content::Frame(frame) }).unwrap();
            }
        }
        fn readiness(&self) -> Readiness<'_> {
            if self.1.is_some() { Readiness::At(START) } else { Readiness::Never }
        }
    }
    for (code, word) in [
        (0x01, "failure"),
        (0x02, "unknown command"),
        (0x03, "unknown id"),
        (0x04, "read-only register"),
        (0x05, "unknown register"),
        (0x06, "string format"),
        (0x07, "data format"),
        (0x0B, "write-only register"),
        (0x42, "reason not in the vendor's list"),
    ] {
        let can = Link::can(Refuser(code, None), VirtualTime::new(START));
        let serial = Link::serial(Refuser(code, None), VirtualTime::new(START));
        for mut link in [can, serial] {
            let mut motor = Native::new(&mut link, 3, None);
            let torque_constant = ConfigurationItem::TORQUE_CONSTANT;
            let refused = [
                motor.start().err(),
                motor.version().err(),
                motor.parameter(4).err(),
                motor.indicator(9).err(),
                motor.configuration(torque_constant).err(),
                motor
                    .set_configuration(torque_constant.item().unwrap(), Value::Float(Finite::default()))
                    .err(),
            ];
            for error in refused {
                let said = error.unwrap().to_string();
                assert!(said.ends_with(&format!("the motor refused: {word} (RES {code:#04X})")), "{said}");
            }
        }
    }
    let mut link = Link::can(Refuser(0x00, None), VirtualTime::new(START));
    Native::new(&mut link, 3, None).start().unwrap();
}
