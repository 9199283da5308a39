//! Faults of a serial line and of the host's adapter: bytes that are lost, changed, echoed or late.

use crate::fault::Fault;
use crate::random::Random;
use motord_bus::{Duration, Instant};

/// A header and a payload.
const FRAME_BYTES: usize = 12;

/// Carries the bytes in both directions. Its seed determines which of them are lost or changed.
#[derive(Debug, Clone)]
pub(crate) struct Line {
    faults: Faults,
    random: Random,
    /// Bytes for the host that its adapter collects.
    held: Vec<u8>,
    handover: Instant,
}

/// The faults; none by default.
#[derive(Debug, Clone, Copy, Default)]
struct Faults {
    echo: bool,
    glue: Option<Duration>,
    loss: f64,
    corruption: f64,
    silent: bool,
}

impl Line {
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            faults: Faults::default(),
            random: Random::new(seed),
            held: Vec::new(),
            handover: Instant::FAR_FUTURE,
        }
    }

    /// Sets `fault` if it is one of a line, and returns `true` then.
    pub(crate) fn inject(&mut self, fault: Fault) -> bool {
        match fault {
            Fault::Echo => self.faults.echo = true,
            Fault::Glue(period) => self.faults.glue = Some(period),
            Fault::Loss(share) => self.faults.loss = share,
            Fault::Corruption(share) => self.faults.corruption = share,
            Fault::Silent => self.faults.silent = true,
            _ => return false,
        }
        true
    }

    pub(crate) fn recover(&mut self) {
        self.faults = Faults::default();
    }

    /// Returns the byte that arrives at the other end, if one does.
    pub(crate) fn carry(&mut self, byte: u8) -> Option<u8> {
        if self.faults.silent || self.happens(self.faults.loss) {
            return None;
        }
        // 1 to 255: a corrupted byte always differs.
        let change = if self.happens(self.faults.corruption) { self.random.next() % 255 + 1 } else { 0 };
        Some(byte ^ change as u8)
    }

    fn happens(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.random.fraction() < probability
    }

    /// Returns the bytes that the host has sent, when the adapter echoes.
    pub(crate) fn echo(&mut self, now: Instant, bytes: &[u8]) {
        if self.faults.echo {
            self.bring(now, bytes);
        }
    }

    /// Adds bytes on their way to the host.
    pub(crate) fn bring(&mut self, now: Instant, bytes: &[u8]) {
        for byte in bytes {
            if let Some(byte) = self.carry(*byte) {
                self.held.push(byte);
                self.handover = self.handover.min(now + self.faults.glue.unwrap_or(Duration::ZERO));
            }
        }
    }

    /// Adds noise of the length of a frame, on its way to the host.
    pub(crate) fn bring_noise(&mut self, now: Instant) {
        let noise = [self.random.next().to_le_bytes(), self.random.next().to_le_bytes()].concat();
        self.bring(now, &noise[..FRAME_BYTES]);
    }

    /// Appends the bytes that the host reads at `now`.
    pub(crate) fn hand_over(&mut self, now: Instant, read: &mut Vec<u8>) {
        if self.handover <= now {
            read.append(&mut self.held);
            self.handover = Instant::FAR_FUTURE;
        }
    }

    /// Returns the time at which the adapter delivers its bytes; [`Instant::FAR_FUTURE`] when it
    /// has none.
    pub(crate) fn handover(&self) -> Instant {
        self.handover
    }
}
