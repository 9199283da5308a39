//! Directories by descriptor: replacing a checked directory with a symbolic link has no effect.

use crate::clock;
use crate::instance_error::{InstanceError, refused};
use nix::dir::Dir;
use nix::errno::Errno;
use nix::fcntl::{AtFlags, OFlag, openat, renameat};
use nix::sys::stat::{FileStat, Mode, SFlag, fchmod, fstat, fstatat, mkdirat};
use nix::unistd::{Uid, UnlinkatFlags, unlinkat};
use std::ffi::{OsStr, OsString};
use std::fmt::{self, Display};
use std::fs::File;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Limit on the depth that is removed. The directories of iceoryx2 have depth two; another program
/// created a deeper tree.
const DEPTH_MAX: usize = 8;
/// Limit on the attempts to create a file that another user creates again and again.
const TRIES: usize = 10;
/// Mode bit: only the owner of a file, or of the directory, may delete or rename the file.
pub(crate) const STICKY: u32 = 0o1000;
/// Mode bits with which users other than the owner may write to a directory.
pub(crate) const OTHERS_WRITE: u32 = 0o022;

/// A file or directory under a name that motord needs, which another user had created and this
/// process removed or renamed. Only root and the owner of the directory may do that.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Displaced {
    /// The path.
    pub path: PathBuf,
    /// The other user.
    pub owner: u32,
}

impl Display for Displaced {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of user {} was in the way, and is removed", self.path.display(), self.owner)
    }
}

/// An open directory.
#[derive(Debug)]
pub(crate) struct Directory {
    pub(crate) path: PathBuf,
    descriptor: OwnedFd,
}

impl Directory {
    /// Opens the directory `path`. Follows a link at its end only if `links` is set.
    ///
    /// # Errors
    /// The directory is missing, or may not be used.
    pub(crate) fn open(path: &Path, links: bool) -> Result<Self, InstanceError> {
        let follow = if links { OFlag::empty() } else { OFlag::O_NOFOLLOW };
        Self::open_at(nix::fcntl::AT_FDCWD, path, path.to_owned(), follow)
    }

    /// Opens the directory `name` in this one. Does not follow links.
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub(crate) fn open_below(&self, name: impl AsRef<Path>) -> Result<Self, InstanceError> {
        let name = name.as_ref();
        Self::open_at(&self.descriptor, name, self.path.join(name), OFlag::O_NOFOLLOW)
    }

    fn open_at(from: impl AsFd, name: &Path, path: PathBuf, flags: OFlag) -> Result<Self, InstanceError> {
        let flags = flags | OFlag::O_DIRECTORY | OFlag::O_RDONLY | OFlag::O_CLOEXEC;
        match openat(from, name, flags, Mode::empty()) {
            Ok(descriptor) => Ok(Self { path, descriptor }),
            Err(Errno::ENOTDIR | Errno::ELOOP) => Err(InstanceError::NotDirectory { path }),
            Err(errno) => Err(refused(&path, errno)),
        }
    }

    /// Opens the directory `name` in this one, and creates it if it is missing.
    /// [Displaces](Displaced) a file or directory that another user created under this name: its
    /// owner could change the contents, or keep this process from using it.
    ///
    /// # Errors
    /// Those of [`open`](Self::open); [`InstanceError::NotOurs`] where this user may displace
    /// nothing.
    pub(crate) fn make_below(
        &self,
        name: &str,
        mode: u32,
        displaced: &mut Vec<Displaced>,
    ) -> Result<Self, InstanceError> {
        let bits = Mode::from_bits_truncate(mode & 0o777);
        let make = || match mkdirat(&self.descriptor, name, bits) {
            Ok(()) | Err(Errno::EEXIST) => self.open_below(name),
            Err(errno) => Err(refused(&self.path.join(name), errno)),
        };
        let made = self.make_trusted(name, displaced, make, |made| Ok(made.stat()?.st_uid))?;
        made.set_mode(mode);
        Ok(made)
    }

    /// Opens the file `name` in this directory for a lock, and creates it if it is missing. Only
    /// its owner may read or write it: a user who may read a file can lock it. Displaces like
    /// [`make_below`](Self::make_below).
    ///
    /// # Errors
    /// Those of [`make_below`](Self::make_below).
    pub(crate) fn make_lock(
        &self,
        name: &str,
        displaced: &mut Vec<Displaced>,
    ) -> Result<File, InstanceError> {
        let owner = |file: &File| {
            let found = fstat(file).map_err(|errno| refused(&self.path.join(name), errno))?;
            // Another name of a file elsewhere: the process id would overwrite that file.
            let is_plain = is_regular(&found) && found.st_nlink == 1;
            Ok(if is_plain { found.st_uid } else { u32::MAX })
        };
        self.make_trusted(name, displaced, || self.make_file(name), owner)
    }

    /// Removes the socket `name` of a dead process of motord, or [displaces](Displaced) what
    /// another user created under this name.
    ///
    /// # Errors
    /// [`InstanceError::NotOurs`]; the file cannot be removed.
    pub(crate) fn clear_name(&self, name: &str, displaced: &mut Vec<Displaced>) -> Result<(), InstanceError> {
        match self.owner_of(name) {
            None => Ok(()),
            Some(owner) if self.trusts(owner)? => self.remove(name.as_ref()),
            Some(owner) => self.displace(name, owner, displaced),
        }
    }

    /// Repeats `make` until what it opens belongs to a trusted user.
    fn make_trusted<T>(
        &self,
        name: &str,
        displaced: &mut Vec<Displaced>,
        make: impl Fn() -> Result<T, InstanceError>,
        owner: impl Fn(&T) -> Result<u32, InstanceError>,
    ) -> Result<T, InstanceError> {
        for _ in 0..TRIES {
            let owner = match make() {
                Ok(made) => {
                    let owner = owner(&made)?;
                    if self.trusts(owner)? {
                        return Ok(made);
                    }
                    owner
                }
                // The other user may have forbidden to open it, or created a link.
                Err(error) => match self.owner_of(name) {
                    Some(owner) if !self.trusts(owner)? => owner,
                    Some(_) | None => return Err(error),
                },
            };
            self.displace(name, owner, displaced)?;
        }
        let owner = self.owner_of(name).unwrap_or(u32::MAX);
        Err(InstanceError::NotOurs { path: self.path.join(name), owner })
    }

    /// Returns `true` for this user, the owner of this directory and root.
    fn trusts(&self, uid: u32) -> Result<bool, InstanceError> {
        Ok([0, Uid::effective().as_raw(), self.stat()?.st_uid].contains(&uid))
    }

    /// Returns the owner of `name` in this directory. Does not follow links.
    fn owner_of(&self, name: &str) -> Option<u32> {
        fstatat(&self.descriptor, name, AtFlags::AT_SYMLINK_NOFOLLOW).ok().map(|found| found.st_uid)
    }

    /// Removes a file. Renames a directory: its owner decides who may enter it, and how deep it is.
    fn displace(&self, name: &str, owner: u32, displaced: &mut Vec<Displaced>) -> Result<(), InstanceError> {
        let path = self.path.join(name);
        let uid = Uid::effective();
        if !uid.is_root() && uid.as_raw() != self.stat()?.st_uid {
            return Err(InstanceError::NotOurs { path, owner });
        }
        match unlinkat(&self.descriptor, name, UnlinkatFlags::NoRemoveDir) {
            Ok(()) | Err(Errno::ENOENT) => {}
            Err(Errno::EISDIR) => {
                let unique = format!("{name}.of-user-{owner}-{}", clock::now_ns());
                renameat(&self.descriptor, name, &self.descriptor, unique.as_str())
                    .map_err(|errno| refused(&path, errno))?;
            }
            Err(errno) => return Err(refused(&path, errno)),
        }
        displaced.push(Displaced { path, owner });
        Ok(())
    }

    /// Sets the mode if this user may. The umask of a service must not exclude its group.
    pub(crate) fn set_mode(&self, mode: u32) {
        let _not_the_owner = fchmod(&self.descriptor, Mode::from_bits_truncate(mode & 0o7777));
    }

    /// Opens the file `name` in this directory to read and write, and creates it if it is missing.
    /// Does not follow links.
    ///
    /// # Errors
    /// The file may not be used.
    pub(crate) fn make_file(&self, name: &str) -> Result<File, InstanceError> {
        let flags = OFlag::O_RDWR | OFlag::O_CREAT | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC | OFlag::O_NONBLOCK;
        match openat(&self.descriptor, name, flags, Mode::S_IRUSR | Mode::S_IWUSR) {
            Ok(file) => Ok(File::from(file)),
            Err(errno) => Err(refused(&self.path.join(name), errno)),
        }
    }

    /// Opens the file `name` in this directory to read. Does not follow links.
    ///
    /// # Errors
    /// The file is missing, or may not be used.
    pub(crate) fn open_file(&self, name: &str) -> Result<File, InstanceError> {
        let flags = OFlag::O_RDONLY | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC | OFlag::O_NONBLOCK;
        let file = openat(&self.descriptor, name, flags, Mode::empty());
        file.map(File::from).map_err(|errno| refused(&self.path.join(name), errno))
    }

    /// Works like [`make_file`](Self::make_file) for a file that only this user may write. All
    /// users who may enter this directory may read it. Removes any other file.
    ///
    /// # Errors
    /// Those of [`make_file`](Self::make_file); [`InstanceError::NotOurs`].
    pub(crate) fn make_ours(&self, name: &str) -> Result<File, InstanceError> {
        const MODE: Mode = Mode::from_bits_truncate(0o644);
        let file = match self.make_file(name) {
            Ok(file) if is_ours(&file) => file,
            // The obstacle is the directory, not the file.
            Err(
                error @ InstanceError::System { errno: Errno::EMFILE | Errno::ENFILE | Errno::ENOMEM, .. },
            ) => return Err(error),
            Ok(_) | Err(_) => {
                self.clear_name(name, &mut Vec::new())?;
                self.make_file(name)?
            }
        };
        if !is_ours(&file) {
            return Err(self.not_ours(name, &file));
        }
        fchmod(&file, MODE).map_err(|errno| refused(&self.path.join(name), errno))?;
        Ok(file)
    }

    /// Works like [`open_file`](Self::open_file) for a file of root, the owner of this directory or
    /// `daemon`.
    ///
    /// # Errors
    /// Those of [`open_file`](Self::open_file); [`InstanceError::NotOurs`].
    pub(crate) fn open_daemons(&self, name: &str, daemon: Option<u32>) -> Result<File, InstanceError> {
        let file = self.open_file(name)?;
        let is_trusted = [Some(0), Some(self.stat()?.st_uid), daemon].contains(&Some(owner(&file)));
        if is_trusted { Ok(file) } else { Err(self.not_ours(name, &file)) }
    }

    fn not_ours(&self, name: &str, file: &File) -> InstanceError {
        InstanceError::NotOurs { path: self.path.join(name), owner: owner(file) }
    }

    pub(crate) fn stat(&self) -> Result<FileStat, InstanceError> {
        fstat(&self.descriptor).map_err(|errno| refused(&self.path, errno))
    }

    /// Returns another descriptor of the same directory, as a file that can be locked.
    ///
    /// # Errors
    /// No descriptors are left.
    pub(crate) fn file(&self) -> Result<File, InstanceError> {
        // Opened again: a duplicate would share its lock with the original.
        let file = openat(&self.descriptor, ".", OFlag::O_DIRECTORY | OFlag::O_CLOEXEC, Mode::empty());
        file.map(File::from).map_err(|errno| refused(&self.path, errno))
    }

    /// Removes everything in this directory. Removes links instead of following them.
    ///
    /// # Errors
    /// The first file that cannot be removed.
    pub(crate) fn clear(&self) -> Result<(), InstanceError> {
        self.clear_to(DEPTH_MAX)
    }

    fn clear_to(&self, depth: usize) -> Result<(), InstanceError> {
        self.names()?.iter().try_for_each(|name| self.remove_to(name, depth))
    }

    /// Returns the names of everything in this directory.
    ///
    /// # Errors
    /// The directory cannot be read.
    pub(crate) fn names(&self) -> Result<Vec<OsString>, InstanceError> {
        let failed = |errno| refused(&self.path, errno);
        let mut names = Vec::new();
        for entry in Dir::from_fd(self.file()?.into()).map_err(failed)?.iter() {
            let entry = entry.map_err(failed)?;
            let name = OsStr::from_bytes(entry.file_name().to_bytes());
            if ![".", ".."].contains(&name.to_str().unwrap_or_default()) {
                names.push(name.to_owned());
            }
        }
        Ok(names)
    }

    /// Returns the time of the last change of `name` in this directory. Does not follow links.
    /// `None` when it does not exist.
    pub(crate) fn changed(&self, name: &OsStr) -> Option<SystemTime> {
        let found = fstatat(&self.descriptor, name, AtFlags::AT_SYMLINK_NOFOLLOW).ok()?;
        Some(UNIX_EPOCH + Duration::from_secs(found.st_mtime.try_into().ok()?))
    }

    /// Removes `name` from this directory, with its contents. Removes a link instead of following
    /// it.
    ///
    /// # Errors
    /// The first file that cannot be removed.
    pub(crate) fn remove(&self, name: &OsStr) -> Result<(), InstanceError> {
        self.remove_to(name, DEPTH_MAX)
    }

    fn remove_to(&self, name: &OsStr, depth: usize) -> Result<(), InstanceError> {
        let name = Path::new(name);
        let failed = |errno| refused(&self.path.join(name), errno);
        match unlinkat(&self.descriptor, name, UnlinkatFlags::NoRemoveDir) {
            Ok(()) | Err(Errno::ENOENT) => return Ok(()),
            Err(Errno::EISDIR) if depth > 0 => {}
            Err(errno) => return Err(failed(errno)),
        }
        self.open_below(name)?.clear_to(depth - 1)?;
        match unlinkat(&self.descriptor, name, UnlinkatFlags::RemoveDir) {
            Ok(()) | Err(Errno::ENOENT) => Ok(()),
            Err(errno) => Err(failed(errno)),
        }
    }
}

fn is_regular(found: &FileStat) -> bool {
    found.st_mode & SFlag::S_IFMT.bits() == SFlag::S_IFREG.bits()
}

/// Returns the owner of `file`; the largest number when it cannot be read.
fn owner(file: &File) -> u32 {
    fstat(file).map_or(u32::MAX, |found| found.st_uid)
}

/// Returns `true` if only this user may write `file`, and it has one name: hard links to files of
/// this user elsewhere are rejected.
fn is_ours(file: &File) -> bool {
    fstat(file).is_ok_and(|found| {
        let is_writable_for_others = found.st_mode & 0o022 != 0;
        found.st_uid == Uid::effective().as_raw()
            && found.st_nlink == 1
            && is_regular(&found)
            && !is_writable_for_others
    })
}
