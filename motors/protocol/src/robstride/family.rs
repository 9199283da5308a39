//! The facts of RobStride's own family.

#[cfg(feature = "drive")]
use crate::drive::Addresses;
use crate::family::Family;
use crate::profile::{Capabilities, Profile, SupplyReport};
use crate::scale::Scales;
#[cfg(feature = "drive")]
use motord_bus::arithmetic::{FrameLength, IdWidth};
#[cfg(feature = "drive")]
use motord_bus::{Format, FrameId, IdFilter};

/// The host's id of the vendor's examples. No motor may have it.
pub const HOST_ID: u8 = 0xFD;

/// RobStride's private protocol, over CAN with ids of 29 bits.
pub const FAMILY: Family = Family {
    name: "robstride",
    capabilities,
    default_host_id: |_, _| HOST_ID.into(),
    #[cfg(feature = "commissioning")]
    reported: |_| crate::reported::ReportedProtocol::RobStride,
    #[cfg(feature = "commissioning")]
    question: crate::reported::Question::PrivateFirst,
    #[cfg(feature = "drive")]
    frame_lengths: |_| [FrameLength { width: IdWidth::Extended, format: Format::Classic, bytes: 8 }; 2],
    #[cfg(feature = "drive")]
    addresses,
    ..Family::COMMON
};

/// Bits of an id: its receiver, and in a reply also its sender.
#[cfg(feature = "drive")]
const COMMAND_MASK: u32 = 0xFF;
#[cfg(feature = "drive")]
const REPLY_MASK: u32 = 0xFFFF;

/// Every state has the faults, so the motor is never asked for them.
const fn capabilities(_: &Profile, scales: &Scales) -> Capabilities {
    Capabilities { supply: SupplyReport::Question, ..Capabilities::of_impedances(scales) }
}

/// A command ends with the motor's id, whatever its type. A reply ends with the ids of motor and
/// host.
#[cfg(feature = "drive")]
fn addresses(id: u8, host_id: FrameId) -> Addresses {
    let masked =
        |raw: u32, mask| IdFilter::masked(FrameId::extended(raw).unwrap_or(FrameId::MAX_EXTENDED), mask);
    let commands = masked(u32::from(id), COMMAND_MASK);
    let replies = masked(u32::from(id) << 8 | host_id.raw() & 0xFF, REPLY_MASK);
    Addresses {
        command_id: commands.highest(),
        commands: commands.into(),
        replies: replies.into(),
        node: None,
        shared: &[],
    }
}
