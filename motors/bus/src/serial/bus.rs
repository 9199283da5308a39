//! A serial line as a [`Bus`].

use super::line::{ByteStream, Line, Request};
use super::port::{OpenError, Port, Use};
use super::{Address, Settings};
use crate::frame::{Arrival, Frame, Inbox};
use crate::time::Instant;
use crate::{Bus, Readiness, Refusal, Sent};
use nix::errno::Errno;

/// Bytes of one read: more than a line at 921 600 bit/s carries in a cycle of 1 ms.
const READ_BYTES: usize = 256;
/// Most arrivals of one read: a reply or a refusal, and the report of other bytes.
const ARRIVALS: usize = 2;

/// A serial line.
pub struct SerialBus<S = Port> {
    port: S,
    line: Line,
    buffer: [u8; READ_BYTES],
    /// The adapter was unplugged, or took only part of a frame, which the next bytes would
    /// complete.
    is_disconnected: bool,
}

impl SerialBus {
    /// Opens and configures the port. Not for the real-time thread: it allocates, and takes
    /// milliseconds. After [`Refusal::Gone`], close it and open it again.
    ///
    /// # Errors
    ///
    /// The reason for which the port cannot be used.
    pub fn open(settings: &Settings) -> Result<Self, OpenError> {
        Ok(Self::over(Port::open(&settings.device, settings.baud, Use::Exclusive)?, settings))
    }
}

impl<S: ByteStream> SerialBus<S> {
    /// Returns a bus over any byte stream `port`, such as that of a test on virtual time.
    /// Allocates.
    #[must_use]
    pub fn over(port: S, settings: &Settings) -> Self {
        Self { port, line: Line::new(settings), buffer: [0; READ_BYTES], is_disconnected: false }
    }

    /// Sends a request, if the line is free. Makes one system call, and a second one after a
    /// request without a reply. The bytes of that request may still wait for an adapter, and a
    /// frame behind them would be late.
    fn ask(&mut self, now: Instant, frame: &Frame) -> Result<(), Refusal> {
        if self.is_disconnected {
            return Err(Refusal::Gone);
        }
        if self.line.is_busy(now) || self.line.leaves_out_a_turn() {
            return Err(Refusal::Full);
        }
        let request = self.line.request(frame).ok_or(Refusal::Error(libc::EINVAL))?;
        if self.line.is_unanswered() && self.port.unsent().map_err(refusal)? > 0 {
            return Err(Refusal::Full);
        }
        write(&self.port, &request)?;
        self.line.sent(request, now);
        Ok(())
    }
}

impl<S: ByteStream> Bus for SerialBus<S> {
    /// Sends at most the first frame, and refuses the others with [`Refusal::Full`]. One system
    /// call, or two after a request without a reply.
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        let Some(frame) = frames.first() else { return Sent::all(0) };
        let asked = self.ask(now, frame);
        self.is_disconnected |= asked == Err(Refusal::Gone);
        match asked {
            Ok(()) => Sent { accepted: 1, refusal: (frames.len() > 1).then_some(Refusal::Full) },
            Err(refusal) => Sent { accepted: 0, refusal: Some(refusal) },
        }
    }

    /// One `read`. The kernel does not stamp the bytes of a serial port: an arrival has the time of
    /// the read.
    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        if self.is_disconnected || inbox.free() < ARRIVALS {
            return;
        }
        let count = match self.port.read(&mut self.buffer) {
            Ok(count) => count,
            Err(Errno::EAGAIN | Errno::EINTR) => return,
            Err(_) => 0,
        };
        self.is_disconnected = count == 0;
        let Self { line, buffer, .. } = self;
        let reply = buffer[..count].iter().filter_map(|byte| line.push(*byte)).last();
        let is_reply = reply.is_some_and(|reply| {
            inbox.push_frame(now, |frame| {
                reply.write(frame);
                true
            })
        });
        let refusal = if is_reply { None } else { line.refusal() };
        for content in [refusal, line.unmatched()].into_iter().flatten() {
            inbox.push(Arrival { at: now, content }).expect("there is space for them");
        }
    }

    fn readiness(&self) -> Readiness<'_> {
        if self.is_disconnected { Readiness::Never } else { self.port.readiness() }
    }
}

/// Sends to the motors of a line in parallel to the process that owns it, and reads nothing. For
/// the stop of motors whose daemon has died.
#[derive(Debug)]
pub struct SerialSender(Port);

impl SerialSender {
    /// Opens the port as its owner does, but neither locks it nor discards waiting bytes.
    /// Allocates, and takes milliseconds.
    ///
    /// # Errors
    ///
    /// The reason for which the port cannot be used.
    pub fn open(device: &str, baud: u32) -> Result<Self, OpenError> {
        Port::open(device, baud, Use::Shared).map(Self)
    }

    /// Sends one frame, unless bytes before it have not left. Never blocks; two system calls.
    ///
    /// # Errors
    ///
    /// The reason for which it was not sent. After [`Refusal::Gone`], close the port and open it
    /// again.
    pub fn send(&self, frame: &Frame) -> Result<(), Refusal> {
        let request = frame.id().byte().and_then(|id| Request::new(Address { id, host_id: None }, frame));
        let request = request.ok_or(Refusal::Error(libc::EINVAL))?;
        if self.0.unsent().map_err(refusal)? > 0 {
            return Err(Refusal::Full);
        }
        write(&self.0, &request)
    }

    /// Returns `true` when the adapter was unplugged. While this port stays open, an adapter that
    /// is plugged in again gets another device name. Never blocks; one system call.
    #[must_use]
    pub fn is_disconnected(&self) -> bool {
        self.0.is_disconnected()
    }
}

/// Writes a whole request. When the port takes only part of it, the next bytes would complete it.
/// The refusal is then [`Refusal::Gone`], because the port has to be opened again.
fn write(port: &impl ByteStream, request: &Request) -> Result<(), Refusal> {
    match port.write(request.bytes()) {
        Ok(count) if count == request.bytes().len() => Ok(()),
        Ok(_) => Err(Refusal::Gone),
        Err(errno) => Err(refusal(errno)),
    }
}

fn refusal(errno: Errno) -> Refusal {
    match errno {
        Errno::EAGAIN | Errno::EINTR => Refusal::Full,
        Errno::EIO | Errno::ENXIO | Errno::ENODEV | Errno::EPIPE => Refusal::Gone,
        other => Refusal::Error(other as i32),
    }
}
