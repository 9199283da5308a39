//! Drivers of other families that report without a request.

use motord_bus::{Frame, FrameId};

/// Largest state of an axis: ODrive 0.6, `AxisState`.
const AXIS_STATE_MAX: u8 = 14;
/// An error of an axis has no bit from this one on: ODrive 0.5 and 0.6, `ODrive.Error` and
/// `Axis.Error`.
const AXIS_ERROR_BITS: u32 = 27;

/// Fewest encoder estimates that count as a driver's: it sends one every 10 ms (SDC104 and ODrive,
/// command 0x009).
const ESTIMATES_MIN: usize = 20;
/// Magnitudes of a position and a velocity in an estimate, turns and turns/s. Zero is also
/// possible. Control frames, read as two such numbers, are outside.
const ESTIMATE: core::ops::RangeInclusive<f32> = 1e-6..=1e5;

/// Ids by which a silent CANSimple driver with its factory node id, 0 (ODrive) or 1 (SDC104),
/// leaves CAN (0x01E), or saves its configuration or enters its boot loader (0x01F).
pub const LASTING: [u8; 4] = [0x1E, 0x1F, 0x3E, 0x3F];

/// A driver that reports without a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unprompted {
    /// A CANSimple driver (SDC104, ODrive), by its heartbeats or its encoder estimates. It reads
    /// frames with 32 ids as commands, among them an emergency stop and a new node id, so nothing
    /// is sent to these.
    CanSimple {
        /// Its node id. It uses the 32 ids from 32 times this number.
        node: u8,
    },
    /// A fault report of a driver with the "custom" protocol (GDZ, GDS), repeated every 200 ms.
    CustomFault {
        /// Its id.
        id: FrameId,
    },
}

impl Unprompted {
    /// Returns the drivers that sent some of `frames`, in the order of their first frames.
    pub(crate) fn among(frames: &[Frame]) -> Vec<Self> {
        let by_estimates = |frame: &Frame| {
            let node = (frame.id().raw() >> 5) as u8;
            reports_encoder(frames, node).then_some(Self::CanSimple { node })
        };
        let mut drivers = Vec::new();
        for driver in frames.iter().filter_map(Self::of).chain(frames.iter().filter_map(by_estimates)) {
            if !drivers.contains(&driver) {
                drivers.push(driver);
            }
        }
        drivers
    }

    /// Returns the driver that this frame alone identifies. Any master may send the bytes of the
    /// other reports.
    pub(crate) fn of(frame: &Frame) -> Option<Self> {
        let id = frame.id();
        match *frame.payload() {
            [0xAE, _, _, _, _, _, _, _] => Some(Self::CustomFault { id }),
            [a, b, c, d, state, _, _, _] if id.raw() & 0x1F == 0x01 => {
                let is_axis =
                    state <= AXIS_STATE_MAX && u32::from_le_bytes([a, b, c, d]) >> AXIS_ERROR_BITS == 0;
                is_axis.then_some(Self::CanSimple { node: (id.raw() >> 5) as u8 })
            }
            _ => None,
        }
    }

    /// Returns `true` when a driver of this kind may have sent the frame without a request.
    /// Constant time.
    pub(crate) fn may_be(frame: &Frame) -> bool {
        // CANSimple: heartbeat, errors, encoder, currents, temperature, voltage.
        const REPORTS: [u32; 9] = [0x01, 0x03, 0x04, 0x05, 0x09, 0x0A, 0x14, 0x15, 0x17];
        frame.payload().len() == 8
            && (frame.payload()[0] == 0xAE || REPORTS.contains(&(frame.id().raw() & 0x1F)))
    }

    /// Returns `true` when this driver sends with this id.
    pub(crate) fn sends(self, id: FrameId) -> bool {
        match self {
            Self::CanSimple { node } => id.raw() >> 5 == u32::from(node),
            Self::CustomFault { id: own } => own == id,
        }
    }

    /// Returns `true` when a request to motor `id` would be a command to this driver.
    pub(crate) fn owns(self, id: u8) -> bool {
        match self {
            Self::CanSimple { node } => u16::from(id) >> 5 == u16::from(node),
            Self::CustomFault { id: own } => own.byte() == Some(id),
        }
    }
}

/// Returns whether all frames with the id of the encoder estimates of this node are such estimates.
fn reports_encoder(frames: &[Frame], node: u8) -> bool {
    let is_number = |bytes: [u8; 4]| {
        let magnitude = f32::from_le_bytes(bytes).abs();
        magnitude == 0.0 || ESTIMATE.contains(&magnitude)
    };
    let is_estimate = |frame: &Frame| match *frame.payload() {
        [a, b, c, d, e, f, g, h] => is_number([a, b, c, d]) && is_number([e, f, g, h]),
        _ => false,
    };
    let of_node = || frames.iter().filter(|frame| frame.id().raw() == u32::from(node) << 5 | 0x09);
    of_node().count() >= ESTIMATES_MIN && of_node().all(is_estimate)
}

/// Fewer frames than this are not checked: they may be the replies to a master whose commands were
/// not received.
const REPORTS_MIN: usize = 5;

/// Highest temperature in such a report, 0.1 °C.
const TEMPERATURE_MAX: u16 = 1500;

/// Returns the motor whose reports are all of these frames: replies in MIT mode with eight bytes,
/// which RobStride motors send without a request when their active report is on (the vendor's
/// command F9). `None` when another frame is among them, such as a command.
pub(crate) fn reporting_motor(frames: &[&Frame]) -> Option<u8> {
    let first = frames.first()?;
    let [motor @ 1..=0x7F, _, _, _, _, _, _, _] = *first.payload() else { return None };
    let is_alike = |frame: &&Frame| {
        frame.id() == first.id() && frame.payload().len() == 8 && frame.payload()[0] == motor
    };
    // A command without torque ends with 0x7FF or 0x800 there.
    let temperature = |frame: &Frame| u16::from_be_bytes([frame.payload()[6], frame.payload()[7]]);
    let is_reply = |frame: &&Frame| {
        is_alike(frame) && temperature(frame) <= TEMPERATURE_MAX && frame.id().byte() != Some(motor)
    };
    (frames.len() >= REPORTS_MIN && frames.iter().all(is_reply)).then_some(motor)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recognised(id: u16, payload: [u8; 8]) -> Option<Unprompted> {
        Unprompted::of(&Frame::classic(FrameId::new(id).unwrap(), payload))
    }

    /// Goal: the error names the motor whose active report is on, not another program.
    #[test]
    fn replies_without_commands_are_reports() {
        let frame = |id, payload| Frame::classic(FrameId::new(id).unwrap(), payload);
        // RobStride, MIT document, feedback: the motor's id, position, velocity, torque,
        // temperature.
        let reply = frame(0x0FD, [0x05, 0x7F, 0xFF, 0x80, 0x08, 0x00, 0x01, 0x04]);
        let command = frame(0x005, [0x7F, 0xFF, 0x80, 0x00, 0x00, 0x00, 0x08, 0x00]);
        assert_eq!(reporting_motor(&[&reply; 5]), Some(5));
        assert_eq!(reporting_motor(&[&reply; 4]), None, "too few");
        assert_eq!(reporting_motor(&[&reply, &reply, &command, &reply, &reply, &command]), None);
        assert_eq!(reporting_motor(&[&command; 9]), None);
        assert_eq!(reporting_motor(&[]), None);
    }

    /// Control frames to motor 9 of a master: neutral, with gains, and start (MIT document 1.2); 1
    /// turn and 0.5 turns/s.
    #[test]
    fn commands_of_a_master_are_no_estimates() {
        let frames = |payload| vec![Frame::classic(FrameId::new(0x009).unwrap(), payload); 100];
        for command in [
            [0x7F, 0xFF, 0x7F, 0xF0, 0x00, 0x00, 0x07, 0xFF],
            [0x80, 0x00, 0x80, 0x00, 0x00, 0x00, 0x08, 0x00],
            [0x85, 0x12, 0x7F, 0xF1, 0x48, 0x33, 0x38, 0x05],
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC],
        ] {
            assert_eq!(Unprompted::among(&frames(command)), [], "{command:X?}");
        }
        let estimates = frames([0, 0, 0x80, 0x3F, 0, 0, 0, 0x3F]);
        assert_eq!(Unprompted::among(&estimates), [Unprompted::CanSimple { node: 0 }]);
        assert_eq!(Unprompted::among(&estimates[..ESTIMATES_MIN - 1]), []);
    }

    #[test]
    fn commands_of_a_master_are_no_heartbeats() {
        assert_eq!(recognised(0x001, [0; 8]), Some(Unprompted::CanSimple { node: 0 }));
        assert_eq!(
            recognised(0x0A1, [0x40, 0, 0, 0, 8, 1, 0, 0x80]),
            Some(Unprompted::CanSimple { node: 5 })
        );
        // MIT: a neutral command, and enable, to motor 1 (MIT document 1.2).
        assert_eq!(recognised(0x001, [0x7F, 0xFF, 0x7F, 0xF0, 0x00, 0x00, 0x07, 0xFF]), None);
        assert_eq!(recognised(0x001, [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC]), None);
    }
}
