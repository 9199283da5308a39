//! The facts of the MIT family that do not depend on a vendor.

use crate::family::Family;
use crate::profile::{Capabilities, Profile};
use crate::register::ENDS;
#[cfg(feature = "commissioning")]
use crate::reported::ReportedProtocol;
use crate::scale::Scales;
#[cfg(feature = "drive")]
use motord_bus::arithmetic::FrameLength;

/// MIT over CAN.
pub const FAMILY: Family = Family {
    name: "mit",
    capabilities,
    #[cfg(feature = "commissioning")]
    reported,
    #[cfg(feature = "drive")]
    frame_lengths: |profile| [8, profile.reply.lengths[0] as u32].map(FrameLength::classic),
    ..Family::COMMON
};

/// Answers of SteadyWin have six bytes.
#[cfg(feature = "commissioning")]
fn reported(profile: &Profile) -> ReportedProtocol {
    if profile.reply.lengths.contains(&6) { ReportedProtocol::Mit } else { ReportedProtocol::OtherMit }
}

const fn capabilities(profile: &Profile, scales: &Scales) -> Capabilities {
    Capabilities {
        answers_fault_question: profile.is_asked_for_faults(),
        registers: if profile.has_registers { ENDS.len() as u8 } else { 0 },
        scales_by_registers: profile.has_registers,
        ..Capabilities::of_impedances(scales)
    }
}
