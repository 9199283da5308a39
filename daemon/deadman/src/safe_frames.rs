//! The safe frames of a daemon, built before they are needed and sent to its dead man's switch by
//! interface.

use motord_bus::transport::{self, BusKind};
use motord_bus::{Duration, Frame, Inbox, candump};
use motord_core::stopper::BusFrames;
use motord_settings::settings::{BusSettings, Settings};
use serde::{Deserialize, Serialize};

/// The frames that damp and stop every motor of a daemon, and when to send them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SafeFrames {
    /// A heartbeat that does not change for this long is dead.
    #[serde(rename = "patience")]
    pub heartbeat_timeout: Duration,
    /// Motors are damped for this long, then stopped.
    pub damp: Duration,
    /// CAN interfaces and serial ports, and the frames for each.
    pub buses: Vec<InterfaceFrames>,
}

/// The frames for one CAN interface or serial port.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InterfaceFrames {
    /// The interface, or the device of the port.
    pub interface: String,
    /// Bit/s of a serial port; `None` for a CAN interface, which is used as it is.
    #[serde(default)]
    pub baud: Option<u32>,
    /// One frame per motor that damps it, twice: rounds send the two in turn.
    pub damp: [Vec<WrittenFrame>; 2],
    /// One frame per motor that stops it.
    pub stop: Vec<WrittenFrame>,
}

/// A frame on its way between processes, as `candump` writes it: `101#0180008008001E00`.
pub type WrittenFrame = String;

/// Why the motors of an interface cannot be stopped.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
pub enum InterfaceError {
    /// The interface cannot be opened.
    #[error("{reason}")]
    Open {
        /// The error of the interface, as text: it comes from another process.
        reason: String,
    },
    /// A text is not a frame.
    #[error("{text:?} is not a frame such as 101#0180008008001E00")]
    Frame {
        /// The text.
        text: WrittenFrame,
    },
    /// The interface has more frames than one call can send.
    #[error("{count} motors on {interface}: at most {} fit", Inbox::CAPACITY)]
    Count {
        /// The interface.
        interface: String,
        /// The number of its frames.
        count: usize,
    },
}

impl SafeFrames {
    /// Builds the safe frames of a daemon with these settings. Simulated buses are inside the
    /// daemon and end with it.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        let interface = |(index, bus): (usize, &BusSettings)| {
            Some(InterfaceFrames::of(settings, index, bus.kind.address()?, bus.kind.baud()))
        };
        Self {
            heartbeat_timeout: settings.safety.deadman,
            damp: settings.safety.damp,
            buses: settings.buses.iter().enumerate().filter_map(interface).collect(),
        }
    }
}

impl InterfaceFrames {
    fn of(settings: &Settings, index: usize, interface: &str, baud: Option<u32>) -> Self {
        let BusFrames { damp, stop } = BusFrames::of(settings, index);
        Self { interface: interface.to_owned(), baud, damp: damp.map(written), stop: written(stop) }
    }

    /// Returns the bus; `None` for a name that no bus can have. Allocates.
    pub(crate) fn kind(&self) -> Option<BusKind> {
        transport::find(&self.interface, self.baud.unwrap_or_default())
    }

    /// Checks the frames, and returns them.
    ///
    /// # Errors
    ///
    /// [`InterfaceError::Frame`] or [`InterfaceError::Count`].
    pub fn checked(&self) -> Result<BusFrames, InterfaceError> {
        let [first, second] = &self.damp;
        let frames = BusFrames { damp: [frames(first)?, frames(second)?], stop: frames(&self.stop)? };
        match frames.most() {
            count if count > Inbox::CAPACITY => {
                Err(InterfaceError::Count { interface: self.interface.clone(), count })
            }
            _ => Ok(frames),
        }
    }
}

fn written(frames: Vec<Frame>) -> Vec<WrittenFrame> {
    frames.iter().map(Frame::to_string).collect()
}

fn frames(written: &[WrittenFrame]) -> Result<Vec<Frame>, InterfaceError> {
    let frame = |text: &WrittenFrame| {
        candump::frame(text).ok_or_else(|| InterfaceError::Frame { text: text.clone() })
    };
    written.iter().map(frame).collect()
}
