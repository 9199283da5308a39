//! Damps and stops the motors when no cycle controls them.
//!
//! | process | on | until |
//! |---|---|---|
//! | the cycle's thread, after a panic in the cycle | the buses of the cycle | every bus is served, or [`REFUSAL_TIMEOUT`] |
//! | the dead man's switch, after the daemon exits | separate CAN sockets and serial ports | every bus is served |
//! | `motord safe-stop`, after both exit | separate CAN sockets and serial ports | every bus is served, or [`REFUSAL_TIMEOUT`] |
//!
//! A [`Stopper`] uses frames only: no protocol, no joint, no state of the daemon. Each bus has
//! separate [`BusFrames`] and a separate [`Schedule`], so a bus that accepts nothing delays no
//! other.

pub mod schedule;

use crate::drive::safe_frames;
use motord_bus::{Clock, Duration, Frame, Instant, Refusal};
use motord_settings::settings::Settings;
use schedule::{SafeFrame, Schedule};

/// Time after the damping during which [`Stopper::run`] serves a bus that refuses frames.
pub const REFUSAL_TIMEOUT: Duration = Duration::from_secs(1);
/// The least time between two searches for a missing interface. One search can take longer than a
/// round.
const SEARCH_INTERVAL: Duration = Duration::from_millis(50);

/// Sends the frames of one bus.
pub trait Outlet: Send {
    /// Sends one frame to each motor. Returns the reason if the bus did not accept all of them.
    /// Neither allocates nor blocks.
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal>;

    /// Searches the interface after [`Refusal::Gone`]. Returns whether it is available. Does not
    /// allocate; may wait while another process configures interfaces.
    fn find(&mut self) -> bool {
        false
    }
}

impl<O: Outlet + ?Sized> Outlet for Box<O> {
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        (**self).send_round(now, frames)
    }

    fn find(&mut self) -> bool {
        (**self).find()
    }
}

/// The rounds of one bus.
struct BusStop {
    frames: BusFrames,
    /// `None` until the stopper begins.
    schedule: Option<Schedule>,
    /// The reason of the last refused round.
    refusal: Option<Refusal>,
    /// Time of the last search for the interface.
    last_search: Option<Instant>,
}

impl BusStop {
    fn new(frames: BusFrames) -> Self {
        Self { frames, schedule: None, refusal: None, last_search: None }
    }

    fn due(&self) -> Option<Instant> {
        self.schedule?.due()
    }

    /// Sends the due frames.
    fn send(&mut self, now: Instant, outlet: &mut impl Outlet) {
        let Some(schedule) = self.schedule else { return };
        let Some(order) = schedule.order(now) else { return };
        let frames = match order {
            SafeFrame::Damp => &self.frames.damp[schedule.turn()],
            SafeFrame::Stop => &self.frames.stop,
        };
        self.refusal = outlet.send_round(now, frames);
    }

    /// Returns whether frames are due on a missing interface, and [`SEARCH_INTERVAL`] has passed.
    fn needs_search(&self, now: Instant) -> bool {
        let is_missing = self.refusal == Some(Refusal::Gone) && self.due().is_some_and(|due| due <= now);
        is_missing && self.last_search.is_none_or(|before| now.since(before) >= SEARCH_INTERVAL)
    }

    /// Searches the interface, and sends the due frames if it is available.
    fn search(&mut self, now: Instant, outlet: &mut impl Outlet) {
        self.last_search = Some(now);
        if outlet.find() {
            self.send(now, outlet);
        }
    }

    fn end_round(&mut self, now: Instant) {
        let waits_for_search = self.needs_search(now);
        match self.schedule.as_mut().filter(|schedule| schedule.order(now).is_some()) {
            Some(schedule) if waits_for_search => schedule.skip(now),
            Some(schedule) => schedule.record(self.refusal.is_none(), now),
            None => {}
        }
    }
}

/// Damps and stops the motors of several buses, in rounds of one frame per motor.
///
/// The outlets of the buses are arguments, in the order of the frames: the cycle lends its buses
/// after a panic.
pub struct Stopper {
    buses: Vec<BusStop>,
    damp: Duration,
}

impl Stopper {
    /// Creates a stopper that damps for `damp`. No frame is due before [`begin`](Self::begin).
    /// Allocates; nothing after it does.
    #[must_use]
    pub fn new(frames: impl IntoIterator<Item = BusFrames>, damp: Duration) -> Self {
        Self { buses: frames.into_iter().map(BusStop::new).collect(), damp }
    }

    /// Begins the damping and the stops of every bus at `now`.
    pub fn begin(&mut self, now: Instant) {
        for bus in &mut self.buses {
            bus.schedule = Some(Schedule::begin(self.damp, now));
        }
    }

    /// Returns when the next [`round`](Self::round) is due; `None` when every bus is served.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        self.buses.iter().filter_map(BusStop::due).min()
    }

    /// Returns the indices of the buses that are not served yet.
    pub fn unserved(&self) -> impl Iterator<Item = usize> {
        let unserved = self.buses.iter().enumerate().filter(|(_, bus)| bus.due().is_some());
        unserved.map(|(index, _)| index)
    }

    /// Returns whether every bus that is not served refused its last round, after the regular end
    /// of its damping.
    #[must_use]
    pub fn is_stalled(&self) -> bool {
        self.buses.iter().filter_map(|bus| bus.schedule).all(|it| it.due().is_none() || it.is_slow())
    }

    /// Sends the frames that are due at `now` on every bus. Then searches one missing interface:
    /// the one whose last search is oldest. A refused round is due again.
    ///
    /// Does not allocate. One [`send_round`](Outlet::send_round) per bus, and one more after a
    /// search. Only the search can block.
    pub fn round(&mut self, now: Instant, outlets: &mut [impl Outlet]) {
        for (bus, outlet) in self.buses.iter_mut().zip(&mut *outlets) {
            bus.send(now, outlet);
        }
        let missing = self.buses.iter_mut().zip(outlets).filter(|(bus, _)| bus.needs_search(now));
        if let Some((bus, outlet)) = missing.min_by_key(|(bus, _)| bus.last_search) {
            bus.search(now, outlet);
        }
        for bus in &mut self.buses {
            bus.end_round(now);
        }
    }

    /// Begins, and returns when every bus is served, at most [`REFUSAL_TIMEOUT`] after the damping.
    /// The buses that are not served by then get one more round, to stop their motors. Does not
    /// allocate. Blocks in the clock, and where [`round`](Self::round) does.
    pub fn run(&mut self, clock: &mut dyn Clock, outlets: &mut [impl Outlet]) {
        let begin = clock.now();
        self.begin(begin);
        let end = begin + self.damp + REFUSAL_TIMEOUT;
        while let Some(due) = self.due().filter(|due| *due < end) {
            clock.sleep_until(due);
            self.round(clock.now(), outlets);
        }
        self.stop_unserved(clock.now(), outlets);
    }

    /// Sends one round of stops to every bus that is not served. A bus that accepts only a part of
    /// every round never reaches its stops, but that part of its motors can be stopped.
    fn stop_unserved(&self, now: Instant, outlets: &mut [impl Outlet]) {
        let unserved = self.buses.iter().zip(outlets).filter(|(bus, _)| bus.due().is_some());
        for (bus, outlet) in unserved {
            let _refused = outlet.send_round(now, &bus.frames.stop);
        }
    }
}

/// The safe frames of one bus.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct BusFrames {
    /// One frame per motor that damps it, twice: rounds send the two in turn, so that their
    /// rounding errors cancel. For a GIM motor both are the frame that stops it: one that brakes it
    /// would be full torque to a motor in MIT mode.
    pub damp: [Vec<Frame>; 2],
    /// One frame per motor that stops it.
    pub stop: Vec<Frame>,
}

impl BusFrames {
    /// Returns the safe frames of the motors on the bus with this index. Allocates.
    #[must_use]
    pub fn of(settings: &Settings, bus: usize) -> Self {
        let motors = settings.motors.iter().filter(|motor| motor.bus == bus);
        let (damp, stop): (Vec<_>, _) = motors.filter_map(safe_frames).unzip();
        Self { damp: [0, 1].map(|turn| damp.iter().map(|frames| frames[turn]).collect()), stop }
    }

    /// Returns the number of frames in the largest round.
    #[must_use]
    pub fn most(&self) -> usize {
        self.damp.iter().chain([&self.stop]).map(Vec::len).max().unwrap_or(0)
    }

    /// Returns whether `frame` is one of them. Does not allocate; bounded by their number.
    #[must_use]
    pub fn contains(&self, frame: &Frame) -> bool {
        self.damp.iter().chain([&self.stop]).any(|frames| frames.contains(frame))
    }
}

/// A round on a serial line, which carries one request at a time. Each call sends the frame of one
/// motor. The round is complete after the frame of the last motor.
#[derive(Debug, Clone, Copy, Default)]
pub struct LineRound {
    next: usize,
}

impl LineRound {
    /// Sends the next frame by `send`, which returns the reason of a refusal. Returns the reason
    /// why the round is not complete. Does not allocate or block, if `send` does not.
    pub fn send(
        &mut self,
        frames: &[Frame],
        send: impl FnOnce(&[Frame]) -> Option<Refusal>,
    ) -> Option<Refusal> {
        if self.next >= frames.len() {
            self.next = 0;
        }
        let refusal = send(frames.get(self.next..=self.next).unwrap_or_default());
        if refusal.is_none() {
            self.next += 1;
        }
        let is_taken = self.next >= frames.len();
        refusal.or((!is_taken).then_some(Refusal::Full))
    }
}
