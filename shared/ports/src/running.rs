//! The daemons of this computer, found by the names of their sockets for emergency stops, and a
//! stop of all of them at once.
//!
//! Any user may take a free name, as often as the limit of descriptors permits, and name any
//! directory in it. A daemon counts only if its process and its directory belong to
//! [`TrustedUsers`]. Nothing in the directory of another one is opened, and no directory is looked
//! at before every request is sent.

use crate::directory::{OTHERS_WRITE, STICKY};
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
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

/// Flags of a listening socket in `/proc/net/unix`.
const LISTENING: &[u8] = b"00010000";
/// Pause between two attempts to reach a daemon that has too many connections, ms.
const RETRY_MS: u16 = 1;
/// Longest wait for the directories: a file system may not answer.
const CHECK_MAX: Duration = Duration::from_millis(200);
/// Mode bit with which the group may write to a directory.
const GROUP_WRITES: u32 = 0o020;

/// A daemon that runs in this network namespace.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct RunningInstance {
    /// The instance's name.
    pub name: String,
    /// Its runtime directory.
    pub runtime: PathBuf,
    /// The daemon's process id; 0 when it lives in another process namespace, or its socket has too
    /// many callers.
    pub pid: u32,
    /// The daemon's user; `u32::MAX` of an unknown process, whose socket has too many callers.
    pub uid: u32,
}

/// The processes that listen for emergency stops, each list sorted.
#[derive(Debug)]
pub struct Listeners {
    /// The daemons of [`TrustedUsers`]. Their values need no quotes in a shell: an instance has a
    /// valid name, and directories with characters other than letters, digits and `/._+-` are
    /// omitted.
    pub daemons: Vec<RunningInstance>,
    /// All other processes under names of daemons. They may be daemons.
    pub foreign: Vec<RunningInstance>,
}

/// Returns the processes that listen for emergency stops. Sends no request.
#[must_use]
pub fn listeners() -> Listeners {
    let users = trusted_users();
    let mut candidates = candidates();
    candidates.iter_mut().for_each(|candidate| drop(candidate.meet(&users)));
    candidates.retain(|candidate| !candidate.is_unbound());
    let (mut daemons, mut foreign) = (Vec::new(), Vec::new());
    for (candidate, verdict) in check_directories(candidates, &users) {
        match verdict {
            Verdict::Daemon(instance) => daemons.push(instance),
            Verdict::Foreign | Verdict::Late => foreign.push(candidate.instance),
        }
    }
    Listeners { daemons: sorted(daemons), foreign: sorted(foreign) }
}

/// Returns the daemons of [`listeners`].
#[must_use]
pub fn running() -> Vec<RunningInstance> {
    listeners().daemons
}

/// The outcome of [`stop_all`].
#[derive(Debug)]
pub struct AllStops {
    /// The daemons of [`TrustedUsers`], with the reason if one did not confirm.
    pub trusted: Vec<(RunningInstance, Result<(), StopError>)>,
    /// The other processes to which the request was sent. Their answers do not count.
    pub foreign: Vec<RunningInstance>,
    /// The processes that did not get the request, or whose directories were not checked in time.
    /// They are no daemons of [`TrustedUsers`], unless the reason is [`StopError::System`]: then
    /// that is unknown.
    pub unreached: Vec<(RunningInstance, StopError)>,
}

/// Requests every process that listens for emergency stops to damp and stop its motors, and waits
/// at most `timeout` for the confirmations, then at most 0.2 s for the directories. No request
/// waits for an answer, a full queue, a directory or another process.
#[must_use]
pub fn stop_all(timeout: Duration) -> AllStops {
    let end = Instant::now() + timeout;
    let users = trusted_users();
    let mut candidates = candidates();
    candidates.iter_mut().for_each(|candidate| candidate.request(&users));
    candidates.retain(|candidate| !candidate.is_unbound());
    while candidates.iter().any(|candidate| !candidate.is_over()) && Instant::now() < end {
        await_answers(&candidates, end);
        candidates.iter_mut().for_each(|candidate| candidate.turn(&users));
    }
    let mut stops = AllStops { trusted: Vec::new(), foreign: Vec::new(), unreached: Vec::new() };
    for (candidate, verdict) in check_directories(candidates, &users) {
        let unreached = candidate.outcome.and_then(Result::err).unwrap_or(candidate.obstacle);
        match verdict {
            Verdict::Daemon(instance) => {
                stops.trusted.push((instance, candidate.outcome.unwrap_or(Err(candidate.obstacle))));
            }
            Verdict::Foreign if candidate.is_requested => stops.foreign.push(candidate.instance),
            Verdict::Foreign => stops.unreached.push((candidate.instance, unreached)),
            Verdict::Late => {
                stops.unreached.push((candidate.instance, StopError::System(Errno::ETIMEDOUT)));
            }
        }
    }
    stops.foreign = sorted(stops.foreign);
    stops.trusted.sort_by(|first, second| first.0.cmp(&second.0));
    stops.unreached.sort_by(|first, second| first.0.cmp(&second.0));
    stops
}

fn sorted(instances: impl IntoIterator<Item = RunningInstance>) -> Vec<RunningInstance> {
    let mut sorted: Vec<_> = instances.into_iter().collect();
    sorted.sort();
    sorted.dedup();
    sorted
}

/// Returns the users whose daemons count here. The runtime directory of this process was chosen by
/// its user.
fn trusted_users() -> TrustedUsers {
    let here = Instance::find("robot");
    here.iter().fold(TrustedUsers::find(), TrustedUsers::and_of)
}

/// Whose process listens at a stop socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Standing {
    /// That of a trusted user. Its directory decides whether it counts.
    Trusted,
    Foreign,
    /// No connection was possible: its queue is full, which any user can bring about, or this
    /// process lacks a descriptor.
    Unknown,
}

/// A process that listens under the name of a daemon.
#[derive(Debug)]
struct Candidate {
    instance: RunningInstance,
    /// The name of the socket.
    name: Vec<u8>,
    standing: Standing,
    /// Open only while an answer that counts may arrive: foreign names may be more than this
    /// process has descriptors.
    socket: Option<OwnedFd>,
    is_requested: bool,
    /// `None` while a confirmation may still arrive.
    outcome: Option<Result<(), StopError>>,
    /// Why there is no outcome.
    obstacle: StopError,
}

impl Candidate {
    fn new(Name { name, instance, runtime }: Name) -> Self {
        let instance = RunningInstance { name: instance, runtime, pid: 0, uid: u32::MAX };
        let (standing, obstacle) = (Standing::Unknown, StopError::NoReply);
        Self { instance, name, standing, socket: None, is_requested: false, outcome: None, obstacle }
    }

    /// Connects, and finds out whose process that is. Does not block.
    fn meet(&mut self, users: &TrustedUsers) -> Option<OwnedFd> {
        match contact(&self.name) {
            Ok((socket, peer)) => {
                // The name may have changed hands meanwhile.
                if self.standing == Standing::Trusted && self.instance.uid != peer.uid() {
                    self.outcome = Some(Err(StopError::NotRunning));
                    return Some(socket);
                }
                let is_trusted = users.contains(peer.uid());
                self.standing = if is_trusted { Standing::Trusted } else { Standing::Foreign };
                (self.instance.pid, self.instance.uid) = (peer.pid().cast_unsigned(), peer.uid());
                self.obstacle = StopError::NoReply;
                return Some(socket);
            }
            Err(Errno::ECONNREFUSED) => self.outcome = Some(Err(StopError::NotRunning)),
            Err(Errno::EAGAIN | Errno::EINTR) => self.obstacle = StopError::NoReply,
            Err(errno) => self.obstacle = StopError::System(errno),
        }
        None
    }

    /// Connects and sends the request. Keeps the connection if an answer may count. Does not block.
    fn request(&mut self, users: &TrustedUsers) {
        let Some(socket) = self.meet(users) else { return };
        let flags = MsgFlags::MSG_NOSIGNAL | MsgFlags::MSG_DONTWAIT;
        // A daemon with too many callers drops the first ones without a request.
        let is_sent = send(socket.as_raw_fd(), REQUEST, flags).is_ok();
        self.is_requested |= is_sent;
        let may_count = is_sent && self.standing == Standing::Trusted && self.outcome.is_none();
        self.socket = may_count.then_some(socket);
    }

    /// Returns true if no process listened under the name at the first attempt.
    fn is_unbound(&self) -> bool {
        self.standing == Standing::Unknown && self.outcome.is_some()
    }

    /// Returns true if there is no more to send or receive.
    fn is_over(&self) -> bool {
        self.outcome.is_some() || (self.standing == Standing::Foreign && self.is_requested)
    }

    /// Asks again a daemon that had too many callers, and takes its answer. Does not block.
    fn turn(&mut self, users: &TrustedUsers) {
        if self.is_over() {
            return;
        }
        if self.socket.is_none() {
            self.request(users);
        }
        let Some(socket) = &self.socket else { return };
        let mut reply = [0; MESSAGE_BYTES_MAX];
        match recv(socket.as_raw_fd(), &mut reply, MsgFlags::MSG_DONTWAIT) {
            Ok(length) if reply[..length] == *CONFIRMED => self.outcome = Some(Ok(())),
            Ok(length) if reply[..length] == *NO_CYCLE => self.outcome = Some(Err(StopError::NoCycle)),
            Ok(length) if reply[..length] == *NOT_PERMITTED => {
                self.outcome = Some(Err(StopError::NotPermitted));
            }
            Err(Errno::EAGAIN | Errno::EINTR) => return,
            Ok(_) | Err(_) => {}
        }
        self.socket = None;
    }
}

/// The decision about a candidate.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Verdict {
    /// The daemon of a trusted user.
    Daemon(RunningInstance),
    Foreign,
    /// A file system did not answer in time.
    Late,
}

/// A candidate whose directory is to be looked at.
#[derive(Debug, Clone)]
struct Case {
    /// Its index among the candidates.
    index: usize,
    instance: RunningInstance,
    standing: Standing,
}

impl Case {
    fn decide(self, users: &TrustedUsers) -> Verdict {
        let daemon = match is_trusted_directory(&self.instance.runtime, users) {
            true if self.standing == Standing::Trusted => Some(self.instance),
            true => self.seen_alive(users),
            false => None,
        };
        daemon.map_or(Verdict::Foreign, Verdict::Daemon)
    }

    /// Returns the instance of a process that shows no credentials, if a daemon of a trusted user
    /// holds the lock of the instance, or just died without stopping its motors.
    fn seen_alive(&self, users: &TrustedUsers) -> Option<RunningInstance> {
        let instance = Instance::below(&self.instance.runtime, &self.instance.name).ok()?;
        let lock = lstat(&instance.lock_path()).ok()?;
        let is_daemon =
            users.contains(lock.st_uid) && (!liveness::is_dead(&instance) || instance.died().is_some());
        is_daemon.then(|| RunningInstance { uid: lock.st_uid, ..self.instance.clone() })
    }
}

/// Closes all connections, and decides about each candidate. Waits at most [`CHECK_MAX`]: any user
/// may name a directory whose file system does not answer. Without a thread for it, waits as long
/// as the file systems take. Processes of trusted users come first.
fn check_directories(mut candidates: Vec<Candidate>, users: &TrustedUsers) -> Vec<(Candidate, Verdict)> {
    candidates.iter_mut().for_each(|candidate| candidate.socket = None);
    let mut verdicts = vec![Verdict::Foreign; candidates.len()];
    let mut cases = Vec::new();
    for (index, Candidate { instance, standing, .. }) in candidates.iter().enumerate() {
        if *standing != Standing::Foreign {
            verdicts[index] = Verdict::Late;
            cases.push(Case { index, instance: instance.clone(), standing: *standing });
        }
    }
    cases.sort_by_key(|case| case.standing != Standing::Trusted);
    let (end, left, users) = (Instant::now() + CHECK_MAX, cases.len(), users.clone());
    let (sender, verdict_of) = channel();
    let decide_all = move || {
        for case in cases {
            let _given_up = sender.send((case.index, case.decide(&users)));
        }
    };
    if left > 0 && std::thread::Builder::new().spawn(decide_all.clone()).is_err() {
        decide_all();
    }
    for _ in 0..left {
        let Ok((index, verdict)) = verdict_of.recv_timeout(end.saturating_duration_since(Instant::now()))
        else {
            break;
        };
        verdicts[index] = verdict;
    }
    candidates.into_iter().zip(verdicts).collect()
}

/// Waits for an answer until `end`, or for the next attempt to connect.
fn await_answers(candidates: &[Candidate], end: Instant) {
    let open = || candidates.iter().filter(|candidate| !candidate.is_over());
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

/// Returns every listening socket with the name of a daemon, the likely ones first. Connects to
/// none.
fn candidates() -> Vec<Candidate> {
    let likely = Instance::find("robot").map_or_else(
        |_| instance::SERVICE_RUNTIME.into(),
        |here| fs::canonicalize(here.runtime()).unwrap_or_else(|_| here.runtime().to_owned()),
    );
    let table = fs::read("/proc/net/unix").unwrap_or_default();
    let mut names: Vec<_> = table.split(|byte| *byte == b'\n').filter_map(name_in).collect();
    names.sort_by_cached_key(|name| (name.runtime != likely, name.name.clone()));
    names.dedup();
    names.into_iter().map(Candidate::new).collect()
}

/// Returns the name in a line of `/proc/net/unix`, if the line shows a listening socket with that
/// of a daemon.
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

/// Returns true if only trusted users decide which directory is at `path`, and it belongs to one of
/// them. A daemon names its directory without links. Walks down from the root, and looks at nothing
/// below a directory of another user, or one whose entries another user may replace. Opens only
/// names.
fn is_trusted_directory(path: &Path, users: &TrustedUsers) -> bool {
    let mut parts = path.components();
    let is_plain = |part: Component<'_>| matches!(part, Component::Normal(_));
    if parts.next() != Some(Component::RootDir) || !parts.clone().all(is_plain) {
        return false;
    }
    let flags = OFlag::O_PATH | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC;
    let Ok(mut reached) = openat(AT_FDCWD, "/", flags, Mode::empty()) else { return false };
    // In a namespace of users, root of the computer may have another number.
    let root = fstat(&reached).map(|root| root.st_uid);
    let is_fixed = |above: FileStat| {
        // A group with the number of its user is that user's own, by Debian's convention: umask 002
        // is usual there.
        let is_private_group = above.st_gid == above.st_uid;
        let others_write = if is_private_group { OTHERS_WRITE & !GROUP_WRITES } else { OTHERS_WRITE };
        let is_replaced_by_others = above.st_mode & others_write != 0 && above.st_mode & STICKY == 0;
        let is_directory = above.st_mode & SFlag::S_IFMT.bits() == SFlag::S_IFDIR.bits();
        is_directory && !is_replaced_by_others && (users.contains(above.st_uid) || root == Ok(above.st_uid))
    };
    for part in parts {
        if !fstat(&reached).is_ok_and(is_fixed) {
            return false;
        }
        match openat(&reached, part.as_os_str(), flags, Mode::empty()) {
            Ok(below) => reached = below,
            Err(_) => return false,
        }
    }
    // Its group may write to the runtime directory itself.
    fstat(&reached).is_ok_and(|found| {
        found.st_mode & SFlag::S_IFMT.bits() == SFlag::S_IFDIR.bits() && users.contains(found.st_uid)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stop_socket::address;
    use nix::sys::socket::{Backlog, accept, bind, listen};
    use std::fs::Permissions;
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};

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

    /// Returns connections that fill the queue of an instance.
    fn filling(instance: &Instance) -> Vec<OwnedFd> {
        let name = address(instance).unwrap();
        let call = || {
            let socket = open(SockFlag::SOCK_NONBLOCK)?;
            connect(socket.as_raw_fd(), &name).map(|()| socket)
        };
        std::iter::from_fn(|| call().ok()).collect()
    }

    /// Another user could put another directory there, after the check.
    #[test]
    fn directory_that_others_may_replace_is_foreign() {
        let directory = tempfile::tempdir().unwrap();
        let (open, link) = (directory.path().join("open"), directory.path().join("link"));
        fs::create_dir_all(open.join("robot")).unwrap();
        let set_mode = |path: &Path, mode| fs::set_permissions(path, Permissions::from_mode(mode)).unwrap();
        set_mode(&open, 0o755);
        symlink(&open, &link).unwrap();
        let is_trusted = |path: &Path| is_trusted_directory(path, &TrustedUsers::find());
        assert!(is_trusted(&open.join("robot")));
        assert!(!is_trusted(&link) && !is_trusted(&link.join("robot")), "a link");
        assert!(!is_trusted(&open.join("../open")) && !is_trusted(Path::new("open")));
        // Only root may give it to another group than that of the user.
        let _owned = std::os::unix::fs::chown(&open, None, Some(1));
        let owner = fs::metadata(&open).unwrap();
        let is_private_group = owner.uid() == owner.gid();
        for (mode, who) in [(0o777, "all users"), (0o770, "its group")] {
            set_mode(&open, mode);
            let is_private = is_private_group && mode == 0o770;
            assert_eq!(is_trusted(&open.join("robot")), is_private, "{who} may rename it");
            set_mode(&open, 0o1000 | mode);
            assert!(is_trusted(&open.join("robot")), "{who} may not rename it");
        }
        if std::os::unix::fs::chown(&open, None, Some(owner.uid())).is_ok() {
            set_mode(&open, 0o770);
            assert!(is_trusted(&open.join("robot")), "the group of its user may rename it");
        }
        set_mode(&open, 0o2770);
        assert!(is_trusted(&open), "members may write to the runtime directory");
        fs::write(open.join("file"), "").unwrap();
        assert!(!is_trusted(&open.join("file")) && !is_trusted(&open.join("missing")));
    }

    /// Variable for a test in a network namespace of its own.
    const ALONE: &str = "MOTORD_TEST_ALONE";

    /// Returns true in a network namespace of its own. Otherwise runs `test` in one, where the
    /// computer allows that.
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

    /// One daemon answers, one is silent, one has a full queue until its callers leave, and one
    /// only has a name. In a network namespace of its own: the stop reaches every daemon of the
    /// computer.
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
        let callers = [2, 3].map(|full| filling(&instances[full]));
        let answers = std::thread::spawn(move || {
            let accepts_request = |socket: &OwnedFd| {
                let caller = accept(socket.as_raw_fd()).unwrap();
                let length = recv(caller, &mut [0; MESSAGE_BYTES_MAX], MsgFlags::empty());
                (caller, length == Ok(REQUEST.len()))
            };
            let (confirming, was_requested) = accepts_request(&sockets[0]);
            assert!(
                was_requested && accepts_request(&sockets[1]).1,
                "the silent one has it before the first answer"
            );
            send(confirming, CONFIRMED, MsgFlags::empty()).unwrap();
            drop(callers);
            let (confirming, _) =
                std::iter::repeat_with(|| accepts_request(&sockets[2])).find(|taken| taken.1).unwrap();
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
        let unreached: Vec<_> =
            stops.unreached.iter().map(|(found, error)| (found.runtime.as_path(), *error)).collect();
        assert_eq!(unreached, [(instances[3].runtime(), StopError::NoReply)], "a full queue is not hidden");
        assert!(listeners().foreign.iter().any(|found| found.runtime == instances[3].runtime()));
        drop(answers.join().unwrap());
    }
}
