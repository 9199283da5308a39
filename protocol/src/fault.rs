//! The fault number of a motor, read as bits.
//!
//! Both documents call it a number, but its values are powers of two, and 0x20 is missing among them: it is taken as a
//! bit mask, and bits without a name are kept. Source: GIM document Table 9, MIT document 1.2.

/// The faults a motor tells. Zero is no fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct FaultBits(
    /// As received.
    pub u8,
);

/// A fault with a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fault {
    /// Its bit in [`FaultBits`].
    pub bit: u8,
    /// A short name, fit for a key.
    pub name: &'static str,
    /// What it means, as a sentence.
    pub sentence: &'static str,
}

const fn fault(bit: u8, name: &'static str, sentence: &'static str) -> Fault {
    Fault { bit, name, sentence }
}

/// Every fault the documents name.
pub const FAULTS: [Fault; 7] = [
    fault(0x01, "foc-frequency", "The current loop could not keep its rate (FOC frequency too high)."),
    fault(FaultBits::OVER_VOLTAGE, "over-voltage", "The bus voltage is above the driver's threshold."),
    fault(0x04, "under-voltage", "The bus voltage is below the driver's threshold."),
    fault(0x08, "over-temperature", "The motor or its driver is hotter than the driver's threshold."),
    fault(0x10, "start-failure", "The motor could not be started."),
    fault(0x40, "over-current", "The current was above what the driver allows."),
    fault(0x80, "software", "The driver's software met a condition it could not handle."),
];

impl FaultBits {
    /// The bus voltage is above the driver's threshold.
    pub const OVER_VOLTAGE: u8 = 0x02;

    /// The motor tells no fault.
    #[must_use]
    pub const fn is_none(self) -> bool {
        self.0 == 0
    }

    /// The faults with a name, lowest bit first.
    pub fn named(self) -> impl Iterator<Item = &'static Fault> {
        FAULTS.iter().filter(move |fault| self.0 & fault.bit != 0)
    }

    /// The bits no document names, as received.
    #[must_use]
    pub fn unknown(self) -> u8 {
        self.named().fold(self.0, |rest, fault| rest & !fault.bit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_is_either_named_or_kept_as_unknown() {
        for raw in 0..=u8::MAX {
            let bits = FaultBits(raw);
            let named = bits.named().fold(0, |sum, fault| sum | fault.bit);
            assert_eq!((named | bits.unknown(), named & bits.unknown()), (raw, 0));
            assert_eq!(bits.is_none(), raw == 0);
        }
        assert_eq!(FaultBits(0xFF).unknown(), 0x20);
    }
}
