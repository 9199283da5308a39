//! The programs of the processes that sent requests.
//!
//! A process may have exited when the log reports its request, so its name is read while it waits for its answer.

use motord_bus::{Duration, Instant, clock};
use motord_realtime::process;
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
    program: String,
    read_at: Instant,
}

impl Askers {
    /// Remembers the program of process `pid`, which waits for an answer. Reads a file of the kernel, and allocates.
    pub fn note(&self, pid: u32) {
        let now = clock::monotonic();
        let Some(mut askers) = self.list() else { return };
        if askers.iter().any(|asker| asker.pid == pid && now.since(asker.read_at) < FRESH) {
            return;
        }
        let Some(program) = process::program(pid) else { return };
        askers.retain(|asker| asker.pid != pid);
        askers.push_front(Asker { pid, program, read_at: now });
        askers.truncate(ASKERS_MAX);
    }

    /// The program of process `pid`; `None` when the kernel does not tell it, as of a process that has ended.
    #[must_use]
    pub fn program(&self, pid: u32) -> Option<String> {
        let known = self.list().and_then(|askers| {
            let asker = askers.iter().find(|asker| asker.pid == pid);
            asker.map(|asker| asker.program.clone())
        });
        known.or_else(|| process::program(pid))
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
}
