//! The ports for the samples of external IMUs.

use crate::iceoryx::{Payload, copied};
use crate::instance::Instance;
use crate::mutex::locked;
use crate::service::{Obstacle, Part, Service, ServiceError};
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use motord_shared::limits::{IMU_PUBLISHERS_MAX, IMU_PUBLISHERS_PER_PROCESS, IMU_SAMPLES_KEPT};
use motord_shared::message::ImuMessage;
use std::path::PathBuf;
use std::sync::Mutex;

/// The daemon's side: receives the samples.
#[derive(Debug)]
pub struct ImuReceiver(Subscriber<Service, Payload<ImuMessage>, ()>);

impl ImuReceiver {
    pub(crate) fn new(service: &PortFactory<Service, Payload<ImuMessage>, ()>) -> Result<Self, ServiceError> {
        service.subscriber_builder().create().map(Self).map_err(Part::Imu.failed())
    }

    /// Passes copies of the samples that have arrived to `accept`, those of each publisher in their
    /// order. Takes at most as many as may wait: a publisher that never stops does not keep the
    /// caller. Allocates. Never blocks.
    ///
    /// # Errors
    /// A damaged connection; earlier samples were passed on.
    pub fn take(&self, mut accept: impl FnMut(&ImuMessage)) -> Result<(), ServiceError> {
        for _ in 0..IMU_PUBLISHERS_MAX * IMU_SAMPLES_KEPT {
            let Some(sample) = self.0.receive().map_err(Part::Imu.failed())? else { break };
            accept(&copied(sample.payload()));
        }
        Ok(())
    }
}

/// The client's side: sends samples.
#[derive(Debug)]
pub struct ImuSender {
    port: Publisher<Service, Payload<ImuMessage>, ()>,
    _slot: Slot,
}

impl ImuSender {
    pub(crate) fn new(
        service: &PortFactory<Service, Payload<ImuMessage>, ()>,
        instance: &Instance,
    ) -> Result<Self, ServiceError> {
        let slot = Slot::take(instance.root())?;
        let builder = service.publisher_builder().max_loaned_samples(1);
        let port = builder.backpressure_strategy(BackpressureStrategy::DiscardData).create();
        port.map(|port| Self { port, _slot: slot }).map_err(|error| match error {
            PublisherCreateError::ExceedsMaxSupportedPublishers => full(IMU_PUBLISHERS_MAX),
            error => Part::Imu.failed()(error),
        })
    }

    /// Sends a sample. It replaces the oldest one when the daemon has not read the last 32. Without
    /// a daemon it is no error. Never blocks.
    ///
    /// # Errors
    /// A damaged connection.
    pub fn send(&self, sample: &ImuMessage) -> Result<(), ServiceError> {
        self.port.send_copy(Payload(*sample)).map_err(Part::Imu.failed())?;
        Ok(())
    }
}

const fn full(most: usize) -> ServiceError {
    ServiceError { part: Part::Imu, obstacle: Obstacle::Full { most } }
}

/// The senders of this process: for each, the process and the directory of its instance. A forked
/// process has none of those of its parent.
static SENDERS: Mutex<Vec<(u32, PathBuf)>> = Mutex::new(Vec::new());

/// A sender of this process, until it is dropped. A program that forgets its senders in a loop must
/// not take the slots of the others.
#[derive(Debug)]
struct Slot(PathBuf);

impl Slot {
    fn take(root: PathBuf) -> Result<Self, ServiceError> {
        let (mut senders, process) = (locked(&SENDERS), std::process::id());
        senders.retain(|(owner, _)| *owner == process);
        if senders.iter().filter(|(_, of)| *of == root).count() >= IMU_PUBLISHERS_PER_PROCESS {
            let obstacle = Obstacle::FullHere { most: IMU_PUBLISHERS_PER_PROCESS };
            return Err(ServiceError { part: Part::Imu, obstacle });
        }
        senders.push((process, root.clone()));
        Ok(Self(root))
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let (mut senders, process) = (locked(&SENDERS), std::process::id());
        if let Some(own) = senders.iter().position(|(owner, of)| (*owner, of) == (process, &self.0)) {
            senders.swap_remove(own);
        }
    }
}
