//! Connecting, and the refusals of a client.

use super::fake_daemon::Running;
use super::{INSTANCE, TIMEOUT, connect, directory};
use iceoryx2::prelude::{Config, FileName, NodeBuilder, SemanticString as _, ServiceName, ZeroCopySend};
use motord_client::{Client, Error, Obstacle};
use motord_ports::{DaemonPorts, Housekeeper, Instance};
use motord_shared::description::Telemetry;
use motord_shared::message::StateMessage;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::os::unix::ffi::OsStrExt as _;
use std::path::Path;
use std::time::Duration;

#[test]
fn where_no_daemon_runs_connecting_says_so() {
    let directory = directory();
    for runtime in [directory.path().to_owned(), directory.path().join("missing")] {
        let error = Client::connect_in(&runtime, INSTANCE).unwrap_err();
        assert!(matches!(error, Error::NotRunning { .. }), "{error}");
        assert!(error.to_string().contains(&runtime.display().to_string()), "{error}");
        assert_eq!(error.exit_status(), 69);
    }
}

#[test]
fn connecting_after_daemon_exit_reports_none_running() {
    let directory = directory();
    drop(Running::start(directory.path(), 1));
    let error = Client::connect_in(directory.path(), INSTANCE).unwrap_err();
    assert!(matches!(error, Error::NotRunning { .. }), "{error}");
}

#[test]
fn names_that_could_leave_the_directory_are_refused() {
    let directory = directory();
    for name in ["", "..", "a/b", "A", "a b", "a\n", "0123456789012345678901234567890123"] {
        let error = Client::connect_in(directory.path(), name).unwrap_err();
        assert_eq!(error.exit_status(), 64, "{name:?}: {error}");
    }
}

#[test]
fn sleeping_and_spinning_clients_receive_states() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    assert_eq!((client.joint("knee"), client.group("leg"), client.joint("toe")), (Some(1), Some(0), None));
    let mut last = 0;
    for turn in 0..200 {
        let state = if turn % 2 == 0 { client.wait(TIMEOUT) } else { client.spin(TIMEOUT) }.unwrap();
        assert!(state.cycle() > last, "no state is given twice, none is older than the one before");
        last = state.cycle();
    }
    assert_eq!(client.telemetry().unwrap(), Telemetry::default());
}

/// Waits until the client's file descriptor is readable.
fn is_readable(client: &Client, at_most: Duration) -> bool {
    let descriptor = client.file_descriptor().unwrap();
    let mut polled = [PollFd::new(descriptor, PollFlags::POLLIN)];
    poll(&mut polled, PollTimeout::try_from(at_most).unwrap()).unwrap() == 1
}

#[test]
fn descriptor_is_readable_with_each_state() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let (mut states, mut readable) = (0, 0);
    while states < 200 {
        assert!(is_readable(&client, TIMEOUT));
        readable += 1;
        states += u32::from(client.newest().unwrap().is_some());
    }
    assert!(readable < 600, "{readable} times readable for {states} states");
    drop(daemon);
    let _left = client.newest();
    assert!(!is_readable(&client, Duration::from_millis(50)), "no state arrives");
    let _next = Running::start(directory.path(), 2);
    assert!(is_readable(&client, TIMEOUT));
    assert!(matches!(client.newest(), Err(Error::Restarted)));
    assert!(is_readable(&client, TIMEOUT) && client.wait(TIMEOUT).is_ok());
}

#[test]
fn watcher_that_never_reads_leaks_no_memory() {
    let directory = directory();
    let lock = Instance::below(directory.path(), INSTANCE).unwrap().lock().unwrap();
    let ports = DaemonPorts::open(&lock).unwrap();
    let housekeeper = Housekeeper::open(&lock).unwrap();
    let attach = || motord_ports::ClientPorts::open(lock.instance().attach().unwrap().unwrap()).unwrap();
    let (idle, reader) = (attach(), attach());
    assert!(idle.newest_state().unwrap().is_none() && reader.newest_state().unwrap().is_none());
    for cycle in 1..=10_000 {
        ports.publish(&StateMessage { cycle, ..StateMessage::default() }).unwrap();
        ports.notify().unwrap();
        assert_eq!(reader.newest_state().unwrap().map(|state| state.cycle), Some(cycle));
    }
    assert_eq!(idle.newest_state().unwrap().map(|state| state.cycle), Some(10_000), "the newest wins");
    assert_eq!(housekeeper.clean(), 0, "the living are left alone");
}

#[test]
fn a_lying_joint_count_reaches_nobody() {
    let directory = directory();
    let _daemon = Running::start_with(directory.path(), 1, u32::MAX, 1000.0);
    let client = connect(&directory);
    assert_eq!(client.wait(TIMEOUT).unwrap().joints().count(), 64);
}

/// Removes the file of the service `record`, as if the daemon lacked that service.
fn forget_records(directory: &Path) {
    for entry in std::fs::read_dir(directory).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.is_dir() {
            forget_records(&path);
        } else if std::fs::read(&path)
            .is_ok_and(|text| String::from_utf8_lossy(&text).contains("robot/record"))
        {
            std::fs::remove_file(&path).unwrap();
        }
    }
}

#[test]
fn daemon_without_records_is_reported_as_other_version() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    forget_records(&directory.path().join("iox"));
    let error = client.records().unwrap_err();
    assert!(matches!(error, Error::Version { service: "record", .. }), "{error}");
}

#[test]
fn another_layout_is_told_as_another_version() {
    #[derive(Debug, Clone, Copy, ZeroCopySend)]
    #[type_name("motord.State.v10")]
    #[repr(C)]
    struct Newer(u64);

    let directory = directory();
    let lock = Instance::below(directory.path(), INSTANCE).unwrap().lock().unwrap();
    let mut config = Config::default();
    let root = directory.path().join("iox").join(INSTANCE);
    config.global.set_root_path(&iceoryx2::prelude::Path::new(root.as_os_str().as_bytes()).unwrap());
    config.global.prefix = FileName::new(b"m_").unwrap();
    let node = NodeBuilder::new().config(&config).create::<motord_ports::service::Service>().unwrap();
    let name = ServiceName::new("motord/robot/state").unwrap();
    let _newer = node.service_builder(&name).publish_subscribe::<Newer>().create().unwrap();
    let error = Client::connect_in(directory.path(), INSTANCE).unwrap_err();
    assert!(matches!(&error, Error::Version { daemon, .. } if daemon == "motord.State.v10"), "{error}");
    let error = DaemonPorts::open(&lock).unwrap_err();
    assert_eq!(error.obstacle, Obstacle::Version, "{error}");
}
