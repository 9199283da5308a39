//! A serial line on a pseudo terminal.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

#[path = "socketcan/counting.rs"]
mod counting;

use motord_bus::conformance::{Condition, Fixture, Stimulus};
use motord_bus::serial::framing::SerialFrame;
use motord_bus::serial::{Address, OpenError, SerialBus, SerialSender, Settings};
use motord_bus::{Bus, Content, Duration, Frame, FrameId, Inbox, Readiness, Refusal, Sent, clock, wait};
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::pty::{OpenptyResult, openpty};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd::ttyname;
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;

const TIMEOUT: Duration = Duration::from_millis(20);
const HOST: u8 = 0x40;
/// Bytes that a terminal would act on: interrupt, end of file, carriage return, line feed, XON,
/// XOFF, erase, and 0xFF.
const CONTROL_BYTES: [u8; 8] = [0x03, 0x04, 0x0D, 0x0A, 0x11, 0x13, 0x7F, 0xFF];

/// The end of the line with the motors.
struct Motors {
    end: File,
    device: String,
    /// Keeps the terminal alive while no other descriptor is open.
    own: Option<OwnedFd>,
}

impl Motors {
    fn new() -> Self {
        let OpenptyResult { master, slave } = openpty(None, None).unwrap();
        let mut modes = tcgetattr(&master).unwrap();
        cfmakeraw(&mut modes);
        tcsetattr(&master, SetArg::TCSANOW, &modes).unwrap();
        fcntl(&master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
        let device = ttyname(&slave).unwrap().to_str().unwrap().to_owned();
        Self { end: master.into(), device, own: Some(slave) }
    }

    fn settings(&self) -> Settings {
        let address = |id| Address { id, host_id: Some(HOST) };
        Settings {
            device: self.device.clone(),
            baud: 921_600,
            addresses: [1, 2].map(address).to_vec(),
            reply_timeout: TIMEOUT,
            answers: |request, reply| request[0] == reply[0],
        }
    }

    fn bus(&self) -> SerialBus {
        SerialBus::open(&self.settings()).unwrap()
    }

    fn received(&mut self) -> Vec<u8> {
        let mut bytes = vec![0; 4096];
        let count = self.end.read(&mut bytes).unwrap_or(0);
        bytes.truncate(count);
        bytes
    }

    fn send(&mut self, bytes: &[u8]) {
        self.end.write_all(bytes).unwrap();
    }

    fn reply(&mut self, payload: [u8; 8]) {
        let frame = SerialFrame::normal(HOST, payload);
        self.send(frame.write(&mut [0; 12]));
    }
}

fn frame(id: u8, payload: [u8; 8]) -> Frame {
    Frame::classic(FrameId::from(id), payload)
}

fn ask(bus: &mut SerialBus, id: u8) -> Sent {
    bus.send(clock::monotonic(), &[frame(id, [0xB1, 0, 0, 0, 0, 0, 0, 0])])
}

/// Returns the arrivals of one read, as soon as something has arrived or 50 ms have passed.
fn received(bus: &mut SerialBus) -> Vec<Content> {
    let now = clock::monotonic();
    let _something = wait(&[bus.readiness()], now, now + Duration::from_millis(50));
    let mut inbox = Inbox::new();
    bus.receive(clock::monotonic(), &mut inbox);
    inbox.arrivals().iter().map(|arrival| arrival.content).collect()
}

#[test]
fn every_byte_passes_unchanged_in_both_directions() {
    let mut motors = Motors::new();
    let mut bus = motors.bus();
    assert_eq!(bus.send(clock::monotonic(), &[frame(1, CONTROL_BYTES)]), Sent::all(1));
    assert_eq!(motors.received(), [&[0x01, 0x00, 0x08, 0x09][..], &CONTROL_BYTES].concat());
    motors.reply(CONTROL_BYTES);
    assert_eq!(received(&mut bus), [Content::Frame(frame(1, CONTROL_BYTES))]);
}

#[test]
fn one_request_is_open_and_late_one_yields() {
    let motors = Motors::new();
    let mut bus = motors.bus();
    let refused = Sent { accepted: 0, refusal: Some(Refusal::Full) };
    let now = clock::monotonic();
    let both = [frame(1, [0x92; 8]), frame(2, [0x92; 8])];
    assert_eq!(bus.send(now, &both), Sent { accepted: 1, refusal: Some(Refusal::Full) });
    assert_eq!(bus.send(now + TIMEOUT / 2, &both[1..]), refused);
    assert_eq!(bus.send(now + TIMEOUT, &both[1..]), Sent::all(1));
    assert_eq!(bus.send(now + TIMEOUT, &[]), Sent::all(0));
}

#[test]
fn unsendable_frame_is_refused_by_line() {
    let mut motors = Motors::new();
    let mut bus = motors.bus();
    let refused = Sent { accepted: 0, refusal: Some(Refusal::Error(22)) };
    assert_eq!(bus.send(clock::monotonic(), &[Frame::classic(FrameId::MAX, [0; 8])]), refused);
    assert_eq!(bus.send(clock::monotonic(), &[Frame::new(FrameId::from(1), &[0; 6]).unwrap()]), refused);
    assert_eq!(motors.received(), []);
}

#[test]
fn replies_arrive_in_pieces_and_behind_echo() {
    let mut motors = Motors::new();
    let mut bus = motors.bus();
    assert_eq!(ask(&mut bus, 2), Sent::all(1));
    let echo = motors.received();
    motors.send(&echo[..7]);
    assert_eq!(received(&mut bus), []);
    let reply = SerialFrame::normal(HOST, [0xB1, 0, 0, 0, 1, 2, 3, 4]);
    let reply = [&echo[7..], reply.write(&mut [0; 12])].concat();
    motors.send(&reply[..9]);
    assert_eq!(received(&mut bus), []);
    motors.send(&reply[9..]);
    assert_eq!(received(&mut bus), [Content::Frame(frame(2, [0xB1, 0, 0, 0, 1, 2, 3, 4]))]);
}

#[test]
fn flood_costs_one_buffer_and_hides_nothing() {
    let mut motors = Motors::new();
    let mut bus = motors.bus();
    ask(&mut bus, 1);
    motors.send(&[0x55; 1000]);
    motors.reply([0xB1; 8]);
    let mut arrivals = Vec::new();
    for reads in 1.. {
        let arrived = received(&mut bus);
        assert!(arrived.len() <= 2 && reads < 10, "{arrived:?}");
        arrivals.extend(arrived);
        if arrivals.contains(&Content::Frame(frame(1, [0xB1; 8]))) {
            break;
        }
    }
}

#[test]
fn bytes_from_before_opening_are_discarded() {
    let mut motors = Motors::new();
    drop(motors.bus());
    motors.reply([0xB1; 8]);
    let mut bus = motors.bus();
    ask(&mut bus, 1);
    assert_eq!(received(&mut bus), []);
}

#[test]
fn unplugged_adapter_fails_sender_and_reader() {
    for reads_first in [true, false] {
        let mut motors = Motors::new();
        let (mut bus, settings) = (motors.bus(), motors.settings());
        let sender = SerialSender::open(&settings.device, settings.baud).unwrap();
        assert!(!sender.is_disconnected());
        motors.own = None;
        drop(motors);
        if reads_first {
            assert_eq!(received(&mut bus), []);
            assert!(matches!(bus.readiness(), Readiness::Never), "nothing will ever come");
        }
        for _ in 0..3 {
            assert_eq!(ask(&mut bus, 1), Sent { accepted: 0, refusal: Some(Refusal::Gone) });
        }
        assert!(sender.is_disconnected());
        assert_eq!(sender.send(&frame(1, [0; 8])), Err(Refusal::Gone));
        assert!(matches!(SerialBus::open(&settings), Err(OpenError::Missing { .. })));
    }
}

#[test]
fn blocked_port_refuses_and_never_sends_partially() {
    let motors = Motors::new();
    let mut bus = motors.bus();
    let mut now = clock::monotonic();
    let begun = now;
    let refusal = (0..20_000).find_map(|_| {
        now = now + TIMEOUT;
        bus.send(now, &[frame(1, [0x92; 8])]).refusal
    });
    assert!(clock::monotonic().since(begun) < Duration::from_secs(5), "sending blocked");
    assert!(matches!(refusal, Some(Refusal::Full | Refusal::Gone)), "{refusal:?}");
}

#[test]
fn port_has_one_owner_beside_the_switch() {
    let mut motors = Motors::new();
    let settings = motors.settings();
    let first = motors.bus();
    let held = SerialBus::open(&settings).err();
    assert_eq!(held, Some(OpenError::Held { device: settings.device.clone() }));
    let sender = SerialSender::open(&settings.device, settings.baud).unwrap();
    sender.send(&frame(2, [0x92, 0, 0x80, 0, 0, 0, 8, 0])).unwrap();
    assert_eq!(motors.received(), [0x02, 0x00, 0x08, 0x0A, 0x92, 0, 0x80, 0, 0, 0, 8, 0]);
    drop(first);
    drop(motors.bus());
}

#[test]
fn port_runs_at_requested_odd_rate() {
    let motors = Motors::new();
    for baud in [115_200, 921_600, 2_000_000, 250_000, 1_234_567] {
        let bus = SerialBus::open(&Settings { baud, ..motors.settings() }).unwrap();
        let modes = rustix::termios::tcgetattr(motors.own.as_ref().unwrap()).unwrap();
        assert_eq!((modes.output_speed(), modes.input_speed()), (baud, baud));
        drop(bus);
    }
}

#[test]
fn files_that_are_no_ports_are_refused() {
    let open = |device: &str| {
        SerialBus::open(&Settings { device: device.into(), ..Motors::new().settings() }).err().unwrap()
    };
    assert!(matches!(open("/dev/null"), OpenError::NotSerial { .. }));
    assert!(matches!(open("/dev/motord-is-not-here"), OpenError::Missing { .. }));
    assert!(open("/dev/null").to_string().starts_with("/dev/null"));
}

/// A line whose motors can be disconnected.
struct Pty {
    motors: Option<Motors>,
    bus: SerialBus,
}

impl Pty {
    fn new() -> Self {
        let motors = Motors::new();
        let bus = motors.bus();
        Self { motors: Some(motors), bus }
    }
}

impl Fixture for Pty {
    fn bus(&mut self) -> &mut dyn Bus {
        &mut self.bus
    }

    fn inject(&mut self, stimulus: Stimulus) -> bool {
        let Stimulus::Frame(frame) = stimulus else { return false };
        let Some(motors) = &mut self.motors else { return false };
        motors.reply(frame.payload().try_into().unwrap());
        true
    }

    fn received(&mut self) -> Vec<Frame> {
        let received = self.motors.as_mut().unwrap().received();
        let frames = received.chunks(12).map(|bytes| SerialFrame::decode(bytes).unwrap());
        frames.map(|it| frame(it.receiver(), it.payload().try_into().unwrap())).collect()
    }

    fn allocations(&self) -> Option<u64> {
        Some(counting::allocations())
    }

    fn set(&mut self, condition: Condition) -> bool {
        if condition == Condition::Gone {
            self.motors = None;
        }
        condition == Condition::Gone
    }
}

motord_bus::conformance! {
    []
    mod pty = Pty::new;
    unplugged_bus_is_reported,
    a_running_bus_allocates_nothing,
}
