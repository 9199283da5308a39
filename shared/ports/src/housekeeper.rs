//! Cleaning up after dead processes.

use crate::instance::{Instance, InstanceLock};
use crate::leftovers;
use crate::service::{self, Service, ServiceError};
use iceoryx2::node::Node;
use std::time::SystemTime;

/// Removes the files of dead processes, which frees their slots. It opens files: use it about once
/// per second, on a thread without deadlines.
#[derive(Debug)]
pub struct Housekeeper {
    node: Node<Service>,
    instance: Instance,
}

impl Housekeeper {
    /// Creates a housekeeper of the instance of `lock`.
    ///
    /// # Errors
    /// This process cannot register itself.
    pub fn open(lock: &InstanceLock) -> Result<Self, ServiceError> {
        let instance = lock.instance().clone();
        Ok(Self { node: service::node(&instance, true)?, instance })
    }

    /// Returns the time when a process last registered or deregistered. One system call.
    #[must_use]
    pub fn changed(&self) -> Option<SystemTime> {
        std::fs::metadata(self.instance.root().join("nodes")).and_then(|nodes| nodes.modified()).ok()
    }

    /// Removes dead processes and returns their number. Files of processes that died during
    /// registration stay for 10 s; files that cannot be removed stay until the next start.
    #[must_use]
    pub fn clean(&self) -> u64 {
        let removed = self.node.try_cleanup_dead_nodes().cleanups;
        let _refused = leftovers::remove(&self.instance);
        removed
    }
}
