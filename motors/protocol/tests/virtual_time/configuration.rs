//! Dumps, applications and journals of configurations, and refused answers.

use crate::{START, inject, on_both_wires};

use motord_bus::{
    Arrival, Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Readiness, Sent, VirtualClock,
};
use motord_protocol::commissioning::{Apply, Error, Event, Failed, Link, Native, changes, identify};
use motord_protocol::gim::{CONFIGURATION, ConfigurationItem, ExecutionTime, Finite, Refusal, Value};
use motord_shared::Fault;

/// Goal: no difference remains after a dump, a reset of the configuration, and an application of
/// the dump.
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
        // The items are stored together. The host id and the id are stored before the motor gets
        // another address.
        let refreshes = journal.iter().filter(|event| **event == Event::Refreshing).count();
        assert_eq!((refreshes, journal.len()), (3, 2 * changes.len() + 3));
        inject(bus, link, "knee power-cycle");
        link.pause(Duration::from_secs(1));
        let after = self::dump(&mut Native::new(link, 3, None));
        assert_eq!(motord_protocol::commissioning::changes(&after, &dump), []);
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
                // No gear has a ratio of 0, so the simulated motor refuses it.
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
        assert!(
            matches!(source, Error::Refused { refusal, .. } if refusal == Refusal::DataFormat.into()),
            "{source}"
        );
        assert_eq!((written, count), (1, 3));
        assert!(matches!(journal.last(), Some(Event::Writing(change)) if change.item.name == "gear-ratio"));
        let after = dump(&mut knee);
        let differing: Vec<_> =
            motord_protocol::commissioning::changes(&before, &after).iter().map(|c| c.item.name).collect();
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

/// A reply that equals the request is never an answer: an adapter echoes, and stale bytes may have
/// any value.
#[test]
fn an_echo_is_never_an_answer() {
    use motord_bus::{Bus, Content, Frame, Inbox, Readiness, Sent};
    /// Returns every frame, and has no motors.
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
        Link::can(Echo::default(), VirtualClock::new(START)),
        Link::serial(Echo::default(), VirtualClock::new(START)),
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
            assert_eq!((fault.0, Fault::unnamed(fault.faults().0)), (bit, 0));
            knee.acknowledge_fault().unwrap();
            assert!(knee.fault().unwrap().faults().is_none());
        }
    });
}

/// A bus that answers every request with one result code.
struct Refuser(u8, Option<Frame>);

impl Bus for Refuser {
    fn send(&mut self, _now: Instant, frames: &[Frame]) -> Sent {
        let mut bytes: [u8; 8] = frames[0].payload().try_into().unwrap();
        let index = match bytes[0] {
            0x83 | 0x84 => 3,
            0xA1 | 0xA2 | 0xB4 => 2,
            _ => 1,
        };
        bytes[index] = self.0;
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

/// Goal: each result code of Table 5 becomes an error with the document's term, for each command
/// that has it. The other codes keep their number. Method: a bus that answers every request with
/// one result.
#[test]
fn every_result_code_is_error_on_both_wires() {
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
        let can = Link::can(Refuser(code, None), VirtualClock::new(START));
        let serial = Link::serial(Refuser(code, None), VirtualClock::new(START));
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
                let text = error.unwrap().to_string();
                assert!(text.ends_with(&format!("the motor refused: {word} (RES {code:#04X})")), "{text}");
            }
        }
    }
    let mut link = Link::can(Refuser(0x00, None), VirtualClock::new(START));
    Native::new(&mut link, 3, None).start().unwrap();
}
