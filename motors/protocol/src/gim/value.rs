//! The values of native frames. Each type holds only values that a frame can represent.

use crate::error::DecodeError;

/// A float that is neither NaN nor infinite.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default)]
pub struct Finite(f32);

impl Finite {
    /// Returns the value, or `None` for NaN and infinity.
    #[must_use]
    pub const fn new(value: f32) -> Option<Self> {
        if value.is_finite() { Some(Self(value)) } else { None }
    }

    /// Returns the number.
    #[must_use]
    pub const fn get(self) -> f32 {
        self.0
    }

    pub(super) const fn to_bytes(self) -> [u8; 4] {
        self.0.to_le_bytes()
    }

    pub(super) fn from_bytes(bytes: [u8; 4]) -> Result<Self, DecodeError> {
        let received = u32::from_le_bytes(bytes);
        Self::new(f32::from_bits(received)).ok_or(DecodeError::NotFinite { received })
    }
}

/// Type of a configuration value. Source: GIM document Table 6.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum ValueType {
    /// 32-bit signed integer.
    Integer = 0x00,
    /// IEEE 754 single precision.
    Float = 0x01,
}

impl ValueType {
    /// Returns the type of a ConfType byte; `None` when Table 6 does not list it.
    #[must_use]
    pub const fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            0x00 => Some(Self::Integer),
            0x01 => Some(Self::Float),
            _ => None,
        }
    }
}

/// The value of a configuration item.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// An integer.
    Integer(i32),
    /// A float.
    Float(Finite),
}

impl Value {
    /// Returns the type of the value.
    #[must_use]
    pub const fn value_type(self) -> ValueType {
        match self {
            Self::Integer(_) => ValueType::Integer,
            Self::Float(_) => ValueType::Float,
        }
    }

    /// Returns the number. A double represents both types exactly.
    #[must_use]
    pub fn as_f64(self) -> f64 {
        match self {
            Self::Integer(value) => f64::from(value),
            Self::Float(value) => f64::from(value.get()),
        }
    }

    pub(super) const fn to_bytes(self) -> [u8; 4] {
        match self {
            Self::Integer(value) => value.to_le_bytes(),
            Self::Float(value) => value.to_bytes(),
        }
    }

    pub(super) fn from_bytes(conf_type: u8, bytes: [u8; 4]) -> Result<Self, DecodeError> {
        match ValueType::from_byte(conf_type) {
            Some(ValueType::Integer) => Ok(Self::Integer(i32::from_le_bytes(bytes))),
            Some(ValueType::Float) => Finite::from_bytes(bytes).map(Self::Float),
            None => Err(DecodeError::UnknownType { received: conf_type }),
        }
    }
}
