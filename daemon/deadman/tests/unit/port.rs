//! The serial ports of the dead man's switch, on pseudo terminals.

use super::*;
use motord_bus::FrameId;
use nix::pty::{OpenptyResult, openpty};
use std::fs::File;
use std::io::Read;
use std::os::fd::OwnedFd;
use std::time::Instant as Clock;

fn stops() -> [Frame; 3] {
    [1, 2, 3].map(|id| Frame::classic(FrameId::from(id), [0x92, 0, 0x80, 0, 0, 0, 8, 0]))
}

/// The motors' end of a line, and the device.
fn pty() -> (File, OwnedFd, String) {
    let OpenptyResult { master, slave } = openpty(None, None).unwrap();
    let device = nix::unistd::ttyname(&slave).unwrap().to_str().unwrap().to_owned();
    (master.into(), slave, device)
}

#[test]
fn every_motor_of_line_gets_stop_and_time() {
    let (mut motors, _slave, device) = pty();
    let mut port = Port::open(&device, 921_600).unwrap();
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(port.send_round(Instant::ZERO, &stops()), None);
    let mut heard = [0; 36];
    let begun = Clock::now();
    motors.read_exact(&mut heard).unwrap();
    assert!(begun.elapsed() >= PACE, "they collide with the answers");
    assert_eq!(heard.chunks(12).map(|frame| frame[0]).collect::<Vec<_>>(), [1, 2, 3]);
    assert_eq!(heard[..5], [0x01, 0x00, 0x08, 0x09, 0x92], "GIM document, table 3");
}

#[test]
fn accepted_round_leaves_before_port_is_released() {
    let (mut motors, _slave, device) = pty();
    let mut port = Port::open(&device, 921_600).unwrap();
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(port.send_round(Instant::ZERO, &stops()), None);
    drop(port);
    motors.read_exact(&mut [0; 36]).unwrap();
}

#[test]
fn missing_port_refuses_immediately_and_serves_when_present() {
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("adapter");
    let mut port = Port::open(link.to_str().unwrap(), 921_600).unwrap();
    let begun = Clock::now();
    let refused = (0..3).map(|_| {
        let refused = port.send_round(Instant::ZERO, &stops());
        std::thread::sleep(Duration::from_millis(20));
        refused
    });
    assert!(refused.collect::<Vec<_>>().contains(&Some(Refusal::Down)));
    assert!(begun.elapsed() < Duration::from_millis(500), "it blocked");
    let (mut motors, _slave, device) = pty();
    std::os::unix::fs::symlink(device, link).unwrap();
    port.send_round(Instant::ZERO, &stops());
    motors.read_exact(&mut [0; 36]).unwrap();
    std::thread::sleep(Duration::from_millis(20));
    assert_eq!(port.send_round(Instant::ZERO, &stops()), None);
}

#[test]
fn an_adapter_that_was_unplugged_is_let_go() {
    let (motors, slave, device) = pty();
    let port = Port::open(&device, 921_600).unwrap();
    std::thread::sleep(Duration::from_millis(50));
    drop((motors, slave));
    std::thread::sleep(2 * IDLE);
    let open = std::fs::read_dir("/proc/self/fd").unwrap();
    let links = open.filter_map(|entry| std::fs::read_link(entry.unwrap().path()).ok());
    assert!(!links.into_iter().any(|link| link.to_string_lossy().starts_with(&device)));
    drop(port);
}
