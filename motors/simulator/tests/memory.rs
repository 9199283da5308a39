//! The register file of a SteadyWin motor: the times at which items take effect, and the
//! non-volatile ones.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::{Bench, CLEAR_FAULT, GET_FAULT, SET_ZERO, STOP};
use motord_bus::{Bus, Duration, Frame, FrameId, Instant};
use motord_simulator::{
    Behaviour, BusSettings, Dialect, Medium, MotorSettings, OtherBitrate, Persistence, SimulatedBus, Store,
};

const INT: u8 = 0x00;
const FLOAT: u8 = 0x01;
/// Table 7.
const INTS: [u8; 24] = [
    0x00, 0x01, 0x02, 0x06, 0x07, 0x08, 0x09, 0x0C, 0x0D, 0x0E, 0x0F, 0x10, 0x11, 0x12, 0x13, 0x14, 0x15,
    0x16, 0x17, 0x18, 0x19, 0x1A, 0x1C, 0x20,
];

fn settings() -> MotorSettings {
    MotorSettings { dialect: Dialect::Gim, ..MotorSettings::default() }
}

fn behaving(behaviour: Behaviour) -> Bench {
    Bench::new(MotorSettings { behaviour, ..settings() })
}

fn bench() -> Bench {
    Bench::new(settings())
}

fn get(bench: &mut Bench, kind: u8, id: u8) -> [u8; 4] {
    let answer = bench.ask([0x84, kind, id, 0, 0, 0, 0, 0]);
    assert_eq!(answer[..4], [0x84, kind, id, 0]);
    answer[4..].try_into().unwrap()
}

fn int(bench: &mut Bench, id: u8) -> i32 {
    i32::from_le_bytes(get(bench, INT, id))
}

/// Writes an item, and returns the result code.
fn set(bench: &mut Bench, id: u8, value: i32) -> u8 {
    let [d0, d1, d2, d3] = value.to_le_bytes();
    bench.ask([0x83, INT, id, 0, d0, d1, d2, d3])[3]
}

fn parameter(bench: &mut Bench, id: u8) -> u8 {
    bench.ask([0xA2, id, 0, 0, 0, 0, 0, 0])[4]
}

fn refresh(bench: &mut Bench) {
    assert_eq!(bench.ask([0x82, 0, 0, 0, 0, 0, 0, 0])[1], 0);
}

fn power_cycle(bench: &mut Bench) {
    bench.inject("power-cycle");
    bench.pass(Duration::from_millis(300));
}

#[test]
fn written_item_survives_power_loss_when_stored() {
    let at_once = Behaviour { persistence: Persistence::AtOnce, ..Behaviour::default() };
    for (mut bench, refreshes, kept) in
        [(bench(), false, false), (bench(), true, true), (behaving(at_once), false, true)]
    {
        assert_eq!(set(&mut bench, 0x01, 17), 0);
        assert_eq!(int(&mut bench, 0x01), 17, "in effect immediately");
        if refreshes {
            refresh(&mut bench);
        }
        power_cycle(&mut bench);
        assert_eq!(int(&mut bench, 0x01) == 17, kept);
    }
}

#[test]
fn default_gain_acts_immediately_runtime_until_reboot() {
    let gains = [0x08, 0x09, 0x0C, 0x0D, 0x0E, 0x0F, 0x10, 0x19, 0x1A];
    for (index, item) in (0_u8..).zip(gains) {
        let mut bench = bench();
        set(&mut bench, item, 33);
        assert_eq!(parameter(&mut bench, index), 33);
        refresh(&mut bench);
        bench.ask([0xA1, index, 0, 0, 44, 0, 0, 0]);
        assert_eq!((parameter(&mut bench, index), int(&mut bench, item)), (44, 33));
        power_cycle(&mut bench);
        assert_eq!(parameter(&mut bench, index), 33);
    }
}

#[test]
fn the_pwm_frequency_alone_waits_for_a_reboot() {
    let mut bench = bench();
    set(&mut bench, 0x07, 16_000);
    refresh(&mut bench);
    assert_eq!((int(&mut bench, 0x07), bench.motor().pwm_frequency()), (16_000, 20_000));
    power_cycle(&mut bench);
    assert_eq!(bench.motor().pwm_frequency(), 16_000);
}

#[test]
fn values_outside_documented_range_change_nothing() {
    let cases = [
        (0x1C, 2),
        (0x1C, -1),
        (0x14, 0x1_0000),
        (0x14, -1),
        (0x12, 0x800),
        (0x13, -1),
        (0x18, 0),
        (0x18, 11),
        (0x11, 0),
    ];
    for (id, value) in cases {
        let mut bench = bench();
        let before = int(&mut bench, id);
        assert_eq!(set(&mut bench, id, value), 0x07, "{id:#X} {value}");
        assert_eq!(int(&mut bench, id), before);
    }
    assert_eq!(set(&mut bench(), 0x15, 0), 0x04);
    let nan = f32::NAN.to_le_bytes();
    assert_eq!(bench().ask([0x83, FLOAT, 0x03, 0, nan[0], nan[1], nan[2], nan[3]])[3], 0x07);
}

#[test]
fn reset_restores_every_factory_value() {
    let mut used = Bench::new(MotorSettings { id: 5, host_id: 0x234, ..settings() });
    for id in [0x01, 0x02, 0x06, 0x07, 0x08, 0x10, 0x11, 0x14, 0x17, 0x19] {
        assert_eq!(set(&mut used, id, 22), 0);
    }
    used.ask([0x81, 0, 0, 0, 0, 0, 0, 0]);
    used.address(1);
    let mut new = Bench::new(MotorSettings { is_new: true, id: 9, ..MotorSettings::default() });
    new.address(1);
    for id in INTS {
        assert_eq!(int(&mut used, id), int(&mut new, id), "{id:#X}");
    }
    for id in 0x00..=0x05 {
        assert_eq!(get(&mut used, FLOAT, id), get(&mut new, FLOAT, id), "{id:#X}");
    }
    assert_eq!(
        (int(&mut new, 0x12), int(&mut new, 0x13), int(&mut new, 0x1C), int(&mut new, 0x18)),
        (1, 0, 0, 10)
    );
}

#[test]
fn unpowered_motor_is_limp_and_silent_until_booted() {
    let mut bench = Bench::new(MotorSettings { has_power: false, ..settings() });
    let version = [0xB1, 0, 0, 0, 0, 0, 0, 0];
    assert!(bench.is_silent(version));
    bench.inject("on");
    assert!(bench.is_silent(version), "it boots");
    bench.pass(Duration::from_millis(300));
    assert_eq!(bench.ask(version)[1], 0);
    bench.ask([0x91, 0, 0, 0, 0, 0, 0, 0]);
    bench.ask([0x93, 0, 0, 0x80, 0x3F, 0, 0, 0]);
    assert!(bench.motor().torque() > 0.9);
    bench.inject("power-off");
    bench.pass(Duration::from_millis(1));
    assert_eq!(bench.motor().torque(), 0.0);
    assert!(bench.is_silent(version));
}

#[test]
fn a_calibration_that_loses_its_power_never_answers() {
    let mut bench = bench();
    assert!(bench.is_silent([0xB5, 0, 0, 0, 0, 0, 0, 0]));
    power_cycle(&mut bench);
    assert!(bench.pass(Duration::from_secs(6)).is_empty());
}

#[test]
fn motor_refusing_writes_returns_code_unchanged() {
    for code in [0x01, 0x03, 0x04, 0x05, 0x06, 0x07, 0x0B] {
        let mut bench = bench();
        let before = int(&mut bench, 0x01);
        bench.inject(&format!("refuse {code:#04X}").replace("0X", "0x"));
        assert_eq!(set(&mut bench, 0x01, before + 1), code);
        assert_eq!(bench.ask([0x81, 0, 0, 0, 0, 0, 0, 0])[1], code);
        assert_eq!(bench.ask([0xA1, 0, 0, 0, 1, 0, 0, 0])[2], code);
        assert_eq!(bench.ask([0xB5, 0, 0, 0, 0, 0, 0, 0])[2], code);
        assert_eq!(int(&mut bench, 0x01), before);
        bench.inject("ok");
        assert_eq!(set(&mut bench, 0x01, before + 1), 0);
    }
}

/// GIM document 3.2: "any value, which does not affect"; MIT document 1.2: 其他字节无意义.
#[test]
fn bytes_without_a_meaning_may_be_stale() {
    let mut stale = behaving(Behaviour { stale_bytes: true, ..Behaviour::default() });
    let version = stale.ask([0xB1, 0, 0, 0, 0, 0, 0, 0]);
    let started = stale.ask([0x91, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!((&started[..2], &started[4..]), (&[0x91, 0][..], &version[4..]));
    let read = stale.ask([0x84, FLOAT, 0x03, 0, 0, 0, 0, 0]);
    assert_eq!(read[4..], 0.125_f32.to_le_bytes(), "bytes with a meaning are unchanged");
    let written = stale.ask([0x83, INT, 0x01, 0, 9, 0, 0, 0]);
    assert_eq!((&written[..4], &written[4..]), (&[0x83, INT, 0x01, 0][..], &read[4..]));
    let refused = stale.ask([0x93, 0, 0, 0xC0, 0x7F, 0, 0, 0]);
    assert_eq!((&refused[..2], &refused[2..]), (&[0x93, 0x07][..], &written[2..]), "no state in a refusal");
    let fault = stale.ask([0xB2, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!((&fault[..3], &fault[3..]), (&[0xB2, 0, 0][..], &refused[3..]));
}

#[test]
fn mit_fault_answer_may_have_stale_bytes() {
    let behaviour = Behaviour { stale_bytes: true, ..Behaviour::default() };
    let mut stale =
        Bench::new(MotorSettings { behaviour, initial_position: 3.0, ..MotorSettings::default() });
    let state = stale.ask(STOP);
    let fault = stale.ask(GET_FAULT);
    assert_eq!((&fault[..2], &fault[2..]), (&[1, 0][..], &state[2..]));
    let cleared = stale.ask(CLEAR_FAULT);
    assert_eq!((cleared[0], &cleared[1..]), (1, &fault[1..]));
}

#[test]
fn zero_of_mit_motor_survives_power_loss() {
    let mut bench = Bench::new(MotorSettings { initial_position: 1.0, ..MotorSettings::default() });
    bench.ask(SET_ZERO);
    power_cycle(&mut bench);
    assert!(bench.motor().position().abs() < 1e-3, "{}", bench.motor().position());
}

#[test]
fn new_bit_rate_works_for_following_host() {
    let mut bench = bench();
    assert_eq!(set(&mut bench, 0x18, 5), 0);
    assert!(bench.is_silent([0xB1, 0, 0, 0, 0, 0, 0, 0]));
    bench.inject_into("can0", "bitrate 500000");
    assert_eq!(int(&mut bench, 0x18), 5);
    bench.inject_into("can0", "bitrate 1000000");
    assert!(bench.is_silent([0xB1, 0, 0, 0, 0, 0, 0, 0]));
}

#[test]
fn motors_of_two_rates_share_a_bus() {
    let motor = |name: &str, id| MotorSettings { name: name.into(), id, host_id: 0x100 + id, ..settings() };
    let mut bus = SimulatedBus::new(BusSettings::default(), vec![motor("a", 1), motor("b", 2)], 0);
    let received = |bus: &mut SimulatedBus, now: u64, id, bytes| {
        bus.send(Instant::from_nanos(now), &[Frame::classic(FrameId::new(id).unwrap(), bytes)]);
        let mut inbox = motord_bus::Inbox::new();
        bus.receive(Instant::from_nanos(now + 1_000_000), &mut inbox);
        common::frames(inbox.arrivals()).len()
    };
    let version = [0xB1, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(received(&mut bus, 0, 2, [0x83, INT, 0x18, 0, 5, 0, 0, 0]), 1);
    assert_eq!(
        (received(&mut bus, 2_000_000, 1, version), received(&mut bus, 4_000_000, 2, version)),
        (1, 0)
    );
    bus.inject(Instant::from_nanos(5_000_000), &"can0 bitrate 500000".parse().unwrap()).unwrap();
    assert_eq!(
        (received(&mut bus, 6_000_000, 1, version), received(&mut bus, 8_000_000, 2, version)),
        (0, 1)
    );
}

#[test]
fn wrong_rate_motor_destroys_frames_sent_again() {
    let behaviour = Behaviour { other_bitrate: OtherBitrate::Disturbs, ..Behaviour::default() };
    let motor = |name: &str, id| MotorSettings {
        name: name.into(),
        id,
        host_id: 0x100 + id,
        behaviour,
        ..settings()
    };
    let mut bus = SimulatedBus::new(BusSettings::default(), vec![motor("a", 1), motor("b", 2)], 0);
    let received = |bus: &mut SimulatedBus, now: u64, id, bytes| {
        bus.send(Instant::from_nanos(now), &[Frame::classic(FrameId::new(id).unwrap(), bytes)]);
        let mut inbox = motord_bus::Inbox::new();
        bus.receive(Instant::from_nanos(now + 5_000_000), &mut inbox);
        let frames = common::frames(inbox.arrivals()).len();
        (frames, inbox.arrivals().len() - frames)
    };
    assert_eq!(
        received(&mut bus, 0, 2, [0x83, INT, 0x18, 0, 5, 0, 0, 0]),
        (1, 0),
        "its answer has the old rate"
    );
    let version = [0xB1, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(received(&mut bus, 6_000_000, 1, version), (1, 16));
    assert_eq!(received(&mut bus, 12_000_000, 1, version), (1, 0), "error passive");
}

#[test]
fn wire_rate_differs_from_configured_motor_rate() {
    let bus = BusSettings { wire_bitrate: Some(8_000_000), ..BusSettings::default() };
    let mut bench = bench();
    bench.bus = SimulatedBus::new(bus, vec![MotorSettings { name: "joint".into(), ..settings() }], 0);
    assert_eq!(int(&mut bench, 0x18), 10);
}

#[test]
fn serial_rate_differs_from_can_rate() {
    let bus = BusSettings { medium: Medium::Serial, bitrate: 921_600, ..BusSettings::default() };
    let mut bench = bench();
    bench.bus = SimulatedBus::new(bus, vec![MotorSettings { name: "joint".into(), ..settings() }], 0);
    assert_eq!(int(&mut bench, 0x18), 10);
}

#[test]
fn kept_memory_is_memory_of_next_motor() {
    let memory = bench().motor().memory();
    assert!(memory.starts_with("int 0x00 21\n"), "{memory}");
    let memory =
        memory.replace("int 0x12 1\n", "int 0x12 7\n").replace("float 0x03 0.125\n", "float 0x03 0.067\n");
    let mut second = bench();
    let revision = second.motor().memory_revision();
    second.bus.remember("joint", &memory).unwrap();
    second.address(7);
    assert_eq!(get(&mut second, FLOAT, 0x03), 0.067_f32.to_le_bytes());
    assert_eq!(second.motor().memory(), memory);
    assert_eq!(second.motor().memory_revision(), revision, "no change to store");
    for bad in ["int 0x1B 1", "int 0x15", "float 0x06 1", "int 0x12 1 1", "double 0x00 1", "int 12 1"] {
        assert!(second.bus.remember("joint", bad).is_err(), "{bad}");
    }
    assert_eq!(second.motor().memory(), memory);
}

// Memories of motors that persist across processes.

#[test]
fn stored_values_survive_restart_and_others_not() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open(&folder.path().join("memories")).unwrap();
    let mut first = bench();
    first.ask([0x83, 0, 0x11, 0, 36, 0, 0, 0]);
    first.ask([0x82, 0, 0, 0, 0, 0, 0, 0]);
    first.ask([0x83, 0, 0x11, 0, 48, 0, 0, 0]);
    store.save(first.bus.motors()).unwrap();
    let mut second = bench();
    Store::open(&folder.path().join("memories")).unwrap().load(&mut second.bus).unwrap();
    assert_eq!(second.ask([0x84, 0, 0x11, 0, 0, 0, 0, 0])[4], 36);
}

#[test]
fn a_file_that_is_no_memory_is_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("joint.memory"), "int 0x12 seven").unwrap();
    let error = Store::open(folder.path()).unwrap().load(&mut bench().bus).unwrap_err().to_string();
    assert!(error.contains("joint.memory: not the memory of a motor"), "{error}");
}
