//! Tests on virtual interfaces.

use std::sync::atomic::{AtomicU32, Ordering};

use motord_bus::conformance::{Condition, Fixture, HOST_IDS, Stimulus};
use motord_bus::socketcan::{FdReplies, Link, OpenError, Sender, SocketCanBus, UnexpectedIds};
use motord_bus::{Bus, Content, Frame, FrameId, IdFilter, Inbox, Refusal, Sent, Unsupported, clock};
use socketcan::CanInterface;

use crate::counting::allocations;
use crate::peer::{Peer, stall, unstall};
use crate::settings;

struct Vcan {
    name: String,
    bus: SocketCanBus,
    peer: Peer,
    stalled: bool,
}

impl Vcan {
    /// Creates an interface, which the bus itself brings up.
    fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!("vt{}", NEXT.fetch_add(1, Ordering::Relaxed));
        CanInterface::create_vcan(&name, None).expect("root, and the module vcan");
        let bus = SocketCanBus::open(&settings(&name)).expect("an interface can be brought up");
        let peer = Peer::open(&name);
        Self { name, bus, peer, stalled: false }
    }

    fn interface(&self) -> CanInterface {
        CanInterface::open(&self.name).expect("the interface is there")
    }

    fn send(&mut self, frames: &[Frame]) -> Sent {
        self.bus.send(clock::monotonic(), frames)
    }

    fn receive_all(&mut self) -> (usize, u32) {
        let (mut count, mut lost) = (0, 0);
        loop {
            let mut inbox = Inbox::new();
            self.bus.receive(clock::monotonic(), &mut inbox);
            count += inbox.arrivals().len();
            lost += inbox.lost;
            if inbox.free() > 0 {
                return (count, lost);
            }
        }
    }
}

impl Drop for Vcan {
    fn drop(&mut self) {
        if let Ok(interface) = CanInterface::open(&self.name) {
            let _ended_anyway = interface.delete();
        }
    }
}

impl Fixture for Vcan {
    fn bus(&mut self) -> &mut dyn Bus {
        &mut self.bus
    }

    fn inject(&mut self, stimulus: Stimulus) -> bool {
        self.peer.inject(stimulus)
    }

    fn set(&mut self, condition: Condition) -> bool {
        match condition {
            Condition::Up if self.stalled => unstall(&self.name),
            Condition::Up => {
                let up = self.interface().bring_up().is_ok();
                self.peer = Peer::open(&self.name);
                up
            }
            Condition::Stalled => {
                self.stalled = stall(&self.name, 4);
                self.stalled
            }
            Condition::Down => self.interface().bring_down().is_ok(),
            Condition::Gone => self.interface().delete().is_ok(),
        }
    }

    fn allocations(&self) -> Option<u64> {
        Some(allocations())
    }

    fn received(&mut self) -> Vec<Frame> {
        self.peer.received()
    }
}

motord_bus::conformance! {
    [ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
    mod conforms: CanBus = Vcan::new;
    a_running_bus_allocates_nothing,
    an_fd_frame_never_arrives_as_a_frame,
    error_reports_arrive_as_reports,
    only_expected_ids_arrive,
}

fn frame(raw: u16) -> Frame {
    Frame::classic(FrameId::new(raw).expect("11 bits"), [raw as u8; 8])
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn frames_the_kernel_had_to_drop_are_counted() {
    const FLOOD: usize = 1000;
    let mut vcan = Vcan::new();
    for _ in 0..FLOOD {
        assert!(vcan.inject(Stimulus::Frame(frame(0x101))));
    }
    let (flooded, lost) = vcan.receive_all();
    assert!(flooded < FLOOD, "the receive buffer is larger than thought: {flooded}");
    // The kernel reports a loss with the next frame that it queues.
    assert!(vcan.inject(Stimulus::Frame(frame(0x101))));
    let (after, lost_after) = vcan.receive_all();
    assert_eq!((after, flooded + (lost + lost_after) as usize), (1, FLOOD));
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn unexpected_ids_are_counted_outside_realtime_path() {
    const FLOOD: u64 = 2000;
    let mut vcan = Vcan::new();
    let commands = [0x001, 0x002, 0x003].map(frame);
    let expected = HOST_IDS.into_iter().chain(commands.iter().map(Frame::id));
    let expected: Vec<_> = expected.map(IdFilter::exact).collect();
    let mut unexpected = UnexpectedIds::open(vcan.bus.link(), &expected).unwrap();
    assert_eq!(vcan.send(&commands), Sent::all(3));
    assert!(vcan.inject(Stimulus::Frame(frame(0x101))));
    assert_eq!(unexpected.count(), 0, "every id here is expected");
    for raw in [0x000, 0x100, 0x7FF].into_iter().cycle().take(FLOOD as usize) {
        assert!(vcan.inject(Stimulus::Frame(frame(raw))));
    }
    assert!(vcan.inject(Stimulus::Extended(HOST_IDS[0])) && vcan.inject(Stimulus::Remote(HOST_IDS[0])));
    assert!(unexpected.count() < FLOOD + 2, "the receive buffer is larger than thought");
    assert!(vcan.inject(Stimulus::Fd(HOST_IDS[0])) && vcan.inject(Stimulus::Frame(frame(0x200))));
    assert!(unexpected.count() >= FLOOD + 3, "{}", unexpected.count());
    assert_eq!(vcan.receive_all(), (1, 0), "only the motor's answer was received, and nothing was lost");
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn fd_replies_are_counted_beside_the_bus() {
    let mut vcan = Vcan::new();
    let expected = HOST_IDS.map(IdFilter::exact);
    let mut replies = FdReplies::open(vcan.bus.link(), &expected).unwrap();
    let mut unexpected = UnexpectedIds::open(vcan.bus.link(), &expected).unwrap();
    assert!(vcan.inject(Stimulus::Frame(frame(0x101))) && vcan.inject(Stimulus::Fd(HOST_IDS[0])));
    assert!(vcan.inject(Stimulus::Extended(HOST_IDS[0])));
    assert_eq!((replies.count(), unexpected.count(), unexpected.extended()), (1, 1, 1));
    assert_eq!(vcan.receive_all(), (1, 0), "the bus receives the classic reply only");
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn search_socket_receives_every_format() {
    let mut vcan = Vcan::new();
    let mut search = SocketCanBus::open_as_is(settings(&vcan.name).interface).unwrap();
    assert!(vcan.inject(Stimulus::Fd(HOST_IDS[0])) && vcan.inject(Stimulus::Extended(HOST_IDS[0])));
    let mut inbox = Inbox::new();
    search.receive(motord_bus::clock::monotonic(), &mut inbox);
    let contents: Vec<_> = inbox.arrivals().iter().map(|arrival| arrival.content).collect();
    let [Content::Unsupported(Unsupported::Fd), Content::Frame(extended)] = contents[..] else {
        panic!("{contents:?}")
    };
    assert!(extended.id().is_extended() && extended.id().raw() == HOST_IDS[0].raw(), "{extended:?}");
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn reopened_bus_leaks_no_descriptor() {
    let descriptors = || std::fs::read_dir("/proc/self/fd").unwrap().count();
    let mut vcan = Vcan::new();
    let before = descriptors();
    for round in 0..20 {
        assert!(vcan.set(Condition::Gone));
        let _error = vcan.receive_all();
        assert_eq!(vcan.send(&[frame(1)]).refusal, Some(Refusal::Gone), "round {round}");
        let missing = settings(&vcan.name).interface;
        assert_eq!(SocketCanBus::open(&settings(&vcan.name)).err(), Some(OpenError::Missing(missing)));
        CanInterface::create_vcan(&vcan.name, None).unwrap();
        vcan.bus = SocketCanBus::open(&settings(&vcan.name)).unwrap();
        assert_eq!(vcan.send(&[frame(1)]), Sent::all(1));
    }
    assert_eq!(descriptors(), before);
}

/// Goal: the sender that stops the motors of a dead daemon uses the interface that has the name at
/// that time. A send never waits for the search.
#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn sender_finds_the_current_interface_of_name() {
    let frames = [frame(1), frame(2)];
    let send = |sender: &mut Sender| sender.send(clock::monotonic(), &frames);
    let mut vcan = Vcan::new();
    let interface = settings(&vcan.name).interface;
    let mut sender = Sender::new(interface, 8).unwrap();
    for round in 0..10 {
        let before = allocations();
        assert_eq!(send(&mut sender).refusal, Some(Refusal::Gone), "round {round}: before the search");
        assert_eq!(sender.find(), Ok(()), "round {round}: new");
        assert_eq!((send(&mut sender), allocations() - before), (Sent::all(2), 0), "round {round}");
        assert_eq!(vcan.received(), frames);
        assert!(vcan.set(Condition::Down));
        assert_eq!(send(&mut sender).refusal, Some(Refusal::Down), "round {round}");
        assert!(vcan.set(Condition::Up));
        assert_eq!(send(&mut sender), Sent::all(2), "round {round}: up again");
        assert!(vcan.set(Condition::Down) && vcan.set(Condition::Up));
        assert_eq!(send(&mut sender), Sent::all(2), "round {round}: it was down between two frames");
        assert!(vcan.set(Condition::Gone));
        let before = allocations();
        assert_eq!(send(&mut sender).refusal, Some(Refusal::Gone), "round {round}");
        assert_eq!(sender.find(), Err(OpenError::Missing(interface)));
        assert_eq!(allocations(), before);
        CanInterface::create_vcan(&vcan.name, None).unwrap();
        assert!(vcan.set(Condition::Up));
    }
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn a_sender_takes_no_interface_of_another_kind() {
    let lo = settings("lo").interface;
    let mut sender = Sender::new(lo, 8).unwrap();
    assert_eq!(sender.find(), Err(OpenError::NotCan(lo)));
    assert_eq!(sender.send(clock::monotonic(), &[frame(1)]).refusal, Some(Refusal::Gone));
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn an_interface_of_another_kind_is_refused_untouched() {
    let queue_length = || std::fs::read_to_string("/sys/class/net/lo/tx_queue_len").unwrap();
    let before = queue_length();
    let lo = settings("lo");
    assert_eq!(SocketCanBus::open(&lo).err(), Some(OpenError::NotCan(lo.interface)));
    assert_eq!(Link::read(lo.interface), Err(OpenError::NotCan(lo.interface)));
    assert_eq!(queue_length(), before);
}
