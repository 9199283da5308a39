//! When the ipc thread wakes by itself, in timed mode. Reads no clock.

use motord_bus::{Backoff, Duration, Instant, Lateness, ReplyTime};
use motord_shared::{GroupState, Phase, StateMessage};

/// From the timestamp of a setpoint to its arrival.
const SENDING: Duration = Duration::from_micros(10);
/// An earlier fetch is at least this long before the last one. Most wake-ups are less late.
const EARLIER_MIN: Duration = Duration::from_micros(60);

/// The times of a cycle that this thread wakes for, and all that it learned of them. Nothing here
/// allocates or blocks.
pub struct Schedule {
    period: Duration,
    lead: Duration,
    busy_poll: Duration,
    tick: Instant,
    /// No group had an owner and every group was disarmed when the newest states were published.
    is_calm: bool,
    /// Every owner has answered the newest states.
    is_answered: bool,
    /// How late the sleeps of this thread end.
    lateness: Lateness,
    /// From the tick of a cycle to the publication of its states.
    publication: ReplyTime,
    /// From the tick of a cycle to the setpoints that answer its states.
    arrival: ReplyTime,
    /// Skips polls for states after repeated failures.
    backoff: Backoff,
}

/// The next time for which this thread wakes by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wake {
    /// The end of the sleep: the expected fetch or publication, minus the usual lateness of
    /// wake-ups. The thread polls for the remaining time, so an early wake-up does not fetch too
    /// early.
    pub sleeps_until: Instant,
    /// The end of the waiting.
    pub at: Instant,
    /// The states are expected by then; else the setpoints are fetched.
    pub is_for_states: bool,
}

impl Schedule {
    /// Before every cycle of this `period` the setpoints are fetched, by `lead`. States are polled
    /// for at most as long as `busy_poll`; zero never polls.
    #[must_use]
    pub fn new(period: Duration, lead: Duration, busy_poll: Duration) -> Self {
        Self {
            period,
            lead,
            busy_poll,
            tick: Instant::ZERO,
            is_calm: true,
            is_answered: false,
            lateness: Lateness::default(),
            publication: ReplyTime::new(period),
            arrival: ReplyTime::new(period),
            backoff: Backoff::default(),
        }
    }

    /// A cycle published `state`.
    pub fn observe(&mut self, state: &StateMessage) {
        self.tick = Instant::from_nanos(state.tick_ns);
        self.publication.observe(Instant::from_nanos(state.publish_ns).since(self.tick));
        let is_calm = |group: &GroupState| group.lease == 0 && group.phase == Phase::Disarmed.code();
        self.is_calm = state.groups().iter().all(is_calm);
        self.is_answered = false;
    }

    /// Every owner has answered the newest states: no fetch is needed before the next ones.
    pub const fn answered(&mut self) {
        self.is_answered = true;
    }

    /// A setpoint with the timestamp `sent` arrived. Any value is harmless.
    pub fn arrived(&mut self, sent: Instant) {
        self.arrival.observe(sent.since(self.tick).min(self.period));
    }

    /// The next fetch, or before it the publication of the next states where that is polled for. A
    /// publication ends the waiting at any time.
    #[must_use]
    pub fn next(&mut self, now: Instant) -> Wake {
        let fetch = self.fetch_after(now);
        let states = self.tick + self.period + self.publication.earliest();
        let is_ahead = !self.is_calm && !self.busy_poll.is_zero() && now < states && states < fetch;
        let (expected, wait) = match is_ahead && self.backoff.attempts() {
            true => (states, self.busy_poll),
            false => (fetch, Duration::ZERO),
        };
        let sleeps_until = expected - self.lateness.expected();
        Wake { sleeps_until, at: expected + wait, is_for_states: !wait.is_zero() }
    }

    /// The sleep before `wake` ended by itself, at `now`.
    pub fn woken(&mut self, wake: Wake, now: Instant) {
        self.lateness.observe(wake.sleeps_until, now);
    }

    /// The waiting for `wake` has ended, with new states or without.
    pub fn waited(&mut self, wake: Wake, has_states: bool) {
        if wake.is_for_states {
            self.backoff.observe(!has_states);
        }
    }

    /// Returns the next fetch.
    ///
    /// The last fetch is `lead` before a cycle, which uses the setpoints that were sent by then. An
    /// earlier fetch follows the usual arrival of the setpoints, so that they are in time even if
    /// the thread wakes late for the last one. Once every owner has answered the newest states, and
    /// while no client may send setpoints and nothing moves, the thread wakes only for new states,
    /// or when a cycle is missing.
    fn fetch_after(&self, now: Instant) -> Instant {
        let last = match (self.is_calm, self.is_answered) {
            (true, _) => 2 * self.period,
            (false, true) => 2 * self.period - self.lead,
            (false, false) => self.period - self.lead,
        };
        let (last, earlier) = (self.tick + last, self.tick + self.arrival.latest() + SENDING);
        let is_needed = !self.is_calm && !self.is_answered && earlier + EARLIER_MIN <= last;
        // While the cycle stalls, this thread runs once per period.
        let fetches = [if is_needed { earlier } else { last }, last, last + self.period];
        fetches.into_iter().find(|fetch| *fetch > now).unwrap_or(now + self.period)
    }
}
