//! Tests of what the checks choose: the daemon, and the advice for a driver.

use super::tests::{Fixture, assert_finding, can0, robot, stat};
use super::{interface, system};
use crate::finding::Level;
use crate::process;
use crate::robot::Robot;
use crate::tree::Tree;
use motord_bus::socketcan::Link;

#[test]
fn daemon_that_was_asked_for_is_shown() {
    let cycle = stat(1, 80);
    let daemons = Fixture::new(&[
        ("proc/700/comm", "motord"),
        ("proc/700/task/701/comm", "motord-cycle"),
        ("proc/700/task/701/stat", &cycle),
        ("proc/812/comm", "motord"),
        ("proc/812/task/813/comm", "motord-cycle"),
        ("proc/812/task/813/stat", &cycle),
    ]);
    let tree = daemons.tree();
    let shown = |asked| {
        let robot = Robot { daemon: asked, ..robot(None) };
        system::daemon(&tree, &robot, process::daemon(&tree, asked))
    };
    assert_finding(
        &shown(Some(812)),
        Level::Good,
        "process 812: its cycle has the real-time priority 80",
        None,
    );
    assert_finding(
        &shown(Some(700)),
        Level::Good,
        "process 700: its cycle has the real-time priority 80",
        None,
    );
    let other =
        "process 700, not of instance robot, which does not run: its cycle has the real-time priority 80";
    assert_finding(&shown(None), Level::Good, other, None);
}

#[test]
fn restart_is_advised_only_where_driver_has_one() {
    let link = Link {
        interface: "can0".parse().unwrap(),
        index: 3,
        up: true,
        bitrate: Some(1_000_000),
        restart_ms: Some(0),
        state: None,
        is_virtual: false,
        listen_only: false,
        loopback: false,
    };
    let folder = tempfile::tempdir().unwrap();
    let device = folder.path().join("sys/class/net/can0/device");
    std::fs::create_dir_all(&device).unwrap();
    let tree = Tree::below(folder.path());
    for (driver, restarts) in [("mcp251xfd", true), ("gs_usb", false)] {
        let _none = std::fs::remove_file(device.join("driver"));
        std::os::unix::fs::symlink(format!("../../bus/drivers/{driver}"), device.join("driver")).unwrap();
        assert_eq!(interface::can_restart(&tree, "can0"), restarts, "{driver}");
    }
    assert!(!interface::can_restart(&tree, "can1"), "an interface of slcan has no device");
    let found = interface::link(&can0(), Ok(link), false);
    let without = "up, 1000000 bit/s; its driver has no restart after a bus-off: motord takes it down and up where it may";
    assert_finding(&found, Level::Good, without, None);
    let down = interface::link(&can0(), Ok(Link { up: false, ..link }), false);
    let commands = down.command.unwrap();
    assert!(commands.contains("bitrate 1000000") && !commands.contains("restart-ms"), "{commands}");
}
