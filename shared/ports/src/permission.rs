//! Advice for a user without permission for a path.

use nix::sys::stat::{Mode, SFlag, stat};
use nix::unistd::{Gid, Group};
use std::path::Path;

/// Returns advice for the path, or for the directory above it whose owner the system reports. It
/// names the group to join, or states that only the owner has access.
#[must_use]
pub fn advice(path: &Path) -> String {
    let Some(found) = path.ancestors().find_map(|path| stat(path).ok()) else {
        return "ask its owner".to_owned();
    };
    let mode = Mode::from_bits_truncate(found.st_mode & !SFlag::S_IFMT.bits());
    if !mode.contains(Mode::S_IWGRP | Mode::S_IXGRP) {
        return "only its owner may use it".to_owned();
    }
    let group = Group::from_gid(Gid::from_raw(found.st_gid)).ok().flatten();
    let name = group.map_or_else(|| found.st_gid.to_string(), |group| group.name);
    format!("join the group {name}, then log in again")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{self, Permissions};
    use std::os::unix::fs::{MetadataExt, PermissionsExt};

    #[test]
    fn refused_process_learns_the_permitted_group() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let gid = Gid::from_raw(fs::metadata(directory.path()).unwrap().gid());
        let name = Group::from_gid(gid).unwrap().unwrap().name;
        for (mode, expected) in [
            (0o2770, format!("join the group {name}, then log in again")),
            (0o700, "only its owner may use it".to_owned()),
        ] {
            fs::set_permissions(directory.path(), Permissions::from_mode(mode)).unwrap();
            assert_eq!(advice(directory.path()), expected);
            assert_eq!(advice(&directory.path().join("iox/robot")), expected, "of an inaccessible path");
        }
    }
}
