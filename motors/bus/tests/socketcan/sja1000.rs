//! Tests on two SJA1000 controllers that share a bus, as `can0` and `can1`.

use std::fs;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use motord_bus::conformance::{Condition, Fixture, Stimulus};
use motord_bus::socketcan::{InterfaceName, Link, LinkNote, OpenError, RESTART_MS, Settings, SocketCanBus};
use motord_bus::{Bus, Frame};
use nix::unistd::{Uid, seteuid};
use socketcan::CanInterface;

use crate::counting::allocations;
use crate::peer::{Peer, run, stall, unstall};
use crate::{BITRATE, settings};

/// Only one pair exists, and every test uses it exclusively.
static PAIR: Mutex<()> = Mutex::new(());

fn take_pair() -> MutexGuard<'static, ()> {
    let pair = PAIR.lock().unwrap_or_else(PoisonError::into_inner);
    for interface in ["can0", "can1"] {
        assert!(run(&format!("ip link set {interface} down")), "the rig has {interface}");
    }
    pair
}

fn name(interface: &str) -> InterfaceName {
    interface.parse().expect("a valid name")
}

struct Sja1000 {
    bus: SocketCanBus,
    peer: Peer,
    stalled: bool,
    /// The driver's folder and the device's name in it, while the adapter is "unplugged".
    unbound: Option<(PathBuf, String)>,
    _pair: MutexGuard<'static, ()>,
}

impl Sja1000 {
    fn new() -> Self {
        let pair = take_pair();
        Link::prepare(name("can1"), None, BITRATE, 100).expect("can1 can be set up");
        let bus = SocketCanBus::open(&settings("can0")).expect("can0 can be set up");
        Self { bus, peer: Peer::open("can1"), stalled: false, unbound: None, _pair: pair }
    }

    fn unplug(&mut self) -> bool {
        let device = fs::canonicalize("/sys/class/net/can0/device").expect("can0 has a device");
        let driver = device.join("driver").canonicalize().expect("the device has a driver");
        let address = device.file_name().expect("a device has an address").to_string_lossy().into_owned();
        let unbound = fs::write(driver.join("unbind"), &address).is_ok();
        self.unbound = Some((driver, address));
        unbound
    }
}

impl Drop for Sja1000 {
    fn drop(&mut self) {
        if let Some((driver, address)) = &self.unbound {
            let bound = fs::write(driver.join("bind"), address);
            assert!(bound.is_ok() || std::thread::panicking(), "{bound:?}");
        } else if self.stalled {
            unstall("can0");
        }
    }
}

impl Fixture for Sja1000 {
    fn bus(&mut self) -> &mut dyn Bus {
        &mut self.bus
    }

    fn inject(&mut self, stimulus: Stimulus) -> bool {
        self.peer.inject(stimulus)
    }

    fn received(&mut self) -> Vec<Frame> {
        self.peer.received()
    }

    fn set(&mut self, condition: Condition) -> bool {
        let can0 = || CanInterface::open("can0").expect("can0 is there");
        match condition {
            Condition::Up if self.stalled => {
                self.stalled = false;
                unstall("can0")
            }
            Condition::Up => can0().bring_up().is_ok(),
            Condition::Stalled => {
                self.stalled = stall("can0", 4);
                self.stalled
            }
            Condition::Down => can0().bring_down().is_ok(),
            Condition::Gone => self.unplug(),
        }
    }

    fn allocations(&self) -> Option<u64> {
        Some(allocations())
    }
}

// CAN FD is missing, which these controllers do not support. Injected error reports are missing,
// which only a virtual interface carries.
motord_bus::conformance! {
    [ignore = "needs two SJA1000 on one bus and root: run verify/rigs/test-can"]
    mod conforms: CanBus = Sja1000::new;
    a_running_bus_allocates_nothing,
    only_expected_ids_arrive,
}

/// Runs without privileges until dropped.
struct OtherUser;

impl OtherUser {
    fn new() -> Self {
        seteuid(Uid::from_raw(65534)).expect("the tests run as root");
        Self
    }
}

impl Drop for OtherUser {
    fn drop(&mut self) {
        seteuid(Uid::from_raw(0)).expect("root may return");
    }
}

#[test]
#[ignore = "needs two SJA1000 on one bus and root: run verify/rigs/test-can"]
fn permitted_process_brings_controller_up() {
    let _pair = take_pair();
    assert!(!Link::read(name("can0")).unwrap().up);
    let bus = SocketCanBus::open(&settings("can0")).unwrap();
    let link = *bus.link();
    assert_eq!((link.up, link.bitrate, link.restart_ms), (true, Some(BITRATE), Some(RESTART_MS)));
    assert_eq!(
        fs::read_to_string("/sys/class/net/can0/tx_queue_len").unwrap(),
        "8\n",
        "two cycles of four frames"
    );
    drop(bus);
    assert_eq!(Link::read(name("can0")), Ok(link), "the settings are not restored");
}

/// Goal: an adapter that gets the name of another, while that one is opened, is not set up.
#[test]
#[ignore = "needs two SJA1000 on one bus and root: run verify/rigs/test-can"]
fn interface_of_another_index_is_left_alone() {
    let _pair = take_pair();
    let before = Link::read(name("can0")).unwrap();
    let other = Link::read(name("can1")).unwrap().index;
    let refused = SocketCanBus::open(&Settings { index: Some(other), ..settings("can0") }).err();
    assert_eq!(refused, Some(OpenError::Missing(name("can0"))));
    assert_eq!(Link::read(name("can0")), Ok(before));
    SocketCanBus::open(&Settings { index: Some(before.index), ..settings("can0") }).unwrap();
}

#[test]
#[ignore = "needs two SJA1000 on one bus and root: run verify/rigs/test-can"]
fn wrong_bit_rate_is_mended_or_explained() {
    let _pair = take_pair();
    assert!(run("ip link set can0 type can bitrate 500000") && run("ip link set can0 up"));
    let other_user = OtherUser::new();
    let refused = SocketCanBus::open(&settings("can0")).err().unwrap();
    drop(other_user);
    assert_eq!(
        refused.to_string(),
        "can0 is set to 500000 bit/s, 1000000 are configured; as root: ip link set can0 down; \
         ip link set can0 type can bitrate 1000000; ip link set can0 type can restart-ms 100; ip link set can0 txqueuelen 8 up"
    );
    assert_eq!(Link::read(name("can0")).unwrap().bitrate, Some(500_000), "a refusal changes nothing");
    let commands = refused.to_string().split("as root: ").nth(1).unwrap().to_owned();
    assert!(commands.split("; ").all(run), "the commands of the remedy work");
    let other_user = OtherUser::new();
    let bus = SocketCanBus::open(&settings("can0")).unwrap();
    drop(other_user);
    assert_eq!(bus.link().bitrate, Some(BITRATE));
    assert_eq!(bus.notes(BITRATE).count(), 0);

    assert!(run("ip link set can0 down") && run("ip link set can0 type can bitrate 500000"));
    assert_eq!(SocketCanBus::open(&settings("can0")).unwrap().link().bitrate, Some(BITRATE));
}

#[test]
#[ignore = "needs two SJA1000 on one bus and root: run verify/rigs/test-can"]
fn listen_only_controller_is_mended_or_refused() {
    let _pair = take_pair();
    assert!(run("ip link set can0 type can bitrate 1000000 listen-only on") && run("ip link set can0 up"));
    let other_user = OtherUser::new();
    let refused = SocketCanBus::open(&settings("can0")).err();
    drop(other_user);
    assert!(matches!(refused, Some(OpenError::Deaf { .. })), "{refused:?}");
    let bus = SocketCanBus::open(&settings("can0")).unwrap();
    assert!(!bus.link().listen_only);
    let notes: Vec<LinkNote> = bus.notes(BITRATE).collect();
    assert_eq!(notes, [LinkNote::ModeEnded(name("can0"))], "a person may have set it");
}

#[test]
#[ignore = "needs two SJA1000 on one bus and root: run verify/rigs/test-can"]
fn refused_controller_keeps_its_settings() {
    let _pair = take_pair();
    assert!(run("ip link set can0 type can bitrate 500000 sample-point 0.8 listen-only on restart-ms 70"));
    assert!(run("ip link set can0 up"));
    let before = Link::read(name("can0")).unwrap();
    let refused = SocketCanBus::open(&Settings { bitrate: 1, ..settings("can0") }).err();
    assert!(matches!(refused, Some(OpenError::Refused { .. })), "{refused:?}");
    assert_eq!(Link::read(name("can0")), Ok(before));
    assert!(run("ip link set can0 down") && run("ip link set can0 type can listen-only off restart-ms 0"));
}

#[test]
#[ignore = "needs two SJA1000 on one bus and root: run verify/rigs/test-can"]
fn impossible_bit_rate_is_refused() {
    let _pair = take_pair();
    for bitrate in [0, 1] {
        let refused = SocketCanBus::open(&Settings { bitrate, ..settings("can0") }).err();
        assert!(matches!(refused, Some(OpenError::Refused { .. })), "{bitrate}: {refused:?}");
    }
}
