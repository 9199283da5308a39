//! Simulated motors on a pseudo terminal, with a host that opens its device.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_bus::{Duration, clock, wait};
use motord_simulator::{BusSettings, Medium, MotorSettings, SerialPort, SerialSlave, SimulatedBus};
use nix::fcntl::OFlag;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// GIM document, table 3 and 3.2.14: "get version" to id 1.
const GET_VERSION: [u8; 12] = [0x01, 0x00, 0x08, 0x09, 0xB1, 0, 0, 0, 0, 0, 0, 0];
const VERSION: [u8; 12] = [0x05, 0x00, 0x08, 0x0D, 0xB1, 0, 0, 0, 0x03, 0x02, 0x01, 0x00];

fn port(link: Option<PathBuf>) -> SerialPort {
    let settings =
        BusSettings { name: "arm".into(), medium: Medium::Serial, bitrate: 921_600, ..Default::default() };
    let motor = MotorSettings { name: "elbow".into(), host_id: 5, ..Default::default() };
    SerialPort::open(SerialSlave::new(SimulatedBus::new(settings, vec![motor], 0), 0), link).unwrap()
}

fn open(device: &Path) -> File {
    let flags = OFlag::O_NONBLOCK | OFlag::O_NOCTTY;
    File::options().read(true).write(true).custom_flags(flags.bits()).open(device).unwrap()
}

fn inject(port: &mut SerialPort, verb: &str) {
    port.inject(clock::monotonic(), &verb.parse().unwrap()).unwrap();
}

/// Serves for 20 ms, and returns the bytes that the host can then read.
fn listen(port: &mut SerialPort, host: &mut File) -> Vec<u8> {
    let end = clock::monotonic() + Duration::from_millis(20);
    while clock::monotonic() < end {
        port.serve(clock::monotonic());
        let _ready = wait(&[port.readiness()], clock::monotonic(), port.due().min(end));
    }
    let mut bytes = [0; 4096];
    match host.read(&mut bytes) {
        Ok(count) => bytes[..count].to_vec(),
        Err(error) if error.kind() == ErrorKind::WouldBlock => Vec::new(),
        Err(error) => panic!("{error}"),
    }
}

fn ask(port: &mut SerialPort, host: &mut File) -> Vec<u8> {
    host.write_all(&GET_VERSION).unwrap();
    listen(port, host)
}

#[test]
fn host_may_reopen_the_device() {
    let mut port = port(None);
    let device = port.path().unwrap().to_owned();
    for _ in 0..3 {
        let mut host = open(&device);
        assert_eq!(ask(&mut port, &mut host), VERSION);
        drop(host);
        port.serve(clock::monotonic());
    }
}

#[test]
fn unplugged_port_hangs_up_and_link_moves() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("ttyUSB0");
    let mut port = port(Some(link.clone()));
    let mut host = open(&link);
    assert_eq!(ask(&mut port, &mut host), VERSION);
    inject(&mut port, "arm gone");
    assert!(port.path().is_none());
    assert!(host.write_all(&GET_VERSION).is_err(), "the device is gone");
    port.serve(clock::monotonic());
    inject(&mut port, "arm ok");
    assert_eq!(ask(&mut port, &mut open(&link)), VERSION);
}

#[test]
fn blocked_port_takes_no_byte_then_recovers() {
    let mut port = port(None);
    let mut host = open(port.path().unwrap());
    inject(&mut port, "arm blocked");
    assert_eq!(host.write(&GET_VERSION).unwrap_err().kind(), ErrorKind::WouldBlock);
    assert!(listen(&mut port, &mut host).is_empty());
    inject(&mut port, "arm ok");
    assert_eq!(ask(&mut port, &mut host), VERSION);
}

#[test]
fn link_never_replaces_other_files() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("ttyUSB0");
    File::create(&link).unwrap();
    let slave = SerialSlave::new(SimulatedBus::new(BusSettings::default(), Vec::new(), 0), 0);
    assert_eq!(SerialPort::open(slave, Some(link)).unwrap_err().kind(), ErrorKind::AlreadyExists);
}
