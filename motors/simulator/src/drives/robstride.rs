//! RobStride's drives in MIT mode, from the vendor's SampleProgram, the RS00 manual, and the
//! Chinese manuals 1.1 of 2026-04-10.
//!
//! An answer is the id, the state, and the winding's temperature in tenths of a °C. Newer firmware
//! has mode (2 bits), fault and warning above 12 bits of temperature. The answer to a fault request
//! is the id, 32 bits of faults with the low byte first, and zeros. The drive answers a clear with
//! its state.

use super::drive::{Answer, Asked, Drive, Status, bits};
use crate::settings::RobStrideFirmware;
use crate::wire::MitCommand;
use motord_bus::Frame;

pub(super) const DRIVE: Drive = Drive {
    name: "robstride",
    decode: MitCommand::decode,
    answer,
    answers_in_fault: |firmware| firmware == RobStrideFirmware::Manual2026,

    conditions: [1 << 3, 1 << 2, 1 << 0],
    raise: bits,
};

fn answer(answer: &Answer) -> Frame {
    if answer.asked == Asked::Fault {
        let [a, b, c, d] = answer.fault.to_le_bytes();
        return Frame::classic(answer.host_id, [answer.id, a, b, c, d, 0, 0, 0]);
    }
    let [a, b, c, d, e] = answer.state.mit();
    let [winding, _] = answer.temperatures;
    let [high, low] = ((winding * 10.0).round() as i16).to_be_bytes();
    let high = match answer.firmware {
        RobStrideFirmware::Manual2025 => high,
        RobStrideFirmware::Manual2026 => status(answer.status) | high & 0x0F,
    };
    Frame::classic(answer.host_id, [answer.id, a, b, c, d, e, high, low])
}

/// Bits 7 and 6: the mode, 0 reset, 2 motor. Bit 5: a fault.
const fn status(status: Status) -> u8 {
    match status {
        Status::Off => 0,
        Status::On => 2 << 6,
        Status::Fault => 1 << 5,
    }
}
