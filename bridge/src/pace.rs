//! Thinning: a message for every `n`th cycle.

/// Every `cycles`th cycle, on the grid of the daemon's cycles.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pace {
    /// 0: never.
    pub(crate) cycles: u64,
    last: u64,
}

impl Pace {
    /// Creates a pace of at most `hz`, where the daemon runs `cycle_hz` cycles per second.
    pub(crate) fn new(hz: f64, cycle_hz: f64) -> Self {
        let cycles = if hz > 0.0 { (cycle_hz / hz).round().max(1.0) as u64 } else { 0 };
        Self { cycles, last: u64::MAX }
    }

    /// Returns `true` for the first state of each interval. Late states do not lower the rate.
    pub(crate) fn is_due(&mut self, cycle: u64) -> bool {
        let Some(number) = cycle.checked_div(self.cycles) else { return false };
        std::mem::replace(&mut self.last, number) != number
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_states_do_not_lower_the_rate() {
        let mut pace = Pace::new(100.0, 1000.0);
        let due: Vec<u64> =
            [5, 14, 19, 20, 29, 31, 49, 50].into_iter().filter(|cycle| pace.is_due(*cycle)).collect();
        assert_eq!(due, [5, 14, 20, 31, 49, 50]);
    }
}
