//! Watches the frames by which another sender commands a motor.

use motord_bus::{Duration, Instant};

/// At least this many frames within [`WINDOW`] are from another master.
const FRAMES: u32 = 5;
const WINDOW: Duration = Duration::from_secs(1);
/// A sender that continues is reported again after this time.
const REPORT: Duration = Duration::from_secs(10);

/// The longest time between two reads with safe frames of one sender. A second daemon may send only
/// every 100 ms, and a slow cycle reads as rarely. Shorter than the time that makes a sender a
/// master: a burst that two reads share is none.
const SAFE_GAP: Duration = Duration::from_millis(150);

/// Frames without a longer pause than [`RARE_GAP`] that continue for [`RARE_TIME`] are reported,
/// although their sender is no master.
const RARE_GAP: Duration = Duration::from_millis(1500);
const RARE_TIME: Duration = Duration::from_secs(5);

/// Frames with the command id of a motor from another sender.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ForeignFrames {
    /// Number of those that are no safe frames.
    pub commands: u32,
    /// Number of safe frames: those by which the dead man's switch and `safe-stop` damp and stop
    /// this motor. A second daemon sends the same ones to a motor that it has not started.
    pub safe: u32,
}

impl ForeignFrames {
    /// Returns whether there is a frame.
    pub(crate) const fn is_any(&self) -> bool {
        self.commands > 0 || self.safe > 0
    }
}

/// Frames of another sender without a long pause.
#[derive(Debug, Clone, Copy)]
struct Run {
    begun: Instant,
    last: Instant,
}

impl Run {
    /// Continues `run` at `at`, or begins another one after a pause longer than `gap`. Returns how
    /// long it lasts.
    fn continue_at(run: &mut Option<Self>, at: Instant, gap: Duration) -> Duration {
        let continued = run.filter(|run| at.since(run.last) <= gap);
        let begun = continued.map_or(at, |run| run.begun);
        *run = Some(Self { begun, last: at });
        at.since(begun)
    }
}

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
    /// The last safe frames, and the last frames of any kind.
    safe: Option<Run>,
    any: Option<Run>,
    /// The last time at which safe frames were those of another master.
    stopped_at: Option<Instant>,
}

/// The judgement of a further frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Observed {
    /// At least [`FRAMES`] arrived within [`WINDOW`], or safe frames for too long: another master
    /// commands the motor.
    pub(super) is_master: bool,
    /// The number of frames, when they should be reported.
    pub(super) report: Option<u32>,
}

impl Foreign {
    /// Counts `frames` that arrived by `at`. A sender that is no master is reported while its
    /// frames continue. Safe frames are from another master when they arrive for `safe_max`: longer
    /// than the switch acts beside a running daemon.
    pub(super) fn observe(&mut self, frames: ForeignFrames, at: Instant, safe_max: Duration) -> Observed {
        let is_master =
            self.counts_safe(frames.safe, at, safe_max) | self.counts_commands(frames.commands, at);
        let is_regular = self.is_regular(frames, at, safe_max);
        if is_regular && !is_master {
            self.total = self.total.wrapping_add(frames.safe);
        }
        let is_due = self.reported.is_none_or(|reported| at.since(reported) >= REPORT);
        let report = ((is_master || is_regular) && is_due).then_some(self.total);
        if report.is_some() {
            self.reported = Some(at);
        }
        Observed { is_master, report }
    }

    fn counts_commands(&mut self, frames: u32, at: Instant) -> bool {
        if frames == 0 {
            return false;
        }
        self.total = self.total.wrapping_add(frames);
        self.before_last = if frames > 1 { Some(at) } else { self.last };
        self.last = Some(at);
        if self.begun.is_none_or(|begun| at.since(begun) >= WINDOW) {
            (self.begun, self.recent) = (Some(at), 0);
        }
        self.recent = self.recent.saturating_add(frames);
        self.recent >= FRAMES
    }

    fn counts_safe(&mut self, frames: u32, at: Instant, safe_max: Duration) -> bool {
        if frames == 0 {
            return false;
        }
        let is_master = Run::continue_at(&mut self.safe, at, SAFE_GAP) >= safe_max;
        if is_master {
            self.total = self.total.wrapping_add(frames);
            self.stopped_at = Some(at);
        }
        is_master
    }

    /// Returns whether frames continue for longer than single ones of a tool do, and a switch acts.
    fn is_regular(&mut self, frames: ForeignFrames, at: Instant, safe_max: Duration) -> bool {
        frames.is_any() && Run::continue_at(&mut self.any, at, RARE_GAP) >= RARE_TIME.max(safe_max)
    }

    /// Returns the number of frames since the start, wrapping.
    pub(super) const fn total(&self) -> u32 {
        self.total
    }

    /// Returns whether at least two commands, or the safe frames of another master, arrived in the
    /// last second before `now`.
    pub(super) fn is_present(&self, now: Instant) -> bool {
        let is_recent = |arrival: Option<Instant>| arrival.is_some_and(|arrival| now.since(arrival) < WINDOW);
        is_recent(self.before_last) || is_recent(self.stopped_at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: ForeignFrames = ForeignFrames { commands: 1, safe: 0 };
    const SAFE_MAX: Duration = Duration::from_millis(200);

    #[test]
    fn sender_is_reported_every_ten_seconds() {
        let (mut foreign, begin) = (Foreign::default(), Instant::from_nanos(1));
        let reports: Vec<u32> = (0..250_u32)
            .filter_map(|frame| {
                foreign.observe(ONE, begin + frame * Duration::from_millis(100), SAFE_MAX).report
            })
            .collect();
        assert_eq!(reports, [5, 105, 205]);
    }

    #[test]
    fn rare_frames_are_no_master() {
        let (mut foreign, begin) = (Foreign::default(), Instant::from_nanos(1));
        for frame in 0..100_u32 {
            let at = begin + frame * Duration::from_millis(300);
            assert!(!foreign.observe(ONE, at, SAFE_MAX).is_master);
        }
        let last = begin + 99 * Duration::from_millis(300);
        assert!(foreign.is_present(last));
        assert!(!foreign.is_present(last + WINDOW));
    }
}
