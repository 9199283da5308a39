//! The IMUs that send samples on a serial line without a request, as one type.

use super::error::SampleError;
use super::hipnuc;
use super::sample::Sample;
use super::xsens;

/// Bits on the line for each byte: start bit, eight data bits, stop bit (8N1).
pub const BITS_PER_BYTE: u32 = 10;

/// The protocol of an IMU on a serial line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SerialProtocol {
    /// HiPNUC, 0x91 frames.
    Hipnuc,
    /// Xsens MTi, MTData2.
    Xsens,
}

impl SerialProtocol {
    /// Every protocol.
    pub const ALL: [Self; 2] = [Self::Hipnuc, Self::Xsens];

    /// Returns the word for it in a configuration.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hipnuc => "hipnuc-serial",
            Self::Xsens => "xsens",
        }
    }

    /// Returns the baud rate of a new device. Sources: as for the modules of the vendors.
    #[must_use]
    pub const fn baud_default(self) -> u32 {
        115_200
    }

    /// Returns the baud rates of the devices, rising. HiPNUC: `SERIALCONFIG` of the command manual.
    /// Xsens: SetBaudrate; of its rates those that adapters offer.
    #[must_use]
    pub const fn bauds(self) -> &'static [u32] {
        match self {
            Self::Hipnuc => &[115_200, 460_800, 921_600],
            Self::Xsens => &[
                9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600, 2_000_000, 3_500_000,
                4_000_000,
            ],
        }
    }

    /// Returns the samples per second of a new device.
    #[must_use]
    pub const fn rate_hz_default(self) -> u16 {
        100
    }

    /// Returns the bytes of the shortest sample with orientation, angular velocity and
    /// acceleration. An Xsens MTi sends more when further outputs are selected.
    #[must_use]
    pub const fn sample_len(self) -> usize {
        match self {
            Self::Hipnuc => hipnuc::serial::FRAME_LEN,
            Self::Xsens => xsens::SAMPLE_LEN_MIN,
        }
    }

    /// Returns the settings that a device needs so that each sample has orientation, angular
    /// velocity and acceleration.
    #[must_use]
    pub const fn complete_samples(self) -> &'static str {
        match self {
            Self::Hipnuc => "0x91 frames (`LOG HI91 ONTIME 0.01`, then `SAVECONFIG`)",
            Self::Xsens => {
                "Quaternion (0x2010), Acceleration (0x4020) and Rate of Turn (0x8020) as outputs, all with one rate"
            }
        }
    }

    /// Returns the highest rate of samples that a line of this baud rate carries, Hz.
    #[must_use]
    pub fn rate_hz_max(self, baud: u32) -> f64 {
        f64::from(baud) / f64::from(BITS_PER_BYTE * self.sample_len() as u32)
    }
}

/// Finds samples in the stream of bytes of a device.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "one for each device; a box would need an allocator")]
pub enum SerialDecoder {
    /// For [`SerialProtocol::Hipnuc`].
    Hipnuc(hipnuc::serial::Decoder),
    /// For [`SerialProtocol::Xsens`].
    Xsens(xsens::Decoder),
}

impl SerialDecoder {
    /// Returns a decoder that has received nothing.
    #[must_use]
    pub const fn new(protocol: SerialProtocol) -> Self {
        match protocol {
            SerialProtocol::Hipnuc => Self::Hipnuc(hipnuc::serial::Decoder::new()),
            SerialProtocol::Xsens => Self::Xsens(xsens::Decoder::new()),
        }
    }

    /// Takes the next byte. Returns the sample that it completes, or the reason for which the frame
    /// that it completes is none.
    ///
    /// Real-time: does not allocate or block; bounded as the decoders of the vendors.
    pub fn push(&mut self, byte: u8) -> Option<Result<Sample, SampleError>> {
        match self {
            Self::Hipnuc(decoder) => decoder.push(byte),
            Self::Xsens(decoder) => decoder.push(byte),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imu::sample::Quaternion;

    /// The shortest complete message of the encoder has the length that is planned with.
    #[test]
    fn shortest_complete_sample_has_the_planned_length() {
        let sample = Sample {
            orientation: Some(Quaternion::from([1.0, 0.0, 0.0, 0.0])),
            angular_velocity: Some([0.0; 3]),
            acceleration: Some([0.0; 3]),
            ..Sample::default()
        };
        let mut buffer = [0; xsens::MESSAGE_LEN_MAX];
        assert_eq!(xsens::encode(&sample, &mut buffer).len(), SerialProtocol::Xsens.sample_len());
        assert_eq!(hipnuc::serial::encode(&sample).len(), SerialProtocol::Hipnuc.sample_len());
        // 82 bytes: 115200 baud carry 140 samples in a second.
        assert_eq!(SerialProtocol::Hipnuc.rate_hz_max(115_200).floor(), 140.0);
    }

    #[test]
    fn default_rate_fits_into_default_baud() {
        for protocol in SerialProtocol::ALL {
            let baud = protocol.baud_default();
            assert!(protocol.bauds().contains(&baud));
            assert!(f64::from(protocol.rate_hz_default()) <= protocol.rate_hz_max(baud));
        }
    }
}
