//! The deaths of processes, as the kernel tells them: at once, whatever the process did or did not say.

use core::time::Duration;
use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use std::os::fd::OwnedFd;
use std::sync::Arc;

/// The processes that are watched, at most one in each place.
#[derive(Debug)]
pub struct Watched {
    epoll: Arc<Epoll>,
    /// Closing one ends its watch.
    processes: Vec<Option<OwnedFd>>,
}

/// The end that waits for their deaths, for another thread.
#[derive(Debug)]
pub struct Deaths(Arc<Epoll>);

/// Both ends, for so many `places`.
///
/// # Errors
///
/// `EMFILE` or `ENFILE` when no descriptors are left.
pub fn deaths(places: usize) -> Result<(Watched, Deaths), Errno> {
    let epoll = Arc::new(Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC)?);
    let processes = std::iter::repeat_with(|| None).take(places).collect();
    Ok((Watched { epoll: Arc::clone(&epoll), processes }, Deaths(epoll)))
}

impl Watched {
    /// Watches the process `pid` of this process namespace instead of the one that was watched in `place`. Its death will be
    /// reported as `key`. Returns whether there is no such process. Nothing will be reported where there can be no watch: `pid` is
    /// no process id, Linux is older than 5.3, or no descriptors are left. Three system calls, none of which blocks.
    pub fn watch(&mut self, place: usize, pid: u32, key: u64) -> bool {
        self.forget(place);
        let (Some(place), Some(pid)) =
            (self.processes.get_mut(place), i32::try_from(pid).ok().and_then(Pid::from_raw))
        else {
            return false;
        };
        let process = match pidfd_open(pid, PidfdFlags::empty()) {
            Ok(process) => process,
            Err(errno) => return errno == rustix::io::Errno::SRCH,
        };
        let event = EpollEvent::new(EpollFlags::EPOLLIN | EpollFlags::EPOLLONESHOT, key);
        if self.epoll.add(&process, event).is_ok() {
            *place = Some(process);
        }
        false
    }

    /// Watches nothing in `place` any more. A death that was told before may still be read.
    pub fn forget(&mut self, place: usize) {
        if let Some(place) = self.processes.get_mut(place) {
            *place = None;
        }
    }
}

impl Deaths {
    /// The key of the next process that has ended, each once. Waits at most `time`; one system call.
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
