//! Publishing the samples of an external IMU.

use crate::handle::{ClientHandle, PublisherHandle, array, borrow, guarded, guarded_or, put_new, text};
use crate::status::{Failure, Status};
use motord_client::ImuSample;
use std::ffi::c_char;
use std::sync::Mutex;

/// A measurement of an IMU, in the frame of the sensor: the daemon applies `mount-rpy-deg`.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct SampleValues {
    /// Orientation of the sensor in the world, whose z points up: a unit quaternion w, x, y, z, within 1 %.
    pub orientation: [f64; 4],
    /// Angular velocity, rad/s.
    pub angular_velocity: [f64; 3],
    /// Specific force, m/s²: at rest 9.81 upwards.
    pub acceleration: [f64; 3],
    /// Temperature of the sensor, °C; NaN for none.
    pub temperature: f64,
    /// Time of the measurement, ns of `CLOCK_MONOTONIC`; 0 for now. It must increase, and may not be older than `lost-after-ms`.
    pub time_ns: u64,
}

impl From<&SampleValues> for ImuSample {
    fn from(values: &SampleValues) -> Self {
        Self {
            orientation: values.orientation.map(|value| value as f32),
            angular_velocity: values.angular_velocity.map(|value| value as f32),
            acceleration: values.acceleration.map(|value| value as f32),
            temperature: Some(values.temperature as f32).filter(|value| !value.is_nan()),
            time_ns: values.time_ns,
        }
    }
}

/// Begins to publish the samples of the external IMU `name`. The publisher survives a restart of the daemon. The daemon uses the samples
/// of one publisher; another one may begin when none of them was used for `lost-after-ms`. Free it with `motord_imu_publisher_free`.
///
/// # Safety
/// `client` is a client, `name` a text that ends with a null byte; `publisher` leads to a place for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_imu_publisher_new(
    client: *mut ClientHandle,
    name: *const c_char,
    publisher: *mut *mut PublisherHandle,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let client = unsafe { borrow(client) }?;
        // SAFETY: by the contract of this function.
        let name = unsafe { text(name) }?;
        let make = || Ok(PublisherHandle(Mutex::new(Some(client.client.publish_imu(name)?))));
        // SAFETY: by the contract of this function.
        unsafe { put_new(publisher, make) }
    })
}

/// Frees a publisher. Null is no error.
///
/// # Safety
/// `publisher` is null, or a publisher that is no longer in use.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_imu_publisher_free(publisher: *mut PublisherHandle) {
    // SAFETY: by the contract of this function.
    unsafe { crate::handle::free(publisher) }
}

/// Sends a sample. Does not wait. `MOTORD_STATUS_BAD_SETPOINT`: a value is not finite, the orientation is no unit quaternion, or
/// the time is of another clock. `MOTORD_STATUS_REFUSED`: the daemon uses the samples of another process.
/// `MOTORD_STATUS_NOT_RUNNING`: without a daemon; later samples arrive once one runs again.
///
/// # Safety
/// `publisher` is a publisher, `sample` a sample.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_imu_publisher_send(
    publisher: *mut PublisherHandle,
    sample: *const SampleValues,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let (publisher, sample) = (unsafe { borrow(publisher) }?, unsafe { array(sample, 1) }?);
        let null = || Failure::bad_argument("the sample is a null pointer");
        let sample = ImuSample::from(sample.and_then(<[_]>::first).ok_or_else(null)?);
        publisher.with(|publisher| Ok(publisher.send(&sample)?))
    })
}

/// Returns true if the daemon used a sample of this publisher last, by the newest state.
///
/// # Safety
/// `publisher` is a publisher.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_imu_publisher_is_used(publisher: *mut PublisherHandle) -> bool {
    // SAFETY: by the contract of this function.
    let publisher = unsafe { borrow(publisher) };
    let is_used = || publisher.and_then(|publisher| publisher.with(|publisher| Ok(publisher.is_used())));
    guarded_or(false, || is_used().unwrap_or(false))
}
