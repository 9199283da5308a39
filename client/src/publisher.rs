//! Publishing the samples of an external IMU.

use crate::error::Error;
use crate::link::Connection;
use motord_ports::{ForkGuard, ImuSender, clock};
use motord_shared::description::RobotDescription;
use motord_shared::message::ImuMessage;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher as _, Hasher as _};
use std::sync::Arc;

/// A sample may be dated this much after now, ns.
const FUTURE_MAX_NS: u64 = 1_000_000;
/// This many samples in a row that are too old are of an unfit clock; fewer may be late.
const OLD_MAX: u32 = 10;

/// Norms of an orientation that count as rounded.
const NORM: core::ops::RangeInclusive<f32> = 0.99..=1.01;

/// A measurement of an IMU, in the frame of the sensor: the daemon applies `mount-rpy-deg`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// Orientation of the sensor in the world, whose z points up: a unit quaternion w, x, y, z,
    /// within 1 %.
    pub orientation: [f32; 4],
    /// Angular velocity, rad/s.
    pub angular_velocity: [f32; 3],
    /// Specific force, m/s²: at rest 9.81 upwards.
    pub acceleration: [f32; 3],
    /// Temperature of the sensor, °C.
    pub temperature: Option<f32>,
    /// Time of the measurement, ns of `CLOCK_MONOTONIC`; 0 for now. It must increase, and may not
    /// be older than `lost-after-ms`.
    pub time_ns: u64,
}

/// Publishes the samples of an external IMU. It survives a restart of the daemon.
///
/// The daemon uses the samples of one publisher. Another one may begin when none of them was used
/// for `lost-after-ms`.
#[derive(Debug)]
pub struct ImuPublisher {
    link: Arc<Connection>,
    port: ForkGuard<ImuSender>,
    name: String,
    message: ImuMessage,
    /// Longest age of a sample that the daemon uses, ns; 0 when unknown.
    lost_after_ns: u64,
    /// Samples in a row that were older.
    old: u32,
}

impl ImuPublisher {
    pub(crate) fn new(link: Arc<Connection>, name: &str) -> Result<Self, Error> {
        link.check_process()?;
        let (imu, lost_after_ns) = external(&link.robot(), name)?;
        let boot_id = link.boot_id();
        let port = link.imu_sender()?;
        let message = ImuMessage { boot_id, publisher: number(), imu, ..ImuMessage::default() };
        Ok(Self { link, port, name: name.to_owned(), message, lost_after_ns, old: 0 })
    }

    /// Sends a sample. Does not wait. Allocates nothing after the first samples.
    ///
    /// # Errors
    /// [`Error::BadSample`]; [`Error::SampleTime`] for a time of another clock: more than 1 ms
    /// after now, or older than `lost-after-ms` for the tenth time in a row;
    /// [`Error::OtherPublisher`] while the daemon uses the samples of another process: this one was
    /// sent, and rejected; [`Error::UnknownImu`] or [`Error::NotExternal`] when the daemon was
    /// started again with another configuration; [`Error::NotRunning`] or [`Error::Silent`] without
    /// a daemon: later samples arrive once it runs again.
    pub fn send(&mut self, sample: &ImuSample) -> Result<(), Error> {
        if !is_sound(sample) {
            return Err(Error::BadSample { imu: self.name.clone() });
        }
        self.link.refresh()?;
        self.follow_restart()?;
        let time_ns = self.checked_time(sample.time_ns)?;
        self.message.sequence += 1;
        self.message.time_ns = time_ns;
        self.message.orientation = sample.orientation;
        self.message.angular_velocity = sample.angular_velocity;
        self.message.acceleration = sample.acceleration;
        self.message.temperature = sample.temperature.unwrap_or(f32::NAN);
        let sent = self.port.get()?.send(&self.message);
        sent.map_err(|error| Error::of_service(error, self.link.instance()))?;
        self.link.check_alive()?;
        self.check_publisher()
    }

    /// Returns `true` if the daemon used a sample of this publisher last, by the newest state.
    #[must_use]
    pub fn is_used(&self) -> bool {
        // Without a check, a forked process would read the last state before the fork.
        if self.port.get().is_err() {
            return false;
        }
        let imu = self.link.try_imu(self.message.imu as usize);
        imu.is_some_and(|imu| !imu.lost && imu.publisher == self.message.publisher)
    }

    /// Returns a time of `CLOCK_MONOTONIC`; now for 0.
    fn checked_time(&mut self, time_ns: u64) -> Result<u64, Error> {
        let now_ns = clock::now_ns();
        let time_ns = if time_ns == 0 { now_ns } else { time_ns };
        let is_old = self.lost_after_ns > 0 && now_ns.saturating_sub(time_ns) > self.lost_after_ns;
        self.old = if is_old { self.old.saturating_add(1) } else { 0 };
        if time_ns <= now_ns.saturating_add(FUTURE_MAX_NS) && self.old < OLD_MAX {
            return Ok(time_ns);
        }
        let offset_ns = i64::try_from(i128::from(time_ns) - i128::from(now_ns)).unwrap_or(i64::MAX);
        Err(Error::SampleTime { imu: self.name.clone(), offset_ns, clock: clock::other_clock(time_ns) })
    }

    /// Finds the IMU again after a restart of the daemon: its index may have changed.
    fn follow_restart(&mut self) -> Result<(), Error> {
        let boot_id = self.link.boot_id();
        if boot_id != self.message.boot_id {
            (self.message.imu, self.lost_after_ns) = external(&self.link.robot(), &self.name)?;
            self.message.boot_id = boot_id;
        }
        Ok(())
    }

    fn check_publisher(&self) -> Result<(), Error> {
        let imu = self.link.try_imu(self.message.imu as usize);
        let other = imu.filter(|imu| !imu.lost && imu.publisher != self.message.publisher);
        other.map_or(Ok(()), |imu| {
            let process = u32::try_from(imu.publisher >> 32).unwrap_or(0);
            Err(Error::OtherPublisher { imu: self.name.clone(), process })
        })
    }
}

/// Returns the index of the IMU `name`.
pub(crate) fn imu_of(robot: &RobotDescription, name: &str) -> Result<usize, Error> {
    let unknown = || {
        let names: Vec<_> = robot.imus.iter().map(|imu| imu.name.as_str()).collect();
        let known = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        Error::UnknownImu { name: name.to_owned(), known }
    };
    robot.imus.iter().position(|imu| imu.name == name).ok_or_else(unknown)
}

/// Returns the index of the external IMU `name`, and the longest age of its samples, ns.
fn external(robot: &RobotDescription, name: &str) -> Result<(u32, u64), Error> {
    let index = imu_of(robot, name)?;
    let source_type = &robot.imus[index].source;
    if source_type != "external" {
        return Err(Error::NotExternal { imu: name.to_owned(), source_type: source_type.clone() });
    }
    Ok((index as u32, (robot.imus[index].lost_after * 1e9) as u64))
}

/// Returns the process id in the bits 63..32 and a random number: the standard library's seed for
/// hash maps is random.
fn number() -> u64 {
    let random = RandomState::new().build_hasher().finish() & u64::from(u32::MAX);
    u64::from(std::process::id()) << 32 | random
}

fn is_sound(sample: &ImuSample) -> bool {
    let ImuSample { orientation, angular_velocity, acceleration, .. } = sample;
    let norm = orientation.iter().map(|part| part * part).sum::<f32>().sqrt();
    NORM.contains(&norm) && angular_velocity.iter().chain(acceleration).all(|value| value.is_finite())
}
