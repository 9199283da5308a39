//! The properties that every [`Bus`] must have, as tests that any implementation can run.
//!
//! An implementation provides a [`Fixture`]: its bus, and the other end of the wire.
//! [`conformance!`](crate::conformance!) creates one test per property in its list. Leave out a
//! property that the implementation cannot support. A fixture that cannot do a step of a property
//! fails the test.
//!
//! The bus under test expects [`HOST_IDS`] and nothing else.

use crate::frame::{Arrival, Content, ControllerState, ErrorFrame, Frame, FrameId, Inbox};
use crate::time::{Duration, Instant};
use crate::{Bus, Readiness, Refusal, Sent, clock, wait};

/// Ids that the bus under test receives.
pub const HOST_IDS: [FrameId; 3] = [id(0x101), id(0x102), id(0x103)];

const fn id(raw: u16) -> FrameId {
    FrameId::new(raw).expect("the ids of this file have 11 bits")
}

/// A bus under test and the other end of its wire.
pub trait Fixture {
    /// The bus under test.
    fn bus(&mut self) -> &mut dyn Bus;

    /// Returns the present time on the clock of this bus. The default is `CLOCK_MONOTONIC`.
    fn now(&self) -> Instant {
        clock::monotonic()
    }

    /// Lets time pass. The default sleeps; a bus on simulated time advances its clock.
    fn pass(&mut self, time: Duration) {
        std::thread::sleep(time);
    }

    /// Sends something from another node. `false` when this wire cannot carry it.
    fn inject(&mut self, stimulus: Stimulus) -> bool;

    /// Returns the frames that the other nodes received since the last call, oldest first.
    fn received(&mut self) -> Vec<Frame>;

    /// Puts the interface into `condition`. `false` when the fixture does not support it.
    fn set(&mut self, condition: Condition) -> bool;

    /// Returns the number of allocations of the calling thread, from a counting allocator. `None`
    /// without one.
    fn allocations(&self) -> Option<u64> {
        None
    }
}

/// A frame or report that another node sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stimulus {
    /// A data frame.
    Frame(Frame),
    /// A data frame whose 29-bit id has the value of one of [`HOST_IDS`].
    Extended(FrameId),
    /// A remote transmission request.
    Remote(FrameId),
    /// A CAN FD frame.
    Fd(FrameId),
    /// A report of the controller.
    Error(ErrorFrame),
}

/// The condition of an interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Condition {
    /// Working.
    Up,
    /// Up, but nothing is sent: the queue fills.
    Stalled,
    /// Down.
    Down,
    /// Unplugged.
    Gone,
}

/// Creates a test of each named property, for the fixture that `$new` returns. `: CanBus` adds the
/// properties that every bus with classic CAN frames has.
///
/// ```text
/// motord_bus::conformance! {
///     [ignore = "needs SocketCAN: run verify/rigs/test-can"]
///     mod vcan: CanBus = Vcan::new;
///     only_expected_ids_arrive,
///     error_reports_arrive_as_reports,
/// }
/// ```
#[macro_export]
macro_rules! conformance {
    (@test [$($attribute:meta)?] $new:path, $property:ident) => {
        #[test]
        $(#[$attribute])?
        fn $property() {
            $crate::conformance::$property(&mut $new());
        }
    };
    ($attribute:tt mod $name:ident: CanBus = $new:path; $($property:ident),* $(,)?) => {
        $crate::conformance! {
            $attribute
            mod $name = $new;
            bus_that_is_down_reports_and_recovers,
            unplugged_bus_is_reported,
            a_flood_fills_an_inbox_and_no_more,
            a_stalled_bus_refuses_at_once_and_forgets,
            a_stamp_is_the_time_of_arrival,
            an_absurd_batch_is_cut,
            arrivals_keep_the_order_of_the_wire,
            every_length_arrives_as_it_was_sent,
            unsupported_frames_never_arrive_as_frames,
            frames_leave_in_the_order_given,
            own_frames_are_not_received,
            readiness_announces_an_arrival,
            stamps_run_forwards_and_never_into_the_future,
            $($property,)*
        }
    };
    ($attribute:tt mod $name:ident = $new:path; $($property:ident),+ $(,)?) => {
        mod $name {
            use super::*;
            $($crate::conformance!(@test $attribute $new, $property);)+
        }
    };
}

/// Long enough for everything on the wire to arrive, on a loaded machine and a slow emulation.
const SETTLED: Duration = Duration::from_millis(50);
/// A call that blocks waits for a frame that never comes. Far longer than other work of the
/// computer may delay one that does not block: rigs run with the processor time that is left.
const BLOCKED: Duration = Duration::from_secs(30);

fn numbered(id: FrameId, number: u16) -> Frame {
    let [high, low] = number.to_be_bytes();
    Frame::classic(id, [high, low, 2, 3, 4, 5, 6, 7])
}

fn frames(count: u16) -> Vec<Frame> {
    (0..count).map(|number| numbered(HOST_IDS[usize::from(number) % HOST_IDS.len()], number)).collect()
}

fn send(fixture: &mut dyn Fixture, frames: &[Frame]) -> Sent {
    let now = fixture.now();
    let sent = fixture.bus().send(now, frames);
    assert!(fixture.now().since(now) < BLOCKED, "sending blocked");
    assert_eq!(
        sent.refusal.is_none(),
        sent.accepted == frames.len(),
        "there is a refusal exactly when frames were refused: {sent:?}"
    );
    sent
}

fn receive(fixture: &mut dyn Fixture) -> Inbox {
    let mut inbox = Inbox::new();
    let now = fixture.now();
    fixture.bus().receive(now, &mut inbox);
    assert!(fixture.now().since(now) < BLOCKED, "receiving blocked");
    inbox
}

fn contents(inbox: &Inbox) -> Vec<Content> {
    inbox.arrivals().iter().map(|arrival| arrival.content).collect()
}

fn inject(fixture: &mut dyn Fixture, stimulus: Stimulus) {
    assert!(fixture.inject(stimulus), "this fixture cannot carry {stimulus:?}: leave the property out");
}

fn set(fixture: &mut dyn Fixture, condition: Condition) {
    assert!(fixture.set(condition), "this fixture cannot be {condition:?}: leave the property out");
}

/// The order given is the order on the wire.
pub fn frames_leave_in_the_order_given(fixture: &mut dyn Fixture) {
    let frames = frames(4);
    assert_eq!(send(fixture, &frames), Sent::all(4));
    fixture.pass(SETTLED);
    assert_eq!(fixture.received(), frames);
    assert_eq!(send(fixture, &[]), Sent::all(0));
}

/// The order on the wire is the order in the inbox.
pub fn arrivals_keep_the_order_of_the_wire(fixture: &mut dyn Fixture) {
    let frames = frames(6);
    for frame in &frames {
        inject(fixture, Stimulus::Frame(*frame));
    }
    fixture.pass(SETTLED);
    let expected: Vec<_> = frames.into_iter().map(Content::Frame).collect();
    assert_eq!(contents(&receive(fixture)), expected);
    assert_eq!(contents(&receive(fixture)), [], "frames are received once");
}

/// Payloads of every length arrive with their length.
pub fn every_length_arrives_as_it_was_sent(fixture: &mut dyn Fixture) {
    for len in 0..=8 {
        let frame = Frame::new(HOST_IDS[0], &[0xA5; 8][..len]).expect("at most eight bytes");
        inject(fixture, Stimulus::Frame(frame));
        fixture.pass(SETTLED);
        assert_eq!(contents(&receive(fixture)), [Content::Frame(frame)]);
    }
}

/// Frames of this bus reach other nodes, and never the bus itself.
pub fn own_frames_are_not_received(fixture: &mut dyn Fixture) {
    assert_eq!(send(fixture, &frames(3)), Sent::all(3));
    fixture.pass(SETTLED);
    assert_eq!(contents(&receive(fixture)), []);
}

/// An id next to an expected one does not arrive.
pub fn only_expected_ids_arrive(fixture: &mut dyn Fixture) {
    for raw in [0x000, 0x001, 0x100, 0x104, 0x301, 0x7FF] {
        inject(fixture, Stimulus::Frame(numbered(id(raw), raw)));
    }
    let expected = numbered(HOST_IDS[1], 1);
    inject(fixture, Stimulus::Frame(expected));
    fixture.pass(SETTLED);
    assert_eq!(contents(&receive(fixture)), [Content::Frame(expected)]);
}

/// An extended frame and a remote request with the number of an expected id do not arrive as that
/// frame.
pub fn unsupported_frames_never_arrive_as_frames(fixture: &mut dyn Fixture) {
    inject(fixture, Stimulus::Extended(HOST_IDS[0]));
    inject(fixture, Stimulus::Remote(HOST_IDS[0]));
    fixture.pass(SETTLED);
    let frame = contents(&receive(fixture)).into_iter().find(|content| matches!(content, Content::Frame(_)));
    assert_eq!(frame, None);
}

/// A CAN FD frame with an expected id does not arrive as a classic one.
pub fn an_fd_frame_never_arrives_as_a_frame(fixture: &mut dyn Fixture) {
    inject(fixture, Stimulus::Fd(HOST_IDS[0]));
    fixture.pass(SETTLED);
    let frame = contents(&receive(fixture)).into_iter().find(|content| matches!(content, Content::Frame(_)));
    assert_eq!(frame, None);
}

/// A report of the controller arrives as a report, whatever the filters are, and in order with the
/// frames.
pub fn error_reports_arrive_as_reports(fixture: &mut dyn Fixture) {
    let passive = ErrorFrame { class: ErrorFrame::CONTROLLER, data: [0, 0x20, 0, 0, 0, 0, 0, 0] };
    let bus_off = ErrorFrame { class: ErrorFrame::BUS_OFF, data: [0; 8] };
    let restarted = ErrorFrame { class: ErrorFrame::RESTARTED, data: [0; 8] };
    let frame = numbered(HOST_IDS[0], 7);
    inject(fixture, Stimulus::Error(passive));
    inject(fixture, Stimulus::Error(bus_off));
    inject(fixture, Stimulus::Frame(frame));
    inject(fixture, Stimulus::Error(restarted));
    fixture.pass(SETTLED);
    let arrived = contents(&receive(fixture));
    let states: Vec<_> = arrived
        .iter()
        .filter_map(|content| if let Content::Error(report) = content { Some(report.state()) } else { None })
        .collect();
    let expected = [ControllerState::Passive, ControllerState::Off, ControllerState::Active].map(Some);
    assert_eq!(states, expected);
    assert_eq!(arrived.get(2), Some(&Content::Frame(frame)));
}

/// One call fills at most one inbox. The following calls return the rest, and no frame arrives
/// twice.
pub fn a_flood_fills_an_inbox_and_no_more(fixture: &mut dyn Fixture) {
    const FLOOD: u16 = 100;
    for frame in frames(FLOOD) {
        inject(fixture, Stimulus::Frame(frame));
    }
    fixture.pass(4 * SETTLED);
    let mut half_full = Inbox::new();
    let earlier = Arrival { at: Instant::ZERO, content: Content::Frame(numbered(HOST_IDS[0], 999)) };
    while half_full.free() > 2 {
        half_full.push(earlier).expect("the inbox is not full");
    }
    let now = fixture.now();
    fixture.bus().receive(now, &mut half_full);
    assert_eq!(half_full.free(), 0);
    assert_eq!(half_full.arrivals()[0], earlier, "earlier arrivals stay");
    fixture.bus().receive(now, &mut half_full);
    let rest = [receive(fixture), receive(fixture), receive(fixture)];
    let arrived = contents(&half_full)
        .into_iter()
        .skip(Inbox::CAPACITY - 2)
        .chain(rest.iter().flat_map(contents))
        .collect::<Vec<_>>();
    assert_eq!(arrived, frames(FLOOD).into_iter().map(Content::Frame).collect::<Vec<_>>());
    assert_eq!(rest[0].arrivals().len(), Inbox::CAPACITY);
}

/// Receive stamps never decrease, and are never later than the `now` of their call.
pub fn stamps_run_forwards_and_never_into_the_future(fixture: &mut dyn Fixture) {
    let mut latest = fixture.now();
    for round in 0..20 {
        for number in 0..3 {
            inject(fixture, Stimulus::Frame(numbered(HOST_IDS[0], 3 * round + number)));
        }
        fixture.pass(SETTLED / 10);
        let inbox = receive(fixture);
        let now = fixture.now();
        for arrival in inbox.arrivals() {
            assert!(arrival.at >= latest, "{:?} after {latest:?}", arrival.at);
            assert!(arrival.at <= now, "{:?} is later than {now:?}", arrival.at);
            latest = arrival.at;
        }
    }
}

/// A stamp is the time of arrival, not the time of reading.
pub fn a_stamp_is_the_time_of_arrival(fixture: &mut dyn Fixture) {
    let _nothing = receive(fixture);
    inject(fixture, Stimulus::Frame(numbered(HOST_IDS[0], 0)));
    let arrived_by = await_arrival(fixture);
    fixture.pass(4 * SETTLED);
    let inbox = receive(fixture);
    let at = inbox.arrivals().first().expect("the frame arrived").at;
    assert!(at <= arrived_by, "stamped {:?} late", at.since(arrived_by));
}

/// Returns a time by which something has arrived. Waits for at most about 5 s, then panics.
fn await_arrival(fixture: &mut dyn Fixture) -> Instant {
    for _ in 0..1000 {
        let now = fixture.now();
        let readiness = fixture.bus().readiness();
        let arrived = match readiness {
            Readiness::Readable(_) => wait(&[readiness], now, now).any(),
            Readiness::At(instant) => instant <= now,
            Readiness::Never => false,
        };
        if arrived {
            return fixture.now();
        }
        fixture.pass(SETTLED / 10);
    }
    panic!("nothing arrived");
}

/// The bus is not ready before a frame arrives, and ready after it.
pub fn readiness_announces_an_arrival(fixture: &mut dyn Fixture) {
    let ready = |fixture: &mut dyn Fixture, timeout| {
        let now = fixture.now();
        let readiness = fixture.bus().readiness();
        match readiness {
            Readiness::Readable(_) => wait(&[readiness], now, now + timeout).any(),
            Readiness::At(instant) => instant <= now + timeout,
            Readiness::Never => false,
        }
    };
    assert!(!ready(fixture, Duration::from_millis(2)));
    inject(fixture, Stimulus::Frame(numbered(HOST_IDS[0], 0)));
    assert!(ready(fixture, SETTLED));
    fixture.pass(SETTLED);
    assert_eq!(receive(fixture).arrivals().len(), 1);
    assert!(!ready(fixture, Duration::from_millis(2)));
}

/// A bus that cannot send refuses instead of blocking, and never sends refused frames later.
pub fn a_stalled_bus_refuses_at_once_and_forgets(fixture: &mut dyn Fixture) {
    set(fixture, Condition::Stalled);
    let mut accepted = Vec::new();
    let refusal = frames(300).chunks(3).find_map(|chunk| {
        let sent = send(fixture, chunk);
        accepted.extend_from_slice(&chunk[..sent.accepted]);
        sent.refusal
    });
    assert_eq!(refusal, Some(Refusal::Full));
    assert!(accepted.len() < 100, "{} frames were queued", accepted.len());
    set(fixture, Condition::Up);
    fixture.pass(SETTLED);
    let late: Vec<_> = fixture.received().into_iter().filter(|frame| !accepted.contains(frame)).collect();
    assert_eq!(late, [], "refused frames were sent later");
    let frame = numbered(HOST_IDS[2], 1000);
    assert_eq!(send(fixture, &[frame]), Sent::all(1));
    fixture.pass(SETTLED);
    assert_eq!(fixture.received(), [frame]);
}

/// A bus that is down refuses with that reason, and works again once it is up.
pub fn bus_that_is_down_reports_and_recovers(fixture: &mut dyn Fixture) {
    set(fixture, Condition::Down);
    fixture.pass(SETTLED);
    for _ in 0..3 {
        assert_eq!(send(fixture, &frames(3)), Sent { accepted: 0, refusal: Some(Refusal::Down) });
        assert_eq!(contents(&receive(fixture)), []);
    }
    set(fixture, Condition::Up);
    fixture.pass(SETTLED);
    let _stale = receive(fixture);
    let frame = numbered(HOST_IDS[0], 1);
    assert_eq!(send(fixture, &[frame]), Sent::all(1));
    fixture.pass(SETTLED);
    assert_eq!(fixture.received(), [frame]);
    inject(fixture, Stimulus::Frame(frame));
    fixture.pass(SETTLED);
    assert_eq!(contents(&receive(fixture)), [Content::Frame(frame)]);
}

/// An unplugged bus refuses with that reason, each time.
pub fn unplugged_bus_is_reported(fixture: &mut dyn Fixture) {
    set(fixture, Condition::Gone);
    fixture.pass(SETTLED);
    let _error = receive(fixture);
    for _ in 0..3 {
        assert_eq!(send(fixture, &frames(3)), Sent { accepted: 0, refusal: Some(Refusal::Gone) });
        assert_eq!(contents(&receive(fixture)), []);
    }
}

/// A batch larger than any bus can accept is refused from some frame on, without a panic.
pub fn an_absurd_batch_is_cut(fixture: &mut dyn Fixture) {
    let sent = send(fixture, &frames(2000));
    assert!(sent.accepted < 2000);
    assert_eq!(sent.refusal, Some(Refusal::Full));
}

/// Neither sending nor receiving allocates.
pub fn a_running_bus_allocates_nothing(fixture: &mut dyn Fixture) {
    let frames = frames(3);
    let mut inbox = Inbox::new();
    for round in 0..100 {
        for frame in &frames {
            inject(fixture, Stimulus::Frame(*frame));
        }
        fixture.pass(SETTLED / 50);
        let (now, before) = (fixture.now(), fixture.allocations());
        assert!(before.is_some(), "this fixture has no counting allocator: leave the property out");
        inbox.clear();
        let bus = fixture.bus();
        let _sent = bus.send(now, &frames);
        bus.receive(now, &mut inbox);
        let _readiness = bus.readiness();
        assert_eq!(fixture.allocations(), before, "round {round}");
    }
}
