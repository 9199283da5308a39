//! SteadyWin's SDC101, SDC102 and SDC103 drivers. Source: MIT document 1.1 and 1.2; models: the
//! vendor's selection table.

use super::{FaultReply, FaultReport, Ids, Profile, ReplyLayout};
use crate::fault::Faults;
use crate::model::MODELS;

/// SteadyWin SDC101, SDC102 and SDC103.
pub const STEADYWIN: Profile = Profile {
    name: "steadywin",
    motors: "SteadyWin GIM with an SDC101, SDC102 or SDC103 driver",
    speaks_gim: true,
    // A reply identifies the motor by one byte, and 0xFF begins every special frame.
    ids: Ids { largest: 0xFE, largest_reply: 0x7FF, reply_offset: 0x100, also_receives: &[] },
    reply: ReplyLayout {
        // Documented replies have 6 bytes. Relatives append up to two bytes.
        lengths: [6, 8],
        id_mask: 0xFF,
        temperatures: &[],
        flags: None,
    },
    faults: FaultReport::Asked(FaultReply {
        bytes: 1,
        lengths: [6, 8],
        // The document gives these bytes no meaning. The vendor's drivers send zero, which no
        // document guarantees.
        zeros: [0, 0, 0, 0xFF, 0xFF, 0xFF, 0, 0],
        words: &[
            (0x01, Faults::FOC_FREQUENCY),
            (0x02, Faults::OVER_VOLTAGE),
            (0x04, Faults::UNDER_VOLTAGE),
            (0x08, Faults::OVER_TEMPERATURE),
            (0x10, Faults::START_FAILURE),
            (0x20, Faults::UNNAMED),
            (0x40, Faults::OVER_CURRENT),
            (0x80, Faults::SOFTWARE),
        ],
    }),
    has_registers: false,
    models: &MODELS,
};
