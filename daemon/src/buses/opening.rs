//! Opens one bus.

use motord_bus::transport::{Cause, Nodes, OpenError, Opened};
use motord_bus::{Difference, Identity};
use motord_settings::plan::BusPlan;
use motord_settings::settings::{BusSettings, Settings};
use motord_twin::simulate;

/// Why a bus could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// Its interface or port cannot be used, or another daemon uses it.
    #[error("bus {bus}: {source}")]
    Open {
        /// The bus.
        bus: String,
        /// Why.
        source: OpenError,
    },
    /// Another interface got the name while it was opened.
    #[error("bus {bus}: its interface was exchanged while it was opened")]
    Exchanged {
        /// The bus.
        bus: String,
    },
    /// Another adapter than the one that was opened first has the name.
    #[error(
        "bus {bus}: {device} is another adapter than before: {difference}; it is not opened. Give each adapter a fixed name and plug \
         it in again, as `motorctl explain exchanged` describes"
    )]
    OtherAdapter {
        /// The bus.
        bus: String,
        /// The interface or the device.
        device: String,
        /// The properties that differ.
        difference: Difference,
    },
}

impl BusError {
    /// Returns the error of opening or locking this bus.
    pub(super) fn of(bus: &BusSettings, source: impl Into<OpenError>) -> Self {
        Self::Open { bus: bus.name.clone(), source: source.into() }
    }

    fn cause(&self) -> Option<Cause> {
        if let Self::Open { source, .. } = self { Some(source.cause()) } else { None }
    }

    /// Returns `true` when the interface or port may come by itself, such as when an adapter is
    /// plugged in.
    #[must_use]
    pub fn may_pass(&self) -> bool {
        matches!(self, Self::Exchanged { .. }) || self.cause() == Some(Cause::Absent)
    }

    /// Returns `true` when another process has the lock of the bus.
    #[must_use]
    pub fn is_locked(&self) -> bool {
        self.cause() == Some(Cause::Locked)
    }
}

/// Opens one bus, for the first time or again. A serial port must be closed before it is opened
/// again.
///
/// # Errors
///
/// Why it cannot be opened.
pub fn open_one(settings: &Settings, index: usize) -> Result<Opened, BusError> {
    open_expected(settings, index, None)
}

/// Works like [`open_one`], but sets up no other CAN interface than the `expected` one.
pub(super) fn open_expected(
    settings: &Settings,
    index: usize,
    expected: Option<Identity>,
) -> Result<Opened, BusError> {
    let bus = &settings.buses[index];
    match bus.kind.hardware() {
        Some(hardware) => hardware.open(&nodes(settings, index), expected),
        None => Ok(Opened::plain(simulate(settings, index, bus.kind.seed().unwrap_or_default()))),
    }
    .map_err(|source| BusError::of(bus, source))
}

/// The nodes of the bus with this index. A request on a line is given up a while before the plan
/// has the next one sent. Allocates.
#[must_use]
pub fn nodes(settings: &Settings, index: usize) -> Nodes {
    let reply_timeout = BusPlan::of(settings)[index].transaction_worst * 3 / 4;
    motord_settings::nodes::nodes(settings, index, reply_timeout)
}
