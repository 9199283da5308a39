//! Reasons for which bytes are not a sample.

use crate::error::write_length;
use core::fmt;

/// The quantities of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SampleField {
    /// Specific force.
    Acceleration,
    /// Angular velocity.
    AngularVelocity,
    /// Roll, pitch and yaw.
    Angles,
    /// Rotation from the sensor to the world.
    Orientation,
    /// Temperature of the device.
    Temperature,
}

impl fmt::Display for SampleField {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Acceleration => "acceleration",
            Self::AngularVelocity => "angular velocity",
            Self::Angles => "angles",
            Self::Orientation => "orientation",
            Self::Temperature => "temperature",
        })
    }
}

/// Reason for which bytes are not a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SampleError {
    /// The number of bytes is not one that frames of this kind have.
    Length {
        /// Fewest bytes of such a frame.
        least: usize,
        /// Most bytes of such a frame.
        most: usize,
        /// Number of bytes of this frame.
        received: usize,
    },
    /// The checksum does not match the bytes.
    Checksum {
        /// Checksum of the bytes.
        expected: u16,
        /// Checksum in the frame.
        received: u16,
    },
    /// A number is NaN or infinite.
    NotFinite {
        /// The quantity with this number.
        field: SampleField,
        /// The number's bits, IEEE 754 single precision.
        received: u32,
    },
    /// The norm of a quaternion is not within 0.99 to 1.01.
    NotUnit {
        /// The norm.
        received: f64,
    },
    /// A frame of the sample is lost, late or not in its order.
    Incomplete {
        /// The quantity whose frame was expected.
        missing: SampleField,
    },
    /// The first byte of a reply is not the number of a register with data.
    UnknownRegister {
        /// The first byte.
        received: u8,
    },
    /// An item of a message does not have the size of its data type.
    ItemSize {
        /// Identifier of the item.
        item: u16,
        /// Bytes of this data type.
        expected: usize,
        /// Bytes of this item.
        received: usize,
    },
    /// The last item of a message ends after the message.
    Truncated {
        /// Bytes that the item needs.
        expected: usize,
        /// Bytes that remain in the message.
        received: usize,
    },
    /// A frame of HiPNUC is intact, and its packets are other ones than 0x91.
    OtherPacket {
        /// The tag of the first of them that is not passed over.
        received: u8,
    },
    /// A message of Xsens is intact, and not from the device at this port.
    BusId {
        /// The bus id.
        received: u8,
    },
    /// The coordinate system of an orientation is not ENU (0), NED (1) or NWU (2).
    CoordinateSystem {
        /// The code of the coordinate system.
        received: u8,
    },
}

impl SampleError {
    /// Returns `true` for bytes that arrived intact and hold no sample: the device is set to send
    /// them.
    #[must_use]
    pub const fn is_other_content(&self) -> bool {
        matches!(self, Self::OtherPacket { .. } | Self::BusId { .. })
    }
}

impl fmt::Display for SampleError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Length { least, most, received } => write_length(f, received, [least, most]),
            Self::Checksum { expected, received } => {
                write!(
                    f,
                    "the checksum is {received:#06X}, expected {expected:#06X}: check baud rate and cable"
                )
            }
            Self::NotFinite { field, received } => {
                write!(f, "the {field} {received:#010X} is not a finite number")
            }
            Self::NotUnit { received } => {
                write!(f, "the norm of the quaternion is {received}, expected 0.99 to 1.01")
            }
            Self::Incomplete { missing } => {
                write!(f, "the {missing} of the sample did not arrive in its order and time")
            }
            Self::UnknownRegister { received } => {
                write!(f, "the reply begins with {received:#04X}, expected a register from 1 to 4")
            }
            Self::ItemSize { item, expected, received } => {
                write!(f, "item {item:#06X} has {received} bytes, expected {expected}")
            }
            Self::Truncated { expected, received } => {
                write!(f, "the message ends after {received} bytes of an item, expected {expected}")
            }
            Self::OtherPacket { received } => {
                write!(
                    f,
                    "the frame has packet {received:#04X}, expected 0x91: select 0x91 alone (`LOG HI91 ONTIME 0.01`)"
                )
            }
            Self::BusId { received } => {
                write!(
                    f,
                    "the message has bus id {received}, expected 255: it is from a device behind an Xbus master; connect one device"
                )
            }
            Self::CoordinateSystem { received } => {
                write!(f, "coordinate system {received} is none of ENU (0), NED (1) and NWU (2)")
            }
        }
    }
}

impl core::error::Error for SampleError {}
