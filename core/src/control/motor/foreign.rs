//! Watches the frames by which another sender commands a motor.

use motord_bus::{Duration, Instant};

/// At least this many frames within [`WINDOW`] are from another master.
const FRAMES: u32 = 5;
const WINDOW: Duration = Duration::from_secs(1);
/// A sender that continues is reported again after this time.
const REPORT: Duration = Duration::from_secs(10);

/// The frames to one motor that this program did not send.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Foreign {
    /// Number since the start, wrapping.
    total: u32,
    /// Number since `begun`.
    recent: u32,
    begun: Option<Instant>,
    reported: Option<Instant>,
    /// Arrivals of the last two.
    last: Option<Instant>,
    before_last: Option<Instant>,
}

/// The judgement of a further frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Judged {
    /// At least [`FRAMES`] arrived within [`WINDOW`]: another master commands the motor.
    pub(super) is_master: bool,
    /// The number of frames, when they should be reported.
    pub(super) report: Option<u32>,
}

impl Foreign {
    /// Counts `frames` that arrived by `at`.
    pub(super) fn observe(&mut self, frames: u32, at: Instant) -> Judged {
        self.total = self.total.wrapping_add(frames);
        self.before_last = if frames > 1 { Some(at) } else { self.last };
        self.last = Some(at);
        if self.begun.is_none_or(|begun| at.since(begun) >= WINDOW) {
            (self.begun, self.recent) = (Some(at), 0);
        }
        self.recent = self.recent.saturating_add(frames);
        let is_master = self.recent >= FRAMES;
        let is_due = self.reported.is_none_or(|reported| at.since(reported) >= REPORT);
        let report = (is_master && is_due).then_some(self.total);
        if report.is_some() {
            self.reported = Some(at);
        }
        Judged { is_master, report }
    }

    /// Returns the number of frames since the start, wrapping.
    pub(super) const fn total(&self) -> u32 {
        self.total
    }

    /// Returns whether at least two frames arrived in the last second before `now`.
    pub(super) fn is_heard(&self, now: Instant) -> bool {
        self.before_last.is_some_and(|arrival| now.since(arrival) < WINDOW)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sender_is_reported_every_ten_seconds() {
        let (mut foreign, begin) = (Foreign::default(), Instant::from_nanos(1));
        let reports: Vec<u32> = (0..250_u32)
            .filter_map(|frame| foreign.observe(1, begin + frame * Duration::from_millis(100)).report)
            .collect();
        assert_eq!(reports, [5, 105, 205]);
    }

    #[test]
    fn rare_frames_are_no_master() {
        let (mut foreign, begin) = (Foreign::default(), Instant::from_nanos(1));
        for frame in 0..100_u32 {
            let at = begin + frame * Duration::from_millis(300);
            assert_eq!(foreign.observe(1, at), Judged { is_master: false, report: None });
        }
        let last = begin + 99 * Duration::from_millis(300);
        assert!(foreign.is_heard(last));
        assert!(!foreign.is_heard(last + WINDOW));
    }
}
