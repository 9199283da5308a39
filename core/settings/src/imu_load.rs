//! The load that IMUs are for their CAN buses.

use crate::imu::{ImuCan, ImuSettings, ImuSource};
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
        let can = imu.source.can()?;
        let bitrate = settings.buses.get(can.bus)?.kind.bitrate();
        Some(Self {
            bus: can.bus,
            frames_per_second: can.device.frames().count() as f64 * imu.rate_hz,
            utilisation: utilisation(bits(can, worst_case_bits), imu.rate_hz, bitrate),
        })
    }
}

/// Returns the bits of the frames of a sample.
fn bits(can: &ImuCan, bits: fn(IdWidth, u32) -> u32) -> u32 {
    can.device.frames().map(|(_, bytes)| bits(IdWidth::Standard, bytes)).sum()
}

/// The frames of the IMUs of one CAN bus, for its plan.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct ImuFrames {
    /// Bits of requests and replies in a cycle that asks each IMU, every stuffing bit included.
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

impl ImuFrames {
    /// Returns the frames of the IMUs of `bus`.
    pub(crate) fn of(settings: &Settings, bus: usize) -> Self {
        let mut frames = Self::default();
        let imus = settings.imus.iter().filter_map(|imu| match &imu.source {
            ImuSource::Can(can) if can.bus == bus => Some((imu.rate_hz, can)),
            _ => None,
        });
        let mut unasked = Vec::new();
        for (rate_hz, can) in imus {
            let (worst, unstuffed) = (bits(can, worst_case_bits), bits(can, unstuffed_bits));
            if can.device.protocol().is_asked() {
                frames.asked_worst += worst;
                frames.asked_unstuffed += unstuffed;
                let expected = |bytes| expected_bits(IdWidth::Standard, bytes);
                let lengths: Vec<_> = can.device.frames().map(|(_, bytes)| expected(bytes)).collect();
                let (requests, replies) = lengths.split_at(lengths.len() / 2);
                frames.asked.extend(requests.iter().zip(replies).map(|(request, reply)| [*request, *reply]));
            } else {
                frames.sent_worst += f64::from(worst) * rate_hz;
                frames.sent_unstuffed += f64::from(unstuffed) * rate_hz;
                unasked.extend(can.device.frames());
            }
        }
        frames.blocking = blocking(settings, bus, &unasked);
        frames
    }
}

/// Returns the expected bits by which `frames`, sent at any time, delay the last reply of a cycle at most. A frame with a lower
/// id than a motor's wins the bus each time. Frames with a higher id delay it only if they are already on the wire: one before
/// the commands, and one more on a bus with a single motor, while it prepares its reply.
fn blocking(settings: &Settings, bus: usize, frames: &[(u16, u32)]) -> u32 {
    let motors = || settings.motors.iter().filter(|motor| motor.bus == bus);
    let last = motors()
        .map(MotorSettings::addresses)
        .flat_map(|ids| [ids.commands.highest(), ids.replies.highest()])
        .max();
    let Some(last) = last else { return 0 };
    let is_urgent = |frame: &&(u16, u32)| FrameId::new(frame.0).is_some_and(|id| id < last);
    let bits = |frame: &(u16, u32)| expected_bits(IdWidth::Standard, frame.1);
    let urgent: u32 = frames.iter().filter(is_urgent).map(bits).sum();
    let gaps = if motors().count() == 1 { 2 } else { 1 };
    let others = frames.iter().filter(|frame| !is_urgent(frame)).map(bits);
    let longest = others.clone().max().unwrap_or(0);
    urgent + (longest * gaps).min(others.sum())
}
