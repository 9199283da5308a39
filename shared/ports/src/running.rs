//! The daemons of this computer, found by the names of their sockets for emergency stops, and a stop of all of them at once.
//!
//! Any user may take a free name, as often as the limit of descriptors permits, and name any directory in it. A daemon counts only if
//! its process and its directory belong to [`TrustedUsers`]. Nothing in the directory of another one is opened.

use crate::instance::{self, Instance};
use crate::liveness;
use crate::peer::TrustedUsers;
use crate::stop_socket::{
    CONFIRMED, MESSAGE_BYTES_MAX, NO_CYCLE, NOT_PERMITTED, PREFIX, REQUEST, StopError, open,
};
use nix::errno::Errno;
use nix::fcntl::{AT_FDCWD, OFlag, openat};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{
    MsgFlags, SockFlag, UnixAddr, UnixCredentials, connect, getsockopt, recv, send, sockopt,
};
use nix::sys::stat::{FileStat, Mode, SFlag, fstat, lstat};
use std::ffi::OsString;
use std::fs;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::ffi::OsStringExt;
use std::path::{Component, Path, PathBuf};
use std::time::{Duration, Instant};

/// Flags of a listening socket in `/proc/net/unix`.
const LISTENING: &[u8] = b"00010000";
/// Pause between two attempts to reach a daemon that has too many connections, ms.
const RETRY_MS: u16 = 1;
/// Mode bits: all users may create files in a directory, and only their owners may rename these.
const ALL_WRITE: u32 = 0o002;
const STICKY: u32 = 0o1000;

/// A daemon that runs in this network namespace.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct RunningInstance {
    /// The instance's name.
    pub name: String,
    /// Its runtime directory.
    pub runtime: PathBuf,
    /// The daemon's process id; 0 when it lives in another process namespace, or its socket has too many callers.
    pub pid: u32,
    /// The daemon's user.
    pub uid: u32,
}

/// Returns the daemons of [`TrustedUsers`] that listen for emergency stops, sorted. Sends no request. The values need no quotes in a
/// shell: an instance has a valid name, and directories with characters other than letters, digits and `/._+-` are omitted.
#[must_use]
pub fn running() -> Vec<RunningInstance> {
    let instances = candidates().into_iter().filter_map(|candidate| match candidate.standing {
        Standing::Trusted => Some(candidate.instance),
        Standing::Unknown => candidate.seen_alive(&trusted_users()),
        Standing::Foreign => None,
    });
    sorted(instances)
}

/// Returns the processes of all other users that listen under names of daemons, sorted like [`running`]. They may be daemons.
#[must_use]
pub fn foreign() -> Vec<RunningInstance> {
    let candidates = candidates().into_iter().filter(|candidate| candidate.standing == Standing::Foreign);
    sorted(candidates.map(|candidate| candidate.instance))
}

/// The outcome of [`stop_all`].
#[derive(Debug)]
pub struct AllStops {
    /// The daemons of [`TrustedUsers`], with the reason if one did not confirm.
    pub trusted: Vec<(RunningInstance, Result<(), StopError>)>,
    /// The other processes to which the request was sent. Their answers do not count.
    pub foreign: Vec<RunningInstance>,
}

/// Requests every process that listens for emergency stops to damp and stop its motors, and waits at most `timeout` for the
/// confirmations. No request waits for an answer, a full queue or another process.
#[must_use]
pub fn stop_all(timeout: Duration) -> AllStops {
    let end = Instant::now() + timeout;
    let users = trusted_users();
    let mut stops = AllStops { trusted: Vec::new(), foreign: Vec::new() };
    let mut pending = Vec::new();
    for mut candidate in candidates() {
        candidate.request();
        match candidate.standing {
            Standing::Trusted => pending.push(candidate),
            Standing::Foreign => stops.foreign.push(candidate.instance),
            Standing::Unknown => {
                if let Some(instance) = candidate.seen_alive(&users) {
                    candidate.instance = instance;
                    pending.push(candidate);
                }
            }
        }
    }
    while pending.iter().any(|candidate| candidate.outcome.is_none()) && Instant::now() < end {
        await_answers(&pending, end);
        pending.iter_mut().for_each(Candidate::turn);
    }
    stops.foreign = sorted(stops.foreign);
    stops.trusted = pending
        .into_iter()
        .map(|candidate| (candidate.instance, candidate.outcome.unwrap_or(Err(StopError::NoReply))))
        .collect();
    stops.trusted.sort_by(|first, second| first.0.cmp(&second.0));
    stops
}

fn sorted(instances: impl IntoIterator<Item = RunningInstance>) -> Vec<RunningInstance> {
    let mut sorted: Vec<_> = instances.into_iter().collect();
    sorted.sort();
    sorted.dedup();
    sorted
}

/// Returns the users whose daemons count here. The runtime directory of this process was chosen by its user.
fn trusted_users() -> TrustedUsers {
    let here = Instance::find("robot");
    here.iter().fold(TrustedUsers::find(), TrustedUsers::and_of)
}

/// How far the process at a stop socket is trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Standing {
    Trusted,
    Foreign,
    /// Its queue of connections is full, which any user can bring about.
    Unknown,
}

/// A process that listens under the name of a daemon.
#[derive(Debug)]
struct Candidate {
    instance: RunningInstance,
    /// The name of the socket.
    name: Vec<u8>,
    standing: Standing,
    /// Not connected while its queue is full.
    socket: Option<OwnedFd>,
    is_requested: bool,
    /// `None` while a confirmation may still arrive.
    outcome: Option<Result<(), StopError>>,
}

impl Candidate {
    /// Connects to the process behind a name of the table. `None` without one.
    fn connect(Name { name, instance, runtime }: Name, users: &TrustedUsers) -> Option<Self> {
        let (socket, peer) = match contact(&name) {
            Ok((socket, peer)) => (Some(socket), Some(peer)),
            Err(Errno::EAGAIN) => (None, None),
            Err(_) => return None,
        };
        let standing = match peer {
            Some(peer) if users.contains(peer.uid()) && is_trusted_directory(&runtime, users) => {
                Standing::Trusted
            }
            Some(_) => Standing::Foreign,
            None => Standing::Unknown,
        };
        let (pid, uid) = peer.map_or((0, u32::MAX), |peer| (peer.pid().cast_unsigned(), peer.uid()));
        let instance = RunningInstance { name: instance, runtime, pid, uid };
        Some(Self { instance, name, standing, socket, is_requested: false, outcome: None })
    }

    /// Returns the instance of a process that shows no credentials, if a daemon of a trusted user holds the lock of the instance.
    fn seen_alive(&self, users: &TrustedUsers) -> Option<RunningInstance> {
        let RunningInstance { name, runtime, .. } = &self.instance;
        if !is_trusted_directory(runtime, users) {
            return None;
        }
        let instance = Instance::below(runtime, name).ok()?;
        let uid =
            lstat(&instance.lock_path()).ok().map(|lock| lock.st_uid).filter(|uid| users.contains(*uid))?;
        (!liveness::is_dead(&instance)).then(|| RunningInstance { uid, ..self.instance.clone() })
    }

    /// Sends the request, once. Does not block.
    fn request(&mut self) {
        let Some(socket) = self.socket.as_ref().filter(|_| !self.is_requested) else { return };
        let flags = MsgFlags::MSG_NOSIGNAL | MsgFlags::MSG_DONTWAIT;
        self.is_requested = send(socket.as_raw_fd(), REQUEST, flags).is_ok();
        if !self.is_requested {
            // A daemon with too many callers drops the first ones without a request.
            self.socket = None;
        }
    }

    /// Connects again to a daemon that had too many callers, and takes its answer. Does not block.
    fn turn(&mut self) {
        if self.outcome.is_some() {
            return;
        }
        if self.socket.is_none() {
            match contact(&self.name) {
                // The name may have changed hands meanwhile.
                Ok((_, peer)) if peer.uid() != self.instance.uid => {
                    self.outcome = Some(Err(StopError::NotRunning));
                }
                Ok((socket, _)) => (self.socket, self.is_requested) = (Some(socket), false),
                Err(Errno::EAGAIN) => {}
                Err(_) => self.outcome = Some(Err(StopError::NotRunning)),
            }
        }
        self.request();
        let Some(socket) = &self.socket else { return };
        let mut reply = [0; MESSAGE_BYTES_MAX];
        match recv(socket.as_raw_fd(), &mut reply, MsgFlags::MSG_DONTWAIT) {
            Ok(length) if reply[..length] == *CONFIRMED => self.outcome = Some(Ok(())),
            Ok(length) if reply[..length] == *NO_CYCLE => self.outcome = Some(Err(StopError::NoCycle)),
            Ok(length) if reply[..length] == *NOT_PERMITTED => {
                self.outcome = Some(Err(StopError::NotPermitted));
            }
            Err(Errno::EAGAIN | Errno::EINTR) => {}
            Ok(_) | Err(_) => self.socket = None,
        }
    }
}

/// Waits for an answer until `end`, or for the next attempt to connect.
fn await_answers(pending: &[Candidate], end: Instant) {
    let open = || pending.iter().filter(|candidate| candidate.outcome.is_none());
    let sockets = open().filter_map(|candidate| candidate.socket.as_ref());
    let mut polled: Vec<_> = sockets.map(|socket| PollFd::new(socket.as_fd(), PollFlags::POLLIN)).collect();
    let left = match open().all(|candidate| candidate.socket.is_some()) {
        true => end.saturating_duration_since(Instant::now()).as_millis().try_into().unwrap_or(u16::MAX),
        false => 0,
    };
    let _interrupted = poll(&mut polled, PollTimeout::from(left.max(RETRY_MS)));
}

/// A name in the table of sockets.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Name {
    name: Vec<u8>,
    instance: String,
    runtime: PathBuf,
}

/// Connects to every process that listens under the name of a daemon, the likely ones first.
fn candidates() -> Vec<Candidate> {
    let users = trusted_users();
    let likely = Instance::find("robot").map_or_else(
        |_| instance::SERVICE_RUNTIME.into(),
        |here| fs::canonicalize(here.runtime()).unwrap_or_else(|_| here.runtime().to_owned()),
    );
    let table = fs::read("/proc/net/unix").unwrap_or_default();
    let mut names: Vec<_> = table.split(|byte| *byte == b'\n').filter_map(name_in).collect();
    names.sort_by_cached_key(|name| (name.runtime != likely, name.name.clone()));
    names.dedup();
    names.into_iter().filter_map(|name| Candidate::connect(name, &users)).collect()
}

/// Returns the name in a line of `/proc/net/unix`, if the line shows a listening socket with that of a daemon.
fn name_in(line: &[u8]) -> Option<Name> {
    line.split(u8::is_ascii_whitespace)
        .filter(|field| !field.is_empty())
        .nth(3)
        .filter(|flags| *flags == LISTENING)?;
    let start = line.windows(PREFIX.len()).position(|part| part == PREFIX)?;
    let name = line[start..].strip_prefix(PREFIX)?;
    let colon = name.iter().position(|byte| *byte == b':')?;
    let (instance, runtime) = (str::from_utf8(&name[..colon]).ok()?, &name[colon + 1..]);
    let of_a_path = |byte: &u8| byte.is_ascii_alphanumeric() || b"/._+-".contains(byte);
    if !instance::is_name(instance) || !runtime.iter().all(of_a_path) {
        return None;
    }
    let runtime = PathBuf::from(OsString::from_vec(runtime.to_vec()));
    Some(Name { name: line[start..].to_vec(), instance: instance.to_owned(), runtime })
}

/// Connects to the process that listens under an abstract name. Does not block.
fn contact(name: &[u8]) -> Result<(OwnedFd, UnixCredentials), Errno> {
    let socket = open(SockFlag::SOCK_NONBLOCK)?;
    connect(socket.as_raw_fd(), &UnixAddr::new_abstract(name)?)?;
    let peer = getsockopt(&socket, sockopt::PeerCredentials)?;
    Ok((socket, peer))
}

/// Returns true if only trusted users decide which directory is at `path`, and it belongs to one of them. A daemon names its
/// directory without links. Opens nothing but the name.
fn is_trusted_directory(path: &Path, users: &TrustedUsers) -> bool {
    let is_plain = path.is_absolute()
        && path.components().all(|part| matches!(part, Component::RootDir | Component::Normal(_)));
    let flags = OFlag::O_PATH | OFlag::O_NOFOLLOW | OFlag::O_DIRECTORY | OFlag::O_CLOEXEC;
    let opened = || openat(AT_FDCWD, path, flags, Mode::empty()).and_then(|found| fstat(&found));
    // In a namespace of users, root of the computer may have another number.
    let root = lstat("/").map(|root| root.st_uid);
    let is_fixed = |above: FileStat| {
        let is_directory = above.st_mode & SFlag::S_IFMT.bits() == SFlag::S_IFDIR.bits();
        let is_renamed_by_all = above.st_mode & ALL_WRITE != 0 && above.st_mode & STICKY == 0;
        is_directory && !is_renamed_by_all && (users.contains(above.st_uid) || root == Ok(above.st_uid))
    };
    is_plain
        && opened().is_ok_and(|found| users.contains(found.st_uid))
        && path.ancestors().skip(1).all(|above| lstat(above).is_ok_and(is_fixed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stop_socket::address;
    use nix::sys::socket::{Backlog, accept, bind, listen};
    use std::fs::Permissions;
    use std::os::unix::fs::{PermissionsExt, symlink};

    fn listening(instance: &Instance, backlog: i32) -> OwnedFd {
        let socket = open(SockFlag::empty()).unwrap();
        bind(socket.as_raw_fd(), &address(instance).unwrap()).unwrap();
        listen(&socket, Backlog::new(backlog).unwrap()).unwrap();
        socket
    }

    #[test]
    fn instance_is_listed_only_with_listener() {
        let directory = tempfile::tempdir().unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let is_listed = || running().into_iter().find(|found| found.runtime == directory.path());
        assert_eq!(is_listed(), None);
        let _daemon = listening(&instance, 8);
        let found = is_listed().unwrap();
        assert_eq!((found.name.as_str(), found.pid), ("robot", std::process::id()));
    }

    /// Another user could put another directory there, after the check.
    #[test]
    fn directory_that_others_may_replace_is_foreign() {
        let directory = tempfile::tempdir().unwrap();
        let (open, link) = (directory.path().join("open"), directory.path().join("link"));
        fs::create_dir_all(open.join("robot")).unwrap();
        symlink(&open, &link).unwrap();
        let is_trusted = |path: &Path| is_trusted_directory(path, &TrustedUsers::find());
        assert!(is_trusted(&open.join("robot")));
        assert!(!is_trusted(&link) && !is_trusted(&link.join("robot")), "a link");
        assert!(!is_trusted(&open.join("../open")) && !is_trusted(Path::new("open")));
        fs::set_permissions(&open, Permissions::from_mode(0o777)).unwrap();
        assert!(!is_trusted(&open.join("robot")), "all users may rename it");
        fs::set_permissions(&open, Permissions::from_mode(0o1777)).unwrap();
        assert!(is_trusted(&open.join("robot")));
    }

    /// Variable for a test in a network namespace of its own.
    const ALONE: &str = "MOTORD_TEST_ALONE";

    /// Returns true in a network namespace of its own. Otherwise runs `test` in one, where the computer allows that.
    fn is_alone(test: &str) -> bool {
        if std::env::var_os(ALONE).is_some() {
            return true;
        }
        let mut alone = std::process::Command::new("sh");
        alone.args(["-c", "exec unshare --user --map-root-user --net \"$@\"", "sh"]).env(ALONE, "1");
        let output = alone.arg(std::env::current_exe().unwrap()).args(["--exact", test]).output().unwrap();
        if String::from_utf8_lossy(&output.stdout).contains("running 1 test") {
            assert!(output.status.success(), "{output:?}");
        } else {
            println!("NOT TESTED: this computer allows no such namespaces: {output:?}");
        }
        false
    }

    /// One daemon answers, one is silent, one has a full queue until its callers leave, and one only has a name.
    /// In a network namespace of its own: the stop reaches every daemon of the computer.
    #[test]
    fn every_daemon_is_sent_to_before_any_answer() {
        if !is_alone("running::tests::every_daemon_is_sent_to_before_any_answer") {
            return;
        }
        let directories: Vec<_> = (0..4).map(|_| tempfile::tempdir().unwrap()).collect();
        let instances: Vec<_> =
            directories.iter().map(|directory| Instance::below(directory.path(), "robot").unwrap()).collect();
        let _lock = instances[2].lock().unwrap();
        let sockets: Vec<_> = instances.iter().map(|instance| listening(instance, 1)).collect();
        let callers: Vec<_> = [2, 3]
            .map(|full| {
                let name = address(&instances[full]).unwrap();
                let fill = || {
                    open(SockFlag::SOCK_NONBLOCK)
                        .and_then(|socket| connect(socket.as_raw_fd(), &name).map(|()| socket))
                };
                std::iter::from_fn(|| fill().ok()).collect::<Vec<_>>()
            })
            .into();
        let answers = std::thread::spawn(move || {
            let takes_request = |socket: &OwnedFd| {
                let caller = accept(socket.as_raw_fd()).unwrap();
                let length = recv(caller, &mut [0; MESSAGE_BYTES_MAX], MsgFlags::empty());
                (caller, length == Ok(REQUEST.len()))
            };
            let (confirming, was_requested) = takes_request(&sockets[0]);
            assert!(
                was_requested && takes_request(&sockets[1]).1,
                "the silent one has it before the first answer"
            );
            send(confirming, CONFIRMED, MsgFlags::empty()).unwrap();
            drop(callers);
            let (confirming, _) =
                std::iter::repeat_with(|| takes_request(&sockets[2])).find(|taken| taken.1).unwrap();
            send(confirming, CONFIRMED, MsgFlags::empty()).unwrap();
            sockets
        });
        let stops = stop_all(Duration::from_secs(2));
        let outcome = |index: usize| {
            let runtime = instances[index].runtime();
            stops.trusted.iter().find(|(found, _)| found.runtime == runtime).map(|(_, outcome)| *outcome)
        };
        assert_eq!(
            [0, 1, 2, 3].map(outcome),
            [Some(Ok(())), Some(Err(StopError::NoReply)), Some(Ok(())), None]
        );
        drop(answers.join().unwrap());
    }
}
