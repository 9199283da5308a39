//! IMUs on CAN buses, written from the vendors' documents (docs/imu-protocols.md): the frames that
//! they send, and the requests that they may be sent. Every other frame with one of these ids is
//! wrong.

use motord_bus::Frame;
use serde::Deserialize;

/// An IMU on a CAN interface.
#[derive(Debug, Clone, PartialEq)]
pub struct WiredImu {
    /// Its interface in candump.
    pub interface: String,
    /// No motor is on its bus: motord starts a HiPNUC only there.
    pub is_alone: bool,
    device: Device,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Device {
    Hipnuc { node: u8 },
    Damiao { firmware: u16, id: u16, reply: u16 },
}

/// `[[imu]]`.
#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) struct ImuTable {
    #[serde(rename = "type")]
    kind: String,
    pub(crate) bus: Option<String>,
    node_id: Option<u8>,
    can_id: Option<u16>,
    master_id: Option<u16>,
    firmware: Option<u16>,
}

impl ImuTable {
    /// Returns the IMU on this interface; `None` for one that is not on CAN.
    pub(crate) fn wired(&self, interface: String, is_alone: bool) -> Option<WiredImu> {
        let device = match self.kind.as_str() {
            "hipnuc-can" => Device::Hipnuc { node: self.node_id.unwrap_or(8) },
            "damiao" => Device::Damiao {
                firmware: self.firmware.unwrap_or(1024),
                id: self.can_id.unwrap_or(1),
                reply: self.master_id.unwrap_or(0x11),
            },
            _ => return None,
        };
        Some(WiredImu { interface, is_alone, device })
    }
}

impl WiredImu {
    /// Returns whether the device sends this frame, or may be sent it.
    #[must_use]
    pub fn knows(&self, frame: &Frame) -> bool {
        let (id, data) = (frame.id().raw(), frame.payload());
        match self.device {
            Device::Hipnuc { node } => {
                let node_id = u32::from(node);
                let sends = [(0x180, 6), (0x280, 6), (0x380, 6), (0x480, 8), (0x700, 1)];
                sends.iter().any(|(base, len)| id == base + node_id && data.len() == *len)
                    || self.is_alone && id == 0 && data == [1, node]
            }
            Device::Damiao { firmware, id: own, reply } => {
                let [low, high] = own.to_le_bytes();
                let is_request = |register: u8| match firmware {
                    0..=1022 => id == 0x6FF && data == [low, high, register, 0xCC],
                    1023 => id == u32::from(own) && data == [low, high, register, 0xCC],
                    _ => id == u32::from(own) && data == [0xCC, register, 0, 0xDD, 0, 0, 0, 0],
                };
                id == u32::from(reply) && data.len() == 8 || [1, 2, 4].into_iter().any(is_request)
            }
        }
    }
}
