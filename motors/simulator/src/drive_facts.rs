//! The facts of an MIT drive, for a vendor without a drive of its own here.

/// The facts of a vendor's MIT drive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveFacts {
    /// The frame that starts the motor.
    pub start: [u8; 8],
    /// The frame that stops it.
    pub stop: [u8; 8],
    /// The frame that makes its position zero.
    pub zero: [u8; 8],
    /// The frame that clears its fault, if it has one. Otherwise a fault lasts until the power
    /// returns.
    pub clear: Option<[u8; 8]>,
    /// Bytes of a state.
    pub bytes: usize,
    /// Bits of the first byte that are the id.
    pub id_bits: u8,
    /// Its temperatures.
    pub temperatures: Vec<TemperatureFacts>,
    /// Its fault report.
    pub faults: FaultFacts,
    /// Numbers of over-voltage, under-voltage and over-temperature; 0 for one that it does not have.
    pub conditions: [u32; 3],
    /// It has the registers of a Damiao drive.
    pub has_registers: bool,
}

/// A temperature in a state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TemperatureFacts {
    /// That of the winding, otherwise that of the board.
    pub of_winding: bool,
    /// The first byte.
    pub byte: usize,
    /// Bits of its code.
    pub bits: u32,
    /// Codes in 10 °C.
    pub codes_per_ten: u32,
}

/// The fault report of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultFacts {
    /// On request: the id, a number with its low byte first, and zeros.
    Asked {
        /// Bytes of the number.
        number: usize,
        /// Bytes of the report.
        bytes: usize,
    },
    /// A code in every state.
    Code {
        /// Its byte.
        byte: usize,
        /// Bits below it.
        shift: u32,
        /// The codes of a stopped and of a running drive.
        healthy: [u8; 2],
    },
    /// None.
    Never,
}
