//! An instance of motord: its name, the directory where daemon and clients meet, and who holds it.
//!
//! ```text
//! <runtime>/<instance>.lock     locked by the daemon, holds its process id
//! <runtime>/iox/<instance>/     everything of iceoryx2; locked (shared) by every client
//! ```
//!
//! Who may enter `<runtime>` may command the motors. The files below are open to everybody who can reach them, so the
//! directory alone decides: `/run/motord` belongs to a group, every other choice is private to its user.

use crate::limits::NAME_BYTES_MAX;
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::sys::signal::kill;
use nix::unistd::{AccessFlags, Pid, Uid, access};
use std::fs::{self, DirBuilder, File, OpenOptions, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// The variable that names another runtime directory.
pub const RUNTIME_DIR_VARIABLE: &str = "MOTORD_RUNTIME_DIR";

/// The runtime directory of a daemon that runs as a service.
const SERVICE_RUNTIME: &str = "/run/motord";

/// Most bytes of an instance's root path. Its sockets lie below it: a socket's path holds 107 bytes, and
/// `/m_<number of up to 39 digits>.event` takes 48 of them.
const ROOT_BYTES_MAX: usize = 107 - 48;

/// Why an instance cannot be reached or held.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum InstanceError {
    /// The name has a form that no instance has.
    #[error("{name:?} is no instance name: use 1 to {NAME_BYTES_MAX} of the characters a-z, 0-9 and -")]
    Name {
        /// The name that was given.
        name: String,
    },
    /// The user may not enter the runtime directory.
    #[error(
        "no permission for {}: join the group that owns it, or name another directory in {RUNTIME_DIR_VARIABLE}",
        path.display()
    )]
    Permission {
        /// The directory that could not be entered.
        path: PathBuf,
    },
    /// Someone else prepared, or could enter, a directory that must be private.
    #[error(
        "{} must be a directory of user {uid} that nobody else can enter: remove it, or name another directory in \
         {RUNTIME_DIR_VARIABLE}",
        path.display()
    )]
    NotPrivate {
        /// The directory.
        path: PathBuf,
        /// Who should own it.
        uid: u32,
    },
    /// The sockets would get paths that are too long for the system.
    #[error(
        "{} is too long, an instance's path may have {ROOT_BYTES_MAX} bytes: name a shorter directory in \
         {RUNTIME_DIR_VARIABLE}",
        path.display()
    )]
    PathLength {
        /// The instance's path.
        path: PathBuf,
    },
    /// Another daemon holds the instance.
    #[error("process {pid} already runs this instance: stop it first, or run another instance ({})", path.display())]
    AlreadyRunning {
        /// The holder; 0 when it did not tell yet.
        pid: u32,
        /// The lock that it holds.
        path: PathBuf,
    },
    /// The system refused something else.
    #[error("cannot use {}: {errno}", path.display())]
    System {
        /// The file or directory.
        path: PathBuf,
        /// Why.
        errno: Errno,
    },
}

/// An instance's name and place. It may run, or not.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Instance {
    name: String,
    runtime: PathBuf,
}

impl Instance {
    /// The instance `name` in the runtime directory of this process: `MOTORD_RUNTIME_DIR`, else `/run/motord` when it
    /// exists, else `$XDG_RUNTIME_DIR/motord`, else a private folder below the directory for temporary files.
    ///
    /// # Errors
    /// When the name is none, or the directory may not be entered or is not private.
    pub fn find(name: &str) -> Result<Self, InstanceError> {
        let variable = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let runtime = match choose(
            variable(RUNTIME_DIR_VARIABLE),
            Path::new(SERVICE_RUNTIME),
            variable("XDG_RUNTIME_DIR"),
        ) {
            Choice::Shared(runtime) => runtime,
            Choice::Private(runtime) => {
                check_private(&runtime)?;
                runtime
            }
        };
        Self::below(&runtime, name)
    }

    /// The instance `name` in the runtime directory `runtime`.
    ///
    /// # Errors
    /// When the name is none, the path is too long, or the directory exists and may not be entered.
    pub fn below(runtime: &Path, name: &str) -> Result<Self, InstanceError> {
        if !is_name(name) {
            return Err(InstanceError::Name { name: name.to_owned() });
        }
        let instance = Self { name: name.to_owned(), runtime: runtime.to_owned() };
        let root = instance.root();
        if root.as_os_str().len() > ROOT_BYTES_MAX {
            return Err(InstanceError::PathLength { path: root });
        }
        check_access(runtime)?;
        check_access(&root)?;
        Ok(instance)
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its runtime directory.
    #[must_use]
    pub fn runtime(&self) -> &Path {
        &self.runtime
    }

    /// Where everything of iceoryx2 lies.
    pub(crate) fn root(&self) -> PathBuf {
        self.runtime.join("iox").join(&self.name)
    }

    /// Becomes the one daemon of this instance, until the lock is dropped or the process dies. Files that dead
    /// processes left behind are removed, unless a client is still attached and waits for its daemon to come back.
    ///
    /// # Errors
    /// [`InstanceError::AlreadyRunning`] with the holder's process id; others when the directory cannot be used.
    pub fn lock(&self) -> Result<InstanceLock, InstanceError> {
        create_directory(&self.runtime, 0o700)?;
        let mode = fs::metadata(&self.runtime).map_err(|error| refused(&self.runtime, &error))?.mode();
        let path = self.runtime.join(format!("{}.lock", self.name));
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .custom_flags(nix::libc::O_NOFOLLOW)
            .open(&path)
            .map_err(|error| refused(&path, &error))?;
        let holder = read_pid(&mut file);
        let mut lock =
            Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(_, errno)| match errno {
                Errno::EWOULDBLOCK => InstanceError::AlreadyRunning { pid: holder, path: path.clone() },
                errno => InstanceError::System { path: path.clone(), errno },
            })?;
        write_pid(&mut lock).map_err(|error| refused(&path, &error))?;
        let root = self.root();
        create_directory(&self.runtime.join("iox"), mode)?;
        create_directory(&root, mode)?;
        sweep(&root)?;
        Ok(InstanceLock { instance: self.clone(), _lock: lock })
    }

    /// Marks this process as one that uses the instance, so that a starting daemon leaves its files alone. `None` when
    /// there is nothing to attach to: no daemon ever ran here, or one is starting at this moment.
    ///
    /// # Errors
    /// When the directory cannot be used.
    pub fn attach(&self) -> Result<Option<Attachment>, InstanceError> {
        let root = self.root();
        let directory = match File::open(&root) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            other => other.map_err(|error| refused(&root, &error))?,
        };
        match Flock::lock(directory, FlockArg::LockSharedNonblock) {
            Ok(lock) => Ok(Some(Attachment { instance: self.clone(), _lock: lock })),
            Err((_, Errno::EWOULDBLOCK)) => Ok(None),
            Err((_, errno)) => Err(InstanceError::System { path: root, errno }),
        }
    }
}

/// Whether `name` has the form of an instance's name.
pub(crate) fn is_name(name: &str) -> bool {
    let of_a_name = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-');
    (1..=NAME_BYTES_MAX).contains(&name.len()) && name.bytes().all(of_a_name)
}

/// Held by the one daemon of an instance.
#[derive(Debug)]
pub struct InstanceLock {
    instance: Instance,
    _lock: Flock<File>,
}

impl InstanceLock {
    /// The instance that is held.
    #[must_use]
    pub fn instance(&self) -> &Instance {
        &self.instance
    }
}

/// Held by every client of an instance.
#[derive(Debug)]
pub struct Attachment {
    instance: Instance,
    _lock: Flock<File>,
}

impl Attachment {
    /// The instance that it is attached to.
    #[must_use]
    pub fn instance(&self) -> &Instance {
        &self.instance
    }
}

/// Whether a process with this id exists. Wrong at worst when the id was reused, or lives in another namespace.
#[must_use]
pub fn process_exists(pid: u32) -> bool {
    i32::try_from(pid).is_ok_and(|pid| pid > 0 && kill(Pid::from_raw(pid), None) != Err(Errno::ESRCH))
}

/// A runtime directory, by who may enter it.
#[derive(Debug, PartialEq, Eq)]
enum Choice {
    /// Those whom its owner wanted to.
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

/// A directory below one that everybody may write to can have been put there by anybody.
fn check_private(path: &Path) -> Result<(), InstanceError> {
    let uid = Uid::effective().as_raw();
    match fs::symlink_metadata(path) {
        Ok(found) if found.is_dir() && found.uid() == uid && found.mode() & 0o077 == 0 => Ok(()),
        Ok(_) => Err(InstanceError::NotPrivate { path: path.to_owned(), uid }),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(refused(path, &error)),
    }
}

/// A directory that does not exist yet is no obstacle: the daemon makes it, and a client finds no daemon.
fn check_access(path: &Path) -> Result<(), InstanceError> {
    match access(path, AccessFlags::R_OK | AccessFlags::W_OK | AccessFlags::X_OK) {
        Ok(()) | Err(Errno::ENOENT) => Ok(()),
        Err(Errno::EACCES) => Err(InstanceError::Permission { path: path.to_owned() }),
        Err(errno) => Err(InstanceError::System { path: path.to_owned(), errno }),
    }
}

/// The mode is set a second time because the umask of a service must not lock its group out.
fn create_directory(path: &Path, mode: u32) -> Result<(), InstanceError> {
    let created = DirBuilder::new().mode(mode).create(path);
    match created.and_then(|()| fs::set_permissions(path, Permissions::from_mode(mode & 0o2777))) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(refused(path, &error)),
        _ => Ok(()),
    }
}

fn read_pid(file: &mut File) -> u32 {
    let mut text = [0; 16];
    let bytes = file.read(&mut text).unwrap_or(0);
    str::from_utf8(&text[..bytes]).ok().and_then(|text| text.trim().parse().ok()).unwrap_or(0)
}

fn write_pid(file: &mut File) -> io::Result<()> {
    io::Seek::rewind(file)?;
    file.set_len(0)?;
    writeln!(file, "{}", std::process::id())
}

/// iceoryx2 leaves a few files per killed process, and a file truncated by a full disk would keep every service from
/// opening. With the daemon's lock held and no client attached nobody needs any of them.
fn sweep(root: &Path) -> Result<(), InstanceError> {
    let directory = File::open(root).map_err(|error| refused(root, &error))?;
    let Ok(_nobody_attached) = Flock::lock(directory, FlockArg::LockExclusiveNonblock) else { return Ok(()) };
    let entries = fs::read_dir(root).map_err(|error| refused(root, &error))?;
    for entry in entries.flatten() {
        let path = entry.path();
        let is_directory = entry.file_type().is_ok_and(|kind| kind.is_dir());
        let removed = if is_directory { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        removed.map_err(|error| refused(&path, &error))?;
    }
    Ok(())
}

fn refused(path: &Path, error: &io::Error) -> InstanceError {
    let path = path.to_owned();
    match Errno::from_raw(error.raw_os_error().unwrap_or(0)) {
        Errno::EACCES | Errno::EPERM => InstanceError::Permission { path },
        errno => InstanceError::System { path, errno },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    fn place() -> tempfile::TempDir {
        tempfile::tempdir_in("/tmp").unwrap()
    }

    #[test]
    fn the_named_directory_comes_before_the_service_and_the_service_before_the_session() {
        let (named, service, session) = (place(), place(), place());
        let path = |place: &tempfile::TempDir| place.path().to_owned();
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
    fn a_private_directory_that_others_prepared_or_can_enter_is_refused() {
        let place = place();
        let (open, link, file) =
            (place.path().join("open"), place.path().join("link"), place.path().join("file"));
        fs::create_dir(&open).unwrap();
        fs::set_permissions(&open, Permissions::from_mode(0o750)).unwrap();
        symlink(place.path(), &link).unwrap();
        fs::write(&file, "").unwrap();
        for path in [open, link, file] {
            assert!(
                matches!(check_private(&path), Err(InstanceError::NotPrivate { .. })),
                "{}",
                path.display()
            );
        }
        fs::set_permissions(place.path(), Permissions::from_mode(0o700)).unwrap();
        assert_eq!(check_private(place.path()), Ok(()));
        assert_eq!(check_private(&place.path().join("missing")), Ok(()));
    }

    #[test]
    fn a_path_that_leaves_no_room_for_sockets_is_refused() {
        let runtime = Path::new("/tmp").join("x".repeat(60));
        assert!(matches!(Instance::below(&runtime, "robot"), Err(InstanceError::PathLength { .. })));
        let longest = "0123456789abcdef0123456789abcdef";
        assert!(Instance::below(Path::new("/run/user/1000/motord"), longest).is_ok());
    }

    #[test]
    fn a_starting_daemon_removes_what_the_dead_left_unless_a_client_waits_for_it() {
        let place = place();
        let instance = Instance::below(place.path(), "robot").unwrap();
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
    fn the_instance_lies_open_to_exactly_those_who_may_enter_the_runtime_directory() {
        for mode in [0o700, 0o2770] {
            let place = place();
            fs::set_permissions(place.path(), Permissions::from_mode(mode)).unwrap();
            let instance = Instance::below(place.path(), "robot").unwrap();
            let _lock = instance.lock().unwrap();
            assert_eq!(fs::metadata(instance.root()).unwrap().mode() & 0o7777, mode);
        }
    }
}
