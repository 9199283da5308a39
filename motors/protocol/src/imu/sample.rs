//! A sample, and the types of its values.

use super::error::{SampleError, SampleField};

/// Smallest norm of a quaternion that counts as rounded by the device.
const NORM_MIN: f64 = 0.99;
/// Largest norm of a quaternion that counts as rounded by the device.
const NORM_MAX: f64 = 1.01;

/// The measurements of one moment. A value is `None` where the device does not report it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// Rotation from the sensor's axes to the world's.
    pub orientation: Option<Quaternion>,
    /// Angular velocity about the sensor's axes x, y, z, rad/s.
    pub angular_velocity: Option<[f32; 3]>,
    /// Specific force along the sensor's axes x, y, z, m/s²: at rest +9.81 upward.
    pub acceleration: Option<[f32; 3]>,
    /// Temperature of the device, °C.
    pub temperature_celsius: Option<f32>,
    /// Time of the measurement by the device's clock.
    pub time: Option<DeviceTime>,
    /// Number of the sample: one more than that of the sample before, modulo 65536.
    pub counter: Option<u16>,
    /// Status bits, as received. Their meaning is the vendor's.
    pub status: Option<u32>,
}

/// A rotation, as a unit quaternion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quaternion {
    /// Real part.
    pub w: f32,
    /// Imaginary part along x.
    pub x: f32,
    /// Imaginary part along y.
    pub y: f32,
    /// Imaginary part along z.
    pub z: f32,
}

impl Quaternion {
    /// Returns the rotation with these parts, in the order w, x, y, z, divided by their norm.
    /// Devices round the parts, so the norm is not exactly 1.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// A part is not finite, or the norm is not within 0.99 to 1.01.
    pub fn new(parts: [f32; 4]) -> Result<Self, SampleError> {
        let parts = finite(SampleField::Orientation, parts)?.map(f64::from);
        let norm = square_root(parts.iter().map(|part| part * part).sum());
        if !(NORM_MIN..=NORM_MAX).contains(&norm) {
            return Err(SampleError::NotUnit { received: norm });
        }
        Ok(Self::from(parts.map(|part| (part / norm) as f32)))
    }

    /// Returns the parts in the order w, x, y, z.
    #[must_use]
    pub const fn parts(self) -> [f32; 4] {
        [self.w, self.x, self.y, self.z]
    }

    /// Returns the rotation by `first`, then by `self`.
    #[must_use]
    pub fn after(self, first: Self) -> Self {
        let (a, b) = (self, first);
        Self {
            w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
            x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
        }
    }

    /// Returns the opposite rotation.
    #[must_use]
    pub const fn inverse(self) -> Self {
        Self { w: self.w, x: -self.x, y: -self.y, z: -self.z }
    }

    /// Returns the vector `from` after the rotation.
    #[must_use]
    pub fn rotate(self, from: [f32; 3]) -> [f32; 3] {
        let vector = Self { w: 0.0, x: from[0], y: from[1], z: from[2] };
        let rotated = self.after(vector).after(self.inverse());
        [rotated.x, rotated.y, rotated.z]
    }
}

impl From<[f32; 4]> for Quaternion {
    /// Takes the parts in the order w, x, y, z, without a check.
    fn from([w, x, y, z]: [f32; 4]) -> Self {
        Self { w, x, y, z }
    }
}

/// A time by the clock of a device: its origin and drift are unknown, and it wraps around.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceTime {
    /// Ticks of the clock.
    pub ticks: u32,
    /// Ticks in a second.
    pub per_second: u32,
}

impl DeviceTime {
    /// Returns the time since `earlier`, µs; `None` when the clocks differ. A clock that wrapped
    /// around once in between is no difference.
    #[must_use]
    pub fn micros_since(self, earlier: Self) -> Option<u64> {
        let ticks = u64::from(self.ticks.wrapping_sub(earlier.ticks));
        let is_same = self.per_second == earlier.per_second;
        (is_same && self.per_second > 0).then(|| ticks * 1_000_000 / u64::from(self.per_second))
    }
}

/// Returns `values` when they are finite numbers.
pub(super) fn finite<const N: usize>(field: SampleField, values: [f32; N]) -> Result<[f32; N], SampleError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(SampleError::NotFinite { field, received: value.to_bits() }),
        None => Ok(values),
    }
}

/// Returns the square root of a finite number that is not negative. `core` has none.
fn square_root(square: f64) -> f64 {
    if square < f64::MIN_POSITIVE {
        return 0.0;
    }
    // Half the exponent: within 7 % of the root. Each step of Newton doubles the correct digits.
    let mut root = f64::from_bits((square.to_bits() >> 1) + (1_023_u64 << 51));
    for _ in 0..4 {
        root = 0.5 * (root + square / root);
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HALF: f32 = core::f32::consts::FRAC_1_SQRT_2;

    #[test]
    fn norm_outside_range_is_refused_with_itself() {
        for (w, is_accepted) in [(0.989, false), (0.991, true), (1.0, true), (1.009, true), (1.011, false)] {
            let quaternion = Quaternion::new([w, 0.0, 0.0, 0.0]);
            assert_eq!(quaternion.is_ok(), is_accepted, "{w}");
            assert_eq!(
                quaternion.err(),
                (!is_accepted).then_some(SampleError::NotUnit { received: w.into() })
            );
        }
        assert_eq!(Quaternion::new([0.0; 4]), Err(SampleError::NotUnit { received: 0.0 }));
        assert!(
            matches!(Quaternion::new([f32::MAX; 4]), Err(SampleError::NotUnit { received }) if received > 1e38)
        );
        for bad in [f32::NAN, f32::INFINITY] {
            let error = SampleError::NotFinite { field: SampleField::Orientation, received: bad.to_bits() };
            assert_eq!(Quaternion::new([1.0, 0.0, bad, 0.0]), Err(error));
        }
    }

    #[test]
    fn quarter_turn_about_z_turns_x_to_y() {
        let quarter = Quaternion::new([HALF, 0.0, 0.0, HALF]).unwrap();
        let [x, y, z] = quarter.rotate([1.0, 0.0, 0.0]);
        assert!(x.abs() < 1e-6 && (y - 1.0).abs() < 1e-6 && z == 0.0);
        let half = quarter.after(quarter);
        assert!((half.z - 1.0).abs() < 1e-6 && half.w.abs() < 1e-6, "{half:?}");
    }

    #[test]
    fn device_time_wraps_around() {
        let time = |ticks| DeviceTime { ticks, per_second: 10_000 };
        assert_eq!(time(3).micros_since(time(u32::MAX - 1)), Some(500));
        assert_eq!(time(3).micros_since(DeviceTime { ticks: 1, per_second: 1000 }), None);
        assert_eq!(DeviceTime { ticks: 3, per_second: 0 }.micros_since(time(1)), None);
    }

    proptest! {
        #[test]
        fn square_root_is_that_of_std(square in prop_oneof![0.0..4.0_f64, 0.0..1e80_f64, Just(0.0)]) {
            prop_assert!((square_root(square) - square.sqrt()).abs() <= square.sqrt() * 1e-12);
        }

        #[test]
        fn accepted_quaternion_has_norm_one(parts in prop::array::uniform4(-1.1..1.1_f32)) {
            let norm = parts.iter().map(|part| f64::from(*part).powi(2)).sum::<f64>().sqrt();
            match Quaternion::new(parts) {
                Ok(unit) => {
                    prop_assert!((0.99..=1.01).contains(&norm));
                    let square: f32 = unit.parts().iter().map(|part| part * part).sum();
                    prop_assert!((square - 1.0).abs() < 1e-6);
                }
                Err(_) => prop_assert!(!(0.990_001..=1.009_999).contains(&norm)),
            }
        }
    }
}
