//! The parameters of the running control loops. Source: GIM document Table 8.
//!
//! All parameters can be read and written, take effect immediately, and are lost at power-off. They
//! are unsigned 32-bit integers without a documented scale. A host changes a gain relative to the
//! value that it has read.

/// A row of Table 8.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parameter {
    /// The ParaID byte.
    pub id: u8,
    /// A short name, usable as a key.
    pub name: &'static str,
}

const fn parameter(id: u8, name: &'static str) -> Parameter {
    Parameter { id, name }
}

/// Table 8.
pub const PARAMETERS: [Parameter; 9] = [
    parameter(0x00, "current-kp"),
    parameter(0x01, "current-ki"),
    parameter(0x02, "speed-kp"),
    parameter(0x03, "speed-ki"),
    parameter(0x04, "position-kp"),
    parameter(0x05, "position-ki"),
    parameter(0x06, "position-kd"),
    parameter(0x07, "flux-weakening-kp"),
    parameter(0x08, "flux-weakening-ki"),
];

impl Parameter {
    /// Returns the row with this id, if there is one.
    #[must_use]
    pub fn by_id(id: u8) -> Option<&'static Self> {
        PARAMETERS.iter().find(|parameter| parameter.id == id)
    }

    /// Returns the row with this name, if there is one.
    #[must_use]
    pub fn by_name(name: &str) -> Option<&'static Self> {
        PARAMETERS.iter().find(|parameter| parameter.name == name)
    }
}
