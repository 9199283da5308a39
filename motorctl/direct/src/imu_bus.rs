//! `motorctl imu find --bus`: HiPNUC IMUs on a CAN interface. Only listens: a request to an unknown
//! id could be a command to a motor.

use crate::failure::DirectFailure;
use motord_bus::socketcan::{InterfaceName, SocketCanBus};
use motord_bus::{Bus as _, Content, Duration, Inbox, Instant, clock, wait};
use motord_protocol::imu::hipnuc::can::{NODE_MAX, Tpdo};
use motord_terminal::Interrupt;
use std::collections::BTreeMap;

/// Time for which frames are counted: ten samples of the slowest device.
const MEASURE: Duration = Duration::from_secs(1);
/// Longest wait for frames, so that Ctrl-C is seen.
const TURN: Duration = Duration::from_millis(50);
/// The quantities of a sample.
const NEEDED: [Tpdo; 3] = [Tpdo::Acceleration, Tpdo::AngularVelocity, Tpdo::Orientation];
/// Frames of each quantity that make a device.
const FRAMES: u32 = 3;

/// The frames of one id.
#[derive(Debug, Clone, Copy, Default)]
struct Frames {
    sound: u32,
    unsound: u32,
    first: Option<Instant>,
    last: Instant,
}

/// The frames of a bus that a HiPNUC IMU could have sent, by node.
#[derive(Debug, Default)]
pub(crate) struct Nodes(BTreeMap<u8, [Frames; NEEDED.len()]>);

/// A device that was found.
#[derive(Debug, PartialEq)]
pub(crate) struct Node {
    pub(crate) id: u8,
    pub(crate) measured_hz: f64,
}

impl Nodes {
    fn take(&mut self, id: u16, payload: &[u8], at: Instant) {
        let node = (id & u16::from(NODE_MAX)) as u8;
        let Some(index) = NEEDED.iter().position(|tpdo| tpdo.id(node) == id).filter(|_| node > 0) else {
            return;
        };
        let frames = &mut self.0.entry(node).or_default()[index];
        match NEEDED[index].decode(payload) {
            Ok(_) => {
                frames.sound += 1;
                frames.first.get_or_insert(at);
                frames.last = at;
            }
            Err(_) => frames.unsound += 1,
        }
    }

    /// Returns the devices. Every quantity must have arrived, and every orientation must have been
    /// a unit quaternion: other frames with these ids are those of motors.
    fn devices(&self) -> Vec<Node> {
        let is_device = |frames: &[Frames; NEEDED.len()]| {
            frames.iter().all(|frames| frames.sound >= FRAMES && frames.unsound == 0)
        };
        let rate_hz = |frames: &Frames| {
            let seconds = frames.first.map_or(0.0, |first| frames.last.since(first).as_secs_f64());
            if seconds > 0.0 { f64::from(frames.sound - 1) / seconds } else { 0.0 }
        };
        let devices = self.0.iter().filter(|(_, frames)| is_device(frames));
        devices.map(|(id, frames)| Node { id: *id, measured_hz: rate_hz(&frames[2]) }).collect()
    }
}

/// Listens on a CAN interface, beside whatever program uses it.
///
/// # Errors
///
/// The interface cannot be used, or Ctrl-C came.
pub(crate) fn listen(interface: &str, interrupt: &Interrupt) -> Result<Vec<Node>, DirectFailure> {
    let name: InterfaceName = interface.parse().map_err(|_| {
        DirectFailure::Usage(format!("`{interface}` is no CAN interface: `ip link` lists them"))
    })?;
    let mut bus = SocketCanBus::open_as_is(name)?;
    let (mut nodes, mut inbox) = (Nodes::default(), Inbox::new());
    let end = clock::monotonic() + MEASURE;
    loop {
        let now = clock::monotonic();
        if interrupt.is_raised() {
            return Err(motord_protocol::commissioning::Error::Interrupted.into());
        }
        if now >= end {
            return Ok(nodes.devices());
        }
        if !wait(&[bus.readiness()], now, end.min(now + TURN)).any() {
            continue;
        }
        inbox.clear();
        bus.receive(clock::monotonic(), &mut inbox);
        for arrival in inbox.arrivals() {
            if let Content::Frame(frame) = &arrival.content
                && !frame.id().is_extended()
                && let Ok(id) = u16::try_from(frame.id().raw())
            {
                nodes.take(id, frame.payload(), arrival.at);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At 100 Hz, with these bytes of the quaternion: the device of the vendor's manual, or a
    /// motor.
    fn nodes(quaternion: [u8; 8]) -> Nodes {
        let mut nodes = Nodes::default();
        for sample in 0..10_u64 {
            let at = Instant::from_nanos(sample * 10_000_000);
            nodes.take(0x188, &[0, 0, 0, 0, 0xE8, 0x03], at);
            nodes.take(0x288, &[0; 6], at);
            nodes.take(0x388, &[0; 6], at);
            nodes.take(0x488, &quaternion, at);
            // A motor whose replies have an id of the same row.
            nodes.take(0x181, &[1, 2, 3, 4, 5, 6, 7, 8], at);
        }
        nodes
    }

    #[test]
    fn node_with_all_quantities_is_a_device() {
        let level = nodes([0x10, 0x27, 0, 0, 0, 0, 0, 0]).devices();
        assert_eq!((level.len(), level[0].id), (1, 8));
        assert!((level[0].measured_hz - 100.0).abs() < 1e-6, "{level:?}");
        assert_eq!(nodes([1, 2, 3, 4, 5, 6, 7, 8]).devices(), [], "no unit quaternion");
        assert_eq!(Nodes::default().devices(), []);
    }
}
