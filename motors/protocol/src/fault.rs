//! The faults of a motor, in terms that all vendors share.
//!
//! Each vendor numbers its faults differently. A [`Profile`](crate::Profile) maps them to these
//! bits, so that a client needs no vendor's document. `motord_shared::Fault` has name and sentence
//! of each. The lowest byte equals SteadyWin's numbering, GIM document Table 9.

/// The faults that a motor reports, as bits. Zero means no fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Faults(
    /// The value that clients receive. The highest byte is a number, see
    /// [`unrecognised`](Self::unrecognised).
    pub u32,
);

/// Declares the constants of the faults that have a name.
macro_rules! faults {
    ($($name:ident = $bit:literal,)+) => {
        impl Faults {
            $(#[doc = concat!("Bit ", $bit, ". `motord_shared::Fault` has the sentence.")]
            pub const $name: Self = Self(1 << $bit);)+
        }

        /// The names of the constants.
        #[cfg(any(test, feature = "models"))]
        const NAMED: &[(&str, Faults)] = &[$((stringify!($name), Faults::$name),)+];
    };
}

faults! {
    FOC_FREQUENCY = 0,
    OVER_VOLTAGE = 1,
    UNDER_VOLTAGE = 2,
    OVER_TEMPERATURE = 3,
    START_FAILURE = 4,
    OVER_CURRENT = 6,
    SOFTWARE = 7,
    DRIVER_OVER_TEMPERATURE = 8,
    MOTOR_OVER_TEMPERATURE = 9,
    HOST_SILENT = 10,
    OVERLOAD = 11,
    DRIVER_CHIP = 12,
    ENCODER = 13,
    HARDWARE = 14,
    POSITION = 15,
    UNRECOGNISED = 23,
}

impl Faults {
    /// No fault.
    pub const NONE: Self = Self(0);
    /// SteadyWin's 0x20, which the documents do not define.
    #[cfg(feature = "models")]
    const UNNAMED: Self = Self(0x20);

    /// Returns the fault for the vendor's number `code`, which the vendor's document does not name.
    #[must_use]
    pub const fn of_unknown_code(code: u8) -> Self {
        Self(Self::UNRECOGNISED.0 | (code as u32) << 24)
    }

    /// Returns the faults and their names in the files of vendors, in kebab-case.
    #[cfg(feature = "models")]
    pub(crate) fn named() -> impl Iterator<Item = (String, Self)> {
        let names = NAMED.iter().filter(|(_, faults)| *faults != Self::UNRECOGNISED);
        let all = names.copied().chain([("UNNAMED", Self::UNNAMED)]);
        all.map(|(name, faults)| (name.to_ascii_lowercase().replace('_', "-"), faults))
    }

    /// Returns the faults of a vendor's `bits` by a table. Of the bits that the table does not have, the
    /// lowest is reported by its index.
    #[must_use]
    pub fn of_bits(table: &[(u64, Self)], bits: u64) -> Self {
        let known = table.iter().filter(|(bit, _)| bits & bit != 0);
        let (faults, rest) =
            known.fold((Self::NONE, bits), |(all, rest), (bit, fault)| (all.and(*fault), rest & !bit));
        if rest == 0 { faults } else { faults.and(Self::of_unknown_code(rest.trailing_zeros() as u8)) }
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
    use motord_shared::Fault;

    #[test]
    fn faults_have_names_and_bits_of_their_table() {
        let kebab = |byte: u8| if byte == b'_' { b'-' } else { byte.to_ascii_lowercase() };
        assert_eq!(NAMED.len(), Fault::ALL.len());
        for ((name, faults), fault) in NAMED.iter().zip(Fault::ALL) {
            assert_eq!(faults.0, fault.bit(), "{name}");
            assert!(name.bytes().map(kebab).eq(fault.name().bytes()), "{name} is {fault}");
        }
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
