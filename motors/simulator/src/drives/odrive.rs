//! ODrive's drives, which speak no MIT: only the numbers of their faults, which are SteadyWin's here, and
//! which `motor::odrive` translates to ODrive's errors.

use super::drive::{Answer, Drive, bits};
use motord_bus::Frame;

pub(super) const DRIVE: Drive = Drive {
    name: "odrive",
    decode: |_| None,
    answer,
    answers_in_fault: |_| true,
    conditions: [0x02, 0x04, 0x08],
    raise: bits,
};

/// No MIT command is decoded, so none is answered.
fn answer(answer: &Answer) -> Frame {
    Frame::classic(answer.host_id, [])
}
