//! The RS485 and RS232 framing of the vendor, from the motors' side: bytes in, bytes out (GIM
//! document, table 3).

use crate::line::Line;
use crate::motor::Motor;
use crate::{Fault, FaultVerb, InjectError, SimulatedBus};
use motord_bus::{Bus, Content, ErrorFrame, Frame, FrameId, Inbox, Instant, Readiness};

/// Id of the receiver, type, payload length, XOR of the three.
const HEADER: usize = 4;
const PAYLOAD: usize = 8;
const NORMAL: u8 = 0;
const ACK: u8 = 1;

/// The motors of a serial [`SimulatedBus`] behind a port: for a pseudo terminal, or for tests of a
/// framer.
///
/// A motor answers a request for its id with an ACK frame when the header is damaged or the length
/// is not 8. The document specifies ACK frames only for faults, and no payload for them (here:
/// none). The decoder then searches the following bytes for the next valid header, without a
/// further ACK.
///
/// The line between port and motors can have faults: [`Fault::Echo`], [`Fault::Glue`],
/// [`Fault::Loss`], [`Fault::Corruption`] and [`Fault::Silent`].
#[derive(Debug, Clone)]
pub struct SerialSlave {
    bus: SimulatedBus,
    line: Line,
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
    /// Puts `bus`, one of medium [`Medium::Serial`](crate::Medium::Serial), behind a port. `seed`
    /// determines which bytes a faulty line loses or changes.
    #[must_use]
    pub fn new(bus: SimulatedBus, seed: u64) -> Self {
        let window = [0; HEADER + PAYLOAD];
        Self { bus, line: Line::new(seed), window, len: 0, searching: false, inbox: Inbox::new() }
    }

    /// Returns the name of the bus, which fault verbs use for it.
    #[must_use]
    pub fn name(&self) -> &str {
        self.bus.name()
    }

    /// Returns the bus, for its motors and for faults.
    pub fn bus(&mut self) -> &mut SimulatedBus {
        &mut self.bus
    }

    /// Returns the time of the next answer, if nothing else is received.
    #[must_use]
    pub fn readiness(&self) -> Readiness<'_> {
        match (self.line.handover(), self.bus.readiness()) {
            (Instant::FAR_FUTURE, readiness) => readiness,
            (handover, Readiness::At(at)) => Readiness::At(handover.min(at)),
            (handover, Readiness::Readable(_) | Readiness::Never) => Readiness::At(handover),
        }
    }

    /// Applies `verb` to the line, to the bus or to one of its motors. `ok` for the bus also ends
    /// the line's faults.
    ///
    /// # Errors
    ///
    /// As for [`SimulatedBus::inject`].
    pub fn inject(&mut self, now: Instant, verb: &FaultVerb) -> Result<(), InjectError> {
        if verb.target == self.bus.name() {
            if verb.fault == Fault::Ok {
                self.line.recover();
            } else if self.line.inject(verb.fault) {
                return Ok(());
            }
        }
        self.bus.inject(now, verb)
    }

    /// Takes the bytes that the host has sent. Appends the bytes that it can read at `now` to
    /// `answers`.
    pub fn transact(&mut self, now: Instant, received: &[u8], answers: &mut Vec<u8>) {
        self.line.echo(now, received);
        for byte in received {
            if let Some(byte) = self.line.carry(*byte) {
                self.window[self.len] = byte;
                self.len += 1;
                self.parse(now);
            }
        }
        self.inbox.clear();
        self.bus.receive(now, &mut self.inbox);
        for arrival in self.inbox.arrivals() {
            match arrival.content {
                Content::Frame(frame) => {
                    self.line.bring(now, &header(frame.id(), NORMAL, frame.payload().len()));
                    self.line.bring(now, frame.payload());
                }
                Content::Error(error) if error.class & ErrorFrame::PROTOCOL != 0 => {
                    self.line.bring_noise(now);
                }
                Content::Error(_) | Content::Refused(_) | Content::Unsupported(_) => {}
            }
        }
        self.line.hand_over(now, answers);
    }

    /// Sends the requests in the window to the bus, and drops damaged bytes. The window then has
    /// room for at least one byte.
    fn parse(&mut self, now: Instant) {
        loop {
            match self.start() {
                Start::Incomplete => return,
                Start::Request(payload) => {
                    self.bus.send(now, &[Frame::classic(self.addressee(), payload)]);
                    self.searching = false;
                    self.len = 0;
                }
                Start::Damage => {
                    if !core::mem::replace(&mut self.searching, true) {
                        self.complain(now);
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

    fn complain(&mut self, now: Instant) {
        let (motors, addressee) = (self.bus.motors(), self.addressee());
        let motor = motors.iter().find(|motor| motor.is_addressed(now, addressee));
        if let Some(host) = motor.map(Motor::host_address) {
            self.line.bring(now, &header(host, ACK, 0));
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
    use crate::{BusSettings, Medium, MotorSettings};

    const GET_VERSION: [u8; 12] = [0x01, 0x00, 0x08, 0x09, 0xB1, 0, 0, 0, 0, 0, 0, 0];
    /// Golden vector rs485_host0_r_version, except for the bytes of the version, which are those of
    /// the default settings.
    const VERSION: [u8; 12] = [0x00, 0x00, 0x08, 0x08, 0xB1, 0, 0, 0, 0x03, 0x02, 0x01, 0x00];

    fn slave() -> SerialSlave {
        let settings = BusSettings { medium: Medium::Serial, bitrate: 921_600, ..BusSettings::default() };
        let motor = MotorSettings { host_id: 0, ..MotorSettings::default() };
        SerialSlave::new(SimulatedBus::new(settings, vec![motor], 0), 0)
    }

    /// Returns the bytes that arrive within 10 ms of `received`.
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
    fn request_is_answered_with_documented_framing() {
        assert_eq!(answers(&mut slave(), &GET_VERSION), VERSION);
        assert!(matches!(slave().readiness(), Readiness::Never));
    }

    #[test]
    fn requests_may_arrive_in_pieces_and_glued() {
        let mut slave = slave();
        let mut out = Vec::new();
        slave.transact(Instant::ZERO, &GET_VERSION[..5], &mut out);
        slave.transact(Instant::ZERO, &[&GET_VERSION[5..], &GET_VERSION[..]].concat(), &mut out);
        slave.transact(Instant::from_nanos(10_000_000), &[], &mut out);
        assert_eq!(out, [VERSION, VERSION].concat());
    }

    #[test]
    fn damaged_header_is_answered_once() {
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
            // Noise can look like the start of a frame, and a pause does not end it. The first
            // request may then be its payload.
            let out = answers(&mut slave(), &[&noise[..len], &GET_VERSION, &GET_VERSION].concat());
            assert!(out.windows(12).any(|window| window == VERSION), "{noise:02X?} {len}");
        }
    }

    #[test]
    fn other_addresses_do_not_reach_the_motor() {
        let other = [0x02, 0x00, 0x08, 0x0A, 0xB1, 0, 0, 0, 0, 0, 0, 0];
        assert!(answers(&mut slave(), &other).is_empty());
        assert_eq!(answers(&mut slave(), &[0x01, 0x00, 0x07, 0x06]), [0x00, 0x01, 0x00, 0x01]);
    }

    fn inject(slave: &mut SerialSlave, what: &str) {
        let verb = format!("can0 {what}").parse().unwrap();
        slave.inject(Instant::ZERO, &verb).unwrap();
    }

    #[test]
    fn echoing_adapter_returns_request_before_answer() {
        let mut echoing = slave();
        inject(&mut echoing, "echo");
        assert_eq!(answers(&mut echoing, &GET_VERSION), [GET_VERSION, VERSION].concat());
        let mut mended = slave();
        inject(&mut mended, "echo");
        inject(&mut mended, "ok");
        assert_eq!(answers(&mut mended, &GET_VERSION), VERSION);
    }

    #[test]
    fn glued_answers_arrive_in_one_piece() {
        let mut slave = slave();
        inject(&mut slave, "glue 16ms");
        let mut read = Vec::new();
        for millisecond in 0..16 {
            let request = if millisecond % 5 == 0 { &GET_VERSION[..] } else { &[] };
            slave.transact(Instant::from_nanos(millisecond * 1_000_000), request, &mut read);
            assert!(read.is_empty(), "{millisecond} ms");
        }
        slave.transact(Instant::from_nanos(17_000_000), &[], &mut read);
        assert_eq!(read, [VERSION; 4].concat());
    }

    #[test]
    fn bad_line_corrupts_reproducibly_at_its_rate() {
        let damage = |verb: &str, seed| {
            let settings = BusSettings { medium: Medium::Serial, bitrate: 921_600, ..BusSettings::default() };
            let mut slave = SerialSlave::new(SimulatedBus::new(settings, Vec::new(), 0), seed);
            inject(&mut slave, "echo");
            inject(&mut slave, verb);
            answers(&mut slave, &[0xA5; 10_000])
        };
        let lost = 10_000 - damage("loss 10%", 1).len();
        assert!((800..1_200).contains(&lost), "{lost}");
        let changed = damage("corrupt 10%", 1).iter().filter(|byte| **byte != 0xA5).count();
        assert!((800..1_200).contains(&changed), "{changed}");
        assert_eq!(damage("corrupt 10%", 1), damage("corrupt 10%", 1));
        assert_ne!(damage("corrupt 10%", 1), damage("corrupt 10%", 2));
    }

    #[test]
    fn silent_line_moves_and_sends_nothing() {
        let mut slave = slave();
        inject(&mut slave, "silent");
        inject(&mut slave, "echo");
        let start = [0x01, 0x00, 0x08, 0x09, 0x91, 0, 0, 0, 0, 0, 0, 0];
        assert!(answers(&mut slave, &start).is_empty());
        assert_eq!(slave.bus().motors()[0].mode(), crate::Mode::Stopped);
    }

    #[test]
    fn unplugged_motor_reports_no_header() {
        let mut slave = slave();
        slave.inject(Instant::ZERO, &"motor off".parse().unwrap()).unwrap();
        assert!(answers(&mut slave, &[0x01, 0x00, 0x07, 0x06]).is_empty());
    }

    #[test]
    fn two_motors_with_one_id_overlap() {
        let settings = BusSettings { medium: Medium::Serial, bitrate: 921_600, ..BusSettings::default() };
        let motor =
            |name: &str| MotorSettings { name: name.into(), is_new: true, ..MotorSettings::default() };
        let mut slave = SerialSlave::new(SimulatedBus::new(settings, vec![motor("a"), motor("b")], 0), 0);
        let noise = answers(&mut slave, &GET_VERSION);
        assert!(noise.len() == 12 && noise != VERSION, "{noise:02X?}");
        let later = Instant::from_nanos(20_000_000);
        slave.inject(later, &"b off".parse().unwrap()).unwrap();
        let mut read = Vec::new();
        slave.transact(later, &GET_VERSION, &mut read);
        slave.transact(Instant::from_nanos(30_000_000), &[], &mut read);
        assert_eq!(read, VERSION);
    }
}
