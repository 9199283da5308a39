//! Ten million corrupted bytes on a serial line: no panic occurs, and the next reply is found. No
//! answer is accepted that contradicts its command or its numbers.
//!
//! Method: a pseudo terminal. Noise is random bytes, bytes like headers, damaged and truncated
//! replies, replies to other commands or motors, and ACK frames. The numbers that a reply repeats
//! are copied here from the document.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_bus::serial::{Address, SerialBus, Settings};
use motord_bus::{Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Sent};
use nix::pty::{OpenptyResult, openpty};
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;

const BYTES: usize = 10_000_000;
const TIMEOUT: Duration = Duration::from_millis(2);
/// Ids of three motors and their hosts.
const MOTORS: [(u8, u8); 3] = [(1, 0x41), (2, 0x42), (3, 0)];

/// Requests, and the number of bytes after the first that their replies repeat (GIM document 3.2.4
/// to 3.2.17).
const REQUESTS: [([u8; 8], usize); 8] = [
    ([0x84, 0x00, 0x11, 0, 0, 0, 0, 0], 2),
    ([0x84, 0x01, 0x03, 0, 0, 0, 0, 0], 2),
    ([0x91, 0, 0x80, 0, 0, 0, 0x08, 0], 0),
    ([0x92, 0, 0x80, 0, 0, 0, 0x08, 0], 0),
    ([0x93, 0, 0, 0xC0, 0x3F, 0, 0, 0], 0),
    ([0xA2, 0x02, 0, 0, 0, 0, 0, 0], 1),
    ([0xB2, 0, 0x80, 0, 0, 0, 0x08, 0], 0),
    ([0xB4, 0x13, 0, 0, 0, 0, 0, 0], 1),
];

/// Random numbers that are the same for a seed on every machine (SplitMix64, Steele, Lea and Flood
/// 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }
}

struct Line {
    motors: File,
    bus: SerialBus,
    _host: OwnedFd,
    now: Instant,
}

impl Line {
    fn new() -> Self {
        let OpenptyResult { master, slave } = openpty(None, None).unwrap();
        let bus = SerialBus::open(&Settings {
            device: nix::unistd::ttyname(&slave).unwrap().to_str().unwrap().to_owned(),
            baud: 921_600,
            addresses: MOTORS.map(|(id, host)| Address { id, host_id: Some(host) }).to_vec(),
            reply_timeout: TIMEOUT,
            answers: motord_protocol::gim::repeats,
        });
        Self {
            motors: master.into(),
            bus: bus.unwrap(),
            _host: slave,
            now: Instant::from_nanos(1_000_000_000),
        }
    }

    /// Sends a request once the previous one is given up.
    fn ask(&mut self, id: u8, payload: [u8; 8]) {
        self.now = self.now + TIMEOUT;
        assert_eq!(self.bus.send(self.now, &[Frame::classic(FrameId::from(id), payload)]), Sent::all(1));
        let mut request = [0; 12];
        self.motors.read_exact(&mut request).unwrap();
        assert_eq!(request, framed(id, payload));
    }

    /// Decodes `bytes` to frames and refusals.
    fn receive(&mut self, bytes: &[u8]) -> Vec<Content> {
        self.motors.write_all(bytes).unwrap();
        let mut received = Vec::new();
        // One read takes 256 bytes.
        for _ in 0..bytes.len().div_ceil(256) {
            let mut inbox = Inbox::new();
            self.bus.receive(self.now, &mut inbox);
            let contents = inbox.arrivals().iter().map(|arrival| arrival.content);
            received.extend(contents.filter(|content| !matches!(content, Content::Unsupported(_))));
        }
        received
    }
}

fn framed(receiver: u8, payload: [u8; 8]) -> [u8; 12] {
    let mut bytes = [receiver, 0, 8, receiver ^ 8, 0, 0, 0, 0, 0, 0, 0, 0];
    bytes[4..].copy_from_slice(&payload);
    bytes
}

/// A reply to `request` with random values.
fn reply((request, repeated): ([u8; 8], usize), random: &mut Random) -> [u8; 8] {
    let mut payload = random.next().to_le_bytes();
    payload[..=repeated].copy_from_slice(&request[..=repeated]);
    payload
}

fn pick<T: Copy>(random: &mut Random, of: &[T]) -> T {
    of[(random.next() % of.len() as u64) as usize]
}

/// Appends bytes that answer no request, but may resemble an answer.
fn noise(random: &mut Random, into: &mut Vec<u8>) {
    let (_, host) = pick(random, &MOTORS);
    let other = pick(random, &REQUESTS);
    let mut frame = framed(host, reply(other, random));
    let bit = 1 << (random.next() % 8);
    match random.next() % 6 {
        0 => into.extend(random.next().to_le_bytes()),
        1 => into.extend(random.next().to_le_bytes().map(|byte| byte % 10)),
        2 => {
            frame[(random.next() % 12) as usize] ^= bit;
            into.extend(frame);
        }
        3 => into.extend(&frame[..(random.next() % 12) as usize]),
        4 => into.extend(&frame[(random.next() % 12) as usize..]),
        _ => into.extend(framed(random.next() as u8, reply(other, random))),
    }
    // Noise often contains an ACK frame without a payload. It must not be accepted before the reply
    // that follows.
    if random.next().is_multiple_of(16) {
        into.extend([host, 1, 0, host ^ 1]);
    }
}

#[test]
fn corrupted_bytes_neither_hide_nor_forge_replies() {
    let (mut line, mut random) = (Line::new(), Random(485));
    let (mut total, mut found, mut forged, mut refused) = (0, 0, 0, 0);
    while total < BYTES {
        let ((id, host), request) = (pick(&mut random, &MOTORS), pick(&mut random, &REQUESTS));
        line.ask(id, request.0);
        let mut bytes = Vec::new();
        for _ in 0..random.next() % 16 {
            noise(&mut random, &mut bytes);
        }
        total += bytes.len();
        let answer = reply(request, &mut random);
        bytes.extend(framed(host, answer));
        let received = line.receive(&bytes);
        assert!(received.len() <= 1, "one request has one answer: {received:?}");
        match received.first() {
            Some(Content::Frame(frame)) => {
                assert_eq!(frame.id(), FrameId::from(id));
                let (payload, repeated) = (frame.payload(), request.1);
                assert_eq!(payload[..=repeated], request.0[..=repeated], "a false answer: {frame:?}");
                *(if payload == answer { &mut found } else { &mut forged }) += 1;
            }
            // The noise was longer than a read and ended with an ACK frame.
            Some(Content::Refused(refuser)) => {
                assert_eq!(*refuser, FrameId::from(id));
                refused += 1;
            }
            other => panic!("{bytes:02X?} hid the reply to {:02X?}: {other:?}", request.0),
        }
    }
    println!("{total} bytes: {found} replies found, {forged} forged beyond recognition, {refused} refused");
    assert!(found > 10 * (forged + refused));
}
