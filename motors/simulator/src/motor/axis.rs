//! The state of a driver that only the CANSimple dialect has.

use motord_bus::{Duration, Instant};

/// Intervals of the reports from the factory.
const HEARTBEAT: Duration = Duration::from_millis(100);
const ESTIMATES: Duration = Duration::from_millis(10);
/// Separates the reports of drivers that boot together, for each step of the node id.
const PHASE: Duration = Duration::from_micros(730);

/// A frame that a driver sends by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Report {
    Heartbeat,
    Estimates,
}

/// The control mode, and the times of the reports.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis {
    /// The control mode is that of impedances.
    pub(super) accepts_impedance: bool,
    heartbeat_at: Instant,
    estimates_at: Instant,
}

impl Axis {
    /// Sends nothing by itself.
    pub(super) const SILENT: Self = Self {
        accepts_impedance: false,
        heartbeat_at: Instant::FAR_FUTURE,
        estimates_at: Instant::FAR_FUTURE,
    };

    /// Returns the state of the driver with this node id that booted at `at`.
    pub(super) fn new(at: Instant, node: u8) -> Self {
        let phase = PHASE * u32::from(node);
        let [heartbeat_at, estimates_at] = [HEARTBEAT, ESTIMATES].map(|period| at + period + phase);
        Self { accepts_impedance: false, heartbeat_at, estimates_at }
    }

    /// Returns the time of the next report.
    pub(super) fn due(&self) -> Instant {
        self.heartbeat_at.min(self.estimates_at)
    }

    /// Takes the report that was due by `now`. The next one of its kind is due one period
    /// later. A driver sends no report again that it could not send in its time.
    pub(super) fn take(&mut self, now: Instant) -> Report {
        let next = |due: Instant, period| if due + period > now { due + period } else { now + period };
        if self.heartbeat_at <= self.estimates_at {
            self.heartbeat_at = next(self.heartbeat_at, HEARTBEAT);
            Report::Heartbeat
        } else {
            self.estimates_at = next(self.estimates_at, ESTIMATES);
            Report::Estimates
        }
    }
}
