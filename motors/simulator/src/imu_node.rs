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
/// Ids of SDO requests and of their answers, without the node.
const SDO: u16 = 0x600;
const SDO_ANSWER: u16 = 0x580;
/// CANopen: there is no such object, and the value is out of its range (CiA 301).
const NO_OBJECT: u32 = 0x0602_0000;
const OUT_OF_RANGE: u32 = 0x0609_0030;
/// Bit rate of a HiPNUC until another one is set.
const HIPNUC_BITRATE: u32 = 500_000;

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
    /// The TPDOs of a device that sends by itself.
    tpdos: [Timer; FRAMES],
    /// Node and bit rate of a HiPNUC after its next power-on.
    stored: (u8, u32),
    is_stopped: bool,
    /// The sample whose quantities a DM-IMU-L1 sends.
    latched: Option<ImuValues>,
}

/// When a TPDO is sent.
#[derive(Debug, Clone, Copy)]
struct Timer {
    /// Zero: never.
    period: Duration,
    due: Instant,
}

impl Timer {
    /// Begins at `now`, with a period of zero or more.
    fn begin(period: Duration, now: Instant) -> Self {
        let due = if period > Duration::ZERO { now + period } else { Instant::FAR_FUTURE };
        Self { period, due }
    }
}

impl ImuNode {
    pub(crate) fn new(settings: &ImuNodeSettings) -> Self {
        let ImuNodeSettings { name, device, noise, bias, delay, seed } = settings.clone();
        let imu = Imu::new(noise, bias, delay, seed);
        let node = if let ImuNodeDevice::Hipnuc { node, .. } = device { node } else { 0 };
        let tpdos = [Timer { period: Duration::ZERO, due: Instant::FAR_FUTURE }; FRAMES];
        let (begun, stored) = (Instant::ZERO, (node, HIPNUC_BITRATE));
        Self { name, device, imu, begun, tpdos, stored, is_stopped: false, latched: None }
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn inject(&mut self, fault: Fault) -> Result<(), InjectError> {
        match (fault, &mut self.device) {
            (Fault::PowerCycle, ImuNodeDevice::Hipnuc { node, .. }) => {
                (*node, self.is_stopped) = (self.stored.0, false);
                Ok(())
            }
            _ => self.imu.inject(fault),
        }
    }

    /// Gets power at `now`.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.begun = now;
        if let ImuNodeDevice::Hipnuc { period, .. } = self.device {
            self.tpdos = [Timer::begin(period, now); FRAMES];
        }
    }

    /// Returns the time of its next frames that need no request.
    pub(crate) fn due(&self) -> Instant {
        self.tpdos.iter().map(|tpdo| tpdo.due).min().unwrap_or(Instant::FAR_FUTURE)
    }

    /// Returns the shortest time from a request to its reply.
    pub(crate) const fn latency() -> Duration {
        REPLY_LATENCY
    }

    /// Returns the ids of frames that it obeys.
    #[cfg(feature = "bridge")]
    pub(crate) fn addresses(&self) -> impl Iterator<Item = FrameId> + use<> {
        let ids = match self.device {
            ImuNodeDevice::Hipnuc { node, .. } => [Some(0), Some(SDO + u16::from(node))],
            ImuNodeDevice::Damiao { firmware: 0..=1022, .. } => [Some(DAMIAO_SHARED_ID), None],
            ImuNodeDevice::Damiao { id, .. } => [Some(id), None],
        };
        ids.into_iter().flatten().filter_map(FrameId::new)
    }

    /// Returns the frames that are due, and the time since when. Advances to the next ones.
    pub(crate) fn emit(&mut self) -> (Instant, [Option<Frame>; FRAMES]) {
        let at = self.due();
        let ImuNodeDevice::Hipnuc { node, .. } = self.device else { return (at, [None; FRAMES]) };
        let are_due = self.tpdos.map(|tpdo| tpdo.due == at);
        for tpdo in self.tpdos.iter_mut().filter(|tpdo| tpdo.due == at) {
            tpdo.due = at + tpdo.period;
        }
        if self.is_stopped {
            return (at, [None; FRAMES]);
        }
        match self.imu.sample(at.since(self.begun)) {
            ImuOutput::Sample(values) => {
                let frames = tpdos(node, &values);
                (at, core::array::from_fn(|tpdo| are_due[tpdo].then_some(frames[tpdo])))
            }
            ImuOutput::Nothing | ImuOutput::Gone => (at, [None; FRAMES]),
        }
    }

    /// Takes a complete frame of another node. Returns the reply, and the time that passes before
    /// it.
    pub(crate) fn receive(&mut self, at: Instant, frame: &Frame) -> Option<(Duration, Frame)> {
        match self.device {
            ImuNodeDevice::Hipnuc { node, .. } => {
                self.obey(node, frame);
                Some((REPLY_LATENCY, self.configure(at, node, frame)?))
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

    /// SDO requests (user manual, "CANopen commands"; reads: CiA 301). A new period acts now, a new
    /// node after a power cycle.
    fn configure(&mut self, at: Instant, node: u8, frame: &Frame) -> Option<Frame> {
        let [command, low, high, sub, a, b, c, d] = *frame.payload() else { return None };
        if frame.id().raw() != u32::from(SDO + u16::from(node)) {
            return None;
        }
        let value = u32::from_le_bytes([a, b, c, d]);
        let outcome = match (command, high, low, sub) {
            (0x2B, 0x18, 0..=3, 5) if value == 0 || (5..=100).contains(&value) => {
                let period = Duration::from_millis(value.into());
                self.tpdos[usize::from(low)] = Timer::begin(period, at);
                Ok(None)
            }
            (0x23, 0x21, 1, 0) if (1..=64).contains(&value) => {
                self.stored.0 = value as u8;
                Ok(None)
            }
            (0x23, 0x21, 0, 0) if [125_000, 250_000, 500_000, 1_000_000].contains(&value) => {
                self.stored.1 = value;
                Ok(None)
            }
            (0x2B | 0x23, 0x18, 0..=3, 5) | (0x2B | 0x23, 0x21, 0..=1, 0) => Err(OUT_OF_RANGE),
            (0x40, 0x18, 0..=3, 5) => Ok(Some(self.tpdos[usize::from(low)].period.as_millis() as u32)),
            (0x40, 0x21, 0, 0) => Ok(Some(self.stored.1)),
            (0x40, 0x21, 1, 0) => Ok(Some(self.stored.0.into())),
            _ => Err(NO_OBJECT),
        };
        let (first, value) = match outcome {
            Ok(None) => (0x60, 0),
            Ok(Some(value)) => (0x43, value),
            Err(code) => (0x80, code),
        };
        let [a, b, c, d] = u32::to_le_bytes(value);
        let id = FrameId::new(SDO_ANSWER + u16::from(node))?;
        Some(Frame::classic(id, [first, low, high, sub, a, b, c, d]))
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

    /// By hand: 0 is 32767.5, so 0x8000; 9.8 of ±235.2 is (245 / 470.4) · 65535 = 34133 = 0x8555,
    /// of ±58.8 is 38229 = 0x9555.
    #[test]
    fn replies_have_documented_bytes() {
        assert_eq!(reply(1024, 1, &LEVEL), Some([1, 0xFB, 0x00, 0x80, 0x00, 0x80, 0x55, 0x85]));
        assert_eq!(reply(1022, 1, &LEVEL), Some([1, 0xFB, 0x00, 0x80, 0x00, 0x80, 0x55, 0x95]));
        assert_eq!(reply(1024, 4, &LEVEL), Some([4, 0xFF, 0xFE, 0x00, 0x08, 0x00, 0x20, 0x00]));
        assert_eq!(reply(1024, 5, &LEVEL), None);
    }

    /// The examples of the user manual for node 8: TPDO 1 every 5 ms, node 9; and a period that the
    /// device does not have.
    #[test]
    fn hipnuc_obeys_requests_of_the_manual() {
        let device = ImuNodeDevice::Hipnuc { node: 8, period: Duration::from_millis(10) };
        let (noise, bias, delay, seed) = (0.0, 0.0, Duration::ZERO, 1);
        let mut node =
            ImuNode::new(&ImuNodeSettings { name: "base".into(), device, noise, bias, delay, seed });
        let at = Instant::from_nanos(1_000_000);
        node.begin(at);
        let mut answered = |bytes: [u8; 8]| {
            let request = Frame::classic(FrameId::new(0x608).unwrap(), bytes);
            node.receive(at, &request).map(|(_, frame)| format!("{frame:?}"))
        };
        let text = |answer: &str| Some(answer.to_owned());
        assert_eq!(answered([0x2B, 0, 0x18, 5, 5, 0, 0, 0]), text("588#6000180500000000"));
        assert_eq!(answered([0x40, 0, 0x18, 5, 0, 0, 0, 0]), text("588#4300180505000000"));
        assert_eq!(answered([0x2B, 0, 0x18, 5, 4, 0, 0, 0]), text("588#8000180530000906"));
        assert_eq!(answered([0x23, 1, 0x21, 0, 9, 0, 0, 0]), text("588#6001210000000000"));
        assert_eq!(node.due(), at + Duration::from_millis(5));
        let ids = |node: &mut ImuNode| node.emit().1.map(|frame| frame.map(|frame| frame.id().raw()));
        assert_eq!(ids(&mut node), [Some(0x188), None, None, None]);
        node.inject(Fault::PowerCycle).unwrap();
        assert_eq!(ids(&mut node), [0x189, 0x289, 0x389, 0x489].map(Some));
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
