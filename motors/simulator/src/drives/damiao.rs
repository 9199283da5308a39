//! Damiao's DM-J drives, from DM_CAN.py, motorbridge and openarm_can.
//!
//! The first byte of every answer holds a status in its upper four bits (0 disabled, 1 enabled, 8
//! and above a fault). The lower four bits are those of the id. The last two bytes are the
//! temperatures of transistors and rotor. A drive in fault is disabled and keeps answering.

use super::drive::{Answer, Drive, Status};
use crate::wire::{Control, MitCommand};
use motord_bus::Frame;

pub(super) const DRIVE: Drive =
    Drive { name: "damiao", decode, answer, answers_in_fault: |_| true, conditions: [0x8, 0x9, 0xC], raise };

/// Decodes a payload. Every special command begins with seven bytes 0xFF. SteadyWin's fault request
/// is a control frame here.
fn decode(payload: &[u8]) -> Option<MitCommand> {
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
    let [rotor, transistors] = answer.temperatures.map(|celsius| celsius.clamp(-128.0, 255.0) as i16 as u8);
    Frame::classic(answer.host_id, [status << 4 | answer.id & 0x0F, a, b, c, d, e, transistors, rotor])
}

/// Keeps the first fault until it is cleared. The numbers 0 and 1 are not faults.
fn raise(known: u32, raised: u32) -> u32 {
    match raised & 0x0F {
        raised if known == 0 && raised > 1 => raised,
        _ => known,
    }
}
