//! Files of clients that were killed while they registered themselves. iceoryx2 does not know whose they are, and leaves them.

use crate::directory::Directory;
use crate::instance::Instance;
use crate::instance_error::InstanceError;
use crate::service::{Service, config};
use iceoryx2::node::NodeView;
use iceoryx2::prelude::*;
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::time::{Duration, SystemTime};

/// A client registers itself within milliseconds.
const REGISTRATION: Duration = Duration::from_secs(10);

/// Removes what belongs to no complete node and is older than [`REGISTRATION`]. Returns how many files and directories those were.
///
/// # Errors
/// The first that cannot be looked at or removed.
pub(crate) fn remove(instance: &Instance) -> Result<u64, InstanceError> {
    let nodes = Directory::open(&instance.root(), false)?.open_below("nodes")?;
    let Some(complete) = complete(instance) else { return Ok(0) };
    let mut removed = 0;
    for name in nodes.names()? {
        let incomplete = node_of(&name).is_some_and(|node| !complete.contains(&node));
        let age = nodes.changed(&name).and_then(|changed| SystemTime::now().duration_since(changed).ok());
        if incomplete && age.is_some_and(|age| age > REGISTRATION) {
            nodes.remove(&name)?;
            removed += 1;
        }
    }
    Ok(removed)
}

/// The nodes of the living, and those of the dead that iceoryx2 can clean. `None` when the system does not tell.
fn complete(instance: &Instance) -> Option<BTreeSet<u128>> {
    let mut found = BTreeSet::new();
    let listed = Node::<Service>::list(&config(instance), |state| {
        let complete = match &state {
            NodeState::Dead(node) if node.details().is_none() => None,
            NodeState::Dead(node) => Some(node.id().value()),
            NodeState::Alive(node) => Some(node.id().value()),
            NodeState::Inaccessible(id) => Some(id.value()),
            NodeState::Undefined(_) => None,
        };
        found.extend(complete);
        CallbackProgression::Continue
    });
    listed.is_ok().then_some(found)
}

/// The node of a directory `<number>`, or of a file `m_<number>.<kind>`.
fn node_of(name: &OsStr) -> Option<u128> {
    let name = str::from_utf8(name.as_bytes()).ok()?;
    let number = name.strip_prefix("m_").map_or(name, |file| file.split('.').next().unwrap_or_default());
    number.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ClientPorts, DaemonPorts, Housekeeper};
    use std::fs::{self, File};

    #[test]
    fn the_files_of_clients_that_were_killed_while_they_registered_go_and_those_of_others_stay() {
        let place = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(place.path(), "robot").unwrap();
        let lock = instance.lock().unwrap();
        let _ports = DaemonPorts::open(&lock).unwrap();
        let housekeeper = Housekeeper::open(&lock).unwrap();
        let _client = ClientPorts::open(instance.attach().unwrap().unwrap()).unwrap();
        let nodes = instance.root().join("nodes");
        let count = || fs::read_dir(&nodes).unwrap().count();
        let living = count();
        // Only directories, and files of nobody: closing a file gives up the locks of this process on it.
        let make_old = |path: &std::path::Path| {
            File::open(path).unwrap().set_modified(SystemTime::now() - 2 * REGISTRATION).unwrap();
        };
        for node in ["1", "2", "3"] {
            fs::create_dir(nodes.join(node)).unwrap();
        }
        for file in ["m_2.node_monitor", "m_2.node_monitor_context", "m_2.node_monitor_owner_lock"] {
            fs::write(nodes.join(file), "").unwrap();
            make_old(&nodes.join(file));
        }
        for entry in fs::read_dir(&nodes).unwrap().map(Result::unwrap) {
            if entry.path().is_dir() && entry.file_name() != "3" {
                make_old(&entry.path());
            }
        }
        let _dead = housekeeper.clean();
        assert_eq!(count(), living + 1, "{:?}", fs::read_dir(&nodes).unwrap().collect::<Vec<_>>());
        assert!(nodes.join("3").exists());
    }
}
