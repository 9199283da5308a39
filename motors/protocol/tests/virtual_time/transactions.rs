//! Single transactions, native and MIT.

use crate::{SECOND, bus, inject, link, mode, motor, on_both_wires};
use motord_bus::{Duration, FrameId};
use motord_protocol::commissioning::{
    CALIBRATION_MAX, Confirmation, Error, Family, Mit, Native, Registers, ends, identify, is_taken,
};
use motord_protocol::gim::{
    Access, CONFIGURATION, Calibration, ConfigurationItem, Finite, INDICATORS, PARAMETERS, Refusal, Value,
};
use motord_protocol::{Faults, Scales};
use motord_simulator::{Dialect, Medium, Mode, MotorSettings};

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
        assert!(
            matches!(refused, Error::Refused { refusal, .. } if refusal == Refusal::ReadOnly.into()),
            "{refused:?}"
        );
        let text = refused.to_string();
        assert_eq!(text, "motor 3, modify configuration: the motor refused: read-only register (RES 0x04)");
        assert!(matches!(
            knee.indicator(0x40),
            Err(Error::Refused { refusal, .. }) if refusal == Refusal::UnknownRegister.into()
        ));
        // A motor refuses control before it was started.
        let torque = knee.torque(Finite::new(1.0).unwrap(), SECOND);
        assert!(
            matches!(torque, Err(Error::Refused { refusal, .. }) if refusal == Refusal::Failure.into()),
            "{torque:?}"
        );
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
    let can = bus(Medium::Can, vec![motor("knee", 3, Dialect::Gim)]);
    let mut over_can = link(&can, Medium::Can);
    let mut knee = Native::new(&mut over_can, 3, None);
    assert_eq!(knee.set_configuration(item, Value::Integer(1)), Ok(Confirmation::AnswersInMit));
    assert_eq!(identify(&mut over_can, 3).unwrap().unwrap().family, Family::Mit);

    let serial = bus(Medium::Serial, vec![motor("knee", 3, Dialect::Mit)]);
    let mut over_serial = link(&serial, Medium::Serial);
    let mut knee = Native::new(&mut over_serial, 3, None);
    assert_eq!(knee.configuration(item.key()), Ok(Value::Integer(1)));
    let back = Confirmation::ReadBack(Value::Integer(0));
    assert_eq!(knee.set_configuration(item, Value::Integer(0)), Ok(back));
}

#[test]
fn motor_with_other_bit_rate_is_unreachable() {
    let bus = bus(Medium::Can, vec![motor("knee", 3, Dialect::Gim)]);
    let mut link = link(&bus, Medium::Can);
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
    for medium in [Medium::Can, Medium::Serial] {
        let calibration_time = CALIBRATION_MAX + Duration::from_secs(60);
        let knee = MotorSettings { calibration_time, ..motor("knee", 3, Dialect::Gim) };
        let bus = bus(medium, vec![knee]);
        let mut link = link(&bus, medium);
        let unanswered = Native::new(&mut link, 3, None).calibrate(Calibration::ENCODER, &mut |_| true);
        assert_eq!(unanswered, Err(Error::Silent { id: 3, request: "calibration" }));
        assert_eq!(mode(&bus), Mode::Stopped, "{medium:?}");
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
    let bus = bus(Medium::Can, vec![hip]);
    let mut link = link(&bus, Medium::Can);
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

#[test]
fn damiao_motor_reports_ends_of_its_codes() {
    let damiao =
        MotorSettings { vendor: "damiao", ends: Some([12.5, 10.0, 28.0]), ..motor("knee", 3, Dialect::Mit) };
    let bus = bus(Medium::Can, vec![damiao, motor("hip", 4, Dialect::Mit)]);
    let mut link = link(&bus, Medium::Can);
    let host_id = |id| FrameId::new(id).unwrap();
    assert_eq!(ends(&mut link, 3, host_id(0x103)), Ok(Some([12.5, 10.0, 28.0])));
    assert_eq!(ends(&mut link, 4, host_id(0x104)), Ok(None), "a motor without registers");
    assert_eq!(bus.lock().motors()[0].mode(), Mode::Stopped);
}

/// Goal: `motorctl fault` reports no fault for a state that is late. Method: each answer is later
/// than the link waits, so the one to a stop arrives after the question for the fault.
#[test]
fn late_state_is_no_fault() {
    let bus = bus(Medium::Can, vec![motor("knee", 3, Dialect::Mit)]);
    let mut link = link(&bus, Medium::Can);
    inject(&bus, &link, "knee delayed 30ms");
    let mut knee = Mit::new(&mut link, 3, None, Scales::WITHOUT_CONSTANTS);
    knee.stop().unwrap();
    assert_eq!(knee.fault(), Ok(Faults::NONE));
}

#[test]
fn fault_of_motor_with_filled_reports_is_read() {
    let mut knee = motor("knee", 3, Dialect::Mit);
    knee.behaviour.stale_bytes = true;
    let bus = bus(Medium::Can, vec![knee]);
    let mut link = link(&bus, Medium::Can);
    inject(&bus, &link, "knee fault 0x40");
    let mut knee = Mit::new(&mut link, 3, None, Scales::WITHOUT_CONSTANTS);
    assert_eq!(knee.fault().map(|faults| faults.0), Ok(0x40));
}

/// Goal: a Damiao motor with factory settings gets an id and a reply id, which last without power.
#[test]
fn address_of_new_damiao_is_stored() {
    let new = MotorSettings {
        is_new: true,
        vendor: "damiao",
        ends: Some([12.5, 30.0, 10.0]),
        ..motor("elbow", 9, Dialect::Mit)
    };
    let bus = bus(Medium::Can, vec![new]);
    let mut link = link(&bus, Medium::Can);
    let found = identify(&mut link, 1).unwrap().unwrap();
    assert_eq!((found.family, found.host_id), (Family::OtherMit { length: 8 }, FrameId::new(0)));
    let host_id = FrameId::new(0x13).unwrap();
    Registers::new(&mut link, 1, FrameId::new(0).unwrap()).set_address(3, host_id).unwrap();
    inject(&bus, &link, "elbow power-cycle");
    link.pause(Duration::from_millis(400));
    assert_eq!(Registers::new(&mut link, 3, host_id).read(8).unwrap(), Some(3));
    assert_eq!(identify(&mut link, 1).unwrap(), None);
}

#[test]
fn silent_registers_are_an_unconfirmed_address() {
    let bus = bus(Medium::Can, vec![motor("knee", 3, Dialect::Mit)]);
    let mut link = link(&bus, Medium::Can);
    let [before, after] = [0x103, 0x13].map(|id| FrameId::new(id).unwrap());
    let refused = Registers::new(&mut link, 3, before).set_address(4, after).unwrap_err();
    assert_eq!(refused, Error::Unconfirmed { id: 3, item: "MST_ID", written: 19.0 });
}
