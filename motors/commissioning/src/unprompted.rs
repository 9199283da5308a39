//! Drivers of other families that report without a request.

use motord_bus::{Frame, FrameId};

/// Largest state of an axis: ODrive 0.6, `AxisState`.
const AXIS_STATE_MAX: u8 = 14;
/// An error of an axis has no bit from this one on: ODrive 0.5 and 0.6, `ODrive.Error` and `Axis.Error`.
const AXIS_ERROR_BITS: u32 = 27;

/// A driver that reports without a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unprompted {
    /// A heartbeat of a CANSimple driver (SDC104, ODrive). It reads frames with 32 ids as commands, among them an emergency stop
    /// and a new node id, so nothing is sent to these.
    CanSimple {
        /// Its node id. It uses the 32 ids from 32 times this number.
        node: u8,
    },
    /// A fault report of a driver with the "custom" protocol (GDZ, GDS), repeated every 200 ms.
    CustomFault {
        /// Its id.
        id: FrameId,
    },
}

impl Unprompted {
    /// Returns the driver that this frame tells of. Other reports of a driver tell nothing: any master may send their bytes.
    pub(crate) fn of(frame: &Frame) -> Option<Self> {
        let id = frame.id();
        match *frame.payload() {
            [0xAE, _, _, _, _, _, _, _] => Some(Self::CustomFault { id }),
            [a, b, c, d, state, _, _, _] if id.raw() & 0x1F == 0x01 => {
                let is_axis =
                    state <= AXIS_STATE_MAX && u32::from_le_bytes([a, b, c, d]) >> AXIS_ERROR_BITS == 0;
                is_axis.then_some(Self::CanSimple { node: (id.raw() >> 5) as u8 })
            }
            _ => None,
        }
    }

    /// Returns `true` when a driver of this kind may have sent the frame without a request. Constant time.
    pub(crate) fn may_be(frame: &Frame) -> bool {
        // CANSimple: heartbeat, errors, encoder, currents, temperature, voltage.
        const REPORTS: [u32; 9] = [0x01, 0x03, 0x04, 0x05, 0x09, 0x0A, 0x14, 0x15, 0x17];
        frame.payload().len() == 8
            && (frame.payload()[0] == 0xAE || REPORTS.contains(&(frame.id().raw() & 0x1F)))
    }

    /// Returns `true` when this driver sends with this id.
    pub(crate) fn sends(self, id: FrameId) -> bool {
        match self {
            Self::CanSimple { node } => id.raw() >> 5 == u32::from(node),
            Self::CustomFault { id: own } => own == id,
        }
    }

    /// Returns `true` when a request to motor `id` would be a command to this driver.
    pub(crate) fn owns(self, id: u8) -> bool {
        match self {
            Self::CanSimple { node } => u16::from(id) >> 5 == u16::from(node),
            Self::CustomFault { id: own } => own.byte() == Some(id),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(id: u16, payload: [u8; 8]) -> Option<Unprompted> {
        Unprompted::of(&Frame::classic(FrameId::new(id).unwrap(), payload))
    }

    #[test]
    fn commands_of_a_master_are_no_heartbeats() {
        assert_eq!(heard(0x001, [0; 8]), Some(Unprompted::CanSimple { node: 0 }));
        assert_eq!(heard(0x0A1, [0x40, 0, 0, 0, 8, 1, 0, 0x80]), Some(Unprompted::CanSimple { node: 5 }));
        // MIT: a neutral command, and enable, to motor 1 (MIT document 1.2).
        assert_eq!(heard(0x001, [0x7F, 0xFF, 0x7F, 0xF0, 0x00, 0x00, 0x07, 0xFF]), None);
        assert_eq!(heard(0x001, [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC]), None);
    }
}
