//! The frames that a drive of the CANSimple family sends by itself.

use super::axis::{Axis, NEVER, Report};
use super::{DelayedReply, Motor};
use crate::dialect::Dialect;
use motord_bus::{Duration, Instant};

/// Intervals of the reports of CANSimple from the factory.
const HEARTBEAT: Duration = Duration::from_millis(100);
const ESTIMATES: Duration = Duration::from_millis(10);

impl Motor {
    /// Begins to report at `at`, if its dialect has reports.
    pub(super) fn begin_reports(&mut self, at: Instant) {
        self.axis = match self.dialect() {
            Dialect::CanSimple => Axis::new(at, self.node(), [HEARTBEAT, ESTIMATES, NEVER, NEVER]),
            Dialect::ODrive => Axis::new(at, self.node(), self.report_periods()),
            _ => Axis::SILENT,
        };
    }

    /// Returns the time of the next frame that it sends by itself.
    pub(crate) fn report_due(&self) -> Instant {
        self.axis.due()
    }

    /// Returns the frame that is due by `to`, and its time: `now`, if it was due before. While the
    /// motor is silent none is sent later.
    pub(crate) fn take_due_report(&mut self, now: Instant, to: Instant) -> Option<(Instant, DelayedReply)> {
        let at = self.axis.due().max(now);
        if !self.listens(at) {
            self.axis.take(to);
            return None;
        }
        self.advance(at);
        let frame = match self.axis.take(at)? {
            Report::Heartbeat if self.dialect() == Dialect::ODrive => self.odrive_heartbeat(),
            Report::Heartbeat => self.heartbeat(),
            Report::Estimates => self.estimates(at),
            Report::Torques => self.torques(at),
            Report::Supply => self.bus_supply(),
        };
        Some((at, DelayedReply { frame, after: Duration::ZERO }))
    }
}
