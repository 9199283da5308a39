//! The registers of a Damiao drive, from DM_CAN.py, LeRobot and openarm_can: a request to 0x7FF has
//! the motor's id in two bytes, the kind, and the register; the answer repeats these four bytes.
//!
//! Of the drive's registers it has 7, 8 and 10 (master id, id, mode), 21 to 23 (ends of the codes)
//! and 35 (bit rate). The ids and the ends can be written. A written id takes effect after the
//! answer, and lasts without power once the drive has stored it, which it does only while it is
//! disabled. A written end is kept as if it were stored.

use super::configuration::int;
use super::{Mode, Motor};
use crate::drives::Asked;
use motord_bus::{Frame, FrameId, Instant};

/// Id of every request.
const REQUEST_ID: u16 = 0x7FF;

impl Motor {
    /// Returns the id of the requests to its registers, if it has some.
    pub(super) fn register_requests(&self) -> Option<FrameId> {
        if self.drive.has_registers(self.settings.vendor) { FrameId::new(REQUEST_ID) } else { None }
    }

    /// Returns whether `frame` is a request to the registers of this drive.
    pub(super) fn is_register_request(&self, frame: &Frame) -> bool {
        let [low, high, ..] = self.address().raw().to_le_bytes();
        self.register_requests() == Some(frame.id()) && frame.payload().starts_with(&[low, high])
    }

    /// Answers a request to a register.
    pub(super) fn register(&mut self, at: Instant, frame: &Frame) -> Option<Frame> {
        let host_id = self.host_address();
        let &[low, high, kind, register, ref value @ ..] = frame.payload() else { return None };
        match kind {
            0x33 => {}
            0x55 => self.write_register(register, *value.first_chunk()?),
            0xAA if self.mode == Mode::Stopped => {
                self.configuration.refresh();
                return Some(Frame::classic(host_id, [low, high, kind, 1, 0, 0, 0, 0]));
            }
            0xCC => {
                let state = self.state(at);
                return Some(self.answer(Asked::State, host_id, state));
            }
            _ => return None,
        }
        let [a, b, c, d] = self.register_bytes(register)?;
        Some(Frame::classic(host_id, [low, high, kind, register, a, b, c, d]))
    }

    /// Returns the value of a register, as the answer carries it.
    fn register_bytes(&self, register: u8) -> Option<[u8; 4]> {
        let [position, velocity, torque] = self.settings.ends?;
        Some(match register {
            7 => self.configuration.int(int::HOST_ID).to_le_bytes(),
            8 => self.configuration.int(int::CAN_ID).to_le_bytes(),
            // MIT.
            10 => 1_u32.to_le_bytes(),
            21 => (position as f32).to_le_bytes(),
            22 => (velocity as f32).to_le_bytes(),
            23 => (torque as f32).to_le_bytes(),
            // 1 Mbit/s.
            35 => 4_u32.to_le_bytes(),
            _ => return None,
        })
    }

    /// Writes a register that can be written.
    fn write_register(&mut self, register: u8, value: [u8; 4]) {
        match register {
            7 => self.configuration.set_int(int::HOST_ID, i32::from_le_bytes(value)),
            8 => self.configuration.set_int(int::CAN_ID, i32::from_le_bytes(value)),
            _ => self.write_end(register, f32::from_le_bytes(value)),
        }
    }

    /// Changes the end of a code, if the register has one and the value is possible.
    fn write_end(&mut self, register: u8, value: f32) {
        let Some(ends) = &mut self.settings.ends else { return };
        if let Some(end) = register.checked_sub(21).and_then(|index| ends.get_mut(usize::from(index)))
            && value.is_finite()
            && value > 0.0
        {
            *end = f64::from(value);
        }
    }
}
