//! The RS485 and RS232 framing of the vendor, from the motors' side: bytes in, bytes out (GIM document, table 3).

use crate::SimulatedBus;
use motord_bus::{Bus, Content, Frame, FrameId, Inbox, Instant, Readiness};

/// Id of the receiver, type, payload length, XOR of the three.
const HEADER: usize = 4;
const PAYLOAD: usize = 8;
const NORMAL: u8 = 0;
const ACK: u8 = 1;

/// The motors of a serial [`SimulatedBus`] behind a port: for a pseudo terminal, or for tests of a framer.
///
/// A request with a damaged header, or with a length other than 8, is answered with an ACK frame by the motor whose
/// id it bears. The document sends ACK frames only for faults, and leaves their payload open (here: none). The bytes that
/// follow are searched for the next valid header, without a further ACK.
#[derive(Debug, Clone)]
pub struct SerialSlave {
    bus: SimulatedBus,
    window: [u8; HEADER + PAYLOAD],
    len: usize,
    searching: bool,
    inbox: Inbox,
}

/// The meaning of the bytes at the start of the window.
enum Start {
    Incomplete,
    Request([u8; PAYLOAD]),
    Damage,
}

impl SerialSlave {
    /// Puts `bus`, one of kind [`BusKind::Serial`](crate::BusKind::Serial), behind a port.
    #[must_use]
    pub fn new(bus: SimulatedBus) -> Self {
        let window = [0; HEADER + PAYLOAD];
        Self { bus, window, len: 0, searching: false, inbox: Inbox::new() }
    }

    /// The bus, for its motors and for faults.
    pub fn bus(&mut self) -> &mut SimulatedBus {
        &mut self.bus
    }

    /// The time of the next answer, if nothing else is received.
    #[must_use]
    pub fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }

    /// Takes received bytes. Appends the bytes that the motors have sent by `now` to `answers`.
    pub fn transact(&mut self, now: Instant, received: &[u8], answers: &mut Vec<u8>) {
        for byte in received {
            self.window[self.len] = *byte;
            self.len += 1;
            self.parse(now, answers);
        }
        self.inbox.clear();
        self.bus.receive(now, &mut self.inbox);
        for arrival in self.inbox.arrivals() {
            if let Content::Frame(frame) = arrival.content {
                answers.extend_from_slice(&header(frame.id(), NORMAL, frame.payload().len()));
                answers.extend_from_slice(frame.payload());
            }
        }
    }

    /// Leaves room for at least one byte in the window.
    fn parse(&mut self, now: Instant, answers: &mut Vec<u8>) {
        loop {
            match self.start() {
                Start::Incomplete => return,
                Start::Request(payload) => {
                    self.bus.send(now, &[Frame::full(self.addressee(), payload)]);
                    self.searching = false;
                    self.len = 0;
                }
                Start::Damage => {
                    if !core::mem::replace(&mut self.searching, true) {
                        self.complain(answers);
                    }
                    self.window.copy_within(1..self.len, 0);
                    self.len -= 1;
                }
            }
        }
    }

    fn start(&self) -> Start {
        match self.window[..self.len] {
            [id, kind, len, check, ..] if check != id ^ kind ^ len => Start::Damage,
            [_, kind, len, _, ..] if kind != NORMAL || usize::from(len) != PAYLOAD => Start::Damage,
            [_, _, _, _, b0, b1, b2, b3, b4, b5, b6, b7] => Start::Request([b0, b1, b2, b3, b4, b5, b6, b7]),
            _ => Start::Incomplete,
        }
    }

    fn addressee(&self) -> FrameId {
        FrameId::new(self.window[0].into()).unwrap_or(FrameId::MAX)
    }

    fn complain(&self, answers: &mut Vec<u8>) {
        let motor = self.bus.motors().iter().find(|motor| motor.address() == self.addressee());
        if let Some(motor) = motor {
            answers.extend_from_slice(&header(motor.host_address(), ACK, 0));
        }
    }
}

fn header(to: FrameId, kind: u8, len: usize) -> [u8; HEADER] {
    let (id, len) = (to.raw() as u8, len as u8);
    [id, kind, len, id ^ kind ^ len]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BusKind, BusSettings, MotorSettings};

    const GET_VERSION: [u8; 12] = [0x01, 0x00, 0x08, 0x09, 0xB1, 0, 0, 0, 0, 0, 0, 0];
    /// Golden vector rs485_host0_r_version but for the version's bytes, which are the default's.
    const VERSION: [u8; 12] = [0x00, 0x00, 0x08, 0x08, 0xB1, 0, 0, 0, 0x03, 0x02, 0x01, 0x00];

    fn slave() -> SerialSlave {
        let settings = BusSettings { kind: BusKind::Serial, bitrate: 921_600, ..BusSettings::default() };
        let motor = MotorSettings { host_id: 0, ..MotorSettings::default() };
        SerialSlave::new(SimulatedBus::new(settings, vec![motor], 0))
    }

    /// The bytes that come back within 10 ms of `received`.
    fn answers(slave: &mut SerialSlave, received: &[u8]) -> Vec<u8> {
        let mut answers = Vec::new();
        let start = match slave.readiness() {
            Readiness::At(at) => at,
            _ => Instant::ZERO,
        };
        slave.transact(start, received, &mut answers);
        slave.transact(start + core::time::Duration::from_millis(10), &[], &mut answers);
        answers
    }

    #[test]
    fn a_request_is_answered_with_the_framing_of_the_document() {
        assert_eq!(answers(&mut slave(), &GET_VERSION), VERSION);
        assert!(matches!(slave().readiness(), Readiness::Never));
    }

    #[test]
    fn requests_may_come_in_pieces_and_glued() {
        let mut slave = slave();
        let mut out = Vec::new();
        slave.transact(Instant::ZERO, &GET_VERSION[..5], &mut out);
        slave.transact(Instant::ZERO, &[&GET_VERSION[5..], &GET_VERSION[..]].concat(), &mut out);
        slave.transact(Instant::from_nanos(10_000_000), &[], &mut out);
        assert_eq!(out, [VERSION, VERSION].concat());
    }

    #[test]
    fn a_damaged_header_is_answered_once_and_the_next_request_is_heard() {
        let mut damaged = GET_VERSION;
        damaged[3] ^= 0x40;
        let expected = [&[0x00, 0x01, 0x00, 0x01][..], &VERSION].concat();
        assert_eq!(answers(&mut slave(), &[damaged, GET_VERSION].concat()), expected);
    }

    #[test]
    fn noise_costs_no_request_that_follows_it() {
        let mut random = crate::random::Random::new(3);
        for _ in 0..2_000 {
            let noise = random.next().to_le_bytes();
            let len = (random.next() % 9) as usize;
            // A quiet line cannot end noise that looks like the start of a frame: a request may be its payload.
            let out = answers(&mut slave(), &[&noise[..len], &GET_VERSION, &GET_VERSION].concat());
            assert!(out.windows(12).any(|window| window == VERSION), "{noise:02X?} {len}");
        }
    }

    #[test]
    fn other_addresses_and_lengths_do_not_reach_the_motor() {
        let other = [0x02, 0x00, 0x08, 0x0A, 0xB1, 0, 0, 0, 0, 0, 0, 0];
        assert!(answers(&mut slave(), &other).is_empty());
        assert_eq!(answers(&mut slave(), &[0x01, 0x00, 0x07, 0x06]), [0x00, 0x01, 0x00, 0x01]);
    }
}
