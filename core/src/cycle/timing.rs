//! The time grid, and the configured times of a cycle.

use motord_bus::{Duration, Instant};
use motord_settings::settings::Settings;

/// Longest time that a cycle polls the clock for its tick, or for expected replies if it does not
/// busy-poll.
const AWAKE_MAX: Duration = Duration::from_micros(50);
/// [`AWAKE_MAX`] is cut to the period divided by this.
const PERIODS_PER_AWAKE: u32 = 20;

/// One point of the time grid: when a cycle should begin. Ticks are a period apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tick {
    /// Its number, from 1; that of its cycle.
    pub number: u64,
    /// Its time.
    pub at: Instant,
}

impl Tick {
    pub(super) fn later(self, ticks: u32, period: Duration) -> Self {
        Self { number: self.number + u64::from(ticks), at: self.at + ticks * period }
    }
}

/// The configured times of a cycle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Timing {
    /// From tick to tick.
    pub(super) period: Duration,
    /// How long a safe stop damps at most.
    pub(super) damp: Duration,
    /// From the sending of the commands to the time when replies count as missed.
    pub(super) reply_deadline: Duration,
    /// Age from the beginning of the cycle at which commands are stale: the dead man's switch may
    /// have acted, or the cycle lost its time base.
    pub(super) stale_after: Duration,
    /// Time for which the buses are polled for the last replies of a cycle, without a sleep.
    pub(super) busy_poll: Duration,
    /// Longest time that a cycle polls the clock for its tick, or for expected replies if it does
    /// not busy-poll.
    pub(super) awake: Duration,
    /// The ipc thread fetches the setpoints this long before a tick.
    lead: Duration,
}

impl Timing {
    pub(super) fn new(settings: &Settings) -> Self {
        Self {
            period: settings.cycle.period,
            damp: settings.safety.damp,
            reply_deadline: settings.cycle.reply_deadline,
            stale_after: settings.cycle.max_lateness.min(settings.safety.deadman),
            busy_poll: settings.cycle.busy_poll,
            awake: AWAKE_MAX.min(settings.cycle.period / PERIODS_PER_AWAKE),
            lead: settings.ipc.lead,
        }
    }

    /// Leaves half of the lead to the ipc thread, which has no other processor.
    pub(super) fn share_processor(&mut self) {
        self.awake = self.awake.min(self.lead / 2);
    }
}
