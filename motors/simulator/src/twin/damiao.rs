//! Damiao's DM-J drives, by DM_CAN.py, motorbridge and openarm_can.
//!
//! The first byte of every answer holds a status (0 disabled, 1 enabled, 8 and more a fault) in its upper four bits, and four
//! bits of the id below. The last two bytes are the temperatures of transistors and rotor. A drive in fault is disabled and
//! keeps answering.

use super::drive::{Answer, Status, Twin};
use crate::wire::{Control, MitCommand};
use motord_bus::Frame;

pub(super) const TWIN: Twin =
    Twin { name: "damiao", hear, answer, answers_in_fault: true, conditions: [0x8, 0x9, 0xC], raise };

/// Every special command begins with seven bytes 0xFF. SteadyWin's question for the fault is a control frame here.
fn hear(payload: &[u8]) -> Option<MitCommand> {
    Some(match payload {
        [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFB] => MitCommand::ClearFault,
        [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC] => MitCommand::Start,
        [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD] => MitCommand::Stop,
        [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFE] => MitCommand::SetZero,
        _ => MitCommand::Control(Control::decode(payload)?),
    })
}

fn answer(answer: &Answer) -> Frame {
    let status = match answer.status {
        Status::Fault => answer.fault as u8,
        Status::On => 1,
        Status::Off => 0,
    };
    let [a, b, c, d, e] = answer.state.mit();
    let [rotor, transistors] = answer.temperatures.map(|celsius| celsius as u8);
    Frame::classic(answer.host_id, [status << 4 | answer.id & 0x0F, a, b, c, d, e, transistors, rotor])
}

/// The drive keeps the first fault until it is cleared; the numbers 0 and 1 are no faults.
fn raise(known: u32, raised: u32) -> u32 {
    match raised & 0x0F {
        raised if known == 0 && raised > 1 => raised,
        _ => known,
    }
}
