//! Descriptions of the fields of a state, for schemas, recordings, plots and bindings.

/// A field of a state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Name in the message.
    pub name: &'static str,
    /// Its meaning, as sentences without the unit.
    pub doc: &'static str,
    /// Unit in the message; empty for a value without one.
    pub unit: &'static str,
    /// Type and shape.
    pub kind: Kind,
    /// Offset in the message, bytes. Flags have the offset of their word.
    pub offset: usize,
    /// Key in JSON.
    pub json: Option<&'static str>,
    /// Name and number in Protobuf.
    pub proto: Option<(&'static str, u32)>,
    /// Number in `motord_quantity` of C.
    pub quantity: Option<u32>,
    /// Property of `State` in Python, an array of all joints.
    pub python: Option<&'static str>,
}

/// Type and shape of a field: how it is stored in a message, and how JSON and Protobuf represent
/// it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `f32` that is valid once the device has reported it.
    Measured,
    /// `f32`; NaN when the device does not report it.
    Optional,
    /// This many `f32`; NaN before the first.
    Vector(usize),
    /// `u32` that counts.
    Count,
    /// `u64` that counts.
    Total,
    /// `u32`, duration in ns; JSON has µs.
    Latency,
    /// `u64`, ns of `CLOCK_MONOTONIC`.
    Time,
    /// `u32`, number of a code. JSON and Protobuf have its name.
    Code(&'static [&'static str]),
    /// `u32`, a bit for each code. JSON has the names.
    Set(&'static [&'static str]),
    /// `u32` whose bits are fields of the kind `Flag`.
    Flags,
    /// Bits of a `Flags` word.
    Flag(u32),
    /// Bits of a `Flags` word from this one on, one for each code. JSON has the names; Protobuf the
    /// bits from bit 0 on.
    FlagSet(u32, &'static [&'static str]),
    /// `f32` values of a command: position, velocity, kp, kd, torque.
    Command,
    /// `u32` without a meaning that replaces padding in the layout.
    Reserved,
}

impl Kind {
    /// Returns the element type and the number of elements in the message.
    #[must_use]
    pub const fn memory(self) -> (&'static str, usize) {
        match self {
            Self::Measured | Self::Optional => ("f32", 1),
            Self::Command => ("f32", 5),
            Self::Vector(values) => ("f32", values),
            Self::Time | Self::Total => ("u64", 1),
            Self::Count
            | Self::Latency
            | Self::Code(_)
            | Self::Set(_)
            | Self::Flags
            | Self::Flag(_)
            | Self::FlagSet(..)
            | Self::Reserved => ("u32", 1),
        }
    }

    /// Returns the type in Protobuf.
    #[must_use]
    pub const fn proto(self) -> &'static str {
        match self {
            Self::Measured | Self::Optional => "optional float",
            Self::Command => "Command",
            Self::Vector(4) => "Quaternion",
            Self::Vector(_) => "Vector",
            Self::Time | Self::Total => "uint64",
            Self::Code(_) => "string",
            Self::Flag(_) => "bool",
            Self::Count | Self::Latency | Self::Set(_) | Self::FlagSet(..) | Self::Flags | Self::Reserved => {
                "uint32"
            }
        }
    }
}

/// The option of a part that a row of a table may leave out.
macro_rules! optional {
    () => {
        None
    };
    ($value:expr) => {
        Some($value)
    };
}

pub(crate) use optional;
