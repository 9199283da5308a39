//! Another node on the wire. It encodes and decodes the kernel's frames independently, so that it
//! shares no error with the bus under test.

use std::io::{ErrorKind, Read, Write};

use motord_bus::conformance::Stimulus;
use motord_bus::{Frame, FrameId};
use socketcan::{CanFdSocket, CanSocket, Socket};

const ERROR: u32 = 0x2000_0000;
const REMOTE: u32 = 0x4000_0000;
const EXTENDED: u32 = 0x8000_0000;

pub(crate) struct Peer {
    interface: String,
    socket: CanSocket,
}

impl Peer {
    pub(crate) fn open(interface: &str) -> Self {
        let socket = CanSocket::open(interface).expect("the interface is there");
        socket.set_nonblocking(true).expect("any socket can be");
        Self { interface: interface.to_owned(), socket }
    }

    pub(crate) fn inject(&mut self, stimulus: Stimulus) -> bool {
        let bytes = match stimulus {
            Stimulus::Frame(frame) => classic(frame.id().raw(), frame.payload()),
            Stimulus::Extended(id) => classic(id.raw() | EXTENDED, &[0; 6]),
            Stimulus::Remote(id) => classic(id.raw() | REMOTE, &[]),
            Stimulus::Error(report) => classic(report.class | ERROR, &report.data),
            Stimulus::Fd(id) => return self.inject_fd(id),
        };
        self.write(&bytes)
    }

    /// Waits for the queue: a peer is another node, and the wire is slower than a loop.
    fn write(&mut self, bytes: &[u8]) -> bool {
        const ATTEMPTS: u32 = 1000;
        (0..ATTEMPTS).any(|_| {
            let written = self.socket.write(bytes).is_ok();
            if !written {
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            written
        })
    }

    fn inject_fd(&self, id: FrameId) -> bool {
        let mut bytes = [0; 72];
        bytes[..4].copy_from_slice(&id.raw().to_ne_bytes());
        bytes[4] = 8;
        CanFdSocket::open(&self.interface).is_ok_and(|mut socket| socket.write(&bytes).is_ok())
    }

    pub(crate) fn received(&mut self) -> Vec<Frame> {
        std::iter::from_fn(|| self.read()).collect()
    }

    fn read(&mut self) -> Option<Frame> {
        let mut bytes = [0; 16];
        match self.socket.read(&mut bytes) {
            Ok(16) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => return None,
            other => panic!("the peer reads {other:?}"),
        }
        let id = u32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let id = FrameId::new(u16::try_from(id).expect("a standard id")).expect("11 bits");
        Frame::new(id, &bytes[8..8 + usize::from(bytes[4])])
    }
}

/// `struct can_frame`: id and flags, length, three bytes of padding, data.
fn classic(word: u32, payload: &[u8]) -> [u8; 16] {
    let mut bytes = [0; 16];
    bytes[..4].copy_from_slice(&word.to_ne_bytes());
    bytes[4] = payload.len() as u8;
    bytes[8..8 + payload.len()].copy_from_slice(payload);
    bytes
}

/// Runs `tc` or `ip`, and returns whether it succeeded.
pub(crate) fn run(command: &str) -> bool {
    let mut words = command.split_whitespace();
    let program = words.next().expect("a command has a name");
    std::process::Command::new(program).args(words).status().is_ok_and(|status| status.success())
}

/// Delays every frame on `interface`, after `limit` of them.
pub(crate) fn stall(interface: &str, limit: u32) -> bool {
    run(&format!("tc qdisc replace dev {interface} root netem delay 200s limit {limit}"))
}

/// Lets frames pass; the delayed ones are dropped.
pub(crate) fn unstall(interface: &str) -> bool {
    run(&format!("tc qdisc del dev {interface} root"))
}
