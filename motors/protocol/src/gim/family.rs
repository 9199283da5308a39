//! The facts of SteadyWin's native family.

use super::{INDICATORS, Indicator, repeats};
use crate::family::Family;
use crate::profile::{Capabilities, Profile, SupplyReport};
use crate::scale::Scales;

/// SteadyWin's GIM protocol, over CAN, RS485 or RS232. Frames have 8 bytes (GIM document, table 2).
pub const FAMILY: Family = Family {
    name: "gim",
    answers_on_line: Some(repeats),
    has_codes: false,
    has_durations: true,
    has_items: true,
    capabilities,
    #[cfg(feature = "commissioning")]
    reported: |_| crate::reported::ReportedProtocol::Gim,
    ..Family::COMMON
};

/// Source: GIM document 3.2.12 (a stop is answered by a separate message).
const fn capabilities(_: &Profile, _: &Scales) -> Capabilities {
    Capabilities {
        impedance: false,
        position_end: None,
        velocity_end: None,
        answers_fault_question: true,
        only_reports: false,
        indicators: INDICATORS.len() as u8,
        supply: SupplyReport::Indicator(Indicator::BUS_VOLTAGE),
        registers: 0,
        scales_by_registers: false,
        reports_stopped_state: false,
        state_confirms_stop: false,
        runs_without_enable: false,
    }
}
