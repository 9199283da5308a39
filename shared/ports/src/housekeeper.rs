//! Cleaning up after dead processes.

use crate::instance::{Instance, InstanceLock};
use crate::leftovers;
use crate::service::{self, Service, ServiceError};
use iceoryx2::node::Node;
use std::time::SystemTime;

/// Removes what dead processes left behind, so that their places become free. It opens files: use it about once per
/// second, on a thread where that does no harm.
#[derive(Debug)]
pub struct Housekeeper {
    node: Node<Service>,
    instance: Instance,
}

impl Housekeeper {
    /// A housekeeper of the instance that is held by `lock`.
    ///
    /// # Errors
    /// When this process cannot register itself.
    pub fn open(lock: &InstanceLock) -> Result<Self, ServiceError> {
        let instance = lock.instance().clone();
        Ok(Self { node: service::node(&instance, true)?, instance })
    }

    /// Returns when a process last registered itself or left. One system call.
    #[must_use]
    pub fn changed(&self) -> Option<SystemTime> {
        std::fs::metadata(self.instance.root().join("nodes")).and_then(|nodes| nodes.modified()).ok()
    }

    /// Cleans. Returns the number of dead processes that were removed. Files of processes that died while they registered stay
    /// for 10 s; files that cannot be removed stay until the next start.
    #[must_use]
    pub fn clean(&self) -> u64 {
        let removed = self.node.try_cleanup_dead_nodes().cleanups;
        let _refused = leftovers::remove(&self.instance);
        removed
    }
}
