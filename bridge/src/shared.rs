//! The values that all threads of the bridge share.

use crate::controls::Values;
use crate::link::GroupLink;
use crate::slot::Slot;
use motord_client::{RobotDescription, State};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

/// The newest states.
#[derive(Debug, Clone)]
pub(crate) struct Snapshot {
    pub(crate) state: State,
    pub(crate) robot: Arc<RobotDescription>,
}

impl Snapshot {
    /// Returns the lowest supply voltage that a motor reports, V.
    pub(crate) fn battery(&self) -> Option<f32> {
        self.state.joints().filter_map(|joint| joint.supply_voltage).min_by(f32::total_cmp)
    }
}

/// A report of the motor thread.
#[derive(Debug, Clone)]
pub(crate) enum Report {
    State(Snapshot),
    /// No state arrives, for this reason.
    Down(String),
}

/// The shared values. No lock in them is held during a call of the network or of the daemon.
#[derive(Debug)]
pub(crate) struct Shared {
    /// The robot as it was when the bridge connected.
    pub(crate) robot: Arc<RobotDescription>,
    /// The groups, in the order of the description.
    pub(crate) groups: Vec<Arc<GroupLink>>,
    /// For the thread that publishes.
    pub(crate) report: Slot<Report>,
    /// For the page.
    pub(crate) page: Slot<Report>,
    /// For the rules of trajectories, which begin at the present positions.
    pub(crate) latest: Slot<State>,
    /// The newest values of the gamepad, put where they change.
    pub(crate) gamepad: Slot<Values>,
    /// The bridge ends. A signal also sets it.
    pub(crate) ends: Arc<AtomicBool>,
    failure: OnceLock<String>,
}

impl Shared {
    pub(crate) fn new(
        robot: Arc<RobotDescription>,
        groups: Vec<Arc<GroupLink>>,
        ends: Arc<AtomicBool>,
    ) -> Self {
        let (report, latest, failure) = (Slot::default(), Slot::default(), OnceLock::new());
        let (page, gamepad) = (Slot::default(), Slot::default());
        Self { robot, groups, report, page, latest, gamepad, ends, failure }
    }

    /// Returns `true` once the bridge has to end.
    pub(crate) fn ends(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }

    /// Ends the bridge for `reason`.
    pub(crate) fn fail(&self, reason: String) {
        let _another_reason = self.failure.set(reason);
        self.ends.store(true, Ordering::Relaxed);
    }

    /// Returns the reason of the end; `None` after a signal.
    pub(crate) fn failure(&self) -> Option<&str> {
        self.failure.get().map(String::as_str)
    }
}
