//! `motorctl imu level`: the mount of an IMU from the direction of gravity.

use crate::failure::Failure;
use crate::status;
use motord_client::Client;
use motord_terminal::{Interrupt, json, within};
use serde::Serialize;
use std::io::{self, Write};
use std::time::{Duration, Instant};

/// Fewer samples are no measurement.
const SAMPLES_MIN: usize = 10;
/// Fastest turn of a robot at rest, rad/s: the bias and noise of a gyroscope are less.
const TURN_MAX: f64 = 0.1;
/// Largest standard deviation of an axis of the acceleration at rest, m/s².
const SHAKE_MAX: f64 = 0.5;
/// Acceleration at rest, and its largest error, m/s².
const GRAVITY: f64 = 9.81;
const GRAVITY_ERROR: f64 = 0.5;
/// A larger correction suggests that the robot is not level, or the mount another one.
const DOUBTFUL_DEGREES: f64 = 20.0;

/// The options of `motorctl imu level`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Name of the IMU.
    #[arg(value_name = "IMU")]
    imu: String,
    /// Duration of the measurement, s: 0.5 to 60.
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = |text: &str| within(text, 0.5, 60.0))]
    seconds: f64,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// The measured mount.
#[derive(Debug, Serialize)]
struct Level<'a> {
    imu: &'a str,
    samples: usize,
    /// Angle between gravity and z of the body with the present mount, °.
    tilt_deg: f64,
    mount_rpy_deg: [f64; 3],
    /// The line for the configuration.
    line: String,
}

/// Samples of an IMU, in the frame of the body.
#[derive(Debug, Default)]
struct Samples {
    accelerations: Vec<[f64; 3]>,
    fastest: f64,
}

impl Samples {
    fn push(&mut self, acceleration: [f32; 3], velocity: [f32; 3]) {
        self.accelerations.push(acceleration.map(f64::from));
        self.fastest = self.fastest.max(norm(velocity.map(f64::from)));
    }

    fn mean(&self) -> [f64; 3] {
        let count = self.accelerations.len() as f64;
        [0, 1, 2].map(|axis| self.accelerations.iter().map(|sample| sample[axis]).sum::<f64>() / count)
    }

    /// The largest standard deviation of an axis.
    fn shake(&self) -> f64 {
        let (mean, count) = (self.mean(), self.accelerations.len() as f64);
        let variance = |axis: usize| {
            self.accelerations.iter().map(|sample| (sample[axis] - mean[axis]).powi(2)).sum::<f64>() / count
        };
        [0, 1, 2].map(variance).into_iter().fold(0.0, f64::max).sqrt()
    }

    /// Returns the mean acceleration at rest, or the reason for which there is none.
    fn at_rest(&self) -> Result<[f64; 3], String> {
        let count = self.accelerations.len();
        if count < SAMPLES_MIN {
            return Err(format!("only {count} samples arrived; measure longer: --seconds"));
        }
        if self.fastest > TURN_MAX {
            return Err(format!("the robot turns, at up to {:.2} rad/s; keep it at rest", self.fastest));
        }
        if self.shake() > SHAKE_MAX {
            return Err(format!("the robot shakes, by {:.2} m/s²; keep it at rest", self.shake()));
        }
        let strength = norm(self.mean());
        if (strength - GRAVITY).abs() > GRAVITY_ERROR {
            return Err(format!(
                "the acceleration is {strength:.2} m/s², and {GRAVITY} at rest; keep the robot at rest, or calibrate the sensor"
            ));
        }
        Ok(self.mean())
    }
}

/// Measures, and prints the mount.
pub(crate) fn run(instance: &str, arguments: &Arguments) -> Result<(), Failure> {
    let imu = arguments.imu.as_str();
    let client = status::connect(instance)?;
    let index = client.imu_named(imu)?;
    let mount = client.description().imus[index].mount.map(f64::from);
    let samples = measure(&client, index, arguments.seconds)?;
    let refused = |reason| Failure::Level { imu: imu.to_owned(), reason };
    let up = samples.at_rest().map_err(refused)?;
    let mount_rpy_deg = levelled(mount, up).ok_or_else(|| {
        refused("the present mount turns the sensor by 90° about y, where roll and yaw are one turn; set mount-rpy-deg by hand".into())
    })?;
    let [roll, pitch, yaw] = mount_rpy_deg;
    let level = Level {
        imu,
        samples: samples.accelerations.len(),
        tilt_deg: (up[2] / norm(up)).clamp(-1.0, 1.0).acos().to_degrees(),
        mount_rpy_deg,
        line: format!("mount-rpy-deg = [{roll}, {pitch}, {yaw}]"),
    };
    print(&level, arguments.json)
}

fn print(level: &Level<'_>, as_json: bool) -> Result<(), Failure> {
    let out = &mut io::stdout().lock();
    if as_json {
        return Ok(json::write_line(out, level)?);
    }
    let Level { imu, samples, tilt_deg, line, .. } = level;
    writeln!(out, "{line}")?;
    eprintln!(
        "{imu}: {samples} samples; with the present mount gravity is {tilt_deg:.2}° away from z of the body. Write the line into its \
         [[imu]] and start motord again."
    );
    if *tilt_deg > DOUBTFUL_DEGREES {
        eprintln!("{imu}: {tilt_deg:.0}° is much: is the robot level, and yaw of the mount right?");
    }
    Ok(())
}

/// Collects each sample once.
fn measure(client: &Client, imu: usize, seconds: f64) -> Result<Samples, Failure> {
    let interrupt = Interrupt::register();
    let end = Instant::now() + Duration::from_secs_f64(seconds);
    let (mut samples, mut newest) = (Samples::default(), 0);
    while Instant::now() < end {
        if interrupt.came() {
            return Err(Failure::Interrupted);
        }
        let state = client.wait(status::PATIENCE)?;
        let Some(sample) = state.imu(imu).filter(|sample| !sample.lost && sample.sequence != newest) else {
            continue;
        };
        newest = sample.sequence;
        if let (Some(acceleration), Some(velocity)) = (sample.acceleration(), sample.angular_velocity()) {
            samples.push(acceleration, velocity);
        }
    }
    Ok(samples)
}

fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Returns roll, pitch and yaw, °, of a mount with the yaw of `mount` that turns gravity onto z of the body. `up` is the specific
/// force in the frame of the body, by `mount`. `None` where the yaw of `mount` is not defined.
fn levelled([w, x, y, z]: [f64; 4], up: [f64; 3]) -> Option<[f64; 3]> {
    let rotation = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    if rotation[0][0].hypot(rotation[1][0]) < 1e-3 {
        return None;
    }
    let yaw = f64::atan2(rotation[1][0], rotation[0][0]);
    // The transposed rotation leads to the frame of the sensor.
    let [ux, uy, uz] = [0, 1, 2].map(|axis| (0..3).map(|row| rotation[row][axis] * up[row]).sum::<f64>());
    let (roll, pitch) = (f64::atan2(uy, uz), f64::atan2(-ux, uy.hypot(uz)));
    let hundredths = |angle: f64| (angle.to_degrees() * 100.0).round() / 100.0 + 0.0;
    Some([roll, pitch, yaw].map(hundredths))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The quaternion of a mount: roll about x, then pitch about y, then yaw about z of the body.
    fn mount(degrees: [f64; 3]) -> [f64; 4] {
        let [(sr, cr), (sp, cp), (sy, cy)] = degrees.map(|angle| (angle.to_radians() / 2.0).sin_cos());
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    }

    /// `vector` after the rotation, or after its opposite.
    fn turned([w, x, y, z]: [f64; 4], vector: [f64; 3]) -> [f64; 3] {
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let axis = [x, y, z];
        let first = cross(axis, vector);
        let second = cross(axis, first);
        [0, 1, 2].map(|part| vector[part] + 2.0 * (w * first[part] + second[part]))
    }

    /// A sensor with a true mount measures gravity; the daemon turns it by the configured mount.
    fn found(configured: [f64; 3], truth: [f64; 3]) -> Option<[f64; 3]> {
        let [w, x, y, z] = mount(truth);
        let sensor = turned([w, -x, -y, -z], [0.0, 0.0, GRAVITY]);
        levelled(mount(configured), turned(mount(configured), sensor))
    }

    #[test]
    fn roll_and_pitch_are_found_and_yaw_stays() {
        for (configured, truth) in [
            ([0.0, 0.0, 0.0], [3.0, -2.0, 0.0]),
            ([0.0, 0.0, 90.0], [-1.5, 4.0, 90.0]),
            ([180.0, 0.0, -45.0], [178.0, 1.0, -45.0]),
            ([90.0, 0.0, 30.0], [92.5, 0.5, 30.0]),
        ] {
            assert_eq!(found(configured, truth), Some(truth), "{configured:?}");
        }
        assert_eq!(found([0.0, 90.0, 0.0], [0.0, 88.0, 0.0]), None);
    }

    #[test]
    fn moving_robot_is_refused() {
        let rest = ([0.0, 0.0, 9.8], [0.01, 0.0, 0.0]);
        let with = |other: ([f32; 3], [f32; 3])| {
            let mut samples = Samples::default();
            (0..20).for_each(|turn| {
                let (acceleration, velocity) = if turn % 2 == 0 { rest } else { other };
                samples.push(acceleration, velocity);
            });
            samples
                .at_rest()
                .map(|_| ())
                .map_err(|reason| reason.split(',').next().unwrap_or_default().to_owned())
        };
        assert_eq!(with(rest), Ok(()));
        assert_eq!(with((rest.0, [0.0, 0.2, 0.0])), Err("the robot turns".to_owned()));
        assert_eq!(with(([1.5, 0.0, 9.8], rest.1)), Err("the robot shakes".to_owned()));
        assert_eq!(with(([0.0, 0.0, 11.0], rest.1)), Err("the robot shakes".to_owned()));
        assert!(Samples::default().at_rest().unwrap_err().starts_with("only 0 samples"));
    }
}
