//! An instance of motord: its name, the directory shared by daemon and clients, and the daemon's
//! lock.
//!
//! ```text
//! <runtime>/<instance>.lock     locked by the daemon, holds its process id
//! <runtime>/iox/<instance>/     everything of iceoryx2; locked (shared) by every client
//! <runtime>/iox/<instance>.cycle  the number that wakes clients; only the daemon may write it
//! <runtime>/iox/<instance>.round  how often a daemon replaced the files of attached clients; missing at first
//! ```
//!
//! Access to `<runtime>` includes the right to command the motors. Its mode is the only protection:
//! all users who reach the files below may use them. `/run/motord` belongs to a group; every other
//! choice is private to its user.

pub use crate::directory::Displaced;
pub use crate::instance_error::{InstanceError, RUNTIME_DIR_VARIABLE};

use crate::directory::{Directory, OTHERS_WRITE, STICKY};
use crate::instance_error::{ROOT_BYTES_MAX, refused};
use crate::lock_file::{Locks, dead_holder, exclusive, hold, read_number};
use motord_shared::limits::NAME_BYTES_MAX;
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::unistd::{AccessFlags, Uid, access};
use std::fs::{DirBuilder, File};
use std::io::{self, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

/// The runtime directory of a daemon that runs as a service.
pub(crate) const SERVICE_RUNTIME: &str = "/run/motord";

/// Marker below the instance's directory while its daemon opens the services.
const OPENING: &str = "opening";

/// Name and location of an instance, running or not.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Instance {
    name: String,
    runtime: PathBuf,
    /// The runtime directory must be accessible to its user only.
    private: bool,
}

impl Instance {
    /// Finds the instance `name` in the runtime directory of this process. That is
    /// `MOTORD_RUNTIME_DIR`, otherwise `/run/motord` if it exists, otherwise
    /// `$XDG_RUNTIME_DIR/motord`, otherwise a private folder below the directory for temporary
    /// files.
    ///
    /// # Errors
    /// An invalid name, or a directory that is inaccessible or not private.
    pub fn find(name: &str) -> Result<Self, InstanceError> {
        let variable = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let choice =
            choose(variable(RUNTIME_DIR_VARIABLE), Path::new(SERVICE_RUNTIME), variable("XDG_RUNTIME_DIR"));
        match choice {
            Choice::Shared(runtime) => Self::below(&runtime, name),
            Choice::Private(runtime) => {
                // Checked before its first use; each user checks again what it opened.
                match open_runtime(&runtime, true) {
                    Err(error) if !is_missing(&error) => return Err(error),
                    Ok(_) | Err(_) => {}
                }
                Ok(Self::below(&runtime, name)?.made_private())
            }
        }
    }

    /// Returns the instance `name` in the runtime directory `runtime`.
    ///
    /// # Errors
    /// An invalid name, a path that is too long, or an inaccessible runtime directory.
    pub fn below(runtime: &Path, name: &str) -> Result<Self, InstanceError> {
        if !is_name(name) {
            return Err(InstanceError::Name { name: name.to_owned() });
        }
        let sound = |byte: &u8| matches!(byte, b' '..=b'~') && !b"<>\"|?*\\".contains(byte);
        if !runtime.as_os_str().as_bytes().iter().all(sound) {
            return Err(InstanceError::Characters { path: runtime.to_owned() });
        }
        let instance = Self { name: name.to_owned(), runtime: runtime.to_owned(), private: false };
        let root = instance.root();
        if root.as_os_str().len() > ROOT_BYTES_MAX {
            return Err(InstanceError::PathLength { path: root });
        }
        check_access(runtime)?;
        Ok(instance)
    }

    /// Returns the name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the runtime directory.
    #[must_use]
    pub fn runtime(&self) -> &Path {
        &self.runtime
    }

    /// Returns the same instance in a directory that must belong to this user.
    pub(crate) fn made_private(self) -> Self {
        Self { private: true, ..self }
    }

    /// Returns whether its directory must belong to this user.
    pub(crate) const fn is_private(&self) -> bool {
        self.private
    }

    /// Returns the directory of all iceoryx2 files.
    pub(crate) fn root(&self) -> PathBuf {
        self.runtime.join("iox").join(&self.name)
    }

    /// Returns the file that a daemon of this instance locks.
    pub(crate) fn lock_path(&self) -> PathBuf {
        self.runtime.join(self.lock_name())
    }

    fn lock_name(&self) -> String {
        format!("{}.lock", self.name)
    }

    fn open_iox(&self) -> Result<Directory, InstanceError> {
        self.open_runtime()?.open_below("iox")
    }

    pub(crate) fn open_runtime(&self) -> Result<Directory, InstanceError> {
        open_runtime(&self.runtime, self.private)
    }

    fn open_root(&self) -> Result<Directory, InstanceError> {
        self.open_iox()?.open_below(&self.name)
    }

    /// Returns how often a daemon removed the files below attached clients. The names of the
    /// services contain this number: the last client of a service removes it by name, and must not
    /// remove a successor's service. 0 without such a file. Reads a file.
    pub(crate) fn round(&self) -> u64 {
        self.open_iox().map_or(0, |iox| self.read_round(&iox).unwrap_or(0))
    }

    /// Returns `None` without a file of the daemon: a client's file could lead other clients to
    /// wrong services.
    fn read_round(&self, iox: &Directory) -> Option<u64> {
        Some(read_number(&mut iox.open_daemons(&self.round_name(), None).ok()?))
    }

    fn round_name(&self) -> String {
        format!("{}.round", self.name)
    }

    /// Opens the file of the number that clients sleep on, to read. The daemon of an instance may
    /// use a runtime directory of another user.
    ///
    /// # Errors
    /// Those of [`Directory::open_daemons`].
    pub(crate) fn open_futex(&self) -> Result<File, InstanceError> {
        let iox = self.open_iox()?;
        let daemon = iox.open_below(&self.name)?.stat()?.st_uid;
        iox.open_daemons(&self.futex_name(), Some(daemon))
    }

    pub(crate) fn futex_path(&self) -> PathBuf {
        self.runtime.join("iox").join(self.futex_name())
    }

    fn futex_name(&self) -> String {
        format!("{}.cycle", self.name)
    }

    /// Starts the next round with a directory that is as empty as possible: attached clients lose
    /// their daemon and reconnect.
    fn begin_anew(&self) -> Result<(), InstanceError> {
        let iox = self.open_iox()?;
        let _no_worse_than_before = self.count_round(&iox);
        let _no_worse_than_before = clear_below_clients(&iox.open_below(&self.name)?);
        Ok(())
    }

    fn count_round(&self, iox: &Directory) -> Result<(), InstanceError> {
        let (name, next) = (self.round_name(), self.round().wrapping_add(1));
        iox.remove(name.as_ref())?;
        write!(iox.make_ours(&name)?, "{next}").map_err(|error| refused(&iox.path.join(&name), errno(&error)))
    }

    /// Locks this instance for its only daemon, until the lock is dropped or the process dies.
    /// Removes the files of dead processes, unless an attached client waits for its daemon to
    /// restart. If the last daemon died of these files, removes them in any case.
    ///
    /// # Errors
    /// [`InstanceError::AlreadyRunning`] with the holder's process id; others when the directory
    /// cannot be used.
    pub fn lock(&self) -> Result<InstanceLock, InstanceError> {
        match DirBuilder::new().mode(0o700).create(&self.runtime) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
                return Err(refused(&self.runtime, errno(&error)));
            }
            _ => {}
        }
        let runtime = self.open_runtime()?;
        let mut displaced = Vec::new();
        let lock = hold(&runtime, &self.lock_name(), &mut displaced)?;
        let mode = runtime.stat()?.st_mode;
        if mode & OTHERS_WRITE != 0 {
            runtime.set_mode(mode | STICKY);
        }
        let iox = runtime.make_below("iox", mode & 0o2777 | STICKY, &mut displaced)?;
        let root = iox.make_below(&self.name, mode & 0o2777, &mut displaced)?;
        self.sweep(&root)?;
        Ok(InstanceLock { instance: self.clone(), displaced, _lock: lock })
    }

    /// iceoryx2 leaves some files per killed process, and a file truncated by a full disk would
    /// block every service. With the daemon's lock held and no client attached, no process needs
    /// these files. Clients reconnect if the daemon dies of these files, or is killed in the
    /// milliseconds in which it opens them.
    fn sweep(&self, root: &Directory) -> Result<(), InstanceError> {
        if root.changed(OPENING.as_ref()).is_some() {
            return self.begin_anew();
        }
        let Ok(_exclusive) = Flock::lock(root.file()?, FlockArg::LockExclusiveNonblock) else {
            return Ok(());
        };
        clear_below_clients(root)
    }

    /// Registers this process as a user of the instance, so that a starting daemon keeps its files.
    /// `None` when no daemon ever ran here, or one is just starting.
    ///
    /// # Errors
    /// The directory cannot be used.
    pub fn attach(&self) -> Result<Option<Attachment>, InstanceError> {
        check_access(&self.root())?;
        let directory = match self.open_root().and_then(|root| root.file()) {
            Err(error) if is_missing(&error) => return Ok(None),
            other => other?,
        };
        match Flock::lock(directory, FlockArg::LockSharedNonblock) {
            Ok(lock) => Ok(Some(Attachment { instance: self.clone(), _lock: lock })),
            Err((_, Errno::EWOULDBLOCK)) => self.check_lock(),
            Err((_, errno)) => Err(InstanceError::System { path: self.root(), errno }),
        }
    }

    /// Returns the process id of the last daemon, if it died without [stopping its
    /// motors](InstanceLock::rest). `None` when unknown.
    #[must_use]
    pub fn died(&self) -> Option<u32> {
        dead_holder(&self.lock_path())
    }

    /// A daemon locks the directory for the first milliseconds of its life. Any member can.
    fn check_lock(&self) -> Result<Option<Attachment>, InstanceError> {
        let (path, daemon) = (self.root(), self.lock_path());
        match exclusive(&path) {
            held @ Locks::Held { pid } if held != exclusive(&daemon) => {
                Err(InstanceError::Locked { path, pid })
            }
            Locks::Held { .. } | Locks::Free | Locks::Unknown => Ok(None),
        }
    }
}

/// Returns `true` if `name` is a valid name of an instance.
pub(crate) fn is_name(name: &str) -> bool {
    let of_a_name = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-');
    (1..=NAME_BYTES_MAX).contains(&name.len()) && name.bytes().all(of_a_name)
}

/// The lock held by the only daemon of an instance.
#[derive(Debug)]
pub struct InstanceLock {
    instance: Instance,
    displaced: Vec<Displaced>,
    _lock: Flock<File>,
}

impl InstanceLock {
    /// Returns the files of other users that were in the way.
    #[must_use]
    pub fn displaced(&self) -> &[Displaced] {
        &self.displaced
    }

    /// Returns the locked instance.
    #[must_use]
    pub fn instance(&self) -> &Instance {
        &self.instance
    }

    /// Records that the motors are stopped: the end of this process is no [death](Instance::died).
    pub fn rest(&self) {
        // Without the record, a client says that motors may still move.
        let _unwritable = self._lock.set_len(0);
    }

    /// Marks that this daemon uses the files of other processes, until the guard is dropped. If it
    /// dies of them, its successor uses none of them.
    pub(crate) fn opening(&self) -> Opening<'_> {
        let _marked = self.instance.open_root().and_then(|root| root.make_file(OPENING));
        Opening(self)
    }

    /// Removes every file below the instance's directory that can be removed. Attached clients lose
    /// their daemon and reconnect.
    pub(crate) fn clear(&self) {
        let _unusable = self.instance.begin_anew();
    }

    /// Removes the socket `<instance>.<role>` of a dead daemon, or what another user created in its
    /// place. The lock proves that its daemon is dead.
    ///
    /// # Errors
    /// The file cannot be removed.
    pub(crate) fn clear_socket(&self, role: &str) -> Result<(), InstanceError> {
        let runtime = self.instance.open_runtime()?;
        runtime.clear_name(&format!("{}.{role}", self.instance.name), &mut Vec::new())
    }

    /// Opens the file of the number that clients sleep on, to write. Creates it if it is missing or
    /// belongs to another user.
    ///
    /// # Errors
    /// Those of [`Directory::make_ours`].
    pub(crate) fn make_futex(&self) -> Result<File, InstanceError> {
        self.instance.open_iox()?.make_ours(&self.instance.futex_name())
    }

    /// Returns the locked file.
    pub(crate) fn path(&self) -> PathBuf {
        self.instance.lock_path()
    }
}

/// Exists while a daemon opens its services. Its file remains if damaged shared memory kills the
/// daemon meanwhile.
#[derive(Debug)]
pub(crate) struct Opening<'a>(&'a InstanceLock);

impl Drop for Opening<'_> {
    fn drop(&mut self) {
        let _left = self.0.instance.open_root().and_then(|root| root.remove(OPENING.as_ref()));
    }
}

/// Held by every client of an instance.
#[derive(Debug)]
pub struct Attachment {
    instance: Instance,
    _lock: Flock<File>,
}

impl Attachment {
    /// Returns the attached instance.
    #[must_use]
    pub fn instance(&self) -> &Instance {
        &self.instance
    }
}

/// Returns the namespace of this process's id, for `AdminRequest::pid_namespace`; 0 when unknown.
#[must_use]
pub fn pid_namespace() -> u64 {
    nix::sys::stat::stat("/proc/self/ns/pid").map_or(0, |namespace| namespace.st_ino)
}

/// A runtime directory, by its users.
#[derive(Debug, PartialEq, Eq)]
enum Choice {
    /// Users chosen by its owner.
    Shared(PathBuf),
    /// Its user alone.
    Private(PathBuf),
}

fn choose(named: Option<PathBuf>, service: &Path, session: Option<PathBuf>) -> Choice {
    if let Some(named) = named {
        return Choice::Shared(named);
    }
    if service.is_dir() {
        return Choice::Shared(service.to_owned());
    }
    let temporary = || std::env::temp_dir().join(format!("motord-{}", Uid::effective()));
    let session = session.filter(|session| session.is_dir()).map(|session| session.join("motord"));
    Choice::Private(session.unwrap_or_else(temporary))
}

/// Opens a runtime directory. A `private` one must be accessible to this user only: in a directory
/// that all users may write to, any of them may have created it.
fn open_runtime(path: &Path, private: bool) -> Result<Directory, InstanceError> {
    let uid = Uid::effective().as_raw();
    let not_private = || InstanceError::NotPrivate { path: path.to_owned(), uid };
    let opened = match Directory::open(path, !private) {
        Err(InstanceError::NotDirectory { .. }) if private => return Err(not_private()),
        other => other?,
    };
    let found = opened.stat()?;
    if private && (found.st_uid != uid || found.st_mode & 0o077 != 0) {
        return Err(not_private());
    }
    Ok(opened)
}

pub(crate) fn is_missing(error: &InstanceError) -> bool {
    matches!(error, InstanceError::System { errno: Errno::ENOENT, .. })
}

/// A missing directory is no obstacle: the daemon creates it, and a client finds no daemon.
fn check_access(path: &Path) -> Result<(), InstanceError> {
    match access(path, AccessFlags::R_OK | AccessFlags::W_OK | AccessFlags::X_OK) {
        Ok(()) | Err(Errno::ENOENT) => Ok(()),
        Err(Errno::EACCES) => Err(InstanceError::Permission { path: path.to_owned() }),
        Err(errno) => Err(InstanceError::System { path: path.to_owned(), errno }),
    }
}

/// A process that creates files meanwhile, such as a registering client, may prevent the removal of
/// a directory. The rest causes no harm, and is no error.
fn clear_below_clients(root: &Directory) -> Result<(), InstanceError> {
    const TRIES: usize = 20;
    let cleared = (1..TRIES).find_map(|_| root.clear().ok());
    match cleared.map_or_else(|| root.clear(), Ok) {
        Err(InstanceError::System { errno: Errno::ENOTEMPTY, .. }) => Ok(()),
        cleared => cleared,
    }
}

fn errno(error: &io::Error) -> Errno {
    Errno::from_raw(error.raw_os_error().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{self, Permissions};
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};

    fn directory() -> tempfile::TempDir {
        tempfile::tempdir_in("/tmp").unwrap()
    }

    #[test]
    fn named_directory_precedes_service_precedes_session() {
        let (named, service, session) = (directory(), directory(), directory());
        let path = |directory: &tempfile::TempDir| directory.path().to_owned();
        let missing = Path::new("/nonexistent/motord");
        assert_eq!(
            choose(Some(path(&named)), service.path(), Some(path(&session))),
            Choice::Shared(path(&named))
        );
        assert_eq!(choose(None, service.path(), Some(path(&session))), Choice::Shared(path(&service)));
        assert_eq!(
            choose(None, missing, Some(path(&session))),
            Choice::Private(session.path().join("motord"))
        );
        let Choice::Private(temporary) = choose(None, missing, Some(missing.to_owned())) else {
            panic!("a folder below the temporary ones must be private")
        };
        assert!(temporary.starts_with(std::env::temp_dir()));
    }

    #[test]
    fn accessible_private_directory_is_refused() {
        let directory = directory();
        let (open, link, file) =
            (directory.path().join("open"), directory.path().join("link"), directory.path().join("file"));
        fs::create_dir(&open).unwrap();
        fs::set_permissions(&open, Permissions::from_mode(0o750)).unwrap();
        symlink(directory.path(), &link).unwrap();
        fs::write(&file, "").unwrap();
        for path in [open, link, file] {
            let refused = open_runtime(&path, true);
            assert!(matches!(refused, Err(InstanceError::NotPrivate { .. })), "{}", path.display());
        }
        fs::set_permissions(directory.path(), Permissions::from_mode(0o700)).unwrap();
        assert!(open_runtime(directory.path(), true).is_ok());
        assert!(is_missing(&open_runtime(&directory.path().join("missing"), true).unwrap_err()));
    }

    #[test]
    fn path_too_long_for_sockets_is_refused() {
        let runtime = Path::new("/tmp").join("x".repeat(60));
        assert!(matches!(Instance::below(&runtime, "robot"), Err(InstanceError::PathLength { .. })));
        let longest = "0123456789abcdef0123456789abcdef";
        assert!(Instance::below(Path::new("/run/user/1000/motord"), longest).is_ok());
    }

    #[test]
    fn starting_daemon_removes_leftovers_without_waiting_clients() {
        let directory = directory();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        drop(instance.lock().unwrap());
        let left_behind = instance.root().join("nodes");
        fs::create_dir(&left_behind).unwrap();
        fs::write(left_behind.join("m_1.node_monitor"), "").unwrap();
        let client = instance.attach().unwrap().unwrap();
        drop(instance.lock().unwrap());
        assert!(left_behind.exists(), "the files of a waiting client are left alone");
        drop(client);
        drop(instance.lock().unwrap());
        assert!(!left_behind.exists() && instance.root().exists());
    }

    #[test]
    fn daemon_killed_by_leftovers_has_clean_successor() {
        let directory = directory();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let lock = instance.lock().unwrap();
        let left_behind = instance.root().join("damaged");
        let _client = instance.attach().unwrap().unwrap();
        fs::write(&left_behind, "").unwrap();
        drop(lock.opening());
        drop(lock);
        let lock = instance.lock().unwrap();
        assert!(left_behind.exists(), "a daemon that opened its services lived");
        std::mem::forget(lock.opening());
        drop(lock);
        drop(instance.lock().unwrap());
        assert_eq!(fs::read_dir(instance.root()).unwrap().count(), 0);
    }

    #[test]
    fn registering_client_blocks_no_fresh_start() {
        let directory = directory();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        drop(instance.lock().unwrap());
        let nodes = instance.root().join("nodes");
        let over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !over.load(std::sync::atomic::Ordering::Relaxed) {
                    let _removed_meanwhile = fs::create_dir(&nodes);
                    let _removed_meanwhile = fs::write(nodes.join("m_1.node_monitor"), "");
                }
            });
            for _ in 0..100 {
                let locked = instance.lock().map(|lock| std::mem::forget(lock.opening()));
                over.fetch_or(locked.is_err(), std::sync::atomic::Ordering::Relaxed);
                locked.unwrap();
            }
            over.store(true, std::sync::atomic::Ordering::Relaxed);
        });
    }

    #[test]
    fn instance_is_open_to_directory_members_only() {
        for mode in [0o700, 0o2770] {
            let directory = directory();
            fs::set_permissions(directory.path(), Permissions::from_mode(mode)).unwrap();
            let instance = Instance::below(directory.path(), "robot").unwrap();
            let _lock = instance.lock().unwrap();
            assert_eq!(fs::metadata(instance.root()).unwrap().mode() & 0o7777, mode);
        }
    }

    #[test]
    fn link_below_runtime_directory_is_not_followed() {
        for link in ["iox", "iox/robot", "iox/robot/services"] {
            let (directory, other) = (directory(), directory());
            fs::create_dir_all(other.path().join("robot/services")).unwrap();
            let treasure = other.path().join("robot/services/treasure");
            fs::write(&treasure, "kept").unwrap();
            fs::write(other.path().join("robot/treasure"), "kept").unwrap();
            let link = directory.path().join(link);
            fs::create_dir_all(link.parent().unwrap()).unwrap();
            symlink(other.path().join(link.strip_prefix(directory.path().join("iox")).unwrap()), &link)
                .unwrap();
            let instance = Instance::below(directory.path(), "robot").unwrap();
            let _refused_or_swept = instance.lock();
            assert!(treasure.exists() && other.path().join("robot/treasure").exists(), "{}", link.display());
        }
    }

    #[test]
    fn character_refused_by_iceoryx2_is_refused_clearly() {
        let directory = directory();
        for odd in ["r\u{f6}bot", "a*b", "a?b", "a<b", "a\nb", "a\\b", "a\"b"] {
            let refused = Instance::below(&directory.path().join(odd), "robot").unwrap_err();
            assert!(matches!(refused, InstanceError::Characters { .. }), "{odd:?}: {refused}");
        }
        let sound = Instance::below(&directory.path().join("a b-c_d.e+f"), "robot").unwrap();
        assert!(sound.lock().is_ok());
    }

    #[test]
    fn only_owner_may_remove_daemon_files() {
        let directory = directory();
        fs::set_permissions(directory.path(), Permissions::from_mode(0o2770)).unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let _lock = instance.lock().unwrap();
        for path in [directory.path().to_owned(), directory.path().join("iox")] {
            assert_eq!(fs::metadata(&path).unwrap().mode() & 0o7777, 0o3770, "{}", path.display());
        }
    }
}
