//! The facts of the MyActuator family.

use super::frame::base;
#[cfg(feature = "drive")]
use super::frame::number;
#[cfg(feature = "drive")]
use crate::drive::Addresses;
use crate::family::Family;
use crate::profile::{Capabilities, Profile, SupplyReport};
use crate::scale::Scales;
#[cfg(feature = "drive")]
use motord_bus::{Frame, FrameId, IdFilter, IdSet};

/// MyActuator's protocol, over CAN.
pub const FAMILY: Family = Family {
    name: "myactuator",
    needs_torque_end: true,
    ids: |_| [1, super::MOTORS_MAX],
    capabilities,
    default_host_id: |_, id| base::STATE + u16::from(id),
    #[cfg(feature = "commissioning")]
    reported: |_| crate::reported::ReportedProtocol::MyActuator,
    #[cfg(feature = "commissioning")]
    question: crate::reported::Question::MotorStatus,
    #[cfg(feature = "drive")]
    addresses,
    #[cfg(feature = "drive")]
    confirms_stop: Some(is_stop),
    ..Family::COMMON
};

/// No state confirms a stop: only the answer to it does.
const fn capabilities(_: &Profile, scales: &Scales) -> Capabilities {
    Capabilities {
        answers_fault_question: true,
        supply: SupplyReport::Question,
        state_confirms_stop: false,
        runs_without_enable: true,
        ..Capabilities::of_impedances(scales)
    }
}

/// The host id has no effect.
#[cfg(feature = "drive")]
fn addresses(id: u8, _: FrameId) -> Addresses {
    let with = |base: u16| FrameId::new(base + u16::from(id)).unwrap_or(FrameId::MAX);
    let exact = |base| IdFilter::exact(with(base));
    Addresses {
        command_id: with(base::IMPEDANCE),
        commands: IdSet::of_two(exact(base::IMPEDANCE), exact(base::COMMAND)),
        replies: IdSet::of_two(exact(base::STATE), exact(base::ANSWER)),
        node: None,
        shared: &base::SHARED,
    }
}

/// Returns whether a frame confirms that the drive is off.
#[cfg(feature = "drive")]
fn is_stop(frame: &Frame) -> bool {
    let is_answer = (base::ANSWER..base::SHARED[0]).contains(&(frame.id().raw() as u16));
    is_answer && frame.payload().first() == Some(&number::STOP)
}
