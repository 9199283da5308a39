//! The IMUs on a CAN bus, as one type.

use super::damiao;
use super::error::{SampleError, SampleField};
use super::hipnuc::can as hipnuc;
use super::request::CanRequest;
use super::sample::Sample;
use super::sequence::Measured;
use super::sequence::Parts;

/// Id of a HiPNUC's messages of its state (CANopen heartbeat), without the node.
const HEARTBEAT: u16 = 0x700;
/// Ids of commands: CiA 301, predefined connection set. A request also contains the node.
const NMT: u16 = 0x000;
const SDO_REQUEST: u16 = 0x600;
/// Bytes of the TPDOs with a vector, and with a quaternion.
const VECTOR_BYTES: u32 = 6;
const QUATERNION_BYTES: u32 = 8;
/// Bytes of a reply of a DM-IMU-L1.
const REPLY_BYTES: u32 = 8;
/// Most ids that a device sends, and most frames of a sample with its requests.
const IDS_MAX: usize = 5;
const FRAMES_MAX: usize = 6;
/// Requests for a sample of a DM-IMU-L1, in their order.
const REGISTERS: [damiao::Register; 3] =
    [damiao::Register::Acceleration, damiao::Register::AngularVelocity, damiao::Register::Orientation];

/// The protocol of an IMU on a CAN bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CanProtocol {
    /// HiPNUC, CANopen: sends samples without a request.
    Hipnuc,
    /// Damiao DM-IMU-L1: answers requests.
    Damiao,
}

impl CanProtocol {
    /// Every protocol.
    pub const ALL: [Self; 2] = [Self::Hipnuc, Self::Damiao];

    /// Returns the word for it in a configuration.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hipnuc => "hipnuc-can",
            Self::Damiao => "damiao",
        }
    }

    /// Returns whether the device sends a sample only when it is asked for one.
    #[must_use]
    pub const fn is_asked(self) -> bool {
        matches!(self, Self::Damiao)
    }

    /// Returns whether a device of this protocol has the setting that a configuration gives by
    /// `key`.
    #[must_use]
    pub fn has(self, key: &str) -> bool {
        let keys: &[&str] = match self {
            Self::Hipnuc => &["node-id"],
            Self::Damiao => &["can-id", "master-id", "firmware"],
        };
        keys.contains(&key)
    }

    /// Returns the samples per second of a new device, or a usual rate of requests.
    #[must_use]
    pub const fn rate_hz_default(self) -> u16 {
        match self {
            Self::Hipnuc => 100,
            Self::Damiao => 200,
        }
    }

    /// Returns the lowest and the highest rate of samples of a device that sends them by itself,
    /// each in a whole number of ms. `None` for one that is asked. Source: user manual of HiPNUC.
    #[must_use]
    pub const fn rates_hz(self) -> Option<[f64; 2]> {
        match self {
            Self::Hipnuc => Some([10.0, 200.0]),
            Self::Damiao => None,
        }
    }
}

/// The settings of a device on a CAN bus that its ids and its frames follow from. Each protocol
/// uses some of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanAddress {
    /// CANopen node, of which seven bits count.
    pub node_id: u8,
    /// Id of the device.
    pub can_id: u16,
    /// Id of its replies.
    pub master_id: u16,
    /// Version of its firmware.
    pub firmware: u16,
}

impl Default for CanAddress {
    /// Returns the settings of a new device.
    fn default() -> Self {
        Self { node_id: hipnuc::NODE_DEFAULT, can_id: 0x01, master_id: 0x11, firmware: 1024 }
    }
}

/// A device on a CAN bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanDevice {
    protocol: CanProtocol,
    address: CanAddress,
}

impl CanDevice {
    /// Returns the device of this protocol with these settings.
    #[must_use]
    pub const fn new(protocol: CanProtocol, address: CanAddress) -> Self {
        Self { protocol, address }
    }

    /// Returns its protocol.
    #[must_use]
    pub const fn protocol(&self) -> CanProtocol {
        self.protocol
    }

    /// Returns its settings.
    #[must_use]
    pub const fn address(&self) -> &CanAddress {
        &self.address
    }

    const fn firmware(&self) -> &'static damiao::Profile {
        damiao::Profile::of_firmware(self.address.firmware)
    }

    /// Returns the ids of the frames that the device sends.
    pub fn sent_ids(&self) -> impl Iterator<Item = u16> + use<> {
        let mut ids = [self.address.master_id; IDS_MAX];
        let count = match self.protocol {
            CanProtocol::Damiao => 1,
            CanProtocol::Hipnuc => {
                let node = self.address.node_id & hipnuc::NODE_MAX;
                let tpdos = hipnuc::Tpdo::ALL.map(|tpdo| tpdo.id(node));
                ids[..tpdos.len()].copy_from_slice(&tpdos);
                ids[tpdos.len()] = HEARTBEAT | u16::from(node);
                IDS_MAX
            }
        };
        ids.into_iter().take(count)
    }

    /// Returns whether a device that is not asked takes frames with this id for commands: NMT
    /// commands and SDO requests of CANopen (CiA 301).
    #[must_use]
    pub fn obeys(&self, id: u16) -> bool {
        let node = u16::from(self.address.node_id & hipnuc::NODE_MAX);
        self.protocol == CanProtocol::Hipnuc && (id == NMT || id == SDO_REQUEST | node)
    }

    /// Returns the id of the requests to the device, if it is asked.
    #[must_use]
    pub fn request_id(&self) -> Option<u16> {
        self.requests().next().map(|request| request.id())
    }

    /// Returns the requests for one sample, in their order. None for a device that is not asked.
    pub fn requests(&self) -> impl Iterator<Item = CanRequest> + use<> {
        let (profile, can_id) = (self.firmware(), self.address.can_id);
        let count = if self.protocol.is_asked() { REGISTERS.len() } else { 0 };
        REGISTERS.into_iter().take(count).map(move |register| profile.request(can_id, register))
    }

    /// Returns the frame that starts a device which sends by itself.
    #[must_use]
    pub fn start(&self) -> Option<CanRequest> {
        (!self.protocol.is_asked()).then(|| super::hipnuc::command::start(self.address.node_id))
    }

    /// Returns the number of the request that a payload answers, as in
    /// [`requests`](Self::requests), by its first byte.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    #[must_use]
    pub fn answered(&self, payload: &[u8]) -> Option<usize> {
        let first = *payload.first().filter(|_| self.protocol.is_asked())?;
        REGISTERS.iter().position(|register| *register as u8 == first)
    }

    /// Returns the quantity that the request with this number asks for.
    #[must_use]
    pub fn requested(&self, number: usize) -> Option<SampleField> {
        Parts::ALL.in_order().nth(number).filter(|_| self.protocol.is_asked())
    }

    /// Decodes a frame with an id of [`sent_ids`](Self::sent_ids) alone. `None` for one without a
    /// quantity: a heartbeat, or the confirmation of a setting.
    ///
    /// # Errors
    ///
    /// As for the decoders of the vendors.
    pub fn measured(&self, id: u16, payload: &[u8]) -> Result<Option<Measured>, SampleError> {
        match self.protocol {
            CanProtocol::Hipnuc => {
                let is_it = |tpdo: &hipnuc::Tpdo| tpdo.id(self.address.node_id) == id;
                hipnuc::Tpdo::ALL.into_iter().find(is_it).map(|tpdo| tpdo.decode(payload)).transpose()
            }
            CanProtocol::Damiao => Ok(match self.firmware().decode(payload)? {
                damiao::Reply::Measured { measured, .. } => Some(measured),
                damiao::Reply::Confirmed { .. } => None,
            }),
        }
    }

    /// Returns id and bytes of each frame of a sample: those that the device sends by itself, or
    /// requests and replies.
    pub fn frames(&self) -> impl Iterator<Item = (u16, u32)> + use<> {
        let mut frames = [(self.address.master_id, REPLY_BYTES); FRAMES_MAX];
        let count = match self.protocol {
            CanProtocol::Damiao => {
                for (frame, request) in frames.iter_mut().zip(self.requests()) {
                    *frame = (request.id(), request.payload().len() as u32);
                }
                2 * REGISTERS.len()
            }
            CanProtocol::Hipnuc => {
                for (frame, tpdo) in frames.iter_mut().zip(hipnuc::Tpdo::ALL) {
                    let is_quaternion = tpdo == hipnuc::Tpdo::Orientation;
                    let bytes = if is_quaternion { QUATERNION_BYTES } else { VECTOR_BYTES };
                    *frame = (tpdo.id(self.address.node_id), bytes);
                }
                hipnuc::Tpdo::ALL.len()
            }
        };
        frames.into_iter().take(count)
    }

    /// Returns a decoder of samples with orientation, angular velocity and acceleration,
    /// `period_us` apart.
    #[must_use]
    pub fn decoder(&self, period_us: u64) -> CanDecoder {
        let within_us = period_us / 2;
        match self.protocol {
            CanProtocol::Hipnuc => {
                CanDecoder::Hipnuc(hipnuc::Decoder::new(self.address.node_id, Parts::ALL, within_us))
            }
            CanProtocol::Damiao => {
                CanDecoder::Damiao(damiao::Decoder::new(self.firmware(), Parts::ALL, within_us))
            }
        }
    }
}

/// Finds samples in the frames of a device.
#[derive(Debug, Clone)]
pub enum CanDecoder {
    /// For [`CanProtocol::Hipnuc`].
    Hipnuc(hipnuc::Decoder),
    /// For [`CanProtocol::Damiao`].
    Damiao(damiao::Decoder),
}

impl CanDecoder {
    /// Takes a frame of the device that arrived at `at_us`, by any clock. Returns the sample that
    /// it completes.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// As for the decoders of the vendors.
    pub fn push(&mut self, id: u16, payload: &[u8], at_us: u64) -> Result<Option<Sample>, SampleError> {
        match self {
            Self::Hipnuc(decoder) => decoder.push(id, payload, at_us),
            Self::Damiao(decoder) => decoder.push(payload, at_us),
        }
    }

    /// Drops the sample that is being received: the next frames belong to another one.
    pub const fn drop_sample(&mut self) {
        match self {
            Self::Hipnuc(decoder) => decoder.drop_sample(),
            Self::Damiao(decoder) => decoder.drop_sample(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    extern crate std;

    #[test]
    fn ids_and_frames_are_those_of_vendors() {
        let hipnuc = CanDevice::new(CanProtocol::Hipnuc, CanAddress::default());
        assert_eq!(hipnuc.sent_ids().collect::<Vec<_>>(), [0x188, 0x288, 0x388, 0x488, 0x708]);
        let frames = [(0x188, 6), (0x288, 6), (0x388, 6), (0x488, 8)];
        assert_eq!((hipnuc.frames().collect::<Vec<_>>(), hipnuc.request_id()), (frames.to_vec(), None));
        for (firmware, request, bytes) in [(1022, 0x6FF, 4), (1023, 1, 4), (1024, 1, 8)] {
            let address = CanAddress { firmware, ..CanAddress::default() };
            let device = CanDevice::new(CanProtocol::Damiao, address);
            let frames = [[(request, bytes); 3], [(0x11, 8); 3]].concat();
            assert_eq!((device.frames().collect::<Vec<_>>(), device.request_id()), (frames, Some(request)));
            assert_eq!(
                [&[1][..], &[2, 9], &[4], &[3], &[]].map(|payload| device.answered(payload)),
                [Some(0), Some(1), Some(2), None, None]
            );
        }
    }

    /// Two frames of one sample, then the next: without the drop its quaternion would complete the
    /// first.
    #[test]
    fn dropped_sample_is_not_completed() {
        let device = CanDevice::new(CanProtocol::Damiao, CanAddress::default());
        let (mut decoder, mut other) = (device.decoder(1000), device.decoder(1000));
        let reply = |register: u8| [register, 0, 0, 0x80, 0, 0x80, 0, 0x80];
        let orientation = [4, 0xFF, 0xFE, 0x00, 0x08, 0x00, 0x20, 0x00];
        for (number, decoder) in [&mut decoder, &mut other].into_iter().enumerate() {
            assert_eq!(decoder.push(0x11, &reply(1), 0), Ok(None));
            assert_eq!(decoder.push(0x11, &reply(2), 100), Ok(None));
            if number == 0 {
                decoder.drop_sample();
            }
            assert_eq!(decoder.push(0x11, &orientation, 200).unwrap().is_some(), number == 1);
        }
    }
}
