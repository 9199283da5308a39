//! The newest state, as the threads of a client share it.

use crate::state::{State, StatePool};
use motord_ports::clock;
use std::time::Duration;

/// The newest state.
#[derive(Debug, Default)]
pub(crate) struct View {
    pub(crate) newest: Option<State>,
    pub(crate) pool: StatePool,
    unseen: bool,
    /// Number of the last cycle of this daemon whose state was taken; 0 before the first.
    taken: u64,
    /// Usual time from a tick to the publication of its state, ns: late cycles have a small weight.
    publish_delay_ns: u64,
    pub(crate) silence_reported: bool,
}

impl View {
    /// Returns `true` if no caller has taken the newest state.
    pub(crate) fn is_unseen(&self) -> bool {
        self.unseen
    }

    /// Returns the newest state, if it was not taken before and its cycle is due for a caller that
    /// takes every `n`th.
    pub(crate) fn take_unseen(&mut self, n: u64) -> Option<State> {
        let due = self.due(n);
        let state = self.newest.as_ref().filter(|state| self.unseen && state.cycle() >= due)?;
        (self.unseen, self.taken) = (false, state.cycle());
        Some(state.clone())
    }

    /// Returns the time until the next `n`th cycle should be published, zero when it is late.
    /// `None` before the first state.
    pub(crate) fn due_in(&self, n: u64, period: Duration) -> Option<Duration> {
        let newest = self.newest.as_ref()?;
        let cycles = u32::try_from(self.due(n).saturating_sub(newest.cycle())).unwrap_or(u32::MAX);
        let tick_ns = newest.tick_ns().saturating_add(nanos(period.saturating_mul(cycles)));
        let due_ns = tick_ns.saturating_add(self.publish_delay_ns);
        Some(Duration::from_nanos(due_ns.saturating_sub(clock::now_ns())))
    }

    /// Returns the number of the first multiple of `n` after the last cycle that was taken.
    fn due(&self, n: u64) -> u64 {
        if self.taken == 0 { 0 } else { (self.taken / n + 1).saturating_mul(n) }
    }

    /// Stores `state` as the newest one. The state of another daemon resets the view.
    pub(crate) fn put(&mut self, state: State) {
        let same_daemon = self.newest.as_ref().is_some_and(|newest| newest.boot_id() == state.boot_id());
        let delay_ns = state.publish_ns().saturating_sub(state.tick_ns());
        let before_ns = self.publish_delay_ns;
        let (taken, publish_delay_ns) = match same_daemon {
            true => {
                (self.taken, delay_ns.min(before_ns.saturating_add(delay_ns.saturating_sub(before_ns) / 8)))
            }
            false => (0, delay_ns),
        };
        self.newest = Some(state);
        (self.unseen, self.taken, self.publish_delay_ns) = (true, taken, publish_delay_ns);
        self.silence_reported = false;
    }

    /// Compares cycles: another thread may have stored a later state before this one.
    pub(crate) fn is_newer(&self, state: &State) -> bool {
        self.newest
            .as_ref()
            .is_none_or(|newest| newest.boot_id() != state.boot_id() || newest.cycle() < state.cycle())
    }
}

/// Returns a duration in ns, at most `u64::MAX`.
pub(crate) fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::StateMessage;

    const PERIOD: Duration = Duration::from_millis(1);

    /// Creates the state of a cycle that was published `delay_ns` after its tick.
    fn state(boot_id: u64, cycle: u64, delay_ns: u64) -> State {
        let tick_ns = cycle * nanos(PERIOD);
        let publish_ns = tick_ns + delay_ns;
        let message = StateMessage { boot_id, cycle, tick_ns, publish_ns, ..Default::default() };
        StatePool::default().copy(&message)
    }

    #[test]
    fn every_nth_cycle_keeps_grid_after_gap() {
        let mut view = View::default();
        let mut take = |cycle| {
            view.put(state(1, cycle, 0));
            view.take_unseen(5).map(|state| state.cycle())
        };
        let given: Vec<u64> = [7, 8, 9, 10, 11, 14, 17, 19, 20].into_iter().filter_map(&mut take).collect();
        assert_eq!(given, [7, 10, 17, 20]);
        view.put(state(2, 3, 0));
        assert_eq!(view.take_unseen(5).map(|state| state.cycle()), Some(3), "another daemon counts anew");
    }

    #[test]
    fn late_caller_gets_newest_state_and_keeps_grid() {
        let mut view = View::default();
        let mut take = |cycles: std::ops::RangeInclusive<u64>| {
            cycles.for_each(|cycle| view.put(state(1, cycle, 0)));
            view.take_unseen(5).map(|state| state.cycle())
        };
        assert_eq!(take(8..=10), Some(10));
        assert_eq!(take(11..=16), Some(16), "the caller slept through the state of cycle 15");
        assert_eq!(take(17..=19), None);
        assert_eq!(take(20..=20), Some(20));
    }

    #[test]
    fn one_late_cycle_hardly_shifts_expected_state_time() {
        let mut view = View::default();
        (1..100).for_each(|cycle| view.put(state(1, cycle, 700_000)));
        assert_eq!(view.publish_delay_ns, 700_000);
        view.put(state(1, 100, 1_500_000));
        assert_eq!(view.publish_delay_ns, 800_000);
        view.put(state(1, 101, 700_000));
        assert_eq!(view.publish_delay_ns, 700_000);
        let hostile = StateMessage { boot_id: 1, cycle: 102, publish_ns: u64::MAX, ..Default::default() };
        view.put(StatePool::default().copy(&hostile));
        assert!(view.due_in(5, Duration::MAX).is_some(), "hostile times do no harm");
    }
}
