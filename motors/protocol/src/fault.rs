//! The faults of a motor, in terms that all vendors share.
//!
//! Each vendor numbers its faults differently. A [`Profile`](crate::Profile) maps them to the bits
//! of this table, so that a client needs no vendor's document. The lowest byte equals SteadyWin's
//! numbering, GIM document Table 9.

/// The faults that a motor reports, as bits of [`FAULTS`]. Zero means no fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Faults(
    /// The value that clients receive. The highest byte is a number, see
    /// [`unrecognised`](Self::unrecognised).
    pub u32,
);

/// A fault with a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fault {
    /// Its bit in [`Faults`].
    pub bit: u32,
    /// A short name, usable as a key.
    pub name: &'static str,
    /// Its meaning, as a sentence.
    pub sentence: &'static str,
}

const fn fault(faults: Faults, name: &'static str, sentence: &'static str) -> Fault {
    Fault { bit: faults.0, name, sentence }
}

/// All named faults.
pub const FAULTS: [Fault; 16] = [
    fault(
        Faults::FOC_FREQUENCY,
        "foc-frequency",
        "The current loop could not keep its rate (FOC frequency too high).",
    ),
    fault(Faults::OVER_VOLTAGE, "over-voltage", "The bus voltage is above the driver's threshold."),
    fault(Faults::UNDER_VOLTAGE, "under-voltage", "The bus voltage is below the driver's threshold."),
    fault(
        Faults::OVER_TEMPERATURE,
        "over-temperature",
        "The motor or its driver is hotter than the driver's threshold.",
    ),
    fault(Faults::START_FAILURE, "start-failure", "The motor could not be started."),
    fault(Faults::OVER_CURRENT, "over-current", "The current was above what the driver allows."),
    fault(
        Faults::SOFTWARE,
        "software",
        "The driver's software met a condition it could not handle (software exception).",
    ),
    fault(
        Faults::DRIVER_OVER_TEMPERATURE,
        "driver-over-temperature",
        "The driver's transistors are hotter than its threshold.",
    ),
    fault(
        Faults::MOTOR_OVER_TEMPERATURE,
        "motor-over-temperature",
        "The motor's winding is hotter than the driver's threshold.",
    ),
    fault(Faults::HOST_SILENT, "host-silent", "The driver received no command for longer than its timeout."),
    fault(Faults::OVERLOAD, "overload", "The motor was overloaded or stalled for too long."),
    fault(Faults::DRIVER_CHIP, "driver-chip", "The driver's gate driver chip reports a fault."),
    fault(Faults::ENCODER, "encoder", "The encoder is not calibrated, or does not work."),
    fault(Faults::HARDWARE, "hardware", "The driver does not recognise its own hardware."),
    fault(Faults::POSITION, "position", "The driver could not find the motor's position at its start."),
    fault(
        Faults::UNRECOGNISED,
        "unrecognised",
        "The motor reports a fault that is in no document: look at the number in the highest byte.",
    ),
];

impl Faults {
    /// No fault.
    pub const NONE: Self = Self(0);
    /// The current loop could not keep its rate. [`FAULTS`] describes each named fault in a
    /// sentence.
    pub const FOC_FREQUENCY: Self = Self(0x01);
    /// The bus voltage is above the driver's threshold. Damping feeds energy back into the bus.
    pub const OVER_VOLTAGE: Self = Self(0x02);
    /// The bus voltage is below the driver's threshold.
    pub const UNDER_VOLTAGE: Self = Self(0x04);
    /// The motor or its driver is too hot.
    pub const OVER_TEMPERATURE: Self = Self(0x08);
    /// The motor could not be started.
    pub const START_FAILURE: Self = Self(0x10);
    /// SteadyWin's 0x20, which the documents do not define.
    pub(crate) const UNNAMED: Self = Self(0x20);
    /// Overcurrent in any phase.
    pub const OVER_CURRENT: Self = Self(0x40);
    /// The driver's software met a condition that it could not handle.
    pub const SOFTWARE: Self = Self(0x80);
    /// The driver's transistors are too hot.
    pub const DRIVER_OVER_TEMPERATURE: Self = Self(0x100);
    /// The winding is too hot.
    pub const MOTOR_OVER_TEMPERATURE: Self = Self(0x200);
    /// The driver received no command for longer than its timeout.
    pub const HOST_SILENT: Self = Self(0x400);
    /// Overload or stall for too long.
    pub const OVERLOAD: Self = Self(0x800);
    /// The gate driver reports a fault.
    pub const DRIVER_CHIP: Self = Self(0x1000);
    /// The encoder is not calibrated, or does not work.
    pub const ENCODER: Self = Self(0x2000);
    /// The driver does not recognise its hardware.
    pub const HARDWARE: Self = Self(0x4000);
    /// The driver could not find the motor's position at its start.
    pub const POSITION: Self = Self(0x8000);
    /// A fault without a bit of its own. The vendor's number is in the highest byte.
    pub const UNRECOGNISED: Self = Self(0x0080_0000);

    /// Returns the fault for the vendor's number `code`, which the vendor's document does not name.
    #[must_use]
    pub const fn of_unknown_code(code: u8) -> Self {
        Self(Self::UNRECOGNISED.0 | (code as u32) << 24)
    }

    /// Returns the vendor's number of an unrecognised fault, if there is one.
    #[must_use]
    pub const fn unrecognised(self) -> Option<u8> {
        if self.has(Self::UNRECOGNISED) { Some((self.0 >> 24) as u8) } else { None }
    }

    /// Returns `true` when the motor reports no fault.
    #[must_use]
    pub const fn is_none(self) -> bool {
        self.0 == 0
    }

    /// Returns `true` when at least one fault of `other` is in this set.
    #[must_use]
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Returns the union of this set and `other`.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns the named faults, lowest bit first.
    pub fn named(self) -> impl Iterator<Item = &'static Fault> {
        FAULTS.iter().filter(move |fault| self.0 & fault.bit != 0)
    }

    /// Returns the bits without a name, and the vendor's number in the highest byte.
    #[must_use]
    pub fn unknown(self) -> u32 {
        self.named().fold(self.0, |rest, fault| rest & !fault.bit)
    }
}

/// The fault number of a SteadyWin motor, read as bits. Source: GIM document Table 9, MIT document
/// 1.2.
///
/// Both documents call it a number. Its values are powers of two without 0x20, so it is decoded as
/// a bit mask. The bit without a name is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct FaultBits(
    /// The byte as received.
    pub u8,
);

impl FaultBits {
    /// Returns the same faults as [`Faults`], whose lowest byte has this numbering.
    #[must_use]
    pub const fn faults(self) -> Faults {
        Faults(self.0 as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_is_named_or_kept_unknown() {
        for raw in 0..=u8::MAX {
            let faults = FaultBits(raw).faults();
            let named = faults.named().fold(0, |sum, fault| sum | fault.bit);
            assert_eq!((named | faults.unknown(), named & faults.unknown()), (u32::from(raw), 0));
            assert_eq!(faults.is_none(), raw == 0);
        }
        assert_eq!(FaultBits(0xFF).faults().unknown(), 0x20);
    }

    #[test]
    fn every_fault_word_has_a_distinct_bit() {
        let bits = FAULTS.iter().fold(0_u32, |bits, fault| {
            assert_eq!((fault.bit.count_ones(), bits & fault.bit), (1, 0), "{}", fault.name);
            bits | fault.bit
        });
        assert_eq!(bits >> 24, 0);
    }

    #[test]
    fn a_fault_without_a_word_keeps_its_number() {
        for code in 0..=u8::MAX {
            let faults = Faults::of_unknown_code(code);
            assert!(!faults.is_none());
            assert_eq!(faults.unrecognised(), Some(code));
        }
        assert_eq!(Faults::OVERLOAD.unrecognised(), None);
    }
}
