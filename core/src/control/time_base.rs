//! The beginning of a cycle, and the check of its timing.
//!
//! | observation | cause |
//! |---|---|
//! | the cycle began later than `max-lateness-ms` | time-base |
//! | the computer was suspended since the cycle before | suspended |
//! | more ticks missed over the last second than `max-missed` | overload |

use motord_bus::{Duration, Instant};
use motord_settings::settings::CycleSettings;
use motord_shared::Cause;

/// The time constant of the mean share of missed ticks.
const MEMORY: Duration = Duration::from_secs(1);
/// A computer takes longer than this to be suspended and woken; the readings of two clocks differ
/// by less.
const SUSPENDED_LEAST: Duration = Duration::from_millis(10);

#[derive(Debug)]
pub(super) struct TimeBase {
    max_lateness: Duration,
    max_missed: f32,
    /// Total time that the computer was suspended before this cycle. A delayed reading may be less.
    suspended: Duration,
    /// Share of the ticks of about the last second that were missed, 0 to 1.
    missed: f32,
}

impl TimeBase {
    pub(super) const fn new(settings: &CycleSettings) -> Self {
        Self {
            max_lateness: settings.max_lateness,
            max_missed: settings.max_missed_ticks,
            suspended: Duration::ZERO,
            missed: 0.0,
        }
    }

    /// Checks the beginning of a cycle; the previous one began `elapsed` before. Returns the cause
    /// to stop, if any.
    pub(super) fn check(&mut self, wake: &Wake, elapsed: Duration) -> Option<Cause> {
        let weight = (elapsed.as_secs_f32() / MEMORY.as_secs_f32()).min(1.0);
        let share = wake.missed_ticks as f32 / (wake.missed_ticks + 1) as f32;
        self.missed += weight * (share - self.missed);
        let known = self.suspended;
        self.suspended = known.max(wake.suspended);
        if wake.begun.since(wake.scheduled) >= self.max_lateness {
            Some(Cause::TimeBase)
        } else if wake.suspended > known + SUSPENDED_LEAST {
            Some(Cause::Suspended)
        } else {
            (self.missed > self.max_missed).then_some(Cause::Overload)
        }
    }
}

/// The beginning of a cycle: tick and time of the wake-up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Wake {
    /// Its number, from 1.
    pub cycle: u64,
    /// When the cycle should begin: the tick that its thread slept until. Missed ticks come after
    /// it.
    pub scheduled: Instant,
    /// When it began.
    pub begun: Instant,
    /// Ticks missed just before it.
    pub missed_ticks: u64,
    /// Total time that the computer was suspended since it was started.
    pub suspended: Duration,
}
