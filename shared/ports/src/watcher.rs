//! The port of a client for states.

use crate::iceoryx::{Payload, read};
use crate::service::{Part, Service, ServiceError};
use iceoryx2::port::DegradationAction;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use motord_shared::message::StateMessage;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The slot of a watcher.
#[derive(Debug)]
pub(crate) struct Watcher {
    port: Subscriber<Service, Payload<StateMessage>, ()>,
    is_deaf: Arc<AtomicBool>,
    /// Copy of the last state: other processes may write to the original at any time.
    state: Box<StateMessage>,
}

impl Watcher {
    /// Takes a slot of `service`.
    pub(crate) fn new(
        service: &PortFactory<Service, Payload<StateMessage>, ()>,
    ) -> Result<Self, ServiceError> {
        let is_deaf = Arc::<AtomicBool>::default();
        let noted = Arc::clone(&is_deaf);
        let builder = service.subscriber_builder().buffer_size(1).set_degradation_handler(move |_, _| {
            noted.store(true, Ordering::Relaxed);
            DegradationAction::Ignore
        });
        let port = builder.create().map_err(Part::State.failed())?;
        Ok(Self { port, is_deaf, state: Box::default() })
    }

    /// Passes the states that were not taken yet to `accept`, the newest last, until it breaks.
    pub(crate) fn take(
        &mut self,
        mut accept: impl FnMut(&StateMessage) -> ControlFlow<()>,
    ) -> Result<(), ServiceError> {
        // One state of a dead daemon may precede those of its successor.
        for _ in 0..3 {
            let Some(sample) = self.port.receive().map_err(Part::State.failed())? else { break };
            read(sample.payload(), &mut self.state);
            if accept(&self.state).is_break() {
                break;
            }
        }
        Ok(())
    }

    /// Returns `true` once a connection to a daemon has failed. The port does not try it again.
    pub(crate) fn is_deaf(&self) -> bool {
        self.is_deaf.load(Ordering::Relaxed)
    }
}
