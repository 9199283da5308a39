//! The facts of the CANSimple family.

use super::{ENDS, NODE_MAX};
#[cfg(feature = "drive")]
use super::{Id, Reply};
#[cfg(feature = "drive")]
use crate::drive::{Addresses, UnpromptedFrame};
use crate::family::Family;
use crate::profile::{Capabilities, Profile, SupplyReport};
use crate::scale::Scales;
#[cfg(feature = "drive")]
use motord_bus::arithmetic::FrameLength;
#[cfg(feature = "drive")]
use motord_bus::{Frame, FrameId, IdFilter, IdSet};

/// CANSimple with impedance control, over CAN.
pub const FAMILY: Family = Family {
    name: "cansimple",
    ends: Some(ENDS),
    reports_rotor: true,
    ids: |_| [0, NODE_MAX],
    factory_bitrate: Some(500_000),
    capabilities,
    default_host_id: |_, node| u16::from(node & NODE_MAX) << 5 | 0x08,
    #[cfg(feature = "commissioning")]
    reported: |_| crate::reported::ReportedProtocol::CanSimple,
    #[cfg(feature = "commissioning")]
    question: crate::reported::Question::Node,
    #[cfg(feature = "drive")]
    addresses,
    #[cfg(feature = "drive")]
    confirms_stop: Some(is_idle),
    #[cfg(feature = "drive")]
    reports: &REPORTS,
    // The answer to an impedance has 6 bytes, that to the poll of a stopped motor the common 8.
    ..Family::COMMON
};

/// Rates from the factory. Other reports are off.
#[cfg(feature = "drive")]
const REPORTS: [UnpromptedFrame; 2] = [
    // Heartbeat.
    UnpromptedFrame { length: FrameLength::classic(8), rate_hz: 10.0 },
    // Estimates of the encoder.
    UnpromptedFrame { length: FrameLength::classic(8), rate_hz: 100.0 },
];

const fn capabilities(_: &Profile, scales: &Scales) -> Capabilities {
    Capabilities {
        answers_fault_question: true,
        supply: SupplyReport::Question,
        reports_stopped_state: true,
        ..Capabilities::of_impedances(scales)
    }
}

/// Bits of an id that all ids of a node share.
#[cfg(feature = "drive")]
const NODE_MASK: u32 = 0x7E0;
/// Bits that separate replies from commands. 0x000 to 0x003 and 0x008 to 0x00B are replies: among
/// them are heartbeat, errors, impedance and estimates. 0x004 to 0x007 and 0x00C to 0x00F are
/// commands: among them are the state of the axis, position, velocity and torque.
#[cfg(feature = "drive")]
const PART_MASK: u32 = 0x7F4;
#[cfg(feature = "drive")]
const COMMANDS: u32 = 0x004;
/// A reply that the bits do not separate.
#[cfg(feature = "drive")]
const SUPPLY: u32 = 0x017;

/// An impedance and its reply have one id, so a bus cannot tell an impedance of another master from
/// a reply by its id. The host id has no effect.
#[cfg(feature = "drive")]
fn addresses(node: u8, _: FrameId) -> Addresses {
    let base = u32::from(node & NODE_MAX) << 5;
    let masked =
        |part: u32, mask| IdFilter::masked(FrameId::new((base | part) as u16).unwrap_or(FrameId::MAX), mask);
    let commands = masked(COMMANDS, PART_MASK);
    Addresses {
        command_id: commands.highest(),
        commands: commands.into(),
        replies: IdSet::of_two(masked(0, PART_MASK), masked(SUPPLY, 0x7FF)),
        node: Some(masked(0, NODE_MASK)),
        shared: &[],
    }
}

/// Returns whether a frame is a heartbeat of an idle axis. A running motor also sends the other frames.
#[cfg(feature = "drive")]
fn is_idle(frame: &Frame) -> bool {
    let reply = Reply::decode(Id::of(frame.id().raw()), frame.payload());
    matches!(reply, Some(Reply::Heartbeat(heartbeat)) if heartbeat.state.is_idle())
}
