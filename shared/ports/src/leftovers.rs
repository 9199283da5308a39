//! Cleaning up after dead processes: their registrations, and the files of clients that were killed
//! during registration. iceoryx2 does not know the owner of these files, and keeps them.

use crate::directory::Directory;
use crate::instance::{Instance, InstanceLock, is_missing};
use crate::instance_error::InstanceError;
use crate::service::{self, Service, ServiceError, config};
use iceoryx2::node::{Node, NodeView};
use iceoryx2::prelude::*;
use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::time::{Duration, SystemTime};

/// Age after which a registration counts as abandoned. A client registers itself within
/// milliseconds.
const REGISTRATION: Duration = Duration::from_secs(10);

/// Removes files and directories older than [`REGISTRATION`] that belong to no complete node or
/// port. Returns their number.
///
/// # Errors
/// The first that cannot be read or removed.
pub(crate) fn remove(instance: &Instance) -> Result<u64, InstanceError> {
    let root = Directory::open(&instance.root(), false)?;
    let nodes = root.open_below("nodes")?;
    Ok(remove_nodes(instance, &nodes)? + remove_listeners(&root, &nodes)?)
}

fn remove_nodes(instance: &Instance, nodes: &Directory) -> Result<u64, InstanceError> {
    let Some(complete) = complete(instance) else { return Ok(0) };
    remove_old(nodes, nodes.names()?, |name| node_of(name).is_some_and(|node| !complete.contains(&node)))
}

/// A listener creates its tag before its files, so this lists the files first. A node that exits
/// meanwhile has no listener.
fn remove_listeners(root: &Directory, nodes: &Directory) -> Result<u64, InstanceError> {
    let files = root.names()?;
    let mut tags = BTreeSet::new();
    for node in nodes.names()?.iter().filter(|name| is_directory_of_a_node(name)) {
        match nodes.open_below(node) {
            Err(error) if is_missing(&error) => {}
            node => tags.extend(node?.names()?.iter().filter_map(|name| port_of(name, &["port_tag"]))),
        }
    }
    remove_old(root, files, |name| {
        port_of(name, &["event", "event_mgmt"]).is_some_and(|listener| !tags.contains(&listener))
    })
}

fn remove_old(
    directory: &Directory,
    names: Vec<OsString>,
    is_left: impl Fn(&OsStr) -> bool,
) -> Result<u64, InstanceError> {
    let mut removed = 0;
    for name in names {
        let age = directory.changed(&name).and_then(|changed| SystemTime::now().duration_since(changed).ok());
        if is_left(&name) && age.is_some_and(|age| age > REGISTRATION) {
            directory.remove(&name)?;
            removed += 1;
        }
    }
    Ok(removed)
}

/// Returns the nodes of running processes, and those of dead ones that iceoryx2 can clean. `None`
/// when they cannot be listed.
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

/// Returns the node of a directory `<number>`, or of a file `m_<number>.<kind>`.
fn node_of(name: &OsStr) -> Option<u128> {
    let name = name.to_str()?;
    let number = name.strip_prefix("m_").map_or(name, |file| file.split('.').next().unwrap_or_default());
    number.parse().ok()
}

/// Returns the port of a file `m_<number>.<kind>` or `m_<service>_<number>.<kind>`.
fn port_of(name: &OsStr, kinds: &[&str]) -> Option<u128> {
    let (file, kind) = name.to_str()?.strip_prefix("m_")?.split_once('.')?;
    let port = file.rsplit('_').next()?.parse().ok()?;
    kinds.contains(&kind).then_some(port)
}

fn is_directory_of_a_node(name: &OsStr) -> bool {
    name.to_str().is_some_and(|name| name.parse::<u128>().is_ok())
}

/// Removes the files of dead processes, which frees their slots. It opens files: use it about once
/// per second, on a thread without deadlines.
#[derive(Debug)]
pub struct Housekeeper {
    node: Node<Service>,
    instance: Instance,
}

impl Housekeeper {
    /// Creates a housekeeper of the instance of `lock`.
    ///
    /// # Errors
    /// This process cannot register itself.
    pub fn open(lock: &InstanceLock) -> Result<Self, ServiceError> {
        let instance = lock.instance().clone();
        Ok(Self { node: service::node(&instance, true)?, instance })
    }

    /// Returns the time when a process last registered or deregistered. One system call.
    #[must_use]
    pub fn changed(&self) -> Option<SystemTime> {
        std::fs::metadata(self.instance.root().join("nodes")).and_then(|nodes| nodes.modified()).ok()
    }

    /// Removes dead processes and returns their number. Files of processes that died during
    /// registration stay for 10 s; files that cannot be removed stay until the next start.
    #[must_use]
    pub fn clean(&self) -> u64 {
        let removed = self.node.try_cleanup_dead_nodes().cleanups;
        let _refused = remove(&self.instance);
        removed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::ClientPorts;
    use crate::daemon::DaemonPorts;
    use nix::sys::stat::{UtimensatFlags, utimensat};
    use nix::sys::time::TimeSpec;
    use std::fs::{self, File};
    use std::path::Path;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn files_of_clients_killed_while_registering_are_removed() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let lock = instance.lock().unwrap();
        let _ports = DaemonPorts::open(&lock).unwrap();
        let housekeeper = Housekeeper::open(&lock).unwrap();
        let _client = ClientPorts::open(instance.attach().unwrap().unwrap()).unwrap();
        let nodes = instance.root().join("nodes");
        let count = || fs::read_dir(&nodes).unwrap().count();
        let living = count();
        // Only directories, and files without an owner: closing a file releases the locks of this
        // process on it.
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

    /// Sets an old time on the file `path`, without opening it: closing it would release the locks
    /// of this process on it.
    fn age(path: &Path) {
        let day = TimeSpec::new(86_400, 0);
        utimensat(nix::fcntl::AT_FDCWD, path, &day, &day, UtimensatFlags::NoFollowSymlink).unwrap();
    }

    fn events(instance: &Instance) -> BTreeSet<OsString> {
        let files = fs::read_dir(instance.root()).unwrap().map(|entry| entry.unwrap().file_name());
        files.filter(|name| name.to_str().unwrap().contains(".event")).collect()
    }

    #[test]
    fn files_of_listeners_killed_while_registering_are_removed() {
        const WAIT: Duration = Duration::from_secs(5);
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let lock = instance.lock().unwrap();
        let ports = DaemonPorts::open(&lock).unwrap();
        let housekeeper = Housekeeper::open(&lock).unwrap();
        let node = crate::service::node(&instance, false).unwrap();
        let service = crate::service::cycle(&node, &instance).open().unwrap();
        let listener = service.listener_builder().create().unwrap();
        let living = events(&instance);
        assert_eq!(living.len(), 2, "{living:?}");
        for (file, is_old) in
            [("m_5.event", true), ("m_0af_5.event_mgmt", true), ("m_6.event", false), ("m_x.event", true)]
        {
            fs::write(instance.root().join(file), "").unwrap();
            if is_old {
                age(&instance.root().join(file));
            }
        }
        living.iter().for_each(|file| age(&instance.root().join(file)));
        let _dead = housekeeper.clean();
        let kept = events(&instance);
        let young_or_strange = ["m_6.event", "m_x.event"].map(OsString::from);
        assert_eq!(kept, living.into_iter().chain(young_or_strange).collect());
        let (begun, awake) = (std::time::Instant::now(), AtomicBool::new(false));
        std::thread::scope(|threads| {
            threads.spawn(|| {
                while !awake.load(Ordering::Relaxed) {
                    ports.notify().unwrap();
                    std::thread::sleep(Duration::from_millis(1));
                }
            });
            assert!(listener.timed_wait(|_| (), WAIT).unwrap() > 0);
            awake.store(true, Ordering::Relaxed);
        });
        assert!(begun.elapsed() < WAIT, "the living are woken");
    }
}
