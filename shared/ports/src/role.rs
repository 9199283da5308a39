//! Locks by which at most one process of an instance has a role.

use crate::directory::Displaced;
use crate::instance::Instance;
use crate::instance_error::InstanceError;
use crate::lock_file::hold;
use nix::fcntl::Flock;
use std::fs::File;

/// The lock held by the only process of an instance with some role.
#[derive(Debug)]
pub struct RoleLock {
    displaced: Vec<Displaced>,
    _lock: Flock<File>,
}

impl RoleLock {
    /// Claims the role `role` of `instance`, such as that of its dead man's switch: locks the file
    /// `<instance>.<role>.lock` until the value is dropped or the process dies, and removes the
    /// socket `<instance>.<role>` of a dead predecessor. The runtime directory must exist.
    ///
    /// # Errors
    /// [`InstanceError::AlreadyRunning`] with the holder's process id; others when the directory
    /// cannot be used.
    pub fn claim(instance: &Instance, role: &str) -> Result<Self, InstanceError> {
        let (runtime, name) = (instance.open_runtime()?, instance.name());
        let mut displaced = Vec::new();
        let lock = hold(&runtime, &format!("{name}.{role}.lock"), &mut displaced)?;
        runtime.clear_name(&format!("{name}.{role}"), &mut displaced)?;
        Ok(Self { displaced, _lock: lock })
    }

    /// Returns the files of other users that were in the way.
    #[must_use]
    pub fn displaced(&self) -> &[Displaced] {
        &self.displaced
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::fcntl::FlockArg;
    use nix::unistd::Uid;
    use std::fs::{self, Permissions};
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};

    /// Plays a member who prepares the names that a daemon needs. Root alone may do that for
    /// another user.
    #[test]
    fn names_prepared_by_member_block_no_start() {
        const MEMBER: u32 = 65_534;
        if !Uid::effective().is_root() {
            println!("not run: only root can give files to another user");
            return;
        }
        let names = ["robot.lock", "iox", "iox/robot", "iox/robot.cycle", "robot.sim"];
        for (name, kind) in names.iter().flat_map(|name| [(name, 0), (name, 1), (name, 2)]) {
            let directory = tempfile::tempdir_in("/tmp").unwrap();
            fs::set_permissions(directory.path(), Permissions::from_mode(0o3770)).unwrap();
            let instance = Instance::below(directory.path(), "robot").unwrap();
            drop(instance.lock().unwrap());
            let path = directory.path().join(name);
            let _missing = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
            match kind {
                0 => fs::write(&path, "").unwrap(),
                1 => fs::create_dir_all(path.join("a/b/c/d/e/f/g/h/i/j")).unwrap(),
                _ => symlink("/", &path).unwrap(),
            }
            std::os::unix::fs::lchown(&path, Some(MEMBER), None).unwrap();
            let held = File::open(&path).map(|file| Flock::lock(file, FlockArg::LockExclusiveNonblock));
            let lock = instance.lock().unwrap_or_else(|error| panic!("{name} {kind}: {error}"));
            let _futex = lock.make_futex().unwrap_or_else(|error| panic!("{name} {kind}: {error}"));
            lock.clear_socket("sim").unwrap_or_else(|error| panic!("{name} {kind}: {error}"));
            let owner = |path| fs::symlink_metadata(path).unwrap().uid();
            assert_eq!([owner(lock.path()), owner(instance.root()), owner(instance.futex_path())], [0; 3]);
            let reported = lock.displaced().iter().any(|found| found.path == path && found.owner == MEMBER);
            assert!(reported || ["iox/robot.cycle", "robot.sim"].contains(name), "{name} {kind}");
            drop(held);
        }
    }

    /// Goal: the process id of a daemon overwrites no file elsewhere that has the lock's name as a
    /// second name.
    #[test]
    fn second_name_of_another_file_is_no_lock() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let elsewhere = directory.path().join("elsewhere");
        fs::write(&elsewhere, "kept").unwrap();
        fs::hard_link(&elsewhere, directory.path().join("robot.lock")).unwrap();
        let _lock = instance.lock().unwrap();
        assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "kept");
    }
}
