//! Tests on an adapter whose driver, `slcan`, supports no restart after a bus-off, and knows no bit
//! rate that it did not set itself. The tests are the adapter, at the other side of a
//! pseudoterminal.

use std::collections::BTreeSet;
use std::fs;
use std::fs::File;
use std::io::{BufReader, Read};
use std::os::fd::OwnedFd;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use motord_bus::socketcan::{InterfaceName, Link, LinkNote, OpenError, Settings, SocketCanBus};
use nix::pty::openpty;
use nix::unistd::ttyname;

use crate::peer::run;
use crate::{BITRATE, settings};

/// The line discipline of serial CAN adapters (linux/tty.h).
const N_SLCAN: u8 = 17;

struct Adapter {
    interface: InterfaceName,
    /// The bytes that the driver writes to the adapter.
    written: Receiver<u8>,
    _slave: OwnedFd,
}

fn interfaces() -> BTreeSet<String> {
    let entries = fs::read_dir("/sys/class/net").expect("a kernel with a network");
    entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect()
}

impl Adapter {
    fn new() -> Self {
        let pair = openpty(None, None).expect("a pseudoterminal");
        let device = ttyname(&pair.slave).expect("a terminal has a name");
        let before = interfaces();
        assert!(run(&format!("ldattach {N_SLCAN} {}", device.display())), "the rig has slcan");
        let deadline = Instant::now() + Duration::from_secs(10);
        let interface = loop {
            if let Some(new) = interfaces().difference(&before).next() {
                break new.parse().expect("a valid name");
            }
            assert!(Instant::now() < deadline, "no interface appears");
        };
        let (sender, written) = channel();
        std::thread::spawn(move || {
            let bytes = BufReader::new(File::from(pair.master)).bytes();
            bytes.map_while(Result::ok).try_for_each(|byte| sender.send(byte))
        });
        Self { interface, written, _slave: pair.slave }
    }

    fn set(&self, words: &str) -> bool {
        run(&format!("ip link set {} {words}", self.interface))
    }

    fn open(&self) -> Result<SocketCanBus, OpenError> {
        SocketCanBus::open(&Settings { interface: self.interface, ..settings("can0") })
    }

    /// Waits until the driver has written `text`.
    fn must_be_written(&self, text: &str) {
        let mut written = String::new();
        while !written.contains(text) {
            let byte = self.written.recv_timeout(Duration::from_secs(10));
            written.push(char::from(byte.unwrap_or_else(|_| panic!("{text:?} is not in {written:?}"))));
        }
    }
}

#[test]
#[ignore = "needs slcan and root: run verify/rigs/test-can"]
fn adapter_without_restart_is_set_up() {
    let adapter = Adapter::new();
    let bus = adapter.open().expect("only the restart is not supported");
    assert_eq!((bus.link().up, bus.link().bitrate, bus.link().restart_ms), (true, Some(BITRATE), Some(0)));
    let notes: Vec<LinkNote> = bus.notes(BITRATE).collect();
    assert_eq!(notes, [LinkNote::NoRestart(adapter.interface)]);
    adapter.must_be_written("S8\rO\r");
}

/// `slcand -o -s8` opens the adapter itself, and the driver does not know at which rate.
#[test]
#[ignore = "needs slcan and root: run verify/rigs/test-can"]
fn interface_of_unknown_bit_rate_is_used() {
    let adapter = Adapter::new();
    assert!(adapter.set("up"));
    let before = Link::read(adapter.interface).unwrap();
    assert_eq!((before.up, before.bitrate, before.is_virtual), (true, None, false));
    let bus = adapter.open().expect("an unknown rate may be right");
    assert_eq!((bus.link().up, bus.link().bitrate), (true, None));
    let notes: Vec<LinkNote> = bus.notes(BITRATE).collect();
    let unknown = LinkNote::UnknownBitrate { interface: adapter.interface, expected: BITRATE };
    assert_eq!(notes, [unknown, LinkNote::NoRestart(adapter.interface)]);
    drop(bus);
    SocketCanBus::open_as_is(adapter.interface).expect("tools use it, too");
}

#[test]
#[ignore = "needs slcan and root: run verify/rigs/test-can"]
fn refused_link_is_left_as_it_was() {
    let adapter = Adapter::new();
    assert!(adapter.set("type can bitrate 500000") && adapter.set("up"));
    let impossible = Settings { interface: adapter.interface, bitrate: 333_333, ..settings("can0") };
    let refused = SocketCanBus::open(&impossible).err();
    assert!(matches!(refused, Some(OpenError::Refused { .. })), "{refused:?}");
    let link = Link::read(adapter.interface).unwrap();
    assert_eq!((link.up, link.bitrate), (true, Some(500_000)));
    let commands = refused.and_then(|refused| refused.remedy().map(ToString::to_string)).unwrap();
    assert!(commands.contains("restart-ms"), "{commands}");
}

/// Every driver must end up with the bit rate, whichever of the printed commands it refuses.
#[test]
#[ignore = "needs slcan and root: run verify/rigs/test-can"]
fn printed_commands_set_up_any_adapter() {
    let adapter = Adapter::new();
    let link = Link::read(adapter.interface).unwrap();
    let refused = link.check(BITRATE, 8).unwrap_err();
    let commands = refused.remedy().unwrap().to_string();
    let failed: Vec<&str> = commands.split("; ").filter(|command| !run(command)).collect();
    assert_eq!(failed, [format!("ip link set {} type can restart-ms 100", adapter.interface)]);
    let link = Link::read(adapter.interface).unwrap();
    assert_eq!((link.up, link.bitrate), (true, Some(BITRATE)));
}
