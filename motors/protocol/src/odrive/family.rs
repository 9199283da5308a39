//! The facts of the ODrive family.

use super::NODE_MAX;
#[cfg(feature = "drive")]
use crate::drive::{Addresses, UnpromptedFrame};
use crate::family::Family;
use crate::profile::{Capabilities, Profile, SupplyReport};
use crate::scale::Scales;
#[cfg(feature = "drive")]
use motord_bus::arithmetic::FrameLength;
#[cfg(feature = "drive")]
use motord_bus::{FrameId, IdFilter, IdSet};

/// ODrive's CANSimple of firmware 0.6, over CAN.
pub const FAMILY: Family = Family {
    name: "odrive",
    has_codes: false,
    ends: None,
    ids: |_| [0, NODE_MAX],
    factory_bitrate: Some(250_000),
    capabilities,
    // That of CANSimple, because a scan reports both alike.
    default_host_id: |_, node| u16::from(node) << 5 | 0x08,
    #[cfg(feature = "drive")]
    addresses,
    #[cfg(feature = "drive")]
    reports: &REPORTS,
    // The answers to a scan, and the heartbeat of an idle axis. A drive that is set up for the cycle sends
    // its estimates once in each turn.
    ..crate::cansimple::FAMILY
};

/// Beside the estimates: heartbeat, torques and supply, as docs/motors.md sets them up.
#[cfg(feature = "drive")]
const REPORTS: [UnpromptedFrame; 3] = [
    UnpromptedFrame { length: FrameLength::classic(8), rate_hz: 10.0 },
    UnpromptedFrame { length: FrameLength::classic(8), rate_hz: 500.0 },
    UnpromptedFrame { length: FrameLength::classic(8), rate_hz: 10.0 },
];

const fn capabilities(_: &Profile, _: &Scales) -> Capabilities {
    Capabilities {
        impedance: false,
        position_end: None,
        velocity_end: None,
        answers_fault_question: false,
        only_reports: true,
        indicators: 0,
        supply: SupplyReport::Unasked,
        registers: 0,
        scales_by_registers: false,
        reports_stopped_state: false,
        state_confirms_stop: true,
        runs_without_enable: false,
    }
}

/// Bits of an id that all ids of a node share.
#[cfg(feature = "drive")]
const NODE_MASK: u32 = 0x7E0;
/// Parts of ids, and the bits by which each is distinguished. State; mode; position, velocity, torque and
/// limits; errors, position and gains.
#[cfg(feature = "drive")]
const COMMANDS: [(u32, u32); 4] = [(0x07, 0x7FF), (0x0B, 0x7FF), (0x0C, 0x7FC), (0x18, 0x7FC)];
/// Heartbeat and errors; estimates; temperatures and supply; torques.
#[cfg(feature = "drive")]
const REPLIES: [(u32, u32); 4] = [(0x01, 0x7FD), (0x09, 0x7FF), (0x15, 0x7FD), (0x1C, 0x7FF)];

/// The host id has no effect.
#[cfg(feature = "drive")]
fn addresses(node: u8, _: FrameId) -> Addresses {
    let base = u32::from(node.min(NODE_MAX)) << 5;
    let masked = |(part, mask): (u32, u32)| {
        IdFilter::masked(FrameId::new((base | part) as u16).unwrap_or(FrameId::MAX), mask)
    };
    Addresses {
        command_id: masked(COMMANDS[3]).highest(),
        commands: IdSet::of_four(COMMANDS.map(masked)),
        replies: IdSet::of_four(REPLIES.map(masked)),
        node: Some(masked((0, NODE_MASK))),
        shared: &[],
    }
}
