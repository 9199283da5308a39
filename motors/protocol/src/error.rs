//! Reasons for which a frame cannot be encoded or decoded.

use core::fmt;

/// The quantities of a control frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Quantity {
    /// Position, rad.
    Position,
    /// Velocity, rad/s.
    Velocity,
    /// Stiffness, N·m/rad.
    Kp,
    /// Damping, N·m·s/rad.
    Kd,
    /// Torque, N·m.
    Torque,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Kp => "kp",
            Self::Kd => "kd",
            Self::Torque => "torque",
        })
    }
}

/// Reason for which a command cannot be encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EncodeError {
    /// NaN or infinity. The wire has no code for either, and any other code would move the motor.
    NotFinite {
        /// The first quantity that is not finite.
        field: Quantity,
    },
}

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite { field } => write!(f, "{field} is not a finite number"),
        }
    }
}

impl core::error::Error for EncodeError {}

/// Reason for which bytes cannot be decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DecodeError {
    /// The number of bytes is not one that frames of this kind have.
    Length {
        /// Fewest bytes of such a frame.
        least: usize,
        /// Most bytes of such a frame.
        most: usize,
        /// Number of bytes of this frame.
        received: usize,
    },
    /// A native frame whose first byte is not in Table 4 of the GIM document.
    UnknownCommand {
        /// The first byte.
        received: u8,
    },
    /// A configuration value whose type is not in Table 6 of the GIM document (0 or 1).
    UnknownType {
        /// The ConfType byte.
        received: u8,
    },
    /// A float that is NaN or infinite.
    NotFinite {
        /// The float's bits, IEEE 754 single precision.
        received: u32,
    },
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Length { least, most, received } => write_length(f, received, [least, most]),
            Self::UnknownCommand { received } => write!(f, "no command begins with {received:#04X}"),
            Self::UnknownType { received } => {
                write!(f, "configuration type {received:#04X} is neither integer (0) nor float (1)")
            }
            Self::NotFinite { received } => write!(f, "the float {received:#010X} is not a finite number"),
        }
    }
}

impl core::error::Error for DecodeError {}

/// Writes that a frame does not have the number of bytes of its kind, the `range` inclusive.
pub(crate) fn write_length(
    f: &mut fmt::Formatter<'_>,
    received: usize,
    [least, most]: [usize; 2],
) -> fmt::Result {
    write!(f, "the frame has {received} bytes, expected {least}")?;
    if least == most { Ok(()) } else { write!(f, " to {most}") }
}
