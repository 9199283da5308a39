//! A quantity on the wire: an unsigned code of 12 or 16 bits that spans a range of real values.
//!
//! A value is clamped to the range and takes the nearest code. The vendor's formulas give no rounding; nearest is the
//! only choice that survives a round trip (truncation loses 5 016 of the 65 536 position codes). None of the symmetric
//! ranges has a code for zero: it falls half way between two, and the upper one is taken.

/// How one quantity is coded. Source: MIT document 1.1 and 1.2, GIM document 3.2.7.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    bits: u32,
    min: f64,
    max: f64,
    /// `max - min`.
    span: f64,
    /// The size of one code.
    step: f64,
    /// Where zero lies between the codes: exactly half way where the range is symmetric.
    zero: f64,
    /// The largest code.
    code_max: f64,
}

impl Field {
    /// `bits` (at most 16) for the values `min` to `max`.
    pub(crate) const fn new(bits: u32, min: f64, max: f64) -> Self {
        let (span, code_max) = (max - min, largest(bits) as f64);
        Self { bits, min, max, span, step: span / code_max, zero: code_max * (-min / span), code_max }
    }

    /// `bits` (at most 16) for the values `-max` to `max`.
    pub(crate) const fn symmetric(bits: u32, max: f64) -> Self {
        Self::new(bits, -max, max)
    }

    /// The value of code 0, in the unit of the quantity.
    #[must_use]
    pub const fn min(&self) -> f64 {
        self.min
    }

    /// The value of the largest code, in the unit of the quantity.
    #[must_use]
    pub const fn max(&self) -> f64 {
        self.max
    }

    /// The largest code: 4095 or 65535.
    #[must_use]
    pub const fn code_max(&self) -> u16 {
        largest(self.bits)
    }

    /// The size of one code, in the unit of the quantity.
    #[must_use]
    pub const fn step(&self) -> f64 {
        self.step
    }

    /// Where `value` lies between the codes, after clamping: 0.0 to [`code_max`](Self::code_max), before rounding.
    ///
    /// For an error-feedback quantiser, which carries what rounding takes away. `None` for NaN and infinity.
    #[must_use]
    #[inline]
    pub fn quantise(&self, value: f64) -> Option<f64> {
        value.is_finite().then(|| self.quantise_finite(value))
    }

    /// As [`quantise`](Self::quantise), of a value that is finite.
    #[inline]
    pub(crate) fn quantise_finite(&self, value: f64) -> f64 {
        // The product of a single-precision value is exact, so a value half way between two codes stays there.
        let code = value * self.code_max / self.span + self.zero;
        // Comparisons of this form are one instruction each; nothing here is NaN.
        let code = if code > 0.0 { code } else { 0.0 };
        if code < self.code_max { code } else { self.code_max }
    }

    /// As [`encode`](Self::encode), of a value that is finite.
    #[inline]
    pub(crate) fn encode_finite(&self, value: f32) -> u16 {
        let code = f64::from(value) * self.code_max / self.span + self.zero;
        let code = if code < self.code_max { code } else { self.code_max };
        // The cast clamps at zero.
        (code + 0.5) as u16
    }

    /// The nearest code, after clamping; of two equally near codes the upper. `None` for NaN and infinity.
    #[must_use]
    pub fn encode(&self, value: f64) -> Option<u16> {
        // The code is never negative, so this cast after adding a half rounds to nearest.
        self.quantise(value).map(|code| (code + 0.5) as u16)
    }

    /// The value of `code`. A code wider than the field counts as the largest.
    #[must_use]
    #[inline]
    pub fn decode(&self, code: u16) -> f64 {
        (f64::from(code.min(self.code_max())) - self.zero) * self.step
    }

    /// The same codes for values `factors` times as large.
    pub(crate) fn scaled(self, factors: [f64; 2]) -> Self {
        let [a, b] = factors;
        Self::new(self.bits, self.min * a * b, self.max * a * b)
    }
}

/// Puts `codes` of these widths, in bits, side by side, the first in the most significant bits. A code wider than its
/// field saturates: it never reaches into its neighbour.
#[inline(always)]
pub(crate) fn pack<const N: usize>(widths: [u32; N], codes: [u16; N]) -> u64 {
    let mut word = 0;
    for field in 0..N {
        word = word << widths[field] | u64::from(codes[field].min(largest(widths[field])));
    }
    word
}

/// Takes apart what [`pack`] put together.
#[inline(always)]
pub(crate) fn unpack<const N: usize>(widths: [u32; N], mut word: u64) -> [u16; N] {
    let mut codes = [0; N];
    for field in (0..N).rev() {
        codes[field] = word as u16 & largest(widths[field]);
        word >>= widths[field];
    }
    codes
}

/// The largest code of `bits` bits, at most 16.
const fn largest(bits: u32) -> u16 {
    ((1_u32 << bits) - 1) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scales;

    fn every_field() -> [Field; 5] {
        let Scales { position, velocity, kp, kd, torque } = Scales::by_current(0.125, 8.0).unwrap();
        [position, velocity, kp, kd, torque]
    }

    #[test]
    fn every_code_of_every_field_survives_a_round_trip() {
        for field in every_field() {
            for code in 0..=field.code_max() {
                let value = field.decode(code);
                assert_eq!(field.encode(value), Some(code), "{field:?}");
                assert_eq!(field.encode(f64::from(value as f32)), Some(code), "{field:?} as f32");
            }
        }
    }

    #[test]
    fn a_value_takes_the_nearest_code_on_both_sides_of_every_midpoint() {
        for field in every_field() {
            for code in 0..field.code_max() {
                let midpoint = field.decode(code) + field.step() / 2.0;
                let nudge = field.step() * 1e-6;
                assert_eq!(field.encode(midpoint - nudge), Some(code), "{field:?}");
                assert_eq!(field.encode(midpoint + nudge), Some(code + 1), "{field:?}");
            }
        }
    }

    #[test]
    fn values_beyond_the_range_take_the_end_codes_and_what_is_not_finite_takes_none() {
        for field in every_field() {
            assert_eq!(field.encode(f64::MAX), Some(field.code_max()));
            assert_eq!(field.encode(f64::MIN), Some(0));
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                assert_eq!((field.quantise(value), field.encode(value)), (None, None));
            }
        }
    }

    #[test]
    fn zero_lies_half_way_between_two_codes_of_every_symmetric_field() {
        for field in every_field().into_iter().filter(|field| field.min() < 0.0) {
            let middle = f64::from(field.code_max()) / 2.0;
            assert_eq!(field.quantise(0.0), Some(middle), "{field:?}");
            assert_eq!(field.encode(-0.0), Some(field.code_max() / 2 + 1), "{field:?}");
        }
    }

    #[test]
    fn a_code_too_wide_for_its_field_never_reaches_its_neighbour() {
        assert_eq!(unpack([12, 12], pack([12, 12], [0, 0xFFFF])), [0, 0x0FFF]);
        let [_, _, kp, ..] = every_field();
        assert_eq!(kp.decode(0xFFFF), 500.0);
    }
}
