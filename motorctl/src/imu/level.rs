//! `motorctl imu level`: the mount of an IMU from the direction of gravity.

use crate::failure::Failure;
use crate::imu_report::sentences;
use crate::status;
use motord_client::{Client, ImuContradiction};
use motord_terminal::{Interrupt, json, within};
use serde::Serialize;
use std::io::{self, Write};
use std::ops::RangeInclusive;
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
/// A sensor whose x is closer to the vertical, °, has a roll and a yaw that noise decides.
const VERTICAL_DEGREES: f64 = 10.0;
/// Angle between the two poses of `--two-poses`, °.
const SECOND_POSE_DEGREES: RangeInclusive<f64> = 20.0..=70.0;
/// Longest wait for the second pose.
const SECOND_POSE_TIME: Duration = Duration::from_secs(120);
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
    /// Also measure a second pose, with the nose lowered by 20° to 70°: it shows the yaw of the mount, and is needed where the
    /// sensor's x points up or down.
    #[arg(long)]
    two_poses: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// The measured mount.
#[derive(Debug, Serialize)]
struct Level<'a> {
    /// The IMU.
    imu: &'a str,
    /// Samples that were measured.
    samples: usize,
    /// Angle between gravity and z of the body with the present mount, °.
    tilt_deg: f64,
    /// Roll, pitch and yaw of the mount, °. Yaw is that of the present mount, or measured with
    /// `--two-poses`.
    mount_rpy_deg: [f64; 3],
    /// The line for the configuration.
    line: String,
}

/// Samples of an IMU, in the frame of the body.
#[derive(Debug, Default)]
struct Samples {
    accelerations: Vec<[f64; 3]>,
    fastest: f64,
    /// Those of the newest sample.
    contradictions: Vec<ImuContradiction>,
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
        if !self.contradictions.is_empty() {
            let names: Vec<_> = self.contradictions.iter().map(|found| found.name()).collect();
            return Err(format!(
                "its quaternion and its acceleration contradict gravity ({}). {} See `motorctl explain imu-contradicts`",
                names.join(", "),
                sentences(&names)
            ));
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
    let interrupt = Interrupt::register();
    let samples = measure(&client, index, arguments.seconds, &interrupt)?;
    let refused = |reason| Failure::Level { imu: imu.to_owned(), reason };
    let up = samples.at_rest().map_err(refused)?;
    let mount_rpy_deg = if arguments.two_poses {
        let lowered = second_pose(&client, index, arguments, up, &interrupt)?;
        of_two_poses(mount, up, lowered)
    } else {
        levelled(mount, up).ok_or_else(|| {
            refused(format!(
                "the sensor's x points up or down, within {VERTICAL_DEGREES}°: there roll and yaw are one turn, and noise decides them. \
                 Measure a second pose as well: `motorctl imu level {imu} --two-poses`"
            ))
        })?
    };
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

/// Waits until the robot rests with its nose lowered. Returns its mean acceleration.
fn second_pose(
    client: &Client,
    index: usize,
    arguments: &Arguments,
    up: [f64; 3],
    interrupt: &Interrupt,
) -> Result<[f64; 3], Failure> {
    let Arguments { imu, seconds, .. } = arguments;
    let [least, most] = [SECOND_POSE_DEGREES.start(), SECOND_POSE_DEGREES.end()];
    eprintln!(
        "{imu}: level pose measured. Now lower the nose of the robot by {least}° to {most}°, and keep it at rest."
    );
    let end = Instant::now() + SECOND_POSE_TIME;
    loop {
        let found = measure(client, index, *seconds, interrupt)?.at_rest();
        let reason = match found {
            Ok(lowered) if SECOND_POSE_DEGREES.contains(&angle(up, lowered)) => return Ok(lowered),
            Ok(lowered) => format!("the second pose is {:.0}° from the first", angle(up, lowered)),
            Err(reason) => reason,
        };
        if Instant::now() > end {
            return Err(Failure::Level { imu: imu.clone(), reason });
        }
    }
}

/// Returns the angle between two vectors, °.
fn angle(one: [f64; 3], other: [f64; 3]) -> f64 {
    let dot = one.iter().zip(other).map(|(one, other)| one * other).sum::<f64>();
    (dot / (norm(one) * norm(other))).clamp(-1.0, 1.0).acos().to_degrees()
}

/// Collects each sample once.
fn measure(client: &Client, imu: usize, seconds: f64, interrupt: &Interrupt) -> Result<Samples, Failure> {
    let end = Instant::now() + Duration::from_secs_f64(seconds);
    let (mut samples, mut newest) = (Samples::default(), 0);
    while Instant::now() < end {
        if interrupt.is_raised() {
            return Err(Failure::Interrupted);
        }
        let state = client.wait(status::TIMEOUT)?;
        let Some(sample) = state.imu(imu).filter(|sample| !sample.lost && sample.sequence != newest) else {
            continue;
        };
        newest = sample.sequence;
        if let (Some(acceleration), Some(velocity)) = (sample.acceleration(), sample.angular_velocity()) {
            samples.push(acceleration, velocity);
        }
        samples.contradictions = sample.contradictions().collect();
    }
    Ok(samples)
}

fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Returns roll, pitch and yaw, °, of a mount with the yaw of `mount` that turns gravity onto z of the body. `up` is the specific
/// force in the frame of the body, by `mount`. `None` where the yaw of `mount` is not defined, or the sensor's x is nearly vertical.
fn levelled(mount: [f64; 4], up: [f64; 3]) -> Option<[f64; 3]> {
    let rotation = matrix(mount);
    if rotation[0][0].hypot(rotation[1][0]) < 1e-3 {
        return None;
    }
    let yaw = f64::atan2(rotation[1][0], rotation[0][0]);
    let [ux, uy, uz] = to_sensor(rotation, up);
    if uy.hypot(uz) < VERTICAL_DEGREES.to_radians().sin() * norm(up) {
        return None;
    }
    let (roll, pitch) = (f64::atan2(uy, uz), f64::atan2(-ux, uy.hypot(uz)));
    Some(degrees([roll, pitch, yaw]))
}

/// Returns roll, pitch and yaw, °, of the mount that turns `up`, measured in the level pose, onto z of the body, and `up` × `lowered`,
/// measured with the nose lowered, onto -y. Both are specific forces in the frame of the body, by `mount`, and not parallel.
fn of_two_poses(mount: [f64; 4], up: [f64; 3], lowered: [f64; 3]) -> [f64; 3] {
    let rotation = matrix(mount);
    let unit = |vector: [f64; 3]| vector.map(|part| part / norm(vector));
    let z = unit(to_sensor(rotation, up));
    let y = unit(cross(to_sensor(rotation, lowered), z));
    let x = cross(y, z);
    // The axes of the body in the frame of the sensor are the rows of the mount.
    let pitch = f64::atan2(-z[0], x[0].hypot(y[0]));
    if x[0].hypot(y[0]) < 1e-3 {
        // Roll and yaw are one turn: all of it is yaw.
        return degrees([0.0, pitch, f64::atan2(-x[1], y[1])]);
    }
    degrees([f64::atan2(z[1], z[2]), pitch, f64::atan2(y[0], x[0])])
}

/// The matrix of a unit quaternion.
fn matrix([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Turns a vector of the body into the frame of the sensor, by the transposed matrix of the mount.
fn to_sensor(rotation: [[f64; 3]; 3], vector: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| (0..3).map(|row| rotation[row][axis] * vector[row]).sum::<f64>())
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Degrees, rounded to hundredths.
fn degrees(angles: [f64; 3]) -> [f64; 3] {
    angles.map(|angle| (angle.to_degrees() * 100.0).round() / 100.0 + 0.0)
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

    /// There noise of 0.05 m/s² turned the roll by any angle.
    #[test]
    fn one_pose_decides_nothing_near_vertical_axis() {
        for pitch in [80.5, 85.0, 90.0, -90.0, -81.0] {
            assert_eq!(found([0.0; 3], [3.0, pitch, 0.0]), None, "{pitch}");
        }
        assert_eq!(found([0.0; 3], [3.0, 79.0, 0.0]), Some([3.0, 79.0, 0.0]));
    }

    /// The mount that is found turns the forces of both poses into the frame of the body.
    #[test]
    fn two_poses_find_the_whole_mount() {
        let lower = mount([0.0, 40.0, 0.0]);
        for truth in [
            [0.0, 90.0, 0.0],
            [0.0, -90.0, 30.0],
            [3.0, 88.0, -20.0],
            [0.0, 0.0, 90.0],
            [178.0, 1.0, -45.0],
            [10.0, -20.0, 135.0],
        ] {
            for configured in [[0.0; 3], [0.0, 90.0, 0.0], [180.0, 0.0, 45.0]] {
                let opposite = |[w, x, y, z]: [f64; 4]| [w, -x, -y, -z];
                let body = [[0.0, 0.0, GRAVITY], turned(opposite(lower), [0.0, 0.0, GRAVITY])];
                let measured =
                    body.map(|force| turned(mount(configured), turned(opposite(mount(truth)), force)));
                let found = of_two_poses(mount(configured), measured[0], measured[1]);
                for vector in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
                    let [right, is] = [truth, found].map(|angles| turned(mount(angles), vector));
                    let error =
                        right.iter().zip(is).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max);
                    assert!(error < 1e-3, "{truth:?} {configured:?}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn contradicting_sensor_is_refused() {
        let mut samples = Samples { contradictions: vec![ImuContradiction::ZDown], ..Samples::default() };
        (0..20).for_each(|_| samples.push([0.0, 0.0, -9.81], [0.0; 3]));
        assert!(samples.at_rest().unwrap_err().contains("contradict gravity (z-down)"));
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
