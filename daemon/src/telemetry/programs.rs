//! The programs of the processes that sent requests.
//!
//! A process may have exited when the log reports its request, so its name is read while it waits
//! for its answer.

use motord_bus::{Duration, Instant, clock};
use motord_ports::instance::pid_namespace;
use motord_realtime::process;
use motord_shared::AdminRequest;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

/// Most processes that are remembered.
const PROGRAMS_MAX: usize = 64;
/// Least time between two reads of a process's name: a process may send requests without pause.
const FRESH: Duration = Duration::from_secs(1);

/// The last requesters and their programs. Clones share them. No call waits for another one: if the
/// lock is taken, it skips.
#[derive(Debug, Clone, Default)]
pub struct Programs(Arc<Mutex<VecDeque<Requester>>>);

#[derive(Debug)]
struct Requester {
    pid: u32,
    /// `None` for a process of another namespace: here its id means another process.
    program: Option<String>,
    read_at: Instant,
}

impl Programs {
    /// Remembers the program of process `pid` of this namespace, which waits for an answer. Reads a
    /// file of the kernel, and allocates.
    pub fn note(&self, pid: u32) {
        self.note_as(pid, true);
    }

    /// Works like [`note`](Self::note), for the process that sent `request`, in whatever namespace
    /// of processes it is.
    pub fn note_request(&self, request: &AdminRequest) {
        self.note_as(request.pid, [0, pid_namespace()].contains(&request.pid_namespace));
    }

    fn note_as(&self, pid: u32, is_here: bool) {
        let now = clock::monotonic();
        let Some(mut programs) = self.list() else { return };
        let is_fresh = |requester: &Requester| {
            requester.program.is_some() == is_here && now.since(requester.read_at) < FRESH
        };
        if programs.iter().any(|requester| requester.pid == pid && is_fresh(requester)) {
            return;
        }
        let program = if is_here { process::program(pid) } else { None };
        if is_here && program.is_none() {
            return;
        }
        programs.retain(|requester| requester.pid != pid);
        programs.push_front(Requester { pid, program, read_at: now });
        if programs.len() > PROGRAMS_MAX {
            // The program of a process of this namespace can be read again.
            let oldest = programs.iter().rposition(|requester| requester.program.is_some());
            programs.remove(oldest.unwrap_or(PROGRAMS_MAX));
        }
    }

    /// The program of process `pid`; `None` when the kernel does not tell it, as of a process that
    /// has ended, or one in another namespace of processes.
    #[must_use]
    pub fn program(&self, pid: u32) -> Option<String> {
        let programs = self.list()?;
        match programs.iter().find(|requester| requester.pid == pid) {
            Some(requester) => requester.program.clone(),
            None => process::program(pid),
        }
    }

    fn list(&self) -> Option<MutexGuard<'_, VecDeque<Requester>>> {
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
        let (pid, programs) = (child.id(), Programs::default());
        while programs.program(pid).as_deref() != Some("sleep") {
            std::thread::yield_now();
        }
        programs.note(pid);
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(programs.clone().program(pid).as_deref(), Some("sleep"));
        assert_eq!(Programs::default().program(pid), None);
    }

    /// Process 1 of a container is not process 1 of this computer.
    #[test]
    fn requester_in_container_has_no_program() {
        let programs = Programs::default();
        let of = |pid, pid_namespace| AdminRequest { pid, pid_namespace, ..AdminRequest::default() };
        programs.note_request(&of(1, pid_namespace() + 1));
        assert_eq!(programs.program(1), None);
        (2..200).for_each(|pid| programs.note_request(&of(pid, pid_namespace())));
        assert_eq!(programs.program(1), None, "whatever number of requests follows");
        programs.note_request(&of(1, pid_namespace()));
        assert!(programs.program(1).is_some());
    }
}
