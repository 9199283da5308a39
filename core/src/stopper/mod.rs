//! Damps and stops the motors when nobody else does.
//!
//! | who | on | until |
//! |---|---|---|
//! | the cycle's thread, after a panic in the cycle | the buses of the cycle | every bus is served, or [`PATIENCE`] |
//! | the dead man's switch, after the daemon's death | CAN sockets of its own | every bus is served |
//! | `motord safe-stop`, after the death of both | CAN sockets of its own | every bus is served, or [`PATIENCE`] |
//!
//! A [`Stopper`] knows frames only: no protocol, no joint, no state of the daemon. Each bus has its [`BusFrames`] and a
//! [`Schedule`] of its own, so a bus that takes nothing delays no other.

pub mod schedule;

mod frames;

pub use frames::BusFrames;

use crate::clock::Clock;
use motord_bus::{Duration, Frame, Instant, Refusal};
use schedule::{Order, Schedule};

/// How much longer than the damping [`Stopper::run`] serves a bus that refuses frames.
pub const PATIENCE: Duration = Duration::from_secs(1);
/// The least time between two searches for a missing interface. One search can take longer than a round.
const SEARCH_INTERVAL: Duration = Duration::from_millis(50);

/// Sends the frames of one bus.
pub trait Outlet: Send {
    /// Sends one frame to each motor. Returns why the bus did not take all of them. Neither allocates nor blocks.
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal>;

    /// Looks for the interface after [`Refusal::Gone`]. Returns whether it is there again. Does not allocate; may wait
    /// while another process configures interfaces.
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
    /// Why the last round was not taken.
    refusal: Option<Refusal>,
    /// When the interface was last looked for.
    sought: Option<Instant>,
}

impl BusStop {
    fn new(frames: BusFrames) -> Self {
        Self { frames, schedule: None, refusal: None, sought: None }
    }

    fn due(&self) -> Option<Instant> {
        self.schedule?.due()
    }

    /// Sends what is due.
    fn send(&mut self, now: Instant, outlet: &mut impl Outlet) {
        let Some(order) = self.schedule.and_then(|schedule| schedule.order(now)) else { return };
        let frames = match order {
            Order::Damp => &self.frames.damp,
            Order::Stop => &self.frames.stop,
        };
        self.refusal = outlet.send_round(now, frames);
    }

    /// Whether frames are due on an interface that is missing, and the last search is long enough ago.
    fn needs_search(&self, now: Instant) -> bool {
        let is_missing = self.refusal == Some(Refusal::Gone) && self.due().is_some_and(|due| due <= now);
        is_missing && self.sought.is_none_or(|before| now.since(before) >= SEARCH_INTERVAL)
    }

    /// Looks for the interface, and sends what is due if it is there again.
    fn search(&mut self, now: Instant, outlet: &mut impl Outlet) {
        self.sought = Some(now);
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
/// The outlets of the buses are arguments, in the order of the frames that the stopper was made with: the cycle lends its
/// own buses after a panic.
pub struct Stopper {
    buses: Vec<BusStop>,
    damp: Duration,
}

impl Stopper {
    /// A stopper that damps for `damp`. Nothing is due before it [begins](Self::begin). Allocates; nothing after it does.
    #[must_use]
    pub fn new(frames: impl IntoIterator<Item = BusFrames>, damp: Duration) -> Self {
        Self { buses: frames.into_iter().map(BusStop::new).collect(), damp }
    }

    /// From `now` on every bus is owed its damping and its stops.
    pub fn begin(&mut self, now: Instant) {
        for bus in &mut self.buses {
            bus.schedule = Some(Schedule::begin(self.damp, now));
        }
    }

    /// When the next [`round`](Self::round) is due; `None` when every bus is served.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        self.buses.iter().filter_map(BusStop::due).min()
    }

    /// The indices of the buses that are not served yet.
    pub fn owed(&self) -> impl Iterator<Item = usize> {
        let owed = self.buses.iter().enumerate().filter(|(_, bus)| bus.due().is_some());
        owed.map(|(index, _)| index)
    }

    /// Whether every bus that is not served has refused frames for longer than its motors would have been damped.
    #[must_use]
    pub fn is_stalled(&self) -> bool {
        self.buses.iter().filter_map(|bus| bus.schedule).all(|it| it.due().is_none() || it.is_slow())
    }

    /// Sends what is due at `now` on every bus. Only then looks for one missing interface, the one that was looked for
    /// least recently. A round that a bus refuses is lost, and due again.
    ///
    /// Does not allocate. One [`send_round`](Outlet::send_round) per bus, and one more after a search. Only the search can block.
    pub fn round(&mut self, now: Instant, outlets: &mut [impl Outlet]) {
        for (bus, outlet) in self.buses.iter_mut().zip(&mut *outlets) {
            bus.send(now, outlet);
        }
        let missing = self.buses.iter_mut().zip(outlets).filter(|(bus, _)| bus.needs_search(now));
        if let Some((bus, outlet)) = missing.min_by_key(|(bus, _)| bus.sought) {
            bus.search(now, outlet);
        }
        for bus in &mut self.buses {
            bus.end_round(now);
        }
    }

    /// Begins, and returns when every bus is served, at most [`PATIENCE`] after the damping. The buses that are not served by
    /// then get one more round, to stop their motors. Does not allocate. Blocks in the clock, and where
    /// [`round`](Self::round) does.
    pub fn run(&mut self, clock: &mut impl Clock, outlets: &mut [impl Outlet]) {
        let begin = clock.now();
        self.begin(begin);
        let end = begin + self.damp + PATIENCE;
        while let Some(due) = self.due().filter(|due| *due < end) {
            clock.sleep_until(due);
            self.round(clock.now(), outlets);
        }
        self.stop_owed(clock.now(), outlets);
    }

    /// A bus that takes a part of every round never comes to its stops, but that part of its motors can be stopped.
    fn stop_owed(&self, now: Instant, outlets: &mut [impl Outlet]) {
        let owed = self.buses.iter().zip(outlets).filter(|(bus, _)| bus.due().is_some());
        for (bus, outlet) in owed {
            let _refused = outlet.send_round(now, &bus.frames.stop);
        }
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_types, reason = "the buses of a test share a log")]
mod tests {
    use super::*;
    use motord_bus::{FrameId, Readiness, Ready};
    use std::sync::{Arc, Mutex};

    /// Writes its name down when it is sent to, and in capitals when it is looked for.
    struct Missing {
        name: char,
        log: Arc<Mutex<String>>,
        is_there: bool,
    }

    impl Outlet for Missing {
        fn send_round(&mut self, _now: Instant, _frames: &[Frame]) -> Option<Refusal> {
            self.log.lock().unwrap().push(self.name);
            (!self.is_there).then_some(Refusal::Gone)
        }

        fn find(&mut self) -> bool {
            self.log.lock().unwrap().push(self.name.to_ascii_uppercase());
            self.is_there = self.name == 'c';
            self.is_there
        }
    }

    const BEGIN: Instant = Instant::from_nanos(1);

    fn frames() -> BusFrames {
        let frame = |last| Frame::full(FrameId::new(1).unwrap(), [0, 0, 0, 0, 0, 0, 0, last]);
        BusFrames { damp: vec![frame(0)], stop: vec![frame(1)] }
    }

    fn missing(names: [char; 3]) -> (Stopper, [Missing; 3], Arc<Mutex<String>>) {
        let log: Arc<Mutex<String>> = Arc::default();
        let outlets = names.map(|name| Missing { name, log: Arc::clone(&log), is_there: name == 'b' });
        let mut stopper = Stopper::new(names.map(|_| frames()), Duration::from_millis(100));
        stopper.begin(BEGIN);
        (stopper, outlets, log)
    }

    #[test]
    fn every_bus_is_sent_to_before_one_is_looked_for_and_those_take_turns() {
        let (mut stopper, mut outlets, log) = missing(['a', 'b', 'c']);
        for millis in [0, 10, 20, 50] {
            stopper.round(BEGIN + Duration::from_millis(millis), &mut outlets);
        }
        assert_eq!(*log.lock().unwrap(), "abcA abcCc abc abcA".replace(' ', ""));
    }

    #[test]
    fn interfaces_that_stay_away_are_each_looked_for_ten_times_a_second() {
        let (mut stopper, mut outlets, log) = missing(['a', 'd', 'e']);
        let end = BEGIN + Duration::from_secs(10);
        while let Some(due) = stopper.due().filter(|due| *due < end) {
            stopper.round(due, &mut outlets);
        }
        for name in ['A', 'D', 'E'] {
            let searches = log.lock().unwrap().matches(name).count();
            assert!((99..=103).contains(&searches), "{name}: {searches}");
        }
    }

    /// Time that passes only while somebody sleeps.
    struct Virtual(Instant);

    impl Clock for Virtual {
        fn now(&self) -> Instant {
            self.0
        }

        fn suspended(&self) -> Duration {
            Duration::ZERO
        }

        fn sleep_until(&mut self, instant: Instant) {
            self.0 = self.0.max(instant);
        }

        fn wait(&mut self, _readiness: &[Readiness<'_>], _until: Instant) -> Ready {
            unreachable!("a stopper reads no answers")
        }
    }

    /// A bus that refuses frames from time to time, and writes down when it took which.
    struct Jammed {
        refuses: fn(Instant) -> bool,
        taken: Vec<(Instant, Frame)>,
    }

    impl Outlet for Jammed {
        fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
            if (self.refuses)(now) {
                return Some(Refusal::Full);
            }
            self.taken.extend(frames.iter().map(|frame| (now, *frame)));
            None
        }
    }

    /// A bus that takes all but the last frame of every round.
    #[derive(Default)]
    struct Narrow(Vec<Frame>);

    impl Outlet for Narrow {
        fn send_round(&mut self, _now: Instant, frames: &[Frame]) -> Option<Refusal> {
            self.0.extend(&frames[..frames.len() - 1]);
            Some(Refusal::Full)
        }
    }

    #[test]
    fn a_run_that_gives_up_on_a_bus_tries_to_stop_its_motors_once() {
        let BusFrames { damp, stop } = frames();
        let (damp, stop) = (damp[0], stop[0]);
        let two_motors = BusFrames { damp: vec![damp; 2], stop: vec![stop; 2] };
        let mut outlets = [Narrow::default()];
        Stopper::new([two_motors], Duration::from_millis(100)).run(&mut Virtual(BEGIN), &mut outlets);
        let (last, before) = outlets[0].0.split_last().unwrap();
        assert_eq!(*last, stop);
        assert!(before.iter().all(|frame| *frame == damp));
    }

    #[test]
    fn a_run_serves_a_bus_that_was_jammed_and_gives_up_on_one_that_stays_so() {
        let outlet = |refuses| Jammed { refuses, taken: Vec::new() };
        let late = |now: Instant| now < BEGIN + Duration::from_millis(500);
        let mut outlets = [outlet(|_| false), outlet(late), outlet(|_| true)];
        let mut stopper = Stopper::new([(); 3].map(|()| frames()), Duration::from_millis(100));
        let mut clock = Virtual(BEGIN);
        stopper.run(&mut clock, &mut outlets);
        assert_eq!(stopper.owed().collect::<Vec<_>>(), [2]);
        assert!(clock.0 < BEGIN + Duration::from_millis(100) + PATIENCE);
        let whole = [[frames().damp[0]; 10].as_slice(), &[frames().stop[0]; 3]].concat();
        for (outlet, begin) in outlets.iter().zip([0, 500]) {
            assert!(outlet.taken.iter().map(|(_, frame)| *frame).eq(whole.iter().copied()));
            assert_eq!(outlet.taken[0].0, BEGIN + Duration::from_millis(begin));
        }
    }
}
