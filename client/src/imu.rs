//! The state of an IMU.

use motord_ports::clock;
use motord_shared::message::{IMU_FRESH, IMU_LOST, IMU_VALID};
use motord_shared::{ImuContradiction, ImuState};
use std::time::Duration;

/// One IMU after a cycle.
///
/// The frame of the body has x forward, y left and z up; z of the world points up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imu {
    orientation: [f32; 4],
    angular_velocity: [f32; 3],
    acceleration: [f32; 3],
    /// Temperature of the sensor, °C, if it reports one.
    pub temperature: Option<f32>,
    /// A sample was received since the previous states were published.
    pub fresh: bool,
    /// At least one sample was received since the daemon started.
    pub valid: bool,
    /// No sample for longer than `lost-after-ms`, or the device is disconnected. True until the
    /// first sample.
    pub lost: bool,
    /// Samples received since the daemon started.
    pub sequence: u64,
    /// Samples that the device took and motord did not receive, modulo 2³².
    pub missing: u32,
    /// Samples rejected: damaged, not finite, or with an orientation that is no unit quaternion;
    /// modulo 2³².
    pub rejected: u32,
    /// Time when the sample was received, or measured by the publisher of an external IMU, ns of
    /// `CLOCK_MONOTONIC`; 0 before the first.
    pub receive_ns: u64,
    /// Bits of the [`ImuContradiction`]s; see [`contradictions`](Self::contradictions).
    pub contradiction_bits: u32,
    /// See `ImuMessage::publisher`.
    pub(crate) publisher: u64,
}

impl Imu {
    /// Returns the orientation of the body in the world: a unit quaternion w, x, y, z. `None`
    /// before the first sample.
    #[must_use]
    pub fn orientation(&self) -> Option<[f32; 4]> {
        self.known(self.orientation)
    }

    /// Returns roll, pitch and yaw of the body, rad: turns about x, y and z of the world, in this
    /// order. Pitch is positive with the nose down. `None` before the first sample.
    #[must_use]
    pub fn roll_pitch_yaw(&self) -> Option<[f32; 3]> {
        let [w, x, y, z] = self.orientation()?.map(f64::from);
        let norm = w * w + x * x + y * y + z * z;
        let angles = [
            f64::atan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z),
            (2.0 * (w * y - z * x) / norm).clamp(-1.0, 1.0).asin(),
            f64::atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z),
        ];
        Some(angles.map(|angle| angle as f32))
    }

    /// Returns the direction of gravity in the frame of the body, a unit vector: 0, 0, -1 for a
    /// level body. Policies observe it as projected gravity. `None` before the first sample.
    #[must_use]
    pub fn projected_gravity(&self) -> Option<[f32; 3]> {
        let [w, x, y, z] = self.orientation()?;
        Some([2.0 * (w * y - x * z), -2.0 * (y * z + w * x), 2.0 * (x * x + y * y) - 1.0])
    }

    /// Returns the angular velocity of the body, in its frame, rad/s. `None` before the first
    /// sample.
    #[must_use]
    pub fn angular_velocity(&self) -> Option<[f32; 3]> {
        self.known(self.angular_velocity)
    }

    /// Returns the specific force on the body, in its frame, m/s²: at rest 9.81 upwards. `None`
    /// before the first sample.
    #[must_use]
    pub fn acceleration(&self) -> Option<[f32; 3]> {
        self.known(self.acceleration)
    }

    /// Returns the conventions in which orientation and acceleration would agree about gravity.
    /// None while they agree within 10° and 10 %, and until the body rested for 2 s for the first
    /// time. The finding stands until a rest in which both agree.
    pub fn contradictions(&self) -> impl Iterator<Item = ImuContradiction> + use<> {
        ImuContradiction::of_bits(self.contradiction_bits)
    }

    /// Returns the time since the sample was received. `None` before the first sample.
    #[must_use]
    pub fn age(&self) -> Option<Duration> {
        self.age_at(clock::now_ns())
    }

    /// Returns the time from the sample to `time_ns`, ns of `CLOCK_MONOTONIC`. `None` before the
    /// first sample.
    #[must_use]
    pub fn age_at(&self, time_ns: u64) -> Option<Duration> {
        self.valid.then(|| Duration::from_nanos(time_ns.saturating_sub(self.receive_ns)))
    }

    fn known<const N: usize>(&self, values: [f32; N]) -> Option<[f32; N]> {
        (self.valid && values.iter().all(|value| value.is_finite())).then_some(values)
    }
}

impl From<&ImuState> for Imu {
    fn from(imu: &ImuState) -> Self {
        let ImuState {
            orientation,
            angular_velocity,
            acceleration,
            temperature,
            flags,
            missing,
            rejected,
            sequence,
            receive_ns,
            publisher,
        } = *imu;
        let contradiction_bits = imu.contradictions();
        Self {
            orientation,
            angular_velocity,
            acceleration,
            temperature: Some(temperature).filter(|value| value.is_finite()),
            fresh: flags & IMU_FRESH != 0,
            valid: flags & IMU_VALID != 0,
            lost: flags & IMU_LOST != 0,
            sequence,
            missing,
            rejected,
            receive_ns,
            contradiction_bits,
            publisher,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn imu(orientation: [f32; 4]) -> Imu {
        Imu::from(&ImuState { orientation, flags: IMU_VALID, ..ImuState::default() })
    }

    fn assert_near(found: Option<[f32; 3]>, expected: [f32; 3]) {
        let found = found.unwrap();
        let is_near = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6);
        assert!(is_near, "{found:?}, expected {expected:?}");
    }

    #[test]
    fn imu_without_sample_has_no_values() {
        let silent = Imu::from(&ImuState::UNKNOWN);
        assert!(silent.lost && !silent.valid && silent.temperature.is_none());
        assert_eq!((silent.orientation(), silent.age()), (None, None));
        assert_eq!((silent.angular_velocity(), silent.acceleration()), (None, None));
        // A daemon that lies about the flag cannot pass on what is no number.
        let lying = Imu::from(&ImuState { flags: IMU_VALID, ..ImuState::UNKNOWN });
        assert_eq!((lying.orientation(), lying.projected_gravity()), (None, None));
    }

    #[test]
    fn projected_gravity_points_down_in_body() {
        assert_near(imu([1.0, 0.0, 0.0, 0.0]).projected_gravity(), [0.0, 0.0, -1.0]);
        // The nose down by 90°: gravity points forward.
        let nose_down = imu([0.5_f32.sqrt(), 0.0, 0.5_f32.sqrt(), 0.0]);
        assert_near(nose_down.projected_gravity(), [1.0, 0.0, 0.0]);
        assert_near(nose_down.roll_pitch_yaw(), [0.0, core::f32::consts::FRAC_PI_2, 0.0]);
        // On its right side: gravity points to the right, which is -y.
        let right_side = imu([0.5_f32.sqrt(), 0.5_f32.sqrt(), 0.0, 0.0]);
        assert_near(right_side.projected_gravity(), [0.0, -1.0, 0.0]);
    }
}
