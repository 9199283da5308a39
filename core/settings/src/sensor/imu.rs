//! IMUs: their settings, their samples, and the mount that turns a sample into the frame of the
//! body.
//!
//! The body's frame has x forward, y left and z up, as in ROS (REP 103). The world's z points up;
//! its x is where the sensor's heading is zero.

use super::frames::SensorFrames;
use motord_bus::{Duration, FrameId};
use motord_protocol::imu::{CanDevice, Quaternion, Sample, SerialProtocol};

/// `[[imu]]`.
#[derive(Debug, Clone)]
pub struct ImuSettings {
    /// Its name.
    pub name: String,
    /// The source of its samples.
    pub source: ImuSource,
    /// Samples per second.
    pub rate_hz: f64,
    /// The mount of the sensor on the body.
    pub mount: Mount,
    /// Without a sample for this long it is lost.
    pub lost_after: Duration,
    /// The reaction to the loss.
    pub when_lost: WhenLost,
}

/// The source of the samples of an IMU.
#[derive(Debug, Clone)]
pub enum ImuSource {
    /// Simulated inside the daemon.
    Simulated(ImuSimulation),
    /// A device on a serial line.
    Serial(ImuSerial),
    /// A device on a CAN bus, which the cycle reads.
    Can(ImuCan),
    /// Published by another process.
    External,
}

impl ImuSettings {
    /// Returns its name and its words, see [`SensorSettings::words`](super::SensorSettings::words).
    pub(super) fn words(&self) -> (&str, [&'static str; 3]) {
        let see = "imu-lost";
        let check = match self.source {
            ImuSource::Serial(_) => "check its cable and power, its device and its baud rate",
            ImuSource::Can(_) => "check its cable and power, its ids, and the bit rate and state of its bus",
            ImuSource::External => "check the process that publishes it",
            ImuSource::Simulated(_) => "a fault of `motorctl sim` holds them back",
        };
        (&self.name, ["imu", see, check])
    }

    /// Returns its frames; `None` for one that is not on a CAN bus. Allocates.
    #[must_use]
    pub fn frames(&self) -> Option<SensorFrames> {
        let can = self.source.can()?;
        let frame = |(id, bytes)| Some((FrameId::new(id)?, bytes));
        let mut requests: Vec<_> = can.device.frames().filter_map(frame).collect();
        let asked = if can.device.protocol().is_asked() { requests.len() / 2 } else { 0 };
        let samples = requests.split_off(asked);
        let sent_ids = can.device.sent_ids().filter_map(FrameId::new).collect();
        Some(SensorFrames { bus: can.bus, rate_hz: self.rate_hz, requests, samples, sent_ids })
    }
}

impl ImuSource {
    /// The word for its type in the configuration.
    #[must_use]
    pub const fn type_name(&self) -> &'static str {
        match self {
            Self::Simulated(_) => "simulated",
            Self::Serial(serial) => serial.protocol.name(),
            Self::Can(can) => can.device.protocol().name(),
            Self::External => "external",
        }
    }

    /// The serial line of the device, if it has one.
    #[must_use]
    pub const fn serial(&self) -> Option<&ImuSerial> {
        if let Self::Serial(serial) = self { Some(serial) } else { None }
    }

    /// The place of the device on a CAN bus, if it is there.
    #[must_use]
    pub const fn can(&self) -> Option<&ImuCan> {
        if let Self::Can(can) = self { Some(can) } else { None }
    }
}

/// A device on a CAN bus.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuCan {
    /// Index of its bus.
    pub bus: usize,
    /// Its protocol and its ids.
    pub device: CanDevice,
    /// The errors of the device that `motord-sim` or a simulated bus has in its place.
    pub simulation: ImuSimulation,
}

impl ImuCan {
    /// The cycles from one request to the next; 1 for a rate of at least that of the cycle.
    #[must_use]
    pub fn every(rate_hz: f64, cycle_rate_hz: f64) -> u32 {
        (cycle_rate_hz / rate_hz).round().max(1.0) as u32
    }
}

/// A device on a serial line, which sends samples without a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImuSerial {
    /// Its protocol.
    pub protocol: SerialProtocol,
    /// Path of the device, such as `/dev/ttyUSB0`.
    pub device: String,
    /// Bit/s.
    pub baud: u32,
}

impl ImuSerial {
    /// Bytes in a second at this rate, at least.
    #[must_use]
    pub fn bytes_per_second(&self, rate_hz: f64) -> f64 {
        rate_hz * self.protocol.sample_len() as f64
    }

    /// Part of the line that these bytes take, 1 for all of it.
    #[must_use]
    pub fn utilisation(&self, rate_hz: f64) -> f64 {
        rate_hz / self.protocol.rate_hz_max(self.baud)
    }
}

/// `[imu.simulation]`: the errors of a simulated IMU.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuSimulation {
    /// Standard deviation of each axis of the angular velocity, rad/s; of the acceleration it is
    /// ten times as much, m/s².
    pub noise: f64,
    /// Constant error of each axis of the angular velocity, rad/s.
    pub bias: f64,
    /// Age of a sample when it is received.
    pub delay: Duration,
    /// Seed of everything that is random in it.
    pub seed: u64,
}

impl ImuSimulation {
    /// A sensor without errors.
    pub const PERFECT: Self = Self { noise: 0.0, bias: 0.0, delay: Duration::ZERO, seed: 0 };
}

/// The reaction to the loss of an IMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhenLost {
    /// The state and the log report it. The default.
    Report,
    /// Every group is stopped, and none can be enabled.
    Stop,
}

/// A sample, in the frame of the sensor or of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// Unit quaternion w, x, y, z to the world.
    pub orientation: [f32; 4],
    /// Specific force, m/s²: at rest 9.81 upwards.
    pub acceleration: [f32; 3],
    /// rad/s.
    pub angular_velocity: [f32; 3],
    /// °C, where the sensor reports it.
    pub temperature: Option<f32>,
}

impl ImuSample {
    /// A body at rest and level.
    pub const LEVEL: Self = Self {
        orientation: [1.0, 0.0, 0.0, 0.0],
        angular_velocity: [0.0; 3],
        acceleration: [0.0, 0.0, 9.81],
        temperature: None,
    };

    /// Returns the quantities of a device's sample; `None` when one is missing.
    #[must_use]
    pub fn of(sample: &Sample) -> Option<Self> {
        Some(Self {
            orientation: sample.orientation.map(Quaternion::parts)?,
            angular_velocity: sample.angular_velocity?,
            acceleration: sample.acceleration?,
            temperature: sample.temperature_celsius,
        })
    }

    /// Returns the sample with an orientation of norm 1. `None` when a value is not finite, or the
    /// norm of the orientation is not 0.99 to 1.01. A temperature that is not finite is left out.
    #[must_use]
    pub fn checked(&self) -> Option<Self> {
        let orientation = Quaternion::new(self.orientation).ok()?.parts();
        let mut values = self.angular_velocity.iter().chain(&self.acceleration);
        let temperature = self.temperature.filter(|value| value.is_finite());
        values.all(|value| value.is_finite()).then_some(Self { orientation, temperature, ..*self })
    }
}

/// The rotation from the frame of the sensor to that of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mount(Quaternion);

impl Mount {
    /// The sensor has the axes of the body.
    pub const ALIGNED: Self = Self(Quaternion { w: 1.0, x: 0.0, y: 0.0, z: 0.0 });

    /// The sensor is turned against the body by `roll`, `pitch` and `yaw`, rad, about x, y and z of
    /// the body, in this order.
    #[must_use]
    pub fn from_roll_pitch_yaw([roll, pitch, yaw]: [f64; 3]) -> Self {
        let turn = |angle: f64, axis: usize| {
            let mut parts = [(angle / 2.0).cos() as f32, 0.0, 0.0, 0.0];
            parts[1 + axis] = (angle / 2.0).sin() as f32;
            Quaternion::from(parts)
        };
        Self(turn(yaw, 2).after(turn(pitch, 1)).after(turn(roll, 0)))
    }

    /// Returns the rotation from the sensor to the body, a unit quaternion w, x, y, z.
    #[must_use]
    pub const fn parts(&self) -> [f32; 4] {
        self.0.parts()
    }

    /// Returns the sample of a sensor in the frame of the body.
    #[must_use]
    pub fn to_body(&self, sample: &ImuSample) -> ImuSample {
        ImuSample {
            orientation: Quaternion::from(sample.orientation).after(self.0.inverse()).parts(),
            angular_velocity: self.0.rotate(sample.angular_velocity),
            acceleration: self.0.rotate(sample.acceleration),
            temperature: sample.temperature,
        }
    }

    /// Returns the sample in the frame of the sensor, of one in the frame of the body.
    #[must_use]
    pub fn to_sensor(&self, sample: &ImuSample) -> ImuSample {
        Self(self.0.inverse()).to_body(sample)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f32::consts::FRAC_PI_2;

    fn assert_near(found: &[f32], expected: &[f32]) {
        let is_near = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-5);
        assert!(is_near, "{found:?}, expected {expected:?}");
    }

    /// A sensor whose x points to the left of the robot.
    fn turned_left() -> Mount {
        Mount::from_roll_pitch_yaw([0.0, 0.0, f64::from(FRAC_PI_2)])
    }

    /// The roll, pitch and yaw, rad, of an orientation.
    fn roll_pitch_yaw(sample: &ImuSample) -> [f32; 3] {
        let [w, x, y, z] = sample.orientation;
        [
            f32::atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin(),
            f32::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        ]
    }

    #[test]
    fn mount_turns_vectors_into_body() {
        let sample = ImuSample { angular_velocity: [1.0, 2.0, 3.0], ..ImuSample::LEVEL };
        assert_eq!(Mount::ALIGNED.to_body(&sample), sample);
        // The sensor's x is the body's y, and the sensor's y the body's -x.
        assert_near(&turned_left().to_body(&sample).angular_velocity, &[-2.0, 1.0, 3.0]);
        // Upside down: the sensor measures gravity along -z.
        let mount = Mount::from_roll_pitch_yaw([core::f64::consts::PI, 0.0, 0.0]);
        let hanging = ImuSample {
            orientation: [0.0, 1.0, 0.0, 0.0],
            acceleration: [0.0, 0.0, -9.81],
            ..ImuSample::LEVEL
        };
        let body = mount.to_body(&hanging);
        assert_near(&body.acceleration, &[0.0, 0.0, 9.81]);
        assert_near(&roll_pitch_yaw(&body), &[0.0; 3]);
        let sensor = mount.to_sensor(&body);
        assert_near(&sensor.acceleration, &hanging.acceleration);
        assert_near(&sensor.orientation, &hanging.orientation);
    }

    /// The nose of the body goes down by 0.3 rad, about its y, which is the x of a sensor that is
    /// turned left.
    #[test]
    fn mount_turns_orientation_into_body() {
        let level = ImuSample {
            orientation: [(FRAC_PI_2 / 2.0).cos(), 0.0, 0.0, (FRAC_PI_2 / 2.0).sin()],
            ..ImuSample::LEVEL
        };
        assert_near(&roll_pitch_yaw(&turned_left().to_body(&level)), &[0.0; 3]);
        let about_x = Quaternion::from([f32::cos(0.15), f32::sin(0.15), 0.0, 0.0]);
        let tilted = Quaternion::from(level.orientation).after(about_x).parts();
        let body = turned_left().to_body(&ImuSample { orientation: tilted, ..level });
        assert_near(&roll_pitch_yaw(&body), &[0.0, 0.3, 0.0]);
    }

    #[test]
    fn unsound_samples_are_rejected() {
        let with = |orientation| ImuSample { orientation, ..ImuSample::LEVEL }.checked();
        assert_eq!(with([1.009, 0.0, 0.0, 0.0]), Some(ImuSample::LEVEL));
        assert_eq!(with([1.02, 0.0, 0.0, 0.0]), None);
        assert_eq!(with([0.0; 4]), None);
        assert_eq!(with([f32::NAN, 0.0, 0.0, 1.0]), None);
        assert_eq!(with([f32::MAX; 4]), None);
        let level = ImuSample::LEVEL;
        let spinning = ImuSample { angular_velocity: [0.0, f32::INFINITY, 0.0], ..level };
        assert_eq!(spinning.checked(), None);
        assert_eq!(ImuSample { acceleration: [f32::NAN; 3], ..level }.checked(), None);
        assert_eq!(ImuSample { temperature: Some(f32::NAN), ..level }.checked(), Some(level));
    }
}
