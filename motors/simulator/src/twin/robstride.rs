//! RobStride's drives in MIT mode, from the vendor's SampleProgram and the RS00 manual.
//!
//! An answer is the id, the state, and the winding's temperature in tenths of a °C. The answer to a
//! fault request is the id, 32 bits of faults with the low byte first, and zeros. The drive answers
//! a clear with its state.

use super::drive::{Answer, Asked, Twin, bits};
use crate::wire::MitCommand;
use motord_bus::Frame;

pub(super) const TWIN: Twin = Twin {
    name: "robstride",
    hear: MitCommand::decode,
    answer,
    answers_in_fault: false,
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
    let [high, low] = ((winding * 10.0).round() as u16).to_be_bytes();
    Frame::classic(answer.host_id, [answer.id, a, b, c, d, e, high, low])
}
