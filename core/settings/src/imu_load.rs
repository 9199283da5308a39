//! The load that sensors are for their CAN buses.

use crate::sensor::SensorFrames;
use crate::sensor::imu::ImuSettings;
use crate::settings::{MotorSettings, Settings};
use motord_bus::FrameId;
use motord_bus::arithmetic::{IdWidth, expected_bits, unstuffed_bits, utilisation, worst_case_bits};

/// The load that an IMU is for its bus.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuLoad {
    /// Index of its bus.
    pub bus: usize,
    /// Frames in a second.
    pub frames_per_second: f64,
    /// Part of the bus that they take, every stuffing bit included.
    pub utilisation: f64,
}

impl ImuLoad {
    /// Returns the load of an IMU; `None` for one that is not on a CAN bus.
    #[must_use]
    pub fn of(settings: &Settings, imu: &ImuSettings) -> Option<Self> {
        let SensorFrames { bus, rate_hz, requests, samples, .. } = imu.frames()?;
        let bitrate = settings.buses.get(bus)?.kind.bitrate();
        let frames = || requests.iter().chain(&samples);
        let bits = frames().map(|frame| bits_of(frame, worst_case_bits)).sum();
        Some(Self {
            bus,
            frames_per_second: frames().count() as f64 * rate_hz,
            utilisation: utilisation(bits, rate_hz, bitrate),
        })
    }
}

/// Returns the bits of a frame with ids of this width and this number of bytes.
type Bits = fn(IdWidth, u32) -> u32;

/// Returns the bits of a frame with this id and this number of bytes.
fn bits_of((id, bytes): &(FrameId, u32), bits: Bits) -> u32 {
    bits(if id.is_extended() { IdWidth::Extended } else { IdWidth::Standard }, *bytes)
}

/// The frames of the sensors of one CAN bus, for its plan.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct SensorLoad {
    /// Bits of requests and replies in a cycle that asks each sensor, every stuffing bit included.
    pub(crate) asked_worst: u32,
    /// The same without stuffing bits.
    pub(crate) asked_unstuffed: u32,
    /// Expected bits of each request, and of its reply.
    pub(crate) asked: Vec<[u32; 2]>,
    /// Bits in a second of frames without a request, every stuffing bit included.
    pub(crate) sent_worst: f64,
    /// The same without stuffing bits.
    pub(crate) sent_unstuffed: f64,
    /// Expected bits by which frames without a request delay the last reply at most.
    pub(crate) blocking: u32,
}

impl SensorLoad {
    /// Returns the frames of the sensors of `bus`.
    pub(crate) fn of(settings: &Settings, bus: usize) -> Self {
        let mut load = Self::default();
        let mut unasked = Vec::new();
        for SensorFrames { rate_hz, requests, samples, .. } in settings.sensors.on_bus(bus) {
            let frames = || requests.iter().chain(&samples);
            let sum = |bits: Bits| frames().map(|frame| bits_of(frame, bits)).sum::<u32>();
            let (worst, unstuffed) = (sum(worst_case_bits), sum(unstuffed_bits));
            if requests.is_empty() {
                load.sent_worst += f64::from(worst) * rate_hz;
                load.sent_unstuffed += f64::from(unstuffed) * rate_hz;
                unasked.extend(samples);
            } else {
                load.asked_worst += worst;
                load.asked_unstuffed += unstuffed;
                let expected = |frame| bits_of(frame, expected_bits);
                let pairs = requests.iter().zip(&samples);
                load.asked.extend(pairs.map(|(request, sample)| [expected(request), expected(sample)]));
            }
        }
        load.blocking = blocking(settings, bus, &unasked);
        load
    }
}

/// Returns the expected bits by which `frames`, sent at any time, delay the last reply of a cycle
/// at most. A frame with a lower id than a motor's wins the bus each time. Frames with a higher id
/// delay it only if they are already on the wire: one before the commands, and one more on a bus
/// with a single motor, while it prepares its reply.
fn blocking(settings: &Settings, bus: usize, frames: &[(FrameId, u32)]) -> u32 {
    let motors = || settings.motors.iter().filter(|motor| motor.bus == bus);
    let last = motors()
        .map(MotorSettings::addresses)
        .flat_map(|ids| [ids.commands.highest(), ids.replies.highest()])
        .max();
    let Some(last) = last else { return 0 };
    let is_urgent = |frame: &&(FrameId, u32)| frame.0 < last;
    let bits = |frame: &(FrameId, u32)| bits_of(frame, expected_bits);
    let urgent: u32 = frames.iter().filter(is_urgent).map(bits).sum();
    let gaps = if motors().count() == 1 { 2 } else { 1 };
    let others = frames.iter().filter(|frame| !is_urgent(frame)).map(bits);
    let longest = others.clone().max().unwrap_or(0);
    urgent + (longest * gaps).min(others.sum())
}
