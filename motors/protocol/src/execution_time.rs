//! The duration of a control command.

/// Execution time of a control command: 24 bits of milliseconds. The meaning of 0, and the motor's
/// behaviour at the end, are not documented. Source: GIM document 3.2.7.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct ExecutionTime {
    millis: u32,
}

impl ExecutionTime {
    /// Longest time, 4 h 39 min.
    pub const MAX: Self = Self { millis: 0x00FF_FFFF };

    /// Returns the time, or `None` above [`MAX`](Self::MAX).
    #[must_use]
    pub const fn from_millis(millis: u32) -> Option<Self> {
        if millis <= Self::MAX.millis { Some(Self { millis }) } else { None }
    }

    /// Returns milliseconds, 0 to 16 777 215.
    #[must_use]
    pub const fn as_millis(self) -> u32 {
        self.millis
    }

    pub(crate) const fn to_bytes(self) -> [u8; 3] {
        let [a, b, c, _] = self.millis.to_le_bytes();
        [a, b, c]
    }

    pub(crate) const fn from_bytes([a, b, c]: [u8; 3]) -> Self {
        Self { millis: u32::from_le_bytes([a, b, c, 0]) }
    }
}
