//! The deaths of owners, between real processes.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord::ipc::owners::owners;
use motord_ports::instance::pid_namespace;
use motord_shared::{AdminRequest, Lease};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const SOON: Duration = Duration::from_secs(20);
const NEVER: Duration = Duration::from_millis(300);

fn lease(epoch: u32) -> Lease {
    Lease::new(1, epoch, 0).unwrap()
}

fn shell(script: &str) -> Child {
    Command::new("sh").args(["-c", script]).stdin(Stdio::piped()).spawn().unwrap()
}

fn claim(child: &Child) -> AdminRequest {
    AdminRequest { pid: child.id(), pid_namespace: pid_namespace(), ..Default::default() }
}

#[test]
fn owner_death_is_reported_once_by_lease() {
    let (mut owners, deaths) = owners().unwrap();
    let mut owner = shell("exec sleep 1000");
    assert!(!owners.watch(lease(1), &claim(&owner)));
    assert_eq!(deaths.next(NEVER), None);
    owner.kill().unwrap();
    assert_eq!(deaths.next(SOON), Some(lease(1)));
    assert_eq!(deaths.next(NEVER), None);
    owner.wait().unwrap();
    assert!(owners.watch(lease(2), &claim(&owner)), "a process that is gone is told at once");
}

#[test]
fn former_owner_is_no_longer_watched() {
    let (mut owners, deaths) = owners().unwrap();
    let (mut first, mut second) = (shell("exec sleep 1000"), shell("exec sleep 1000"));
    owners.watch(lease(1), &claim(&first));
    owners.watch(lease(2), &claim(&second));
    first.kill().unwrap();
    assert_eq!(deaths.next(NEVER), None);
    second.kill().unwrap();
    assert_eq!(deaths.next(SOON), Some(lease(2)));
    let _reaped = (first.wait(), second.wait());
}

/// Process 1 of a container is not process 1 of this machine.
#[test]
fn owner_in_other_namespace_is_not_confused() {
    let (mut owners, deaths) = owners().unwrap();
    let mut other = shell("exec sleep 1000");
    for pid_namespace in [0, pid_namespace() + 1] {
        assert!(!owners.watch(lease(1), &AdminRequest { pid_namespace, ..claim(&other) }));
    }
    for pid in [0, u32::MAX] {
        assert!(!owners.watch(lease(1), &AdminRequest { pid, ..claim(&other) }));
    }
    other.kill().unwrap();
    assert_eq!(deaths.next(NEVER), None);
    other.wait().unwrap();
}

#[test]
fn forking_owner_is_watched_but_child_not() {
    let (mut owners, deaths) = owners().unwrap();
    let mut parent = shell("true & wait; read -r _; sleep 5 >&- 2>&- & exit");
    owners.watch(lease(1), &claim(&parent));
    assert_eq!(deaths.next(NEVER), None, "a child that ends is no death");
    drop(parent.stdin.take());
    assert_eq!(deaths.next(SOON), Some(lease(1)), "a child that lives on is no owner");
    parent.wait().unwrap();
}
