//! The thread of the emergency stop's socket, [`motord_ports::stop_socket`].
//!
//! ```text
//! client ─ abstract socket ──▶ this thread ──▶ Robot::stop ──▶ motors
//!   ▲                              │
//!   └───────── confirmed ──────────┘
//! ```
//!
//! A stop waits behind no other request, and needs nothing that clients can exhaust: no slot, no
//! file, no descriptor that the other threads share. Until the robot has it, this thread allocates
//! and logs nothing for it, and opens only its connection. A process that may read, write and enter
//! the runtime directory may stop the robot. Its permission bits decide; access control lists are
//! ignored.

use motord_ports::instance::Instance as MotordInstance;
use motord_ports::stop_socket::{self, CONFIRMED, MESSAGE_BYTES_MAX, NO_CYCLE, NOT_PERMITTED, StopError};
use motord_ports::stop_source::StopSource;
use motord_realtime::descriptors::keep_only;
use motord_realtime::process::{GROUPS_OF_A_PROCESS_MAX, peer_groups};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{
    Backlog, MsgFlags, SockFlag, UnixCredentials, bind, getsockopt, listen, recv, send, sockopt,
};
use nix::sys::stat::{FileStat, stat};
use nix::unistd::geteuid;
use rustix::net::{SocketFlags, accept_with};
use std::array::from_fn;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::time::{Duration, Instant};

/// Limit on connections that have not sent a request. One more closes the oldest.
const CALLERS_MAX: usize = 64;
/// Most callers accepted in a turn.
const CALLERS_PER_TURN: usize = 16;
/// Least time from one turn to the next: a flood of callers must not take the processor from other
/// threads.
const TURN: Duration = Duration::from_millis(1);
/// Period in which an idle thread checks whether the daemon ends. Each wake-up delays the threads
/// below it.
const IDLE: Duration = Duration::from_millis(250);
/// Between two of the first tries to get the socket's name.
const NAME_TURN: Duration = Duration::from_millis(50);
/// Between two lines of the log about stops, and between two tries to get the socket's name.
const SECOND: Duration = Duration::from_secs(1);
const BACKLOG: i32 = 128;

/// Whose motors are stopped.
pub trait Robot {
    /// Stops every motor for process `pid` and its `source`. Blocks until that is done.
    ///
    /// # Errors
    /// [`StopError::NoCycle`] when it is not known to be done.
    fn stop(&self, pid: u32, source: StopSource) -> Result<(), StopError>;

    /// Returns the program of a process, for the log. `None` when it is not known.
    fn program(&self, pid: u32) -> Option<String>;
}

/// Serves the socket of `instance` until `ended` returns true, in a dedicated thread, which loses
/// the descriptors of all other threads. No thread waits for it.
pub fn run(instance: &MotordInstance, robot: impl Robot, ended: impl Fn() -> bool) {
    let Some(listener) = await_name(instance, &ended) else { return };
    let mut server = Server {
        listener,
        callers: from_fn(|_| None),
        eldest: 0,
        gate: Gate::new(instance),
        robot,
        logged: None,
        unlogged: 0,
    };
    while !ended() {
        server.turn();
    }
}

/// Returns the listening socket as soon as the system grants it. An exiting predecessor may hold
/// the name, or any other process.
fn await_name(instance: &MotordInstance, ended: impl Fn() -> bool) -> Option<OwnedFd> {
    // With a table of its own, this thread has descriptors for callers however many the other threads
    // use. It comes before the socket: a copy in the table of the other threads would hold the name
    // after the end of this thread. Where the kernel refuses, all threads share one.
    let _shared = keep_only(std::io::stderr().as_fd());
    let mut tries = 0_u32;
    while !ended() {
        match listen_for(instance) {
            Ok(listener) => return Some(listener),
            Err(errno) if tries == 20 => tracing::error!(
                see = "stop-socket",
                "no socket for emergency stops: {}{}. Keeps trying.",
                errno.desc(),
                stop_socket::holder(instance).map_or_else(String::new, |holder| format!(": {holder}"))
            ),
            Err(_) => {}
        }
        tries = tries.saturating_add(1);
        std::thread::sleep(if tries > 20 { SECOND } else { NAME_TURN });
    }
    None
}

fn listen_for(instance: &MotordInstance) -> Result<OwnedFd, Errno> {
    let socket = stop_socket::open(SockFlag::SOCK_NONBLOCK)?;
    bind(socket.as_raw_fd(), &stop_socket::address(instance)?)?;
    listen(&socket, Backlog::new(BACKLOG)?)?;
    Ok(socket)
}

struct Server<R> {
    listener: OwnedFd,
    callers: [Option<OwnedFd>; CALLERS_MAX],
    /// The place in `callers` that was filled first.
    eldest: usize,
    gate: Gate,
    robot: R,
    /// Time of the last log line about a stop. `unlogged` counts the stops since then without a
    /// line.
    logged: Option<Instant>,
    unlogged: u32,
}

impl<R: Robot> Server<R> {
    /// Waits for callers, takes them in, and carries out what they ask for. Does not allocate
    /// before the robot has the request.
    fn turn(&mut self) {
        let begun = Instant::now();
        self.wait();
        self.accept();
        let mut asking: [Option<(OwnedFd, UnixCredentials)>; CALLERS_MAX] = from_fn(|_| None);
        let mut source_of_first = None;
        for (caller, asking) in self.callers.iter_mut().zip(&mut asking) {
            let Some((caller, source)) = receive(caller) else { continue };
            *asking = self.gate.admit(caller);
            if asking.is_some() {
                source_of_first.get_or_insert(source);
            }
        }
        if let Some(first) = asking.iter().flatten().map(|(_, peer)| peer.pid().cast_unsigned()).next() {
            let source = source_of_first.unwrap_or(StopSource::NONE);
            let outcome = self.robot.stop(first, source);
            let reply = if outcome.is_ok() { CONFIRMED } else { NO_CYCLE };
            asking.iter().flatten().for_each(|(caller, _)| answer(caller, reply));
            self.log(first, source.text(), asking.iter().flatten().count(), outcome);
        }
        std::thread::sleep(TURN.saturating_sub(begun.elapsed()));
    }

    /// Sleeps until a process connects or sends, at most [`IDLE`]. One system call.
    fn wait(&self) {
        let listener = || PollFd::new(self.listener.as_fd(), PollFlags::POLLIN);
        let mut polled: [PollFd<'_>; CALLERS_MAX + 1] = from_fn(|_| listener());
        for (polled, caller) in polled[1..].iter_mut().zip(&self.callers) {
            *polled = caller
                .as_ref()
                .map_or_else(listener, |caller| PollFd::new(caller.as_fd(), PollFlags::POLLIN));
        }
        let _awake = poll(&mut polled, PollTimeout::try_from(IDLE).unwrap_or(PollTimeout::ZERO));
    }

    /// Takes at most [`CALLERS_PER_TURN`] callers.
    fn accept(&mut self) {
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        for _ in 0..CALLERS_PER_TURN {
            let Ok(caller) = accept_with(&self.listener, flags) else { break };
            self.callers[self.eldest] = Some(caller);
            self.eldest = (self.eldest + 1) % CALLERS_MAX;
        }
    }

    /// At most one line a second: many may ask without pause.
    fn log(&mut self, pid: u32, source: Option<&str>, programs: usize, outcome: Result<(), StopError>) {
        let now = Instant::now();
        self.unlogged += programs as u32;
        if self.logged.is_some_and(|logged| now.duration_since(logged) < SECOND) {
            return;
        }
        let (requests, program) = (std::mem::take(&mut self.unlogged), self.robot.program(pid));
        self.logged = Some(now);
        match outcome {
            Ok(()) => {
                tracing::warn!(pid, program, source, requests, see = "emergency-stop", "emergency stop");
            }
            Err(error) => tracing::error!(
                pid,
                program,
                source,
                requests,
                see = "stop-not-carried-out",
                "emergency stop not carried out: {error}"
            ),
        }
    }
}

/// Returns the caller and its source if it requests a stop. Closes the connection of one that does
/// not, or has disconnected.
fn receive(caller: &mut Option<OwnedFd>) -> Option<(OwnedFd, StopSource)> {
    let mut message = [0; MESSAGE_BYTES_MAX];
    let source = match recv(caller.as_ref()?.as_raw_fd(), &mut message, MsgFlags::MSG_DONTWAIT) {
        Ok(length) => StopSource::of_request(&message[..length]),
        Err(Errno::EAGAIN | Errno::EINTR) => return None,
        Err(_) => None,
    };
    caller.take().zip(source)
}

/// A caller that is gone misses its answer.
fn answer(caller: &OwnedFd, reply: &[u8]) {
    let _disconnected = send(caller.as_raw_fd(), reply, MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_NOSIGNAL);
}

/// Decides who may stop the robot.
struct Gate {
    directory: std::ffi::CString,
    /// Metadata of the runtime directory from the last successful `stat`.
    seen: Option<FileStat>,
    /// Room for the groups of a caller.
    groups: Vec<u32>,
}

impl Gate {
    fn new(instance: &MotordInstance) -> Self {
        use std::os::unix::ffi::OsStrExt;
        let path = instance.runtime().as_os_str().as_bytes();
        Self {
            directory: std::ffi::CString::new(path).unwrap_or_default(),
            seen: None,
            groups: vec![0; GROUPS_OF_A_PROCESS_MAX],
        }
    }

    /// Returns the caller and its process if that may stop the robot. Otherwise refuses the request
    /// and closes the connection.
    fn admit(&mut self, caller: OwnedFd) -> Option<(OwnedFd, UnixCredentials)> {
        self.seen = stat(self.directory.as_c_str()).ok().or(self.seen);
        let peer = getsockopt(&caller, sockopt::PeerCredentials).ok()?;
        let groups = peer_groups(caller.as_fd(), &mut self.groups).unwrap_or(&[]);
        let is_daemons_user = peer.uid() == geteuid().as_raw();
        if is_daemons_user || self.seen.is_some_and(|seen| may_enter(&seen, peer.uid(), peer.gid(), groups)) {
            return Some((caller, peer));
        }
        answer(&caller, NOT_PERMITTED);
        None
    }
}

/// Returns true if the kernel would let a process with these ids read, write and enter the
/// directory.
fn may_enter(directory: &FileStat, uid: u32, gid: u32, groups: &[u32]) -> bool {
    const ALL: u32 = 0o7;
    let bits = if uid == directory.st_uid {
        directory.st_mode >> 6
    } else if gid == directory.st_gid || groups.contains(&directory.st_gid) {
        directory.st_mode >> 3
    } else {
        directory.st_mode
    };
    uid == 0 || bits & ALL == ALL
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn socket_is_bound_when_runtime_directory_returns() {
        let parent = tempfile::tempdir().unwrap();
        let directory = parent.path().join("run");
        std::fs::create_dir(&directory).unwrap();
        let instance = MotordInstance::below(&directory, "robot").unwrap();
        std::fs::remove_dir_all(&directory).unwrap();
        let waits = std::thread::spawn(move || await_name(&instance, || false).is_some());
        std::thread::sleep(4 * NAME_TURN);
        std::fs::create_dir(&directory).unwrap();
        assert!(waits.join().unwrap());
    }

    #[test]
    fn ended_thread_frees_the_name() {
        let parent = tempfile::tempdir().unwrap();
        let instance = MotordInstance::below(parent.path(), "robot").unwrap();
        for round in 1..=2 {
            let instance = instance.clone();
            let tries = std::sync::atomic::AtomicU32::new(0);
            let is_over = move || tries.fetch_add(1, std::sync::atomic::Ordering::Relaxed) > 10;
            let served = std::thread::spawn(move || await_name(&instance, is_over).is_some());
            assert!(served.join().unwrap(), "round {round}");
        }
    }

    #[test]
    fn members_of_runtime_directory_alone_may_stop() {
        let parent = tempfile::tempdir().unwrap();
        let mut directory = stat(parent.path()).unwrap();
        (directory.st_uid, directory.st_gid) = (1000, 500);
        let mut may = |mode: u32, uid, gid, groups: &[u32]| {
            directory.st_mode = 0o40_000 | mode;
            may_enter(&directory, uid, gid, groups)
        };
        assert!(may(0o2770, 1000, 1, &[]) && may(0o2770, 7, 500, &[]) && may(0o2770, 7, 1, &[2, 500]));
        assert!(!may(0o2770, 7, 1, &[2]) && !may(0o700, 7, 500, &[500]) && !may(0o2750, 7, 500, &[]));
        assert!(may(0o000, 0, 0, &[]), "root enters everything");
        assert!(!may(0o077, 1000, 500, &[500]), "the owner's bits come first");
        assert!(may(0o777, 7, 1, &[]));
    }
}
