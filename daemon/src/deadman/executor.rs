//! A will at work: its buses, each with its own [`Schedule`], in rounds.

use motord_bus::{Duration, Frame, FrameId, Inbox, Instant, Refusal};

use super::schedule::{Order, Schedule};
use super::will::{BusWill, Open, Outlet, WillError, WrittenFrame};

/// An interface that was not there is not looked for again before so long: that can take longer than a round.
const SEARCH_INTERVAL: Duration = Duration::from_millis(50);

/// One bus of a will, ready to be served.
pub struct Executor {
    interface: String,
    outlet: Box<dyn Outlet>,
    damp: Vec<Frame>,
    stop: Vec<Frame>,
    schedule: Option<Schedule>,
    /// Why the last round was not taken.
    refusal: Option<Refusal>,
    /// When its interface was looked for last.
    sought: Option<Instant>,
}

impl Executor {
    /// Opens the interface and checks the frames. Allocates; nothing after it does.
    ///
    /// # Errors
    ///
    /// Why the will cannot be carried out.
    pub fn new(will: &BusWill, open: Open<'_>) -> Result<Self, WillError> {
        let count = will.damp.len().max(will.stop.len());
        if count > Inbox::CAPACITY {
            return Err(WillError::Count { interface: will.interface.clone(), count });
        }
        let (damp, stop) = (frames(&will.damp)?, frames(&will.stop)?);
        let outlet = open(&will.interface, 2 * count as u32)?;
        Ok(Self {
            interface: will.interface.clone(),
            outlet,
            damp,
            stop,
            schedule: None,
            refusal: None,
            sought: None,
        })
    }

    fn due(&self) -> Option<Instant> {
        self.schedule?.due()
    }

    /// Sends what is due.
    fn send(&mut self, now: Instant) {
        let Some(order) = self.schedule.and_then(|schedule| schedule.order(now)) else { return };
        let frames = match order {
            Order::Damp => &self.damp,
            Order::Stop => &self.stop,
        };
        self.refusal = self.outlet.send(now, frames).refusal;
    }

    /// Whether something is due on an interface that is not there, and was not looked for just now.
    fn is_to_be_found(&self, now: Instant) -> bool {
        let is_away = self.refusal == Some(Refusal::Gone) && self.due().is_some_and(|due| due <= now);
        is_away && self.sought.is_none_or(|before| now.since(before) >= SEARCH_INTERVAL)
    }

    /// Looks for the interface, and sends what is due when it is there again.
    fn find(&mut self, now: Instant) {
        self.sought = Some(now);
        if self.outlet.look_for() {
            self.send(now);
        }
    }

    fn end_round(&mut self, now: Instant) {
        let waits_for_its_turn = self.is_to_be_found(now);
        match self.schedule.as_mut().filter(|schedule| schedule.order(now).is_some()) {
            Some(schedule) if waits_for_its_turn => schedule.pass(now),
            Some(schedule) => schedule.told(self.refusal.is_none(), now),
            None => {}
        }
    }
}

fn frames(written: &[WrittenFrame]) -> Result<Vec<Frame>, WillError> {
    let frame = |&(id, bytes): &WrittenFrame| {
        FrameId::new(id).map(|id| Frame::full(id, bytes)).ok_or(WillError::Id { id })
    };
    written.iter().map(frame).collect()
}

/// All buses of a will.
pub struct Executors {
    all: Vec<Executor>,
    damp: Duration,
}

impl Executors {
    /// Nothing is due yet. Motors will be damped for `damp`.
    #[must_use]
    pub fn new(all: Vec<Executor>, damp: Duration) -> Self {
        Self { all, damp }
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.all.len()
    }

    /// From `now` on every motor is owed damping and stops.
    pub fn begin(&mut self, now: Instant) {
        for executor in &mut self.all {
            executor.schedule = Some(Schedule::begin(self.damp, now));
        }
    }

    /// When [`round`](Self::round) is due next; `None` when every bus is served.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        self.all.iter().filter_map(Executor::due).min()
    }

    /// Whether the buses that are not served all refuse, and for longer than their motors would have been damped.
    #[must_use]
    pub fn only_wait(&self) -> bool {
        self.all.iter().filter_map(|executor| executor.schedule).all(|it| it.due().is_none() || it.is_slow())
    }

    /// The interfaces that are not served yet. Allocates.
    #[must_use]
    pub fn owed(&self) -> Vec<String> {
        let owed = self.all.iter().filter(|executor| executor.due().is_some());
        owed.map(|executor| executor.interface.clone()).collect()
    }

    /// Sends what is due at `now` on every bus, and only then looks for one of the interfaces that are not there, the one
    /// that has waited longest. What a bus refuses is lost, and due again. Does not allocate; one system call per bus. A
    /// search is five more and a send, and can wait for another process that configures interfaces.
    pub fn round(&mut self, now: Instant) {
        for executor in &mut self.all {
            executor.send(now);
        }
        let away = self.all.iter_mut().filter(|executor| executor.is_to_be_found(now));
        if let Some(executor) = away.min_by_key(|executor| executor.sought) {
            executor.find(now);
        }
        for executor in &mut self.all {
            executor.end_round(now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::{Bus, Readiness, Sent};
    use std::sync::mpsc::{Receiver, Sender, channel};

    /// Tells its name when it is sent to, and in capitals when it is looked for.
    struct Away {
        name: String,
        log: Sender<String>,
        there: bool,
    }

    impl Bus for Away {
        fn send(&mut self, _now: Instant, frames: &[Frame]) -> Sent {
            self.log.send(self.name.clone()).unwrap();
            if self.there {
                Sent::all(frames.len())
            } else {
                Sent { accepted: 0, refusal: Some(Refusal::Gone) }
            }
        }

        fn receive(&mut self, _now: Instant, _inbox: &mut Inbox) {}

        fn readiness(&self) -> Readiness<'_> {
            Readiness::Never
        }
    }

    impl Outlet for Away {
        fn look_for(&mut self) -> bool {
            self.log.send(self.name.to_uppercase()).unwrap();
            self.there = self.name == "c";
            self.there
        }
    }

    const BEGIN: Instant = Instant::from_nanos(1);

    fn executors(names: [&str; 3]) -> (Executors, Receiver<String>) {
        let (log, told) = channel();
        let mut open = |name: &str, _frames: u32| -> Result<Box<dyn Outlet>, WillError> {
            Ok(Box::new(Away { name: name.into(), log: log.clone(), there: name == "b" }))
        };
        let bus = |name: &str| BusWill { interface: name.into(), damp: vec![(1, [0; 8])], stop: vec![] };
        let all = names.map(|name| Executor::new(&bus(name), &mut open).unwrap());
        let mut executors = Executors::new(all.into(), Duration::from_millis(100));
        executors.begin(BEGIN);
        (executors, told)
    }

    #[test]
    fn every_bus_is_sent_to_before_one_is_looked_for_and_those_take_turns() {
        let (mut executors, told) = executors(["a", "b", "c"]);
        for millis in [0, 10, 20, 50] {
            executors.round(BEGIN + Duration::from_millis(millis));
        }
        let told: String = told.try_iter().collect();
        assert_eq!(told, "abcA abcCc abc abcA".replace(' ', ""));
    }

    #[test]
    fn interfaces_that_stay_away_are_each_looked_for_ten_times_a_second() {
        let (mut executors, told) = executors(["a", "d", "e"]);
        let end = BEGIN + Duration::from_secs(10);
        while let Some(due) = executors.due().filter(|due| *due < end) {
            executors.round(due);
        }
        let told: String = told.try_iter().collect();
        for name in ["A", "D", "E"] {
            let searches = told.matches(name).count();
            assert!((99..=103).contains(&searches), "{name}: {searches}");
        }
    }
}
