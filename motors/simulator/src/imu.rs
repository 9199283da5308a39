//! A simulated inertial measurement unit (IMU) on a body that sways.

use crate::fault::{Fault, InjectError};
use crate::random::Random;
use core::f64::consts::TAU;
use motord_bus::Duration;

/// Acceleration of free fall, m/s².
const GRAVITY: f64 = 9.81;
/// The noise of the acceleration, m/s², for each rad/s of the noise of the angular velocity.
const ACCELERATION_NOISE: f64 = 10.0;
/// °C.
const TEMPERATURE: f64 = 35.0;

/// Motion about one axis: angle, rad = amplitude · sin(2π · frequency · time).
#[derive(Debug, Clone, Copy)]
struct Sway {
    amplitude: f64,
    /// Hz.
    frequency: f64,
}

/// About x, y and z: roll, pitch and yaw of a robot that trots on the spot.
const SWAYS: [Sway; 3] = [
    Sway { amplitude: 0.04, frequency: 0.9 },
    Sway { amplitude: 0.03, frequency: 0.7 },
    Sway { amplitude: 0.2, frequency: 0.1 },
];

/// The values that a simulated IMU measures, in its own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuValues {
    /// Unit quaternion w, x, y, z to the world, whose z points up.
    pub orientation: [f64; 4],
    /// rad/s.
    pub angular_velocity: [f64; 3],
    /// Specific force, m/s²: at rest 9.81 upwards.
    pub acceleration: [f64; 3],
    /// °C.
    pub temperature: f64,
}

/// The outcome of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ImuOutput {
    /// The sample arrives.
    Sample(ImuValues),
    /// It is lost.
    Nothing,
    /// The device is disconnected.
    Gone,
}

/// A simulated IMU. The same seed and the same calls give the same samples.
#[derive(Debug, Clone)]
pub struct Imu {
    noise: f64,
    bias: f64,
    delay: Duration,
    random: Random,
    faults: Faults,
}

/// The faults in effect.
#[derive(Debug, Clone, Default)]
struct Faults {
    is_disconnected: bool,
    is_off: bool,
    is_garbage: bool,
    /// The sample that is repeated, with its noise.
    stuck: Option<ImuValues>,
    should_stick: bool,
    delay: Duration,
    lost: f64,
}

impl Imu {
    /// `noise` is the standard deviation of each axis of the angular velocity and `bias` its
    /// constant error, rad/s. A sample is `delay` old when it arrives.
    #[must_use]
    pub fn new(noise: f64, bias: f64, delay: Duration, seed: u64) -> Self {
        Self { noise, bias, delay, random: Random::new(seed), faults: Faults::default() }
    }

    /// Returns the sample that arrives at `time` after the start.
    pub fn sample(&mut self, time: Duration) -> ImuOutput {
        self.sample_of(&motion(time.saturating_sub(self.delay())))
    }

    /// As [`sample`](Self::sample), of a body that the caller moves: `values` are those of the time
    /// that the sample was taken.
    pub fn sample_of(&mut self, values: &ImuValues) -> ImuOutput {
        let Faults { is_disconnected, is_off, is_garbage, lost, .. } = self.faults;
        if is_disconnected {
            return ImuOutput::Gone;
        }
        if is_off || self.random.fraction() < lost {
            return ImuOutput::Nothing;
        }
        if is_garbage {
            return ImuOutput::Sample(ImuValues { orientation: [f64::NAN; 4], ..self.with_errors(*values) });
        }
        if let Some(values) = self.faults.stuck {
            return ImuOutput::Sample(values);
        }
        let values = self.with_errors(*values);
        self.faults.stuck = self.faults.should_stick.then_some(values);
        ImuOutput::Sample(values)
    }

    /// Time from a measurement to its arrival.
    #[must_use]
    pub fn delay(&self) -> Duration {
        self.delay + self.faults.delay
    }

    /// Gives it a fault, or ends all.
    ///
    /// # Errors
    ///
    /// [`InjectError::NotForImus`] for a fault of a motor or bus.
    pub fn inject(&mut self, fault: Fault) -> Result<(), InjectError> {
        let faults = &mut self.faults;
        match fault {
            Fault::Ok => *faults = Faults::default(),
            Fault::Off => faults.is_off = true,
            Fault::Gone => faults.is_disconnected = true,
            Fault::Garbage => faults.is_garbage = true,
            Fault::Stuck => faults.should_stick = true,
            Fault::Delayed(delay) => faults.delay = delay,
            Fault::Intermittent(lost) => faults.lost = lost,
            _ => return Err(InjectError::NotForImus),
        }
        Ok(())
    }

    fn with_errors(&mut self, values: ImuValues) -> ImuValues {
        let noise = self.noise;
        ImuValues {
            angular_velocity: values.angular_velocity.map(|value| value + self.bias + noise * self.normal()),
            acceleration: values.acceleration.map(|value| value + ACCELERATION_NOISE * noise * self.normal()),
            ..values
        }
    }

    /// A random number of mean 0 and standard deviation 1: the sum of twelve uniform ones
    /// (Irwin-Hall), at most ±6.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.random.fraction()).sum::<f64>() - 6.0
    }
}

/// The motion of the body without errors.
fn motion(time: Duration) -> ImuValues {
    let seconds = time.as_secs_f64();
    let [(roll, roll_rate), (pitch, pitch_rate), (yaw, yaw_rate)] = SWAYS.map(|sway| {
        let (sine, cosine) = (TAU * sway.frequency * seconds).sin_cos();
        (sway.amplitude * sine, sway.amplitude * TAU * sway.frequency * cosine)
    });
    let ((sr, cr), (sp, cp)) = (roll.sin_cos(), pitch.sin_cos());
    ImuValues {
        orientation: quaternion([roll, pitch, yaw]),
        // The rates of yaw, pitch and roll act about z of the world, y after the yaw, and x of the
        // body.
        angular_velocity: [
            roll_rate - sp * yaw_rate,
            cr * pitch_rate + sr * cp * yaw_rate,
            -sr * pitch_rate + cr * cp * yaw_rate,
        ],
        acceleration: [-sp, sr * cp, cr * cp].map(|part| GRAVITY * part),
        temperature: TEMPERATURE,
    }
}

/// The quaternion w, x, y, z of roll, pitch and yaw about x, y and z of the world, in this order.
fn quaternion(angles: [f64; 3]) -> [f64; 4] {
    let [(sr, cr), (sp, cp), (sy, cy)] = angles.map(|angle| (angle / 2.0).sin_cos());
    [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ideal() -> Imu {
        Imu::new(0.0, 0.0, Duration::ZERO, 1)
    }

    fn sample(imu: &mut Imu, millis: u64) -> ImuValues {
        match imu.sample(Duration::from_millis(millis)) {
            ImuOutput::Sample(values) => values,
            other => panic!("no sample: {other:?}"),
        }
    }

    /// The orientation turned by the angular velocity for 1 ms is the next one, and gravity is up
    /// in both frames.
    #[test]
    fn angular_velocity_and_acceleration_agree_with_orientation() {
        let mut imu = ideal();
        for millis in (0..5000).step_by(37) {
            let [before, after] = [millis, millis + 1].map(|millis| sample(&mut imu, millis));
            let [w, x, y, z] = before.orientation;
            let [p, q, r] = before.angular_velocity.map(|rate| rate * 0.5e-3);
            let turned = [
                w - p * x - q * y - r * z,
                x + p * w + r * y - q * z,
                y + q * w - r * x + p * z,
                z + r * w + q * x - p * y,
            ];
            for (turned, after) in turned.iter().zip(after.orientation) {
                assert!((turned - after).abs() < 1e-6, "{turned} {after}");
            }
            // The third row of the rotation to the world: its up, in the frame of the body.
            let up = [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
            for (up, measured) in up.iter().zip(before.acceleration) {
                assert!((up * GRAVITY - measured).abs() < 1e-9, "{up} {measured}");
            }
        }
    }

    #[test]
    fn noise_has_the_configured_deviation_and_bias() {
        let (mut noisy, mut ideal) = (Imu::new(0.02, 0.1, Duration::ZERO, 1), ideal());
        let errors: Vec<f64> = (0..4000)
            .map(|n| sample(&mut noisy, n).angular_velocity[0] - sample(&mut ideal, n).angular_velocity[0])
            .collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let variance = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / errors.len() as f64;
        assert!((mean - 0.1).abs() < 0.002, "{mean}");
        assert!((variance.sqrt() - 0.02).abs() < 0.001, "{}", variance.sqrt());
    }

    #[test]
    fn faults_act_until_ok_ends_them() {
        let mut noisy = Imu::new(0.02, 0.0, Duration::ZERO, 1);
        noisy.inject(Fault::Stuck).unwrap();
        assert_eq!(sample(&mut noisy, 100), sample(&mut noisy, 200), "with its noise");
        let mut imu = ideal();
        imu.inject(Fault::Ok).unwrap();
        imu.inject(Fault::Delayed(Duration::from_millis(50))).unwrap();
        assert_eq!(sample(&mut imu, 350), sample(&mut ideal(), 300));
        imu.inject(Fault::Garbage).unwrap();
        assert!(sample(&mut imu, 1).orientation[0].is_nan());
        imu.inject(Fault::Off).unwrap();
        assert_eq!(imu.sample(Duration::ZERO), ImuOutput::Nothing);
        imu.inject(Fault::Gone).unwrap();
        assert_eq!(imu.sample(Duration::ZERO), ImuOutput::Gone);
        imu.inject(Fault::Ok).unwrap();
        assert_eq!(sample(&mut imu, 5), sample(&mut ideal(), 5));
        assert_eq!(imu.inject(Fault::Reorder), Err(InjectError::NotForImus));
        imu.inject(Fault::Intermittent(0.25)).unwrap();
        let lost = (0..4000).filter(|&n| imu.sample(Duration::from_millis(n)) == ImuOutput::Nothing).count();
        assert!((900..1100).contains(&lost), "{lost}");
    }
}
