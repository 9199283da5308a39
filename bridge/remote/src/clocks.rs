//! The clock of the other computer, compared with the own one by round trips.

use std::time::Duration;

/// Samples are compared within this time: two clocks of computers drift apart by at most 0.1 ms in
/// it.
const WINDOW: u64 = 1_000_000_000;

/// The difference between the other computer's clock and the own one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Offset {
    /// The other clock minus the own one, ns.
    pub(crate) offset_ns: i64,
    /// Bound of its error: half of the round trip.
    pub(crate) bound: Duration,
}

/// A round trip: an own frame, and the frame of the other computer that repeats it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RoundTrip {
    /// The own frame left, by the own clock, ns.
    pub(crate) left_ns: u64,
    /// The other frame left, by the other clock, ns.
    pub(crate) other_ns: u64,
    /// Time between the arrival of the own frame there and the other frame, ns.
    pub(crate) held_ns: u64,
    /// The other frame arrived, by the own clock, ns.
    pub(crate) arrived_ns: u64,
}

impl RoundTrip {
    /// Returns the time on the network, both ways together. `None` for numbers that contradict each
    /// other.
    pub(crate) fn duration(&self) -> Option<Duration> {
        let all = self.arrived_ns.checked_sub(self.left_ns)?;
        all.checked_sub(self.held_ns).map(Duration::from_nanos)
    }

    /// Returns the offset if both ways took equally long.
    fn offset(&self) -> Option<Offset> {
        let round_trip = self.duration()?;
        let middle = i128::from(self.left_ns) + i128::from(self.arrived_ns);
        let other = 2 * i128::from(self.other_ns) - i128::from(self.held_ns);
        let offset_ns = i64::try_from((other - middle) / 2).ok()?;
        Some(Offset { offset_ns, bound: round_trip / 2 })
    }
}

/// Estimates the offset from the shortest round trip of the last one to two seconds.
#[derive(Debug, Default)]
pub(crate) struct Clocks {
    /// Best of this window and of the one before.
    best: [Option<Offset>; 2],
    begun_ns: u64,
}

impl Clocks {
    /// Takes a round trip.
    pub(crate) fn take(&mut self, trip: &RoundTrip) {
        let Some(offset) = trip.offset() else { return };
        if trip.arrived_ns.saturating_sub(self.begun_ns) > WINDOW {
            self.best = [None, self.best[0]];
            self.begun_ns = trip.arrived_ns;
        }
        if self.best[0].is_none_or(|best| offset.bound <= best.bound) {
            self.best[0] = Some(offset);
        }
    }

    /// Returns the best known offset. `None` before the first round trip.
    pub(crate) fn offset(&self) -> Option<Offset> {
        self.best.into_iter().flatten().min_by_key(|offset| offset.bound)
    }
}

impl Offset {
    /// Returns a time of the other computer by the own clock, ns: not later than `now_ns`, and 1 where it was
    /// before the own clock began. 0 stays 0: there is no time.
    pub(crate) fn own(&self, other_ns: u64, now_ns: u64) -> u64 {
        self.moved(other_ns).min(now_ns.max(1))
    }

    /// The same without the limit `now_ns`: differences between two times stay as they are.
    pub(crate) fn moved(&self, other_ns: u64) -> u64 {
        let own = i128::from(other_ns) - i128::from(self.offset_ns);
        if other_ns == 0 { 0 } else { u64::try_from(own.max(1)).unwrap_or(u64::MAX) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AHEAD: u64 = 5_000_000_000;

    /// A round trip at `left_ns` to a robot whose clock is `AHEAD`, with these times on the network.
    fn trip(left_ns: u64, there: u64, back: u64) -> RoundTrip {
        let held_ns = 700;
        let other_ns = left_ns + AHEAD + there + held_ns;
        RoundTrip { left_ns, other_ns, held_ns, arrived_ns: left_ns + there + held_ns + back }
    }

    fn offset(trips: impl IntoIterator<Item = RoundTrip>) -> Offset {
        let mut clocks = Clocks::default();
        trips.into_iter().for_each(|trip| clocks.take(&trip));
        clocks.offset().unwrap()
    }

    #[test]
    fn error_of_offset_is_within_its_bound() {
        for (there, back) in [(100, 100), (0, 1000), (1000, 0), (5_000_000, 90_000)] {
            let found = offset([trip(1_000, there, back)]);
            let error = found.offset_ns.abs_diff(AHEAD as i64);
            assert!(u128::from(error) <= found.bound.as_nanos() + 1, "{there} {back}: {error}");
        }
    }

    #[test]
    fn shortest_round_trip_of_window_counts() {
        let slow = trip(3_000_000, 9_000_000, 100);
        assert_eq!(offset([trip(0, 100, 100), slow]).bound, Duration::from_nanos(100));
        let late = trip(3 * WINDOW, 400, 400);
        let later = trip(5 * WINDOW, 500, 500);
        assert_eq!(offset([trip(0, 100, 100), late, later]).bound, Duration::from_nanos(400));
    }

    #[test]
    fn contradictory_numbers_are_no_round_trip() {
        let trip = trip(1_000, 100, 100);
        assert_eq!(RoundTrip { held_ns: 10_000, ..trip }.duration(), None);
        assert_eq!(RoundTrip { arrived_ns: 0, ..trip }.duration(), None);
        let mut clocks = Clocks::default();
        clocks.take(&RoundTrip { held_ns: u64::MAX, ..trip });
        assert_eq!(clocks.offset(), None);
    }

    #[test]
    fn time_of_robot_never_becomes_newer() {
        let offset = Offset { offset_ns: 500, bound: Duration::ZERO };
        assert_eq!([offset.own(1500, 2000), offset.own(9000, 2000), offset.own(0, 2000)], [1000, 2000, 0]);
        assert_eq!(offset.own(100, 2000), 1, "before the own clock began");
        let behind = Offset { offset_ns: i64::MIN, bound: Duration::ZERO };
        assert_eq!(behind.own(u64::MAX, 2000), 2000);
    }
}
