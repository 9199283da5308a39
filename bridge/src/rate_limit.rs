//! A limit on lines of the log.

use std::time::{Duration, Instant};

/// Permits `most` events in each period, and counts the others.
#[derive(Debug)]
pub(crate) struct RateLimit {
    most: u32,
    period: Duration,
    begun: Option<Instant>,
    permitted: u32,
    suppressed: u64,
}

impl RateLimit {
    pub(crate) const fn new(most: u32, period: Duration) -> Self {
        Self { most, period, begun: None, permitted: 0, suppressed: 0 }
    }

    /// Returns whether an event at `now` is permitted: `Some` with the number of events that were
    /// suppressed before it.
    pub(crate) fn permit(&mut self, now: Instant) -> Option<u64> {
        if self.begun.is_none_or(|begun| now.saturating_duration_since(begun) >= self.period) {
            (self.begun, self.permitted) = (Some(now), 0);
        }
        if self.permitted >= self.most {
            self.suppressed += 1;
            return None;
        }
        self.permitted += 1;
        Some(std::mem::take(&mut self.suppressed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suppressed_events_are_counted_until_next_permit() {
        let (begun, period) = (Instant::now(), Duration::from_secs(1));
        let mut limit = RateLimit::new(2, period);
        let permits = [0, 1, 2, 3].map(|ms| limit.permit(begun + Duration::from_millis(ms)));
        assert_eq!(permits, [Some(0), Some(0), None, None]);
        assert_eq!(limit.permit(begun + period), Some(2));
    }
}
