//! Simulated IMUs on a CAN bus: a HiPNUC with CANopen, and Damiao's DM-IMU-L1.
//!
//! Written from the vendors' documents, without the decoders of the host.

use crate::fault::{Fault, InjectError};
use crate::imu::{Imu, ImuOutput, ImuValues};
use motord_bus::{Duration, Frame, FrameId, Instant};

/// 1 G of a HiPNUC, m/s² (SDK, `hipnuc_sample.h`).
const HIPNUC_G: f64 = 9.8;
/// Ends of the codes of a DM-IMU-L1: rad/s, and m/s² up to firmware 1022 and from 1023 on.
const DAMIAO_VELOCITY: f64 = 34.88;
const DAMIAO_ACCELERATION: [f64; 2] = [58.8, 235.2];
/// Time from a request to a DM-IMU-L1 to its reply. No document states it.
const REPLY_LATENCY: Duration = Duration::from_micros(50);
/// Id of the requests to every DM-IMU-L1 up to firmware 1022.
const DAMIAO_SHARED_ID: u16 = 0x6FF;
/// Most frames of a sample.
const FRAMES: usize = 4;

/// A simulated IMU on a CAN bus.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuNodeSettings {
    /// The name that fault verbs use for it.
    pub name: String,
    /// The device.
    pub device: ImuNodeDevice,
    /// Standard deviation of each axis of the angular velocity, rad/s.
    pub noise: f64,
    /// Constant error of each axis of the angular velocity, rad/s.
    pub bias: f64,
    /// Age of a sample when it is sent.
    pub delay: Duration,
    /// Seed of its noise.
    pub seed: u64,
}

/// The kind of a simulated IMU on a CAN bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImuNodeDevice {
    /// Sends four TPDOs per period.
    Hipnuc {
        /// CANopen node.
        node: u8,
        /// Time between two samples.
        period: Duration,
    },
    /// Answers requests.
    Damiao {
        /// Version of the firmware.
        firmware: u16,
        /// Its id.
        id: u16,
        /// Id of its replies.
        reply_id: u16,
    },
}

/// A simulated IMU on a CAN bus.
#[derive(Debug, Clone)]
pub(crate) struct ImuNode {
    name: String,
    device: ImuNodeDevice,
    imu: Imu,
    begun: Instant,
    /// The next sample of a device that sends by itself.
    due: Instant,
    is_stopped: bool,
    /// The sample whose quantities a DM-IMU-L1 sends.
    latched: Option<ImuValues>,
}

impl ImuNode {
    pub(crate) fn new(settings: &ImuNodeSettings) -> Self {
        let ImuNodeSettings { name, device, noise, bias, delay, seed } = settings.clone();
        let imu = Imu::new(noise, bias, delay, seed);
        let (begun, due) = (Instant::ZERO, Instant::FAR_FUTURE);
        Self { name, device, imu, begun, due, is_stopped: false, latched: None }
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn inject(&mut self, fault: Fault) -> Result<(), InjectError> {
        self.imu.inject(fault)
    }

    /// Gets power at `now`.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.begun = now;
        if let ImuNodeDevice::Hipnuc { period, .. } = self.device {
            self.due = now + period;
        }
    }

    /// Returns the time of its next frames that need no request.
    pub(crate) const fn due(&self) -> Instant {
        self.due
    }

    /// Returns the shortest time from a request to its reply; `None` for a device that sends by itself.
    pub(crate) const fn latency(&self) -> Option<Duration> {
        match self.device {
            ImuNodeDevice::Hipnuc { .. } => None,
            ImuNodeDevice::Damiao { .. } => Some(REPLY_LATENCY),
        }
    }

    /// Returns the id of frames that it obeys.
    #[cfg(feature = "bridge")]
    pub(crate) fn address(&self) -> Option<FrameId> {
        FrameId::new(match self.device {
            ImuNodeDevice::Hipnuc { .. } => 0,
            ImuNodeDevice::Damiao { firmware: 0..=1022, .. } => DAMIAO_SHARED_ID,
            ImuNodeDevice::Damiao { id, .. } => id,
        })
    }

    /// Returns the frames that are due, and the time since when. Advances to the next ones.
    pub(crate) fn emit(&mut self) -> (Instant, [Option<Frame>; FRAMES]) {
        let ImuNodeDevice::Hipnuc { node, period } = self.device else { return (self.due, [None; FRAMES]) };
        let at = self.due;
        self.due = at + period;
        if self.is_stopped {
            return (at, [None; FRAMES]);
        }
        match self.imu.sample(at.since(self.begun)) {
            ImuOutput::Sample(values) => (at, tpdos(node, &values).map(Some)),
            ImuOutput::Nothing | ImuOutput::Gone => (at, [None; FRAMES]),
        }
    }

    /// Takes a complete frame of another node. Returns the reply, and the time that passes before it.
    pub(crate) fn hear(&mut self, at: Instant, frame: &Frame) -> Option<(Duration, Frame)> {
        match self.device {
            ImuNodeDevice::Hipnuc { node, .. } => {
                self.obey(node, frame);
                None
            }
            ImuNodeDevice::Damiao { firmware, id, reply_id } => {
                let register = asked(firmware, id, frame)?;
                Some((REPLY_LATENCY, self.answer(at, firmware, reply_id, register)?))
            }
        }
    }

    /// NMT commands (user manual: 01 starts, 02 stops; node 0 is every node).
    fn obey(&mut self, node: u8, frame: &Frame) {
        if frame.id().raw() != 0 {
            return;
        }
        match frame.payload() {
            [1, to] if *to == node || *to == 0 => self.is_stopped = false,
            [2, to] if *to == node || *to == 0 => self.is_stopped = true,
            _ => {}
        }
    }

    /// The acceleration takes a new sample, and the other quantities are those of the same one.
    fn answer(&mut self, at: Instant, firmware: u16, reply_id: u16, register: u8) -> Option<Frame> {
        if register == 1 {
            self.latched = match self.imu.sample(at.since(self.begun)) {
                ImuOutput::Sample(values) => Some(values),
                ImuOutput::Nothing | ImuOutput::Gone => None,
            };
        }
        let bytes = reply(firmware, register, self.latched.as_ref()?)?;
        Some(Frame::classic(FrameId::new(reply_id)?, bytes))
    }
}

/// Returns the register that a frame asks a DM-IMU-L1 for.
fn asked(firmware: u16, id: u16, frame: &Frame) -> Option<u8> {
    let to = frame.id().raw();
    let [low, high] = id.to_le_bytes();
    match (firmware, frame.payload()) {
        (0..=1022, [l, h, register, 0xCC])
            if to == u32::from(DAMIAO_SHARED_ID) && [*l, *h] == [low, high] =>
        {
            Some(*register)
        }
        (1023, [l, h, register, 0xCC]) if to == u32::from(id) && [*l, *h] == [low, high] => Some(*register),
        (1024.., [0xCC, register, 0, 0xDD, _, _, _, _]) if to == u32::from(id) => Some(*register),
        _ => None,
    }
}

/// The reply of a DM-IMU-L1 with a register.
fn reply(firmware: u16, register: u8, values: &ImuValues) -> Option<[u8; 8]> {
    let code = |value: f64, end: f64, codes: u32| {
        let exact = (value + end) / (2.0 * end) * f64::from(codes);
        exact.round().clamp(0.0, f64::from(codes)) as u64
    };
    let sixteen = |vector: [f64; 3], ends: [f64; 3], second: u8| {
        let mut bytes = [register, second, 0, 0, 0, 0, 0, 0];
        for axis in 0..3 {
            let code = code(vector[axis], ends[axis], 65535);
            bytes[2 + 2 * axis] = (code % 256) as u8;
            bytes[3 + 2 * axis] = (code / 256) as u8;
        }
        bytes
    };
    let acceleration = DAMIAO_ACCELERATION[usize::from(firmware > 1022)];
    let [roll, pitch, yaw] = angles(values.orientation).map(f64::to_degrees);
    Some(match register {
        1 => sixteen(values.acceleration, [acceleration; 3], values.temperature as i8 as u8),
        2 => sixteen(values.angular_velocity, [DAMIAO_VELOCITY; 3], 0),
        3 => sixteen([pitch, yaw, roll], [90.0, 180.0, 180.0], 0),
        4 => {
            let mut word = 4_u64;
            for part in values.orientation {
                word = word * 0x4000 + code(part, 1.0, 0x3FFF);
            }
            word.to_be_bytes()
        }
        _ => return None,
    })
}

/// The TPDOs of a HiPNUC.
fn tpdos(node: u8, values: &ImuValues) -> [Frame; FRAMES] {
    let id = |base: u16| FrameId::new(base + u16::from(node)).unwrap_or(FrameId::MAX);
    let vector = |base, vector: [f64; 3]| {
        let [[a, b], [c, d], [e, f]] = vector.map(|value| (value.round() as i16).to_le_bytes());
        Frame::classic(id(base), [a, b, c, d, e, f])
    };
    let [[a, b], [c, d], [e, f], [g, h]] =
        values.orientation.map(|part| ((part * 10_000.0).round() as i16).to_le_bytes());
    [
        vector(0x180, values.acceleration.map(|value| value / HIPNUC_G * 1000.0)),
        vector(0x280, values.angular_velocity.map(|value| value.to_degrees() * 10.0)),
        vector(0x380, angles(values.orientation).map(|value| value.to_degrees() * 100.0)),
        Frame::classic(id(0x480), [a, b, c, d, e, f, g, h]),
    ]
}

/// Roll, pitch and yaw, rad.
fn angles([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    [
        (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y)),
        (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin(),
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEVEL: ImuValues = ImuValues {
        orientation: [1.0, 0.0, 0.0, 0.0],
        angular_velocity: [0.0, 0.1, -0.1],
        acceleration: [0.0, 0.0, 9.8],
        temperature: -5.0,
    };

    /// By hand: 1 G is 1000; 0.1 rad/s is 5.73 °/s; w is 10 000.
    #[test]
    fn tpdos_have_documented_bytes() {
        let [acceleration, velocity, angles, orientation] = tpdos(8, &LEVEL);
        assert_eq!(format!("{acceleration:?}"), "188#00000000E803");
        assert_eq!(format!("{velocity:?}"), "288#00003900C7FF");
        assert_eq!(format!("{angles:?}"), "388#000000000000");
        assert_eq!(format!("{orientation:?}"), "488#1027000000000000");
    }

    /// By hand: 0 is 32767.5, so 0x8000; 9.8 of ±235.2 is (245 / 470.4) · 65535 = 34133 = 0x8555, of ±58.8 is 38229 = 0x9555.
    #[test]
    fn replies_have_documented_bytes() {
        assert_eq!(reply(1024, 1, &LEVEL), Some([1, 0xFB, 0x00, 0x80, 0x00, 0x80, 0x55, 0x85]));
        assert_eq!(reply(1022, 1, &LEVEL), Some([1, 0xFB, 0x00, 0x80, 0x00, 0x80, 0x55, 0x95]));
        assert_eq!(reply(1024, 4, &LEVEL), Some([4, 0xFF, 0xFE, 0x00, 0x08, 0x00, 0x20, 0x00]));
        assert_eq!(reply(1024, 5, &LEVEL), None);
    }

    #[test]
    fn each_firmware_answers_its_requests_only() {
        let frame = |id, bytes: &[u8]| Frame::new(FrameId::new(id).unwrap(), bytes).unwrap();
        let shared = frame(0x6FF, &[1, 0, 2, 0xCC]);
        let short = frame(1, &[1, 0, 2, 0xCC]);
        let long = frame(1, &[0xCC, 2, 0, 0xDD, 0, 0, 0, 0]);
        for (firmware, answered) in [(1022, &shared), (1023, &short), (1024, &long)] {
            for request in [&shared, &short, &long] {
                assert_eq!(asked(firmware, 1, request), (request == answered).then_some(2), "{firmware}");
            }
            assert_eq!(asked(firmware, 2, answered), None, "another device");
        }
    }
}
