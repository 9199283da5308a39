//! The programs of the processes that sent requests.
//!
//! A process may have exited when the log reports its request, so its name is read while it waits for its answer.

use motord_bus::{Duration, Instant, clock};
use motord_ports::instance::pid_namespace;
use motord_realtime::process;
use motord_shared::AdminRequest;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

/// Most processes that are remembered.
const ASKERS_MAX: usize = 64;
/// Least time between two reads of a process's name: a process may send requests without pause.
const FRESH: Duration = Duration::from_secs(1);

/// The last requesters and their programs. Clones share them. No call waits for another one: if the lock is taken, it skips.
#[derive(Debug, Clone, Default)]
pub struct Askers(Arc<Mutex<VecDeque<Asker>>>);

#[derive(Debug)]
struct Asker {
    pid: u32,
    /// `None` for a process of another namespace: here its id means another process.
    program: Option<String>,
    read_at: Instant,
}

impl Askers {
    /// Remembers the program of process `pid` of this namespace, which waits for an answer. Reads a file of the kernel, and
    /// allocates.
    pub fn note(&self, pid: u32) {
        self.note_as(pid, true);
    }

    /// Works like [`note`](Self::note), for the process that sent `request`, in whatever namespace of processes it is.
    pub fn note_request(&self, request: &AdminRequest) {
        self.note_as(request.pid, [0, pid_namespace()].contains(&request.pid_namespace));
    }

    fn note_as(&self, pid: u32, is_here: bool) {
        let now = clock::monotonic();
        let Some(mut askers) = self.list() else { return };
        let is_fresh = |asker: &Asker| asker.program.is_some() == is_here && now.since(asker.read_at) < FRESH;
        if askers.iter().any(|asker| asker.pid == pid && is_fresh(asker)) {
            return;
        }
        let program = if is_here { process::program(pid) } else { None };
        if is_here && program.is_none() {
            return;
        }
        askers.retain(|asker| asker.pid != pid);
        askers.push_front(Asker { pid, program, read_at: now });
        if askers.len() > ASKERS_MAX {
            // The program of a process of this namespace can be read again.
            let oldest = askers.iter().rposition(|asker| asker.program.is_some());
            askers.remove(oldest.unwrap_or(ASKERS_MAX));
        }
    }

    /// The program of process `pid`; `None` when the kernel does not tell it, as of a process that has ended, or one in another
    /// namespace of processes.
    #[must_use]
    pub fn program(&self, pid: u32) -> Option<String> {
        let askers = self.list()?;
        match askers.iter().find(|asker| asker.pid == pid) {
            Some(asker) => asker.program.clone(),
            None => process::program(pid),
        }
    }

    fn list(&self) -> Option<MutexGuard<'_, VecDeque<Asker>>> {
        match self.0.try_lock() {
            Ok(list) => Some(list),
            Err(TryLockError::Poisoned(list)) => Some(list.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requester_program_is_known_after_its_exit() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let (pid, askers) = (child.id(), Askers::default());
        while askers.program(pid).as_deref() != Some("sleep") {
            std::thread::yield_now();
        }
        askers.note(pid);
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(askers.clone().program(pid).as_deref(), Some("sleep"));
        assert_eq!(Askers::default().program(pid), None);
    }

    /// Process 1 of a container is not process 1 of this computer.
    #[test]
    fn requester_in_container_has_no_program() {
        let askers = Askers::default();
        let of = |pid, pid_namespace| AdminRequest { pid, pid_namespace, ..AdminRequest::default() };
        askers.note_request(&of(1, pid_namespace() + 1));
        assert_eq!(askers.program(1), None);
        (2..200).for_each(|pid| askers.note_request(&of(pid, pid_namespace())));
        assert_eq!(askers.program(1), None, "whatever number of requests follows");
        askers.note_request(&of(1, pid_namespace()));
        assert!(askers.program(1).is_some());
    }
}
