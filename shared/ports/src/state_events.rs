//! A file descriptor that becomes readable with each state, for programs with an event loop.

use crate::iceoryx::descriptor_of;
use crate::service::{Part, Service, ServiceError};
use iceoryx2::port::listener::Listener;
use iceoryx2::service::port_factory::event::PortFactory;
use std::os::fd::{AsFd, BorrowedFd};

/// Limit on the notifications that wait: the daemon sends one per state, and none while one is
/// unread.
const WAITING_MAX: usize = 4;

/// Becomes readable with each state. The daemon pays a system call for it in each cycle.
#[derive(Debug)]
pub struct StateEvents(Listener<Service>);

impl StateEvents {
    pub(crate) fn new(service: &PortFactory<Service>) -> Result<Self, ServiceError> {
        service.listener_builder().create().map(Self).map_err(Part::Cycle.failed())
    }

    /// Makes the descriptor unreadable until the next state. Call it before checking for a state.
    /// Makes a system call for each notification, and another one. Never blocks.
    ///
    /// # Errors
    /// A damaged connection.
    pub fn clear(&self) -> Result<(), ServiceError> {
        for _ in 0..WAITING_MAX {
            if self.0.try_wait(|_| ()).map_err(Part::Cycle.failed())? == 0 {
                break;
            }
        }
        Ok(())
    }
}

impl AsFd for StateEvents {
    fn as_fd(&self) -> BorrowedFd<'_> {
        descriptor_of(&self.0)
    }
}
