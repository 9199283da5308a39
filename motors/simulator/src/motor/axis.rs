//! The state of a drive that only the dialects of the CANSimple family have: its control mode, and when
//! it reports by itself.

use motord_bus::{Duration, Instant};

/// The interval of a report that is not sent.
pub(super) const NEVER: Duration = Duration::ZERO;
/// Separates the reports of drives that boot together, for each step of the node id.
const PHASE: Duration = Duration::from_micros(730);

/// A frame that a drive sends by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Report {
    Heartbeat,
    Estimates,
    Torques,
    Supply,
}

/// All reports. Of those that are due at the same time, the first one is sent first.
const REPORTS: [Report; 4] = [Report::Heartbeat, Report::Estimates, Report::Torques, Report::Supply];

/// A report, its interval, and the time of the next one.
#[derive(Debug, Clone, Copy)]
struct Cyclic {
    report: Report,
    period: Duration,
    due: Instant,
}

/// A control mode with the input mode passthrough.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ControlMode {
    Torque,
    Velocity,
    Position,
}

/// Position, turns, velocity, turns/s, and torque, N·m, of the rotor.
pub(super) type Input = [f64; 3];

/// The controller of an ODrive.
#[derive(Debug, Clone, Copy)]
pub(super) struct Controller {
    /// `None`: one that exerts no torque.
    pub(super) mode: Option<ControlMode>,
    /// The last input of each control mode.
    pub(super) inputs: [Option<Input>; 3],
}

impl Controller {
    /// After a boot.
    pub(super) const FACTORY: Self = Self { mode: Some(ControlMode::Position), inputs: [None; 3] };
}

/// The controller modes, and the times of the reports.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis {
    /// With CANSimple: the control mode is that of impedances.
    pub(super) accepts_impedance: bool,
    /// Of an ODrive.
    pub(super) controller: Controller,
    /// In the order of [`REPORTS`].
    reports: [Cyclic; REPORTS.len()],
}

impl Cyclic {
    /// Never sent.
    const OFF: Self = Self { report: Report::Heartbeat, period: NEVER, due: Instant::FAR_FUTURE };

    /// Returns a report that is due one `period` after `start` for the first time.
    fn new(report: Report, period: Duration, start: Instant) -> Self {
        let due = if period == NEVER { Instant::FAR_FUTURE } else { start + period };
        Self { report, period, due }
    }
}

impl Axis {
    /// Sends nothing by itself.
    pub(super) const SILENT: Self = Self {
        accepts_impedance: false,
        controller: Controller::FACTORY,
        reports: [Cyclic::OFF; REPORTS.len()],
    };

    /// Returns the state of the drive with this node id that booted at `at`. `periods` are the
    /// intervals of its heartbeat, estimates, torques and supply.
    pub(super) fn new(at: Instant, node: u8, periods: [Duration; REPORTS.len()]) -> Self {
        let start = at + PHASE * u32::from(node);
        let cyclic = |index: usize| Cyclic::new(REPORTS[index], periods[index], start);
        Self { reports: core::array::from_fn(cyclic), ..Self::SILENT }
    }

    /// Returns the time of the next report.
    pub(super) fn due(&self) -> Instant {
        self.reports.iter().map(|cyclic| cyclic.due).min().unwrap_or(Instant::FAR_FUTURE)
    }

    /// Takes the report that was due by `now`. The next one of its kind is due one period
    /// later. A drive sends no report again that it could not send in its time.
    pub(super) fn take(&mut self, now: Instant) -> Option<Report> {
        let cyclic = self.reports.iter_mut().min_by_key(|cyclic| cyclic.due)?;
        let next = cyclic.due + cyclic.period;
        cyclic.due = if next > now { next } else { now + cyclic.period };
        Some(cyclic.report)
    }
}
