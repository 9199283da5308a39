//! The ports for the samples of external IMUs.

use crate::iceoryx::{Payload, copied};
use crate::service::{Obstacle, Part, Service, ServiceError};
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use motord_shared::limits::{IMU_PUBLISHERS_MAX, IMU_SAMPLES_KEPT};
use motord_shared::message::ImuMessage;

/// The daemon's side: receives the samples.
#[derive(Debug)]
pub struct ImuReceiver(Subscriber<Service, Payload<ImuMessage>, ()>);

impl ImuReceiver {
    pub(crate) fn new(service: &PortFactory<Service, Payload<ImuMessage>, ()>) -> Result<Self, ServiceError> {
        service.subscriber_builder().create().map(Self).map_err(Part::Imu.failed())
    }

    /// Passes copies of the samples that have arrived to `accept`, those of each publisher in their order. Takes at most as
    /// many as may wait: a publisher that never stops does not keep the caller. Allocates. Never blocks.
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
pub struct ImuSender(Publisher<Service, Payload<ImuMessage>, ()>);

impl ImuSender {
    pub(crate) fn new(service: &PortFactory<Service, Payload<ImuMessage>, ()>) -> Result<Self, ServiceError> {
        let builder = service.publisher_builder().max_loaned_samples(1);
        let port = builder.backpressure_strategy(BackpressureStrategy::DiscardData).create();
        port.map(Self).map_err(|error| match error {
            PublisherCreateError::ExceedsMaxSupportedPublishers => {
                ServiceError { part: Part::Imu, obstacle: Obstacle::Full { most: IMU_PUBLISHERS_MAX } }
            }
            error => Part::Imu.failed()(error),
        })
    }

    /// Sends a sample. It replaces the oldest one when the daemon has not read the last 32. Without a daemon it is no error. Never blocks.
    ///
    /// # Errors
    /// A damaged connection.
    pub fn send(&self, sample: &ImuMessage) -> Result<(), ServiceError> {
        self.0.send_copy(Payload(*sample)).map_err(Part::Imu.failed())?;
        Ok(())
    }
}
