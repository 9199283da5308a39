//! One daemon per bus: two would command the same motors.
//!
//! A lock is a listening Unix socket with an abstract name. There is no file that another process
//! could delete or replace, and the name disappears with its process. Such names belong to a
//! network namespace, as CAN interfaces do.
//!
//! A bus has two of them. One is for its [`Identity`], which is the same under all names of the
//! bus. The other is for the name, and also holds while the interface or the device does not exist.

use std::os::fd::{AsRawFd, OwnedFd};

use nix::errno::Errno;
use nix::sys::socket::{Backlog, UnixAddr, bind, listen};

use crate::holder::{Holder, listener, open, owner};
use crate::identity::Identity;
use crate::socketcan::InterfaceName;

/// Most bytes of a device's path in the name of its lock, which may have 107 bytes. Only the end of
/// a longer path is used.
const NAME_BYTES_MAX: usize = 64;

/// Exclusive use of a CAN interface or a serial device among the processes of a network namespace.
/// Released when dropped, and by the kernel when the process ends for any reason.
#[derive(Debug)]
pub struct BusLock {
    bus: Named,
    _name: OwnedFd,
    /// The interface or device that had the name when the bus was last followed.
    identity: Option<(Identity, OwnedFd)>,
}

/// A bus, as its user names it.
#[derive(Debug, Clone)]
enum Named {
    Interface(InterfaceName),
    /// The motors' side of an interface.
    Simulation(InterfaceName),
    Device(String),
}

/// Reason for which a bus could not be locked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LockError {
    /// Another process holds the lock.
    #[error("{bus} is in use by {holder}; {}", .holder.remedy())]
    Held {
        /// The interface or the device.
        bus: String,
        /// The process that holds the lock.
        holder: Holder,
    },
    /// The kernel returned an error for the socket.
    #[error("lock of {bus}: {errno}")]
    System {
        /// The interface or the device.
        bus: String,
        /// The error of the kernel.
        errno: Errno,
    },
}

impl BusLock {
    /// Locks `interface` under all its names. Every process in its network namespace may do so.
    ///
    /// # Errors
    ///
    /// [`LockError::Held`] with the holder; [`LockError::System`] when the kernel provides no
    /// socket.
    pub fn interface(interface: InterfaceName) -> Result<Self, LockError> {
        Self::acquire(Named::Interface(interface))
    }

    /// Locks the motors' side of `interface`, for a program that simulates motors there. Their
    /// driver may hold [`interface`](Self::interface).
    ///
    /// # Errors
    ///
    /// As [`interface`](Self::interface).
    pub fn simulation(interface: InterfaceName) -> Result<Self, LockError> {
        Self::acquire(Named::Simulation(interface))
    }

    /// Locks the serial port `device` under all its names.
    ///
    /// # Errors
    ///
    /// As [`interface`](Self::interface).
    pub fn device(device: &str) -> Result<Self, LockError> {
        Self::acquire(Named::Device(device.to_owned()))
    }

    /// Prepares the kernel for [`holders_of_interface`](Self::holders_of_interface): a first search
    /// may load a module from the disk. Blocks until that is done; allocates.
    pub fn prepare_search() {
        let _no_name_is_empty = owner(b"");
    }

    /// Returns the processes that hold the interface or the name `interface`: one in each, of which
    /// one may be another process than the other. Neither blocks nor waits for them; at most twelve
    /// system calls.
    ///
    /// Any user may hold a free name, and hide: see [`Holder`]. If `thorough`, names the user of
    /// one that hides, which takes at most 80 ms of processor time and allocates.
    #[must_use]
    pub fn holders_of_interface(interface: &str, thorough: bool) -> [Option<Holder>; 2] {
        let interface = interface.parse().map(Named::Interface);
        interface.map_or([None; 2], |interface| interface.holders(thorough))
    }

    /// Returns the processes that hold the serial port or the path `device`. Like
    /// [`holders_of_interface`](Self::holders_of_interface), and it resolves the path.
    #[must_use]
    pub fn holders_of_device(device: &str, thorough: bool) -> [Option<Holder>; 2] {
        Named::Device(device.to_owned()).holders(thorough)
    }

    /// Locks the interface or device that has the name now, and lets another one go: its index or
    /// number may already be that of another bus. The name stays locked. Call it before a bus is
    /// opened again: a reconnected adapter has another index or number.
    ///
    /// # Errors
    ///
    /// As [`interface`](Self::interface). Then only the name is locked.
    pub fn follow(&mut self) -> Result<(), LockError> {
        let current = self.current();
        if self.held() != current {
            self.leave();
        }
        if let Some(current) = current.filter(|_| self.identity.is_none()) {
            self.identity = Some((current, self.bus.lock(&self.bus.name_of(current))?));
        }
        Ok(())
    }

    /// Lets the interface or device go. The name stays locked.
    pub fn leave(&mut self) {
        self.identity = None;
    }

    /// Returns the interface or device that has the name now; `None` without one.
    #[must_use]
    pub fn current(&self) -> Option<Identity> {
        self.bus.identity()
    }

    /// Returns the interface or device that is locked.
    #[must_use]
    pub fn held(&self) -> Option<Identity> {
        self.identity.as_ref().map(|(held, _)| *held)
    }

    fn acquire(bus: Named) -> Result<Self, LockError> {
        let mut lock = Self { _name: bus.lock(&bus.name_of_path())?, bus, identity: None };
        lock.follow()?;
        Ok(lock)
    }
}

impl Named {
    fn identity(&self) -> Option<Identity> {
        match self {
            Self::Interface(interface) | Self::Simulation(interface) => {
                Identity::of_interface(interface.as_str())
            }
            Self::Device(device) => Identity::of_device(device),
        }
    }

    fn text(&self) -> &str {
        match self {
            Self::Interface(interface) | Self::Simulation(interface) => interface.as_str(),
            Self::Device(device) => device,
        }
    }

    fn name_of_path(&self) -> Vec<u8> {
        match self {
            Self::Interface(interface) => [b"motord/can/", interface.as_str().as_bytes()].concat(),
            Self::Simulation(interface) => [b"motord-sim/can/", interface.as_str().as_bytes()].concat(),
            Self::Device(device) => name_of_device(device),
        }
    }

    fn name_of(&self, identity: Identity) -> Vec<u8> {
        let owner = if matches!(self, Self::Simulation(_)) { "motord-sim" } else { "motord" };
        match identity {
            Identity::Interface(index) => format!("{owner}/can-index/{index}"),
            Identity::Device { number, terminals: None } => format!("{owner}/serial-number/{number:x}"),
            Identity::Device { number, terminals: Some(terminal) } => {
                format!("{owner}/serial-number/{number:x}/{terminal:x}")
            }
        }
        .into_bytes()
    }

    /// The process that drives the interface or device, and the one that has its name.
    fn holders(&self, thorough: bool) -> [Option<Holder>; 2] {
        let names = [self.identity().map(|identity| self.name_of(identity)), Some(self.name_of_path())];
        names.map(|name| {
            let name = name?;
            let holder = listener(&name)?;
            let is_hidden = thorough && holder.uid.is_none();
            Some(if is_hidden { Holder { uid: owner(&name), ..holder } } else { holder })
        })
    }

    fn lock(&self, name: &[u8]) -> Result<OwnedFd, LockError> {
        let bus = || self.text().to_owned();
        let failed = |errno| LockError::System { bus: bus(), errno };
        let address = UnixAddr::new_abstract(name).map_err(failed)?;
        let socket = open().map_err(failed)?;
        match bind(socket.as_raw_fd(), &address) {
            Ok(()) => {}
            Err(Errno::EADDRINUSE) => {
                let found = listener(name).filter(|holder| holder.uid.is_some());
                let holder = found.unwrap_or_else(|| Holder { pid: None, uid: owner(name) });
                return Err(LockError::Held { bus: bus(), holder });
            }
            Err(errno) => return Err(failed(errno)),
        }
        // Each side of a connection sees the other's credentials.
        listen(&socket, Backlog::MAXCONN).map_err(failed)?;
        Ok(socket)
    }
}

fn name_of_device(device: &str) -> Vec<u8> {
    // Links are not resolved: the device that one leads to may be another tomorrow.
    let path = std::path::absolute(device).unwrap_or_else(|_| device.into());
    let bytes = path.as_os_str().as_encoded_bytes();
    [b"motord/serial/", &bytes[bytes.len().saturating_sub(NAME_BYTES_MAX)..]].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::sys::stat::{Mode, SFlag, makedev, mknod};
    use std::os::unix::fs::symlink;
    use std::path::Path;

    fn this_process() -> Holder {
        Holder { pid: Some(std::process::id()), uid: Some(nix::unistd::Uid::effective().as_raw()) }
    }

    fn holder_of_interface(name: InterfaceName) -> Option<Holder> {
        BusLock::holders_of_interface(name.as_str(), false).into_iter().flatten().next()
    }

    fn holder_of_device(path: &str) -> Option<Holder> {
        BusLock::holders_of_device(path, false).into_iter().flatten().next()
    }

    /// Returns a name that no other test and no interface uses.
    fn interface(terminal: u32) -> InterfaceName {
        format!("t{}-{terminal}", std::process::id()).parse().unwrap()
    }

    #[test]
    fn second_holder_learns_process_of_first() {
        let name = interface(0);
        assert_eq!(holder_of_interface(name), None);
        let first = BusLock::interface(name).unwrap();
        let holder = this_process();
        assert_eq!(holder_of_interface(name), Some(holder));
        let refused = BusLock::interface(name).unwrap_err();
        assert_eq!(refused, LockError::Held { bus: name.as_str().into(), holder });
        assert!(refused.to_string().contains(&std::process::id().to_string()));
        drop(first);
        BusLock::interface(name).unwrap();
    }

    /// A terminal and a node of the same device number elsewhere, as a container or `mknod` makes
    /// them.
    #[test]
    fn device_number_is_locked_under_every_path() {
        let directory = tempfile::tempdir().unwrap();
        let node = directory.path().join("leg");
        // No child process: until it executes its program, it also holds the locks of the other
        // tests.
        let null = makedev(1, 3);
        if mknod(&node, SFlag::S_IFCHR, Mode::S_IRUSR, null).is_err() {
            println!("skipped: mknod needs root");
            return;
        }
        let held = BusLock::device("/dev/null").unwrap();
        let node = node.to_str().unwrap();
        let holder = this_process();
        assert_eq!(holder_of_device(node), Some(holder));
        assert_eq!(BusLock::device(node).unwrap_err(), LockError::Held { bus: node.into(), holder });
        drop(held);
        BusLock::device(node).unwrap();
    }

    #[test]
    fn lock_follows_device_to_its_new_number() {
        let directory = tempfile::tempdir().unwrap();
        let adapter = directory.path().join("adapter");
        let (first, second) = ("/dev/zero", "/dev/full");
        symlink(first, &adapter).unwrap();
        let mut lock = BusLock::device(adapter.to_str().unwrap()).unwrap();
        std::fs::remove_file(&adapter).unwrap();
        lock.follow().unwrap();
        assert!(holder_of_device(adapter.to_str().unwrap()).is_some(), "its name stays locked");
        symlink(second, &adapter).unwrap();
        let other = BusLock::device(second).unwrap();
        assert!(matches!(lock.follow(), Err(LockError::Held { .. })));
        drop(other);
        lock.follow().unwrap();
        assert!(matches!(BusLock::device(second), Err(LockError::Held { .. })));
    }

    /// The kernel gives the number of an adapter that is gone to the next one that is plugged in.
    #[test]
    fn absent_adapter_leaves_its_number_to_others() {
        let directory = tempfile::tempdir().unwrap();
        let [left, right] = ["left", "right"].map(|name| directory.path().join(name));
        let lead = |adapter: &Path, device: &str| {
            let _absent = std::fs::remove_file(adapter);
            symlink(device, adapter).unwrap();
        };
        let lock = |adapter: &Path| BusLock::device(adapter.to_str().unwrap()).unwrap();
        let (first, second) = ("/dev/random", "/dev/urandom");
        lead(&left, first);
        lead(&right, second);
        let (mut on_left, mut on_right) = (lock(&left), lock(&right));

        // Both were unplugged, and return in the other order.
        lead(&left, second);
        lead(&right, first);
        assert!(matches!(on_left.follow(), Err(LockError::Held { .. })), "until the other has let it go");
        on_right.follow().unwrap();
        on_left.follow().unwrap();
        assert!([first, second].iter().all(|device| holder_of_device(device).is_some()));

        // One does not return, and the other gets its number.
        std::fs::remove_file(&left).unwrap();
        on_left.follow().unwrap();
        lead(&right, second);
        on_right.follow().unwrap();
    }

    #[test]
    fn motors_are_simulated_once_beside_their_driver() {
        let name = interface(4);
        let _driver = BusLock::interface(name).unwrap();
        let _motors = BusLock::simulation(name).unwrap();
        assert!(matches!(BusLock::simulation(name), Err(LockError::Held { .. })));
        // An interface that every machine has.
        let _loopback = BusLock::simulation("lo".parse().unwrap()).unwrap();
        BusLock::interface("lo".parse().unwrap()).unwrap();
    }

    #[test]
    fn interfaces_are_locked_one_by_one() {
        let _first = BusLock::interface(interface(1)).unwrap();
        BusLock::interface(interface(2)).unwrap();
    }

    #[test]
    fn device_has_one_lock_under_all_names() {
        let directory = tempfile::tempdir().unwrap();
        let (device, link) = ("/dev/tty", directory.path().join("adapter"));
        symlink(device, &link).unwrap();
        let link = link.to_str().unwrap();
        let first = BusLock::device(link).unwrap();
        let holder = this_process();
        assert_eq!(BusLock::device(device).unwrap_err(), LockError::Held { bus: device.into(), holder });
        assert_eq!(holder_of_device(device), Some(holder));
        drop(first);
        BusLock::device(device).unwrap();
        BusLock::device(&format!("/dev/serial/by-id/{}", "x".repeat(300))).unwrap();
    }

    #[test]
    fn repeatedly_requested_lock_still_holds() {
        let name = interface(3);
        let _held = BusLock::interface(name).unwrap();
        let asked: Vec<_> = (0..5000).map(|_| BusLock::interface(name)).collect();
        assert!(asked.iter().all(|lock| matches!(lock, Err(LockError::Held { .. }))));
    }
}
