//! MyActuator's drives, as far as motion mode has the fields of MIT, from the protocol document V4.2
//! (section 5).
//!
//! There are no special frames. An answer is the id, the state, and two bytes without a use. Faults are
//! the bits of status 1.

use super::drive::{Answer, Drive, bits};
use crate::wire::{Control, MitCommand};
use motord_bus::Frame;

pub(super) const DRIVE: Drive = Drive {
    name: "myactuator",
    decode: |payload| Control::decode(payload).map(MitCommand::Control),
    answer,
    answers_in_fault: |_| true,
    conditions: [0x0008, 0x0004, 0x1000],
    raise: bits,
};

fn answer(answer: &Answer) -> Frame {
    let [a, b, c, d, e] = answer.state.mit();
    Frame::classic(answer.host_id, [answer.id, a, b, c, d, e, 0, 0])
}
