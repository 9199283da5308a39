//! The form of a vendor's drive.

use crate::settings::RobStrideFirmware;
use crate::wire::{MitCommand, State};
use motord_bus::{Frame, FrameId};

/// The differences of one vendor's drive from those of others.
#[derive(Debug)]
pub(crate) struct Drive {
    /// The vendor's name in [`MotorSettings::vendor`](crate::MotorSettings::vendor).
    pub(super) name: &'static str,
    /// Decodes a payload as the motor does; `None` for one that the motor ignores.
    pub(crate) decode: fn(&[u8]) -> Option<MitCommand>,
    /// Returns the frame of an answer.
    pub(crate) answer: fn(&Answer) -> Frame,
    /// A drive of this firmware answers every request in fault, whatever the other settings are.
    pub(crate) answers_in_fault: fn(RobStrideFirmware) -> bool,
    /// The vendor's numbers of over-voltage, under-voltage and over-temperature.
    pub(crate) conditions: [u32; 3],
    /// Returns the fault number of a drive that has the first fault and raises the second.
    pub(crate) raise: fn(u32, u32) -> u32,
}

/// The content of a reply, before the vendor's layout.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Answer {
    pub(crate) asked: Asked,
    /// The id of its frame.
    pub(crate) host_id: FrameId,
    /// The id of the motor, in the payload.
    pub(crate) id: u8,
    pub(crate) state: State,
    pub(crate) status: Status,
    pub(crate) fault: u32,
    /// Temperatures of the winding and of the driver board, °C.
    pub(crate) temperatures: [f64; 2],
    /// The firmware, if the motor is RobStride's.
    pub(crate) firmware: RobStrideFirmware,
    /// Values of bytes without a meaning.
    pub(crate) filler: [u8; 8],
}

/// The status of the drive, as far as a reply can carry it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Status {
    Off,
    On,
    Fault,
}

/// The content that a command requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Asked {
    State,
    Fault,
    Clear,
}

/// Combines faults that are bits.
pub(crate) const fn bits(known: u32, raised: u32) -> u32 {
    known | raised
}
