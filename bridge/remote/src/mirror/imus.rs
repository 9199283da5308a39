//! Samples of external IMUs that programs of this computer publish, for the robot.

use super::wire::{Sender, Wire};
use crate::frame::SAMPLES_MAX;
use crate::network::NetworkError;
use motord_ports::ImuReceiver;
use motord_shared::description::RobotDescription;
use motord_shared::limits::IMUS_MAX;
use motord_shared::message::ImuMessage;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Shortest time between two frames: a publisher without a pause must not fill the network.
const PERIOD: Duration = Duration::from_micros(500);
/// Samples of an IMU in a frame: the daemon counts older ones as missing.
const KEPT: usize = SAMPLES_MAX / IMUS_MAX;

/// Returns `true` if other processes publish the samples of an IMU of this robot.
pub(super) fn has_external(description: &[u8]) -> bool {
    let robot: Option<RobotDescription> = serde_json::from_slice(description).ok();
    robot.is_some_and(|robot| robot.imus.iter().any(|imu| imu.source == "external"))
}

/// The newest samples of each IMU that were not sent yet.
#[derive(Debug, Default)]
struct Newest([VecDeque<ImuMessage>; IMUS_MAX]);

impl Newest {
    fn note(&mut self, sample: &ImuMessage) {
        let Some(kept) = self.0.get_mut(sample.imu as usize) else { return };
        if kept.len() >= KEPT {
            kept.pop_front();
        }
        kept.push_back(*sample);
    }

    fn take(&mut self) -> Vec<ImuMessage> {
        self.0.iter_mut().flat_map(|kept| kept.drain(..)).collect()
    }
}

/// Sends the samples of a robot with an external IMU.
pub(super) struct Imus<'a> {
    wire: &'a Wire,
    sender: Sender<'a>,
    boot_id: u64,
    newest: Newest,
    sent: Instant,
}

impl<'a> Imus<'a> {
    /// For the daemon with this `boot_id`.
    pub(super) fn new(wire: &'a Wire, boot_id: u64) -> Result<Self, NetworkError> {
        let sender = wire.sender(wire.keys.imu())?;
        Ok(Self { wire, sender, boot_id, newest: Newest::default(), sent: Instant::now() })
    }

    /// Sends the samples that have arrived. Never waits for the network.
    pub(super) fn pass(&mut self, receiver: &ImuReceiver) {
        let Self { newest, boot_id, .. } = self;
        let _damaged = receiver.take(|sample| {
            if sample.boot_id == *boot_id {
                newest.note(sample);
            }
        });
        if self.sent.elapsed() < PERIOD {
            return;
        }
        let samples = self.newest.take();
        if !samples.is_empty() {
            self.sent = Instant::now();
            self.sender.put(self.wire.up().with_samples(&samples));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::description::ImuDescription;

    fn sample(imu: u32, sequence: u64) -> ImuMessage {
        ImuMessage { imu, sequence, ..ImuMessage::default() }
    }

    #[test]
    fn newest_samples_of_each_imu_are_sent() {
        let mut newest = Newest::default();
        (1..=100).for_each(|sequence| newest.note(&sample(0, sequence)));
        newest.note(&sample(3, 1));
        newest.note(&sample(u32::MAX, 1));
        let sent: Vec<_> = newest.take().iter().map(|sample| (sample.imu, sample.sequence)).collect();
        let expected: Vec<_> = (100 - KEPT as u64 + 1..=100).map(|sequence| (0, sequence)).collect();
        assert_eq!(sent, [&expected[..], &[(3, 1)]].concat());
        assert!(sent.len() <= SAMPLES_MAX && newest.take().is_empty());
    }

    #[test]
    fn only_robot_with_external_imu_receives_samples() {
        let robot = |source: &str| {
            let imu = ImuDescription { source: source.to_owned(), ..ImuDescription::default() };
            serde_json::to_vec(&RobotDescription { imus: vec![imu], ..RobotDescription::default() }).unwrap()
        };
        assert!(has_external(&robot("external")));
        assert!(!has_external(&robot("simulated")) && !has_external(b"{}") && !has_external(b""));
    }
}
