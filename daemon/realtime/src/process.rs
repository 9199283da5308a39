//! Other processes of this machine: their programs, and their deaths as the kernel reports them.

pub use crate::kernel::{GROUPS_OF_A_PROCESS_MAX, peer_groups};
use core::time::Duration;
use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use std::os::fd::OwnedFd;
use std::sync::Arc;

/// The processes that are watched, at most one in each slot.
#[derive(Debug)]
pub struct Watched {
    epoll: Arc<Epoll>,
    /// Closing one ends its watch.
    processes: Vec<Option<OwnedFd>>,
}

/// The end that waits for their deaths, for another thread.
#[derive(Debug)]
pub struct Deaths(Arc<Epoll>);

/// Creates both ends, with this number of slots.
///
/// # Errors
///
/// `EMFILE` or `ENFILE` when no descriptors are left.
pub fn deaths(slots: usize) -> Result<(Watched, Deaths), Errno> {
    let epoll = Arc::new(Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC)?);
    let processes = std::iter::repeat_with(|| None).take(slots).collect();
    Ok((Watched { epoll: Arc::clone(&epoll), processes }, Deaths(epoll)))
}

impl Watched {
    /// Watches the process `pid` of this process namespace, in slot `slot`, and reports its death
    /// as `key`. Replaces the watch that the slot had. Returns true when there is no such process.
    /// Reports nothing where no watch is possible: `pid` is no process id, Linux is older than 5.3,
    /// or no descriptors are left. Three system calls, none of which blocks.
    pub fn watch(&mut self, slot: usize, pid: u32, key: u64) -> bool {
        self.forget(slot);
        let (Some(slot), Some(pid)) =
            (self.processes.get_mut(slot), i32::try_from(pid).ok().and_then(Pid::from_raw))
        else {
            return false;
        };
        let process = match pidfd_open(pid, PidfdFlags::empty()) {
            Ok(process) => process,
            Err(errno) => return errno == rustix::io::Errno::SRCH,
        };
        let event = EpollEvent::new(EpollFlags::EPOLLIN | EpollFlags::EPOLLONESHOT, key);
        if self.epoll.add(&process, event).is_ok() {
            *slot = Some(process);
        }
        false
    }

    /// Ends the watch in slot `slot`. A death that was reported before may still be read.
    pub fn forget(&mut self, slot: usize) {
        if let Some(slot) = self.processes.get_mut(slot) {
            *slot = None;
        }
    }
}

impl Deaths {
    /// Returns the key of the next process that exited, each once. Waits at most `time`; one system
    /// call.
    #[must_use]
    pub fn next(&self, time: Duration) -> Option<u64> {
        let mut events = [EpollEvent::empty()];
        let timeout = EpollTimeout::try_from(time).unwrap_or(EpollTimeout::ZERO);
        match self.0.wait(&mut events, timeout) {
            Ok(1) => Some(events[0].data()),
            Ok(_) | Err(_) => None,
        }
    }
}

/// Returns the name of the program that process `pid` runs: its first 15 bytes, as `comm` of
/// proc(5). A process may choose any name. Reads a file of the kernel, which does not block.
#[must_use]
pub fn program(pid: u32) -> Option<String> {
    let name = std::fs::read(format!("/proc/{pid}/comm")).ok()?;
    Some(String::from_utf8_lossy(&name).trim_end_matches('\n').to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn process_has_program_and_absent_process_none() {
        let own = std::env::current_exe().unwrap();
        let own = own.file_name().unwrap().to_str().unwrap();
        assert!(own.starts_with(&program(std::process::id()).unwrap()), "{own}");
        assert_eq!(program(0), None);
    }
}
