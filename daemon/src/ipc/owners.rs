//! Watches the processes of group owners. The kernel reports an exit immediately, long before the
//! setpoint timeout.
//!
//! An owner in another process namespace, such as a container's, is not watched: its process id
//! means another process here. Only its silence shows that it has ended. The process that claims is
//! the one that is watched: a child that uses the lease of its parent loses it when the parent
//! ends.

use core::time::Duration;
use motord_ports::instance::pid_namespace;
use motord_realtime::process::{self, deaths};
use motord_shared::limits::GROUPS_MAX;
use motord_shared::{AdminRequest, Lease};
use nix::errno::Errno;

/// The owners that are watched, by group: the end of the ipc thread.
pub struct Owners {
    processes: process::Watched,
    namespace: u64,
}

/// Their deaths: the end of the thread that waits.
pub struct Deaths(process::Deaths);

/// Both ends.
///
/// # Errors
///
/// When no descriptors are left.
pub fn owners() -> Result<(Owners, Deaths), Errno> {
    let (processes, ends) = deaths(GROUPS_MAX)?;
    Ok((Owners { processes, namespace: pid_namespace() }, Deaths(ends)))
}

impl Owners {
    /// Watches the process that made the request which `lease` answers. Returns whether it has
    /// ended already. A few system calls, none of which blocks.
    pub fn watch(&mut self, lease: Lease, request: &AdminRequest) -> bool {
        if self.namespace == 0 || request.pid_namespace != self.namespace {
            self.processes.forget(lease.group());
            return false;
        }
        self.processes.watch(lease.group(), request.pid, lease.raw())
    }
}

impl Deaths {
    /// The lease of the next owner whose process has ended. Waits at most `time`; one system call.
    #[must_use]
    pub fn next(&self, time: Duration) -> Option<Lease> {
        self.0.next(time).and_then(Lease::from_raw)
    }
}
