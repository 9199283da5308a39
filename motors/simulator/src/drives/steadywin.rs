//! SteadyWin's SDC101, SDC102 and SDC103 drivers (MIT document 1.1 and 1.2, GIM document table 9).

use super::drive::{Answer, Asked, Drive, bits};
use crate::wire::MitCommand;
use motord_bus::Frame;

pub(super) const DRIVE: Drive = Drive {
    name: "steadywin",
    decode: MitCommand::decode,
    answer,
    answers_in_fault: |_| false,

    conditions: [0x02, 0x04, 0x08],
    raise: bits,
};

fn answer(answer: &Answer) -> Frame {
    let Answer { host_id, id, filler: [_, f1, f2, f3, f4, f5, ..], .. } = *answer;
    let [a, b, c, d, e] = match answer.asked {
        Asked::State => answer.state.mit(),
        Asked::Fault => [answer.fault as u8, f2, f3, f4, f5],
        Asked::Clear => [f1, f2, f3, f4, f5],
    };
    Frame::classic(host_id, [id, a, b, c, d, e])
}
