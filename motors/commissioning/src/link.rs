//! A bus with one open request.

use crate::error::Error;
use crate::time::Timer;
use motord_bus::{Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Refusal};

/// The kind of wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// CAN: an answer bears the motor's host id.
    Can,
    /// RS485 or RS232: an answer bears no sender, so the bus gives it the id that was asked.
    Serial,
}

/// Something that arrived on a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Heard {
    /// A frame.
    Frame(Frame),
    /// The motor could not read the request.
    NotRead,
    /// Frames destroyed each other: two motors answered with one id.
    Collision,
}

/// A bus, its clock, and how long an answer may take.
pub struct Link {
    bus: Box<dyn Bus>,
    timer: Box<dyn Timer>,
    wire: Wire,
    patience: Duration,
    inbox: Inbox,
}

/// A CAN adapter on USB takes a few milliseconds.
const CAN_PATIENCE: Duration = Duration::from_millis(25);
/// A serial adapter on USB may wait 16 ms, its latency timer, before it hands over what it received.
const SERIAL_PATIENCE: Duration = Duration::from_millis(60);
/// Between two tries of a bus that is full.
const PAUSE: Duration = Duration::from_millis(1);
/// Reads that empty a receive buffer before a request.
const DRAINS_MAX: usize = 64;

impl Link {
    /// A CAN bus that receives every id, or at least the host ids of the motors that are asked.
    #[must_use]
    pub fn can(bus: impl Bus + 'static, timer: impl Timer + 'static) -> Self {
        Self::over(Box::new(bus), timer, Wire::Can)
    }

    /// A serial bus.
    #[must_use]
    pub fn serial(bus: impl Bus + 'static, timer: impl Timer + 'static) -> Self {
        Self::over(Box::new(bus), timer, Wire::Serial)
    }

    /// A bus of this kind.
    #[must_use]
    pub fn over(bus: Box<dyn Bus>, timer: impl Timer + 'static, wire: Wire) -> Self {
        let patience = match wire {
            Wire::Can => CAN_PATIENCE,
            Wire::Serial => SERIAL_PATIENCE,
        };
        Self { bus, timer: Box::new(timer), wire, patience, inbox: Inbox::new() }
    }

    /// The same with another time for an answer.
    #[must_use]
    pub fn with_patience(self, patience: Duration) -> Self {
        Self { patience, ..self }
    }

    /// The bus, for another use.
    #[must_use]
    pub fn into_bus(self) -> Box<dyn Bus> {
        self.bus
    }

    /// The kind of wire.
    #[must_use]
    pub fn wire(&self) -> Wire {
        self.wire
    }

    /// How long an answer may take.
    #[must_use]
    pub fn patience(&self) -> Duration {
        self.patience
    }

    /// The time of the link's clock.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.timer.now()
    }

    /// Sends `payload` to motor `id`, and shows every arrival to `read` until it returns something, or `patience` has
    /// passed. An echo of the request is not shown.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`] when the bus does not take the frame.
    pub fn ask<T>(
        &mut self,
        id: u8,
        payload: [u8; 8],
        patience: Duration,
        mut read: impl FnMut(Heard) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        self.drain();
        let request = Frame::classic(id_of(id), payload);
        self.send(&request, patience)?;
        self.hear(patience, |heard| match heard {
            Heard::Frame(frame) if frame.payload() == payload => None,
            heard => read(heard),
        })
    }

    /// Shows every arrival to `read` until it returns something, or `patience` has passed.
    ///
    /// # Errors
    ///
    /// None at present: a bus that is gone stays silent, and the next [`ask`](Self::ask) tells why.
    pub fn hear<T>(
        &mut self,
        patience: Duration,
        mut read: impl FnMut(Heard) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        let deadline = self.timer.now() + patience;
        loop {
            let before = self.timer.now();
            self.timer.wait(self.bus.readiness(), deadline);
            self.inbox.clear();
            self.bus.receive(self.timer.now(), &mut self.inbox);
            let found = self
                .inbox
                .arrivals()
                .iter()
                .filter_map(|arrival| heard(&arrival.content))
                .find_map(&mut read);
            if found.is_some() || before >= deadline {
                return Ok(found);
            }
        }
    }

    /// Lets `time` pass.
    pub fn pause(&mut self, time: Duration) {
        let _silence = self.hear(time, |_| None::<()>);
    }

    /// Drops what has arrived so far.
    fn drain(&mut self) {
        for _ in 0..DRAINS_MAX {
            self.inbox.clear();
            self.bus.receive(self.timer.now(), &mut self.inbox);
            if self.inbox.arrivals().is_empty() {
                return;
            }
        }
    }

    /// A bus that is full is tried again: a serial bus refuses while an earlier request may still be answered.
    fn send(&mut self, frame: &Frame, patience: Duration) -> Result<(), Error> {
        let deadline = self.timer.now() + patience.max(self.patience);
        loop {
            let now = self.timer.now();
            match self.bus.send(now, &[*frame]).refusal {
                None => return Ok(()),
                Some(Refusal::Full) if now < deadline => self.pause(PAUSE),
                Some(refusal) => return Err(Error::Bus(refusal)),
            }
        }
    }
}

/// The identifier of a command to motor `id`.
fn id_of(id: u8) -> FrameId {
    FrameId::new(u16::from(id)).unwrap_or(FrameId::MAX)
}

fn heard(content: &Content) -> Option<Heard> {
    match content {
        Content::Frame(frame) => Some(Heard::Frame(*frame)),
        Content::Refused(_) => Some(Heard::NotRead),
        Content::Error(error) if error.class & motord_bus::ErrorFrame::PROTOCOL != 0 => {
            Some(Heard::Collision)
        }
        Content::Error(_) | Content::Unsupported(_) => None,
    }
}
