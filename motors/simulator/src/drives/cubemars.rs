//! CubeMars' AK drives in MIT mode, V1.1 and V2, from the AK manual 1.0.8 (pages 48 and 49) and
//! TMotorCANControl.
//!
//! An answer is the id, the state, the winding's temperature as a signed byte, and an error code: 1
//! over-temperature, 2 over-current, 3 over-voltage, 4 under-voltage, 5 encoder, 6 phases. No frame
//! clears an error: here it lasts until the power returns, which no document says.

use super::drive::{Answer, Drive, Status};
use crate::wire::{Control, MitCommand};
use motord_bus::Frame;

pub(super) const DRIVE: Drive =
    Drive { name: "cubemars", decode, answer, answers_in_fault: |_| true, conditions: [3, 4, 1], raise };

fn decode(payload: &[u8]) -> Option<MitCommand> {
    Some(match payload {
        [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC] => MitCommand::Start,
        [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD] => MitCommand::Stop,
        [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFE] => MitCommand::SetZero,
        _ => MitCommand::Control(Control::decode(payload)?),
    })
}

fn answer(answer: &Answer) -> Frame {
    let error = if answer.status == Status::Fault { answer.fault as u8 } else { 0 };
    let [a, b, c, d, e] = answer.state.mit();
    let [winding, _] = answer.temperatures;
    let celsius = winding.round().clamp(-128.0, 127.0) as i8 as u8;
    Frame::classic(answer.host_id, [answer.id, a, b, c, d, e, celsius, error])
}

/// Keeps the first error until it is cleared.
const fn raise(known: u32, raised: u32) -> u32 {
    if known == 0 { raised & 0xFF } else { known }
}
