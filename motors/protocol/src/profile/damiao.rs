//! Damiao's DM-J motors. None of the sources is confirmed on hardware: DM_CAN.py (the vendor's
//! Python sample), motorbridge (`motor_vendors/damiao`), openarm_can (`dm_motor_control.cpp`), and
//! the Seeed wiki's table of the series.
//!
//! - A control frame has the motor's id. The motor also receives other modes at 0x100, 0x200 and
//!   0x300 + id, and register access at 0x7FF.
//! - The first byte of a reply is the error code and the lower four bits of the id. The largest id
//!   here is therefore 15. Replies have the id MST_ID, which is 0 by default: set it to 0x10 + id
//!   on each motor.
//! - The motors have no request for faults. They read SteadyWin's (six bytes 0xFF, 0x00, 0xFB) as a
//!   control frame.
//! - PMAX, VMAX and TMAX are registers (21 to 23). The sources disagree on VMAX of the 4340: 8 in
//!   the vendor's table, 10 in registers that users read. The cycle reads the registers of each
//!   motor and uses them: the ends of a model are used until then.

use super::{FaultReport, Ids, Profile, ReplyLayout, Status, Temperature};
use crate::fault::Faults;
use crate::model::{Model, model};

/// Damiao's DM-J series.
pub const DAMIAO: Profile = Profile {
    name: "damiao",
    motors: "Damiao DM-J",
    speaks_gim: false,
    ids: Ids {
        largest: 0x0F,
        largest_reply: 0x7FE,
        reply_offset: 0x10,
        also_receives: &[0x100, 0x200, 0x300],
    },
    reply: ReplyLayout {
        lengths: [8, 8],
        id_mask: 0x0F,
        temperatures: &[
            Temperature { of: "driver", at: 6, bits: 8, per_celsius: 1.0, negative_from: FROST },
            Temperature { of: "motor", at: 7, bits: 8, per_celsius: 1.0, negative_from: FROST },
        ],
        flags: None,
    },
    faults: FaultReport::InEveryReply(Status {
        shift: 4,
        off: 0x0,
        on: 0x1,
        words: &[
            (0x8, Faults::OVER_VOLTAGE),
            (0x9, Faults::UNDER_VOLTAGE),
            (0xA, Faults::OVER_CURRENT),
            (0xB, Faults::DRIVER_OVER_TEMPERATURE),
            (0xC, Faults::MOTOR_OVER_TEMPERATURE),
            (0xD, Faults::HOST_SILENT),
            (0xE, Faults::OVERLOAD),
        ],
    }),
    has_registers: true,
    models: &MODELS,
};

/// -40 °C. No source names the sign of a temperature, and no motor has 216 °C.
const FROST: u16 = 0xD8;

/// The 24 V windings. Mechanics from the Seeed wiki, whose torque constant is that of the output;
/// ends from DM_CAN.py. The wiki has the ends of 4340P, 8009P, 3507 and 10010, too; those of 4310P,
/// 6248P and H3510 are from damiao-motor 1.0.6 (`_MOTOR_LIMIT_PARAM`). The mechanics of these three
/// have one source, a library that quotes their manuals; the phase resistance is not known: 0. The
/// peak of the 4310P, 12.5 N·m, is cut at TMAX. The pole pairs of 6248P and H3510 are assumed. The
/// inertias of rotors are those of the vendor's table of the series for 4310, 4340 and 8009. A P in
/// the name of 4340 and 8009 is another bearing of the same motor.
#[expect(clippy::approx_constant, reason = "a velocity without load of 60 rpm")]
const MODELS: [Model; 13] = [
    model("DM-J3507-2EC", 7.0, 0.0777, [0.8, 3.0], [2.4, 8.3], 48.2, 0.8, 14, 24.0)
        .with_ends(12.566, 50.0, 5.0),
    model("DM-J4310-2EC", 10.0, 0.0945, [3.0, 7.0], [3.7, 7.2], 20.9, 0.85, 14, 24.0)
        .with_ends(12.5, 30.0, 10.0)
        .with_rotor_inertia(1.8e-5),
    model("DM-J4310P-2EC", 10.0, 0.0714, [3.5, 10.0], [4.9, 16.0], 20.9, 0.0, 14, 24.0)
        .with_ends(12.5, 50.0, 10.0),
    model("DM-J4340-2EC", 40.0, 0.1019, [9.0, 27.0], [3.0, 8.0], 5.5, 0.88, 14, 24.0)
        .with_ends(12.5, 8.0, 28.0)
        .with_rotor_inertia(2.0e-5),
    model("DM-J4340P-2EC", 40.0, 0.1019, [9.0, 27.0], [3.0, 8.0], 5.5, 0.88, 14, 24.0)
        .with_ends(12.5, 8.0, 28.0)
        .with_rotor_inertia(2.0e-5),
    model("DM-J6006-2EC", 6.0, 0.1218, [4.0, 11.0], [5.96, 17.6], 23.7, 0.435, 14, 24.0)
        .with_ends(12.5, 45.0, 20.0),
    model("DM-J6248P-2EC", 48.0, 0.0553, [30.0, 97.0], [11.3, 38.7], 6.28, 0.0, 14, 24.0)
        .with_ends(12.566, 20.0, 120.0),
    model("DM-J8006-2EC", 6.0, 0.1701, [8.0, 20.0], [9.0, 21.0], 20.3, 0.4, 21, 24.0)
        .with_ends(12.5, 45.0, 40.0),
    model("DM-J8009-2EC", 9.0, 0.1402, [20.0, 40.0], [18.6, 40.0], 17.6, 0.145, 21, 24.0)
        .with_ends(12.5, 45.0, 54.0)
        .with_rotor_inertia(1.95e-4),
    model("DM-J8009P-2EC", 9.0, 0.1402, [20.0, 40.0], [18.6, 40.0], 17.6, 0.145, 21, 24.0)
        .with_ends(12.5, 45.0, 54.0)
        .with_rotor_inertia(1.95e-4),
    model("DM-J10010-2EC", 10.0, 0.2599, [40.0, 150.0], [18.4, 80.2], 7.85, 0.125, 21, 24.0)
        .with_ends(12.5, 20.0, 200.0),
    model("DM-J10010L-2EC", 10.0, 0.2, [40.0, 120.0], [23.5, 95.0], 10.5, 0.11, 21, 24.0)
        .with_ends(12.5, 25.0, 200.0),
    model("DM-H3510", 1.0, 0.1636, [0.18, 0.45], [1.1, 3.2], 188.5, 0.0, 14, 24.0)
        .with_ends(12.5, 280.0, 1.0),
];
