//! A bench with one motor: sends requests, lets time pass, and injects faults.

#![allow(dead_code, reason = "each test file uses its part of the bench")]

use motord_bus::{Arrival, Bus, Content, Duration, Frame, FrameId, Inbox, Instant};
use motord_simulator::{BusSettings, FaultVerb, Motor, MotorSettings, SimulatedBus};

pub(crate) const START: [u8; 8] = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC];
pub(crate) const STOP: [u8; 8] = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD];
pub(crate) const SET_ZERO: [u8; 8] = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFE];
pub(crate) const CLEAR_FAULT: [u8; 8] = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFB];
pub(crate) const GET_FAULT: [u8; 8] = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x00, 0xFB];
/// No torque, by truncation (half a code below zero).
pub(crate) const NEUTRAL: [u8; 8] = [0x7F, 0xFF, 0x7F, 0xF0, 0x00, 0x00, 0x07, 0xFF];
/// 0.11 · 100 N·m of torque at the default torque scale of ±225 N·m: code 2148.
pub(crate) const PUSH: [u8; 8] = [0x80, 0x00, 0x80, 0x00, 0x00, 0x00, 0x08, 0x64];

pub(crate) struct Bench {
    pub(crate) bus: SimulatedBus,
    pub(crate) now: Instant,
    id: FrameId,
}

impl Bench {
    pub(crate) fn new(motor: MotorSettings) -> Self {
        let motor = MotorSettings { name: "joint".into(), ..motor };
        let id = FrameId::new(motor.id).unwrap();
        let settings = BusSettings { record: 64, ..BusSettings::default() };
        Self { bus: SimulatedBus::new(settings, vec![motor], 7), now: Instant::ZERO, id }
    }

    /// Passes a millisecond first, as a bus begins with the first call.
    pub(crate) fn begun(motor: MotorSettings) -> Self {
        let mut bench = Self::new(motor);
        bench.pass(Duration::from_millis(1));
        bench
    }

    pub(crate) fn motor(&self) -> &Motor {
        self.bus.motor("joint").unwrap()
    }

    /// Sends `bytes` to the motor, and returns the arrivals of the next millisecond.
    pub(crate) fn arrivals(&mut self, bytes: [u8; 8]) -> Vec<Arrival> {
        assert_eq!(self.bus.send(self.now, &[Frame::classic(self.id, bytes)]).accepted, 1);
        self.pass(Duration::from_millis(1))
    }

    pub(crate) fn pass(&mut self, time: Duration) -> Vec<Arrival> {
        self.now = self.now + time;
        let mut inbox = Inbox::new();
        self.bus.receive(self.now, &mut inbox);
        inbox.arrivals().to_vec()
    }

    /// Returns the answers to `bytes`.
    pub(crate) fn answers(&mut self, bytes: [u8; 8]) -> Vec<Frame> {
        frames(&self.arrivals(bytes))
    }

    /// Returns the payload of the only answer.
    pub(crate) fn ask(&mut self, bytes: [u8; 8]) -> Vec<u8> {
        let answers = self.answers(bytes);
        let [answer] = answers[..] else { panic!("one answer expected, not {answers:?}") };
        answer.payload().to_vec()
    }

    pub(crate) fn is_silent(&mut self, bytes: [u8; 8]) -> bool {
        self.answers(bytes).is_empty()
    }

    pub(crate) fn inject(&mut self, what: &str) {
        self.inject_into("joint", what);
    }

    pub(crate) fn inject_into(&mut self, target: &str, what: &str) {
        let verb: FaultVerb = format!("{target} {what}").parse().unwrap();
        self.bus.inject(self.now, &verb).unwrap();
    }

    /// Changes the address to which the host sends, after the motor's id was changed.
    pub(crate) fn address(&mut self, id: u16) {
        self.id = FrameId::new(id).unwrap();
    }
}

pub(crate) fn frames(arrivals: &[Arrival]) -> Vec<Frame> {
    let frame = |arrival: &Arrival| match arrival.content {
        Content::Frame(frame) => Some(frame),
        _ => None,
    };
    arrivals.iter().filter_map(frame).collect()
}

/// Returns the position of an MIT state, rad (MIT document 1.2).
pub(crate) fn position(state: &[u8]) -> f64 {
    f64::from(u16::from_be_bytes([state[1], state[2]])) * 25.0 / 65535.0 - 12.5
}
