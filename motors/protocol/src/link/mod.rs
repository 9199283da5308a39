//! A bus with one open request.

mod error;
mod format;
mod unprompted;

pub use error::{Error, MotorRefusal};
pub use format::Formats;
pub use unprompted::{LASTING, Unprompted};

use unprompted::reporting_motor;

use motord_bus::{Bus, Clock, Content, Duration, Frame, FrameId, Inbox, Instant, Refusal};

/// The kind of wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// CAN: an answer has the motor's host id.
    Can,
    /// RS485 or RS232: an answer does not identify its sender, so the bus gives it the id of the
    /// request.
    Serial,
}

/// Something that arrived on a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkEvent {
    /// A frame.
    Frame(Frame),
    /// The motor could not read the request.
    NotRead,
    /// Frames destroyed each other: two motors answered with one id.
    Collision,
}

/// A bus, its clock, and the time limit of an answer.
pub struct Link {
    bus: Box<dyn Bus>,
    clock: Box<dyn Clock + Send>,
    wire: Wire,
    timeout: Duration,
    inbox: Inbox,
    unprompted: Vec<Unprompted>,
    is_ambiguous: bool,
    formats: Formats,
    /// The open request has an id of 29 bits, and so have its answers.
    is_extended: bool,
}

/// Time limit on CAN: a CAN adapter on USB takes a few milliseconds.
const CAN_TIMEOUT: Duration = Duration::from_millis(25);
/// Time limit on a serial line: a USB adapter may wait for its latency timer, 16 ms, before it
/// delivers bytes.
const SERIAL_TIMEOUT: Duration = Duration::from_millis(60);
/// Longest time to listen on a serial line, to which only another master can send without a
/// request.
const SERIAL_LISTEN: Duration = Duration::from_millis(300);
/// Pause between two attempts to send on a full bus.
const PAUSE: Duration = Duration::from_millis(1);
/// Attempts for a request that may be repeated.
pub(crate) const ATTEMPTS: usize = 3;
/// Most reads that empty a receive buffer before a request.
const DRAINS_MAX: usize = 64;

/// The value that a reader found in the frames after a request; `None` where there is none.
pub(crate) type Asked<T> = Result<Option<T>, Error>;

/// Repeats a transaction until it returns a value, [`ATTEMPTS`] times at most.
///
/// # Errors
///
/// Those of the transaction.
pub(crate) fn repeat<T>(mut transact: impl FnMut() -> Asked<T>) -> Asked<T> {
    for _ in 0..ATTEMPTS {
        let found = transact()?;
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}

impl Link {
    /// Returns the link of a CAN bus that receives every id, or at least the host ids of the
    /// requested motors.
    #[must_use]
    pub fn can(bus: impl Bus + 'static, clock: impl Clock + Send + 'static) -> Self {
        Self::over(Box::new(bus), clock, Wire::Can)
    }

    /// Returns the link of a serial bus.
    #[must_use]
    pub fn serial(bus: impl Bus + 'static, clock: impl Clock + Send + 'static) -> Self {
        Self::over(Box::new(bus), clock, Wire::Serial)
    }

    /// Returns the link of a bus of this kind.
    #[must_use]
    pub fn over(bus: Box<dyn Bus>, clock: impl Clock + Send + 'static, wire: Wire) -> Self {
        let timeout = match wire {
            Wire::Can => CAN_TIMEOUT,
            Wire::Serial => SERIAL_TIMEOUT,
        };
        Self {
            bus,
            clock: Box::new(clock),
            wire,
            timeout,
            inbox: Inbox::new(),
            unprompted: Vec::new(),
            is_ambiguous: false,
            formats: Formats::default(),
            is_extended: false,
        }
    }

    /// Returns the link with another time limit for an answer.
    #[must_use]
    pub fn with_timeout(self, timeout: Duration) -> Self {
        Self { timeout, ..self }
    }

    /// Returns the bus, for another use.
    #[must_use]
    pub fn into_bus(self) -> Box<dyn Bus> {
        self.bus
    }

    /// Returns the kind of wire.
    #[must_use]
    pub fn wire(&self) -> Wire {
        self.wire
    }

    /// Returns the time limit of an answer.
    #[must_use]
    pub fn timeout(&self) -> Duration {
        self.timeout
    }

    /// Returns the drivers of other families that [`listen`](Self::listen) heard.
    #[must_use]
    pub fn unprompted(&self) -> &[Unprompted] {
        &self.unprompted
    }

    /// Returns the number of frames in formats that motord does not use, since the link was opened.
    #[must_use]
    pub const fn formats(&self) -> Formats {
        self.formats
    }

    /// Returns whether a frame that was taken for an answer may be the report of a driver of
    /// another family.
    pub(crate) fn is_ambiguous(&self) -> bool {
        self.is_ambiguous
    }

    /// Listens for `time`, and remembers the drivers that report without a request: their frames
    /// are no answers from now on. On a serial line no driver does.
    ///
    /// # Errors
    ///
    /// [`Error::InUse`] when other frames arrive; [`Error::Reports`] when all are reports of one
    /// motor.
    pub fn listen(&mut self, time: Duration) -> Result<(), Error> {
        let mut frames = Vec::new();
        let time = if self.wire == Wire::Serial { time.min(SERIAL_LISTEN) } else { time };
        let _end = self.receive(time, |event| {
            frames.extend(if let LinkEvent::Frame(frame) = event { Some(frame) } else { None });
            None::<()>
        })?;
        for driver in Unprompted::among(&frames) {
            if !self.unprompted.contains(&driver) {
                self.unprompted.push(driver);
            }
        }
        let is_other = |frame: &&Frame| !self.unprompted.iter().any(|driver| driver.sends(frame.id()));
        let others: Vec<&Frame> = frames.iter().filter(is_other).collect();
        let Some(id) = others.first().map(|frame| frame.id()) else { return Ok(()) };
        let count = others.len();
        Err(reporting_motor(&others).map_or(Error::InUse { id, count }, |motor| Error::Reports {
            motor,
            id,
            count,
        }))
    }

    /// Returns the time of the link's clock.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Sends `payload` to motor `id`. Passes every arrival to `read` until it returns a value, or
    /// `timeout` has passed. An echo of the request is not passed.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`] when the bus does not accept the frame.
    pub fn ask<T>(
        &mut self,
        id: u8,
        payload: [u8; 8],
        timeout: Duration,
        read: impl FnMut(LinkEvent) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        self.ask_frame(&Frame::classic(id_of(id), payload), timeout, read)
    }

    /// As [`ask`](Self::ask), for a request with any id. Its answers have ids of the same width;
    /// frames with others are not passed.
    pub(crate) fn ask_frame<T>(
        &mut self,
        request: &Frame,
        timeout: Duration,
        read: impl FnMut(LinkEvent) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        let is_echo = |frame: &Frame| (frame.id(), frame.payload()) == (request.id(), request.payload());
        self.transact(request, timeout, is_echo, read)
    }

    /// As [`ask_frame`](Self::ask_frame), for a request to a driver that reports by itself. Its answers
    /// may equal the request, so an echo is passed.
    pub(crate) fn ask_node<T>(
        &mut self,
        request: &Frame,
        timeout: Duration,
        read: impl FnMut(LinkEvent) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        let unprompted = std::mem::take(&mut self.unprompted);
        let answer = self.transact(request, timeout, |_| false, read);
        self.unprompted = unprompted;
        answer
    }

    fn transact<T>(
        &mut self,
        request: &Frame,
        timeout: Duration,
        is_echo: impl Fn(&Frame) -> bool,
        mut read: impl FnMut(LinkEvent) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        self.drain();
        self.send(request, timeout)?;
        let (unprompted, mut is_ambiguous) = (self.unprompted.clone(), false);
        self.is_extended = request.id().is_extended();
        let answer = self.receive(timeout, |event| match event {
            LinkEvent::Frame(frame) if is_echo(&frame) => None,
            LinkEvent::Frame(frame) if unprompted.iter().any(|driver| driver.sends(frame.id())) => None,
            event => {
                is_ambiguous |= matches!(event, LinkEvent::Frame(frame) if Unprompted::may_be(&frame));
                read(event)
            }
        });
        (self.is_ambiguous, self.is_extended) = (is_ambiguous, false);
        answer
    }

    /// Passes every arrival to `read` until it returns a value, or `timeout` has passed.
    ///
    /// # Errors
    ///
    /// None at present: an unplugged bus delivers nothing, and the next [`ask`](Self::ask) returns
    /// the error.
    pub fn receive<T>(
        &mut self,
        timeout: Duration,
        mut read: impl FnMut(LinkEvent) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        let deadline = self.clock.now() + timeout;
        loop {
            let before = self.clock.now();
            self.clock.wait(&[self.bus.readiness()], deadline);
            self.inbox.clear();
            self.bus.receive(self.clock.now(), &mut self.inbox);
            let Self { inbox, formats, is_extended, .. } = self;
            let found = inbox.arrivals().iter().filter_map(|arrival| {
                let is_other = is_of_other_width(&arrival.content, *is_extended);
                formats.note(&arrival.content, is_other);
                event(&arrival.content).filter(|_| !is_other)
            });
            let found = found.fold(None, |found: Option<T>, event| found.or_else(|| read(event)));
            if found.is_some() || before >= deadline {
                return Ok(found);
            }
        }
    }

    /// Lets `time` pass.
    pub fn pause(&mut self, time: Duration) {
        let _silence = self.receive(time, |_| None::<()>);
    }

    /// Drops the frames that have arrived so far.
    fn drain(&mut self) {
        for _ in 0..DRAINS_MAX {
            self.inbox.clear();
            self.bus.receive(self.clock.now(), &mut self.inbox);
            if self.inbox.arrivals().is_empty() {
                return;
            }
        }
    }

    /// Retries while the bus is full: a serial bus refuses while an earlier request may still be
    /// answered.
    fn send(&mut self, frame: &Frame, timeout: Duration) -> Result<(), Error> {
        let deadline = self.clock.now() + timeout.max(self.timeout);
        loop {
            let now = self.clock.now();
            match self.bus.send(now, &[*frame]).refusal {
                None => return Ok(()),
                Some(Refusal::Full) if now < deadline => self.pause(PAUSE),
                Some(refusal) => return Err(Error::Bus(refusal)),
            }
        }
    }
}

/// Returns the identifier of a command to motor `id`.
fn id_of(id: u8) -> FrameId {
    FrameId::new(u16::from(id)).unwrap_or(FrameId::MAX)
}

/// Returns whether the content is a frame whose id has another width than those of a request.
fn is_of_other_width(content: &Content, is_extended: bool) -> bool {
    matches!(content, Content::Frame(frame) if frame.id().is_extended() != is_extended)
}

fn event(content: &Content) -> Option<LinkEvent> {
    match content {
        Content::Frame(frame) => Some(LinkEvent::Frame(*frame)),
        Content::Refused(_) => Some(LinkEvent::NotRead),
        Content::Error(error) if error.class & motord_bus::ErrorFrame::PROTOCOL != 0 => {
            Some(LinkEvent::Collision)
        }
        Content::Error(_) | Content::Unsupported(_) => None,
    }
}
