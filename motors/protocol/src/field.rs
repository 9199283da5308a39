//! A quantity on the wire: an unsigned code of 12 or 16 bits that spans a range of real values.
//!
//! A value is clamped to the range and takes the nearest code. The vendor's formulas specify no
//! rounding. Only rounding to the nearest code survives a round trip: truncation loses 5 016 of the
//! 65 536 position codes. None of the symmetric ranges has a code for zero: zero lies half way
//! between two codes, and the encoder takes the upper one.

/// Encoding of one quantity. Source: MIT document 1.1 and 1.2, GIM document 3.2.7.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    /// The largest code.
    largest: u16,
    min: f64,
    max: f64,
    /// Codes per unit of the quantity.
    codes: f64,
    /// The size of one code.
    step: f64,
    /// Position of zero between the codes: exactly half way where the range is symmetric.
    zero: f64,
    /// The sum of `zero`, a half and [`TIE`]: a value in codes plus this, rounded down, is the
    /// nearest code.
    base: f64,
    /// The largest code plus a half.
    top: f64,
}

/// In codes. Rounding errors make a value in codes at most 2⁻³⁵ too low. Without this term, the
/// exact middle could take the lower code.
const TIE: f64 = 1.0 / (1_u64 << 30) as f64;

impl Field {
    /// Returns a field of `bits` (at most 16) for the values `min` to `max`.
    pub(crate) const fn new(bits: u32, min: f64, max: f64) -> Self {
        Self::up_to(largest(bits), min, max)
    }

    const fn up_to(largest: u16, min: f64, max: f64) -> Self {
        let (span, code_max) = (max - min, largest as f64);
        let zero = code_max * (-min / span);
        let (codes, step) = (code_max / span, span / code_max);
        Self { largest, min, max, codes, step, zero, base: zero + 0.5 + TIE, top: code_max + 0.5 }
    }

    /// Returns a field of `bits` (at most 16) for the values `-max` to `max`.
    pub(crate) const fn symmetric(bits: u32, max: f64) -> Self {
        Self::new(bits, -max, max)
    }

    /// Returns the value of code 0, in the unit of the quantity.
    #[must_use]
    pub const fn min(&self) -> f64 {
        self.min
    }

    /// Returns the value of the largest code, in the unit of the quantity.
    #[must_use]
    pub const fn max(&self) -> f64 {
        self.max
    }

    /// Returns the largest code: 4095 or 65535.
    #[must_use]
    pub const fn code_max(&self) -> u16 {
        self.largest
    }

    /// Returns the size of one code, in the unit of the quantity.
    #[must_use]
    pub const fn step(&self) -> f64 {
        self.step
    }

    /// Returns the position of `value` between the codes, before clamping and rounding: within 0.0
    /// to [`code_max`](Self::code_max) for a value of the range.
    ///
    /// For an error-feedback quantiser, which adds the rounding error to its next value.
    #[must_use]
    #[inline]
    pub fn quantise(&self, value: f64) -> f64 {
        value * self.codes + self.zero
    }

    /// Returns the nearest code, after clamping; of two equally near codes, the upper one. `None`
    /// for NaN and infinity.
    #[must_use]
    pub fn encode(&self, value: f64) -> Option<u16> {
        value.is_finite().then(|| self.encode_finite(value))
    }

    /// Like [`encode`](Self::encode), for a finite value.
    #[inline]
    pub(crate) fn encode_finite(&self, value: f64) -> u16 {
        let code = value * self.codes + self.base;
        let code = if code < self.top { code } else { self.top };
        // The cast rounds down, and clamps at zero.
        code as u16
    }

    /// Returns the value of `code`. A code wider than the field counts as the largest code.
    #[must_use]
    #[inline]
    pub fn decode(&self, code: u16) -> f64 {
        self.decode_within(code.min(self.largest))
    }

    /// Like [`decode`](Self::decode), for a code that is no wider than the field.
    #[inline]
    pub(crate) fn decode_within(&self, code: u16) -> f64 {
        (f64::from(code) - self.zero) * self.step
    }

    /// Returns a field with the same codes for values multiplied by `factors`.
    pub(crate) fn scaled(self, factors: [f64; 2]) -> Self {
        let [a, b] = factors;
        Self::up_to(self.largest, self.min * a * b, self.max * a * b)
    }
}

/// Packs `codes` of these widths, in bits, side by side, the first in the most significant bits. A
/// code wider than its field saturates: it never changes the bits of another code.
#[inline(always)]
pub(crate) fn pack<const N: usize>(widths: [u32; N], codes: [u16; N]) -> u64 {
    let mut word = 0;
    for field in 0..N {
        word = word << widths[field] | u64::from(codes[field].min(largest(widths[field])));
    }
    word
}

/// Unpacks the codes that [`pack`] packed.
#[inline(always)]
pub(crate) fn unpack<const N: usize>(widths: [u32; N], mut word: u64) -> [u16; N] {
    let mut codes = [0; N];
    for field in (0..N).rev() {
        codes[field] = word as u16 & largest(widths[field]);
        word >>= widths[field];
    }
    codes
}

/// The largest code of 12 bits, and its mask.
pub(crate) const TWELVE_BITS: u16 = largest(12);

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
    fn every_code_survives_a_round_trip() {
        for field in every_field() {
            for code in 0..=field.code_max() {
                let value = field.decode(code);
                assert_eq!(field.encode(value), Some(code), "{field:?}");
                assert_eq!(field.encode(f64::from(value as f32)), Some(code), "{field:?} as f32");
            }
        }
    }

    #[test]
    fn value_rounds_to_nearest_code_around_midpoints() {
        for field in every_field() {
            for code in 0..field.code_max() {
                let midpoint = field.decode(code) + field.step() / 2.0;
                let nudge = field.step() * 1e-6;
                assert_eq!(field.encode(midpoint - nudge), Some(code), "{field:?}");
                assert_eq!(field.encode(midpoint + nudge), Some(code + 1), "{field:?}");
            }
        }
    }

    /// 250 N·m/rad is half way between two codes, and its product with the codes of one unit is
    /// rounded down.
    #[test]
    fn exact_midpoint_rounds_to_the_upper_code() {
        let [_, _, kp, kd, _] = every_field();
        assert_eq!((kp.encode(250.0), kp.encode(f64::from(249.999_98_f32))), (Some(2048), Some(2047)));
        assert_eq!((kd.encode(2.5), kd.encode(f64::from(2.499_999_8_f32))), (Some(2048), Some(2047)));
        for field in every_field() {
            for code in 0..field.code_max() {
                let middle =
                    (f64::from(code) + 0.5) * (field.max() - field.min()) / f64::from(field.code_max());
                assert_eq!(field.encode(middle + field.min()), Some(code + 1), "{field:?}");
            }
        }
    }

    #[test]
    fn excess_has_end_codes_and_nonfinite_none() {
        for field in every_field() {
            assert_eq!(field.encode(f64::MAX), Some(field.code_max()));
            assert_eq!(field.encode(f64::MIN), Some(0));
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                assert_eq!(field.encode(value), None);
            }
        }
    }

    #[test]
    fn zero_lies_between_two_codes_of_symmetric_fields() {
        for field in every_field().into_iter().filter(|field| field.min() < 0.0) {
            let middle = f64::from(field.code_max()) / 2.0;
            assert_eq!(field.quantise(0.0), middle, "{field:?}");
            assert_eq!(field.encode(-0.0), Some(field.code_max() / 2 + 1), "{field:?}");
        }
    }

    #[test]
    fn wide_code_never_reaches_neighbouring_field() {
        assert_eq!(unpack([12, 12], pack([12, 12], [0, 0xFFFF])), [0, 0x0FFF]);
        let [_, _, kp, ..] = every_field();
        assert_eq!(kp.decode(0xFFFF), 500.0);
    }
}
