//! Error feedback: the mean of the codes of velocity and torque of MIT frames is the value asked
//! for.
//!
//! Zero lies half a code off. A code of torque is up to 0.3 N·m. Half a code of velocity, times the
//! damping, is a torque as well: 32 mN·m for a GIM8108-8 with 2 N·m·s/rad. The code of the position
//! is the nearest one: an error of half a code is below the resolution of the reported position.
//!
//! Real-time: nothing here allocates, blocks or loops.

use super::Impedance;
use crate::field::TWELVE_BITS;
use crate::{Field, Scales};

/// Carries the rounding errors of velocity and torque from frame to frame.
#[derive(Debug)]
pub struct Feedback {
    velocity: Carry,
    torque: Carry,
}

impl Feedback {
    /// Limits velocities and torques to `limits`, rad/s and N·m. Only the two codes next to zero
    /// may exceed them.
    #[must_use]
    pub fn within(limits: [f32; 2], scales: &Scales) -> Self {
        let [velocity, torque] = limits;
        Self {
            velocity: Carry::within(velocity, &scales.velocity),
            torque: Carry::within(torque, &scales.torque),
        }
    }

    /// Forgets the carried errors.
    pub const fn forget(&mut self) {
        (self.velocity.error, self.torque.error) = (0.0, 0.0);
    }

    /// Returns the codes of velocity and torque of `wanted`, whose values are finite.
    #[inline(always)]
    pub fn quantise(&mut self, wanted: &Impedance, scales: &Scales) -> [u16; 2] {
        [
            self.velocity.quantise(wanted.velocity, &scales.velocity),
            self.torque.quantise(wanted.torque, &scales.torque),
        ]
    }
}

/// The rounding error of one quantity.
#[derive(Debug)]
struct Carry {
    /// The sum that the frames so far sent too much, in codes; within ±0.5.
    error: f64,
    /// The lowest code within the limit, and the highest one plus a half.
    ends: [f64; 2],
}

impl Carry {
    /// Limits values to ±`most`. Only the two codes next to zero may exceed it.
    fn within(most: f32, field: &Field) -> Self {
        let [low, zero, high] = [-most, 0.0, most].map(|value| field.quantise(value.into()));
        let highest = high.floor().max(zero.ceil()).min(field.code_max().into());
        Self { error: 0.0, ends: [low.ceil().min(zero.floor()).max(0.0), highest + 0.5] }
    }

    /// The code for a finite `value`: at most one code off, such that the error of all codes so far
    /// stays within half a code. What the limit takes away is not carried.
    #[inline(always)]
    fn quantise(&mut self, value: f32, field: &Field) -> u16 {
        let wanted = field.quantise(value.into()) - self.error;
        let [low, top] = self.ends;
        let rounded = wanted + 0.5;
        let rounded = if rounded > low { rounded } else { low };
        let rounded = if rounded < top { rounded } else { top };
        // The cast rounds down. The mask changes nothing: both fields have 12 bits. It lets the
        // compiler remove the saturation when the codes are packed.
        let code = rounded as u16 & TWELVE_BITS;
        self.error = (f64::from(code) - wanted).clamp(-0.5, 0.5);
        code
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::collection::vec;
    use proptest::prelude::*;

    /// Of the GIM8108-8, by the MIT document 1.1.
    fn fields() -> [Field; 2] {
        let scales = Scales::by_current(0.125, 8.0).unwrap();
        [scales.velocity, scales.torque]
    }

    #[test]
    fn mean_of_thousand_frames_is_within_thousandth_code() {
        for field in fields() {
            for thirds in -30..30 {
                let value = (f64::from(thirds) * 0.3 * field.step()) as f32;
                let exact = field.quantise(value.into());
                let mut carry = Carry::within(20.0, &field);
                let codes: Vec<f64> = (0..1000).map(|_| f64::from(carry.quantise(value, &field))).collect();
                let mean = codes.iter().sum::<f64>() / 1000.0;
                assert!((mean - exact).abs() <= 0.001, "{exact} became {mean}");
            }
        }
    }

    proptest! {
        #[test]
        fn mean_of_many_frames_is_requested_torque(
            before in vec(-19.0_f32..19.0, 0..5),
            wanted in -19.0_f32..19.0,
            frames in 1_u16..2000,
        ) {
            for field in fields() {
                let exact = field.quantise(wanted.into());
                let mut carry = Carry::within(20.0, &field);
                for value in &before {
                    carry.quantise(*value, &field);
                }
                let mut sum = 0.0;
                for _ in 0..frames {
                    let code = f64::from(carry.quantise(wanted, &field));
                    prop_assert!((code - exact).abs() < 1.0, "{} is no neighbour of {}", code, exact);
                    sum += code;
                }
                let frames = f64::from(frames);
                prop_assert!((sum / frames - exact).abs() <= 1.0 / frames + 1e-9);
            }
        }

        #[test]
        fn no_code_exceeds_the_allowed_torque(
            limit in 0.06_f32..25.0,
            shares in vec(-1.5_f32..=1.5, 1..50),
        ) {
            for field in fields() {
                let mut carry = Carry::within(limit, &field);
                for share in shares.iter().copied().chain([1.0, 1.0, -1.0, -1.0]) {
                    let code = carry.quantise(share * limit, &field);
                    prop_assert!(field.decode(code).abs() <= f64::from(limit) + 1e-6, "{}", share);
                }
            }
        }
    }

    /// The ends of the codes may be below the limit of the joint.
    #[test]
    fn limit_beyond_the_codes_is_their_end() {
        for field in fields() {
            let mut carry = Carry::within(1e6, &field);
            for (value, code) in [(1e9, field.code_max()), (f32::MAX, field.code_max()), (f32::MIN, 0)] {
                assert_eq!(carry.quantise(value, &field), code);
            }
        }
    }
}
