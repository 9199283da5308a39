//! RobStride's motors in MIT mode. None of the sources is confirmed on hardware: the vendor's
//! SampleProgram (`RS/Robstride01.cpp`), its manuals of 2026-04-28 (section 6), its Chinese manuals
//! 1.1 of 2026-04-10 (RS00 to RS06), and notes that quote the RS00 manual of 2026-01-12 (sections
//! "MIT protocol").
//!
//! - By default the motors use another protocol, with 29-bit ids. Select MIT once, with the
//!   vendor's tool.
//! - A command has the motor's id, 1 to 127. The motor receives position and speed mode at 0x100
//!   and 0x200 + id. Newer firmware (RS00 from 0.0.3.27, RS01 from 0.1.3.14) reads a parameter at
//!   0x300 + id, and writes one at 0x400 + id.
//! - Replies have the master id of eight bits, which is the same for all motors by default. Set it
//!   to 0x40 + id on each motor.
//! - Six bytes 0xFF begin the commands that change mode (…FC), protocol (…FD), the motor's id (…FA)
//!   and the master id (…01). Except in the stop frame, the seventh byte is a value and not 0xFF.
//!   Therefore no control frame may begin with six 0xFF, and the stop frame has seven.
//! - The motor replies to a clear with a state. It replies to a fault request with the id and 32
//!   little-endian bits. The sample treats a reply as a fault report when its last bytes are zero.
//! - The manuals of 2026-04-10 describe byte 6 of a state as mode (bits 7 and 6: 0 reset, 1
//!   calibration, 2 motor), fault (5), warning (4), and the highest four bits of the temperature.
//!   Older manuals give bytes 6 and 7 to the temperature alone. 12 bits are enough for both.

use super::{FaultReply, FaultReport, Flags, Ids, Profile, ReplyLayout, Temperature};
use crate::fault::Faults;
use crate::model::{Model, model};

/// RobStride's RS series, MIT mode.
pub const ROBSTRIDE: Profile = Profile {
    name: "robstride",
    motors: "RobStride RS in MIT mode",
    speaks_gim: false,
    ids: Ids {
        largest: 0x7F,
        largest_reply: 0xFF,
        reply_offset: 0x40,
        also_receives: &[0x100, 0x200, 0x300, 0x400],
    },
    reply: ReplyLayout {
        lengths: [8, 8],
        id_mask: 0xFF,
        temperatures: &[Temperature {
            of: "motor",
            at: 6,
            bits: 12,
            per_celsius: 10.0,
            negative_from: 0x800,
        }],
        flags: Some(Flags { at: 6, mode: 0b1100, on: 0b1000, no_mode: 0b1100, fault: 0b0010 }),
    },
    faults: FaultReport::Asked(FaultReply {
        bytes: 4,
        lengths: [5, 8],
        // No fault above bit 16 is documented, and the sample's report ends with its number. Not
        // confirmed on hardware.
        zeros: [0, 0, 0, 0xFE, 0xFF, 0xFF, 0xFF, 0xFF],
        words: &[
            (1 << 0, Faults::OVER_TEMPERATURE),
            (1 << 1, Faults::DRIVER_CHIP),
            (1 << 2, Faults::UNDER_VOLTAGE),
            (1 << 3, Faults::OVER_VOLTAGE),
            (1 << 4, Faults::OVER_CURRENT),
            (1 << 5, Faults::OVER_CURRENT),
            (1 << 7, Faults::ENCODER),
            (1 << 8, Faults::HARDWARE),
            (1 << 9, Faults::POSITION),
            (1 << 14, Faults::OVERLOAD),
            (1 << 16, Faults::OVER_CURRENT),
        ],
    }),
    has_registers: false,
    models: &MODELS,
};

/// From the vendor's manuals of 2026-04-28, of which each model has one. The phase resistance is
/// not published: 0. Velocities without load (RS03 20.9, RS04 20.9, RS05 and RS06 50.3 rad/s) are
/// cut at the ends of the codes.
///
/// The Chinese manuals (version 1.1) give RS02, RS03 and RS04 in MIT mode the ends of the private
/// protocol. The English ones (version 1.0) have 33 rad/s there, a text that they share with RS00.
const MODELS: [Model; 7] = [
    model("RS00", 10.0, 0.105, [5.0, 14.0], [4.7, 15.5], 33.0, 0.0, 14, 48.0).with_ends(12.57, 33.0, 14.0),
    model("RS01", 7.75, 0.111, [6.0, 17.0], [7.0, 23.0], 33.0, 0.0, 14, 36.0).with_ends(12.57, 44.0, 17.0),
    model("RS02", 7.75, 0.111, [6.0, 17.0], [7.0, 23.0], 42.9, 0.0, 14, 48.0).with_ends(12.57, 44.0, 17.0),
    model("RS03", 9.0, 0.185, [20.0, 60.0], [13.0, 43.0], 20.0, 0.0, 21, 48.0)
        .with_ends(12.57, 20.0, 60.0)
        .with_gain_ends(5000.0, 100.0),
    model("RS04", 9.0, 0.165, [40.0, 120.0], [27.0, 90.0], 15.0, 0.0, 21, 48.0)
        .with_ends(12.57, 15.0, 120.0)
        .with_gain_ends(5000.0, 100.0),
    model("RS05", 7.75, 0.0858, [1.6, 5.5], [2.4, 11.0], 50.0, 0.0, 10, 48.0).with_ends(12.57, 50.0, 5.5),
    model("RS06", 9.0, 0.0856, [11.0, 36.0], [14.3, 57.0], 50.0, 0.0, 14, 48.0)
        .with_ends(12.57, 50.0, 36.0)
        .with_gain_ends(5000.0, 100.0),
];
