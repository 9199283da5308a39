//! The stopper serves every bus independently of the others.

#![expect(clippy::disallowed_types, reason = "the buses of a test share a log")]
#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_bus::{Clock, Duration, Frame, FrameId, Instant, Readiness, Ready, Refusal};
use motord_core::stopper::schedule::{SafeFrame, Schedule};
use motord_core::stopper::{BusFrames, Outlet, REFUSAL_TIMEOUT, Stopper};
use motord_harness::robot;
use motord_protocol::{Ends, MotorProtocol, Profile};
use std::sync::{Arc, Mutex};

/// Records its name at each send, and in capitals at each search.
struct Missing {
    name: char,
    log: Arc<Mutex<String>>,
    is_there: bool,
}

impl Outlet for Missing {
    fn send_round(&mut self, _now: Instant, _frames: &[Frame]) -> Option<Refusal> {
        self.log.lock().unwrap().push(self.name);
        (!self.is_there).then_some(Refusal::Gone)
    }

    fn find(&mut self) -> bool {
        self.log.lock().unwrap().push(self.name.to_ascii_uppercase());
        self.is_there = self.name == 'c';
        self.is_there
    }
}

const BEGIN: Instant = Instant::from_nanos(1);

fn frames() -> BusFrames {
    let frame = |last| Frame::classic(FrameId::new(1).unwrap(), [0, 0, 0, 0, 0, 0, 0, last]);
    BusFrames { damp: [2, 0].map(|last| vec![frame(last)]), stop: vec![frame(1)] }
}

fn missing(names: [char; 3]) -> (Stopper, [Missing; 3], Arc<Mutex<String>>) {
    let log: Arc<Mutex<String>> = Arc::default();
    let outlets = names.map(|name| Missing { name, log: Arc::clone(&log), is_there: name == 'b' });
    let mut stopper = Stopper::new(names.map(|_| frames()), Duration::from_millis(100));
    stopper.begin(BEGIN);
    (stopper, outlets, log)
}

#[test]
fn all_buses_are_sent_to_before_any_search() {
    let (mut stopper, mut outlets, log) = missing(['a', 'b', 'c']);
    for millis in [0, 10, 20, 50] {
        stopper.round(BEGIN + Duration::from_millis(millis), &mut outlets);
    }
    assert_eq!(*log.lock().unwrap(), "abcA abcCc abc abcA".replace(' ', ""));
}

#[test]
fn absent_interfaces_are_checked_ten_times_a_second() {
    let (mut stopper, mut outlets, log) = missing(['a', 'd', 'e']);
    let end = BEGIN + Duration::from_secs(10);
    while let Some(due) = stopper.due().filter(|due| *due < end) {
        stopper.round(due, &mut outlets);
    }
    for name in ['A', 'D', 'E'] {
        let searches = log.lock().unwrap().matches(name).count();
        assert!((99..=103).contains(&searches), "{name}: {searches}");
    }
}

/// Time that advances only in a sleep.
struct Virtual(Instant);

impl Clock for Virtual {
    fn now(&self) -> Instant {
        self.0
    }

    fn now_and_suspended(&self) -> (Instant, Duration) {
        (self.now(), Duration::ZERO)
    }

    fn sleep_until(&mut self, instant: Instant) {
        self.0 = self.0.max(instant);
    }

    fn wait(&mut self, _readiness: &[Readiness<'_>], _until: Instant) -> Ready {
        unreachable!("a stopper reads no answers")
    }
}

/// A bus that refuses frames at times, and records the time of each accepted one.
struct Jammed {
    refuses: fn(Instant) -> bool,
    taken: Vec<(Instant, Frame)>,
}

impl Outlet for Jammed {
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        if (self.refuses)(now) {
            return Some(Refusal::Full);
        }
        self.taken.extend(frames.iter().map(|frame| (now, *frame)));
        None
    }
}

/// A bus that accepts all except the last frame of every round.
#[derive(Default)]
struct Narrow(Vec<Frame>);

impl Outlet for Narrow {
    fn send_round(&mut self, _now: Instant, frames: &[Frame]) -> Option<Refusal> {
        self.0.extend(&frames[..frames.len() - 1]);
        Some(Refusal::Full)
    }
}

#[test]
fn abandoned_bus_gets_one_last_stop_attempt() {
    let BusFrames { damp, stop } = frames();
    let (damp, stop) = (damp.map(|frames| frames[0]), stop[0]);
    let two_motors = BusFrames { damp: damp.map(|frame| vec![frame; 2]), stop: vec![stop; 2] };
    let mut outlets = [Narrow::default()];
    Stopper::new([two_motors], Duration::from_millis(100)).run(&mut Virtual(BEGIN), &mut outlets);
    let (last, before) = outlets[0].0.split_last().unwrap();
    assert_eq!(*last, stop);
    assert!(before.iter().all(|frame| *frame == damp[0]), "an incomplete round is repeated");
}

#[test]
fn stopper_serves_unjammed_bus_and_abandons_jammed_one() {
    let outlet = |refuses| Jammed { refuses, taken: Vec::new() };
    let late = |now: Instant| now < BEGIN + Duration::from_millis(500);
    let mut outlets = [outlet(|_| false), outlet(late), outlet(|_| true)];
    let mut stopper = Stopper::new([(); 3].map(|()| frames()), Duration::from_millis(100));
    let mut clock = Virtual(BEGIN);
    stopper.run(&mut clock, &mut outlets);
    assert_eq!(stopper.unserved().collect::<Vec<_>>(), [2]);
    assert!(clock.0 < BEGIN + Duration::from_millis(100) + REFUSAL_TIMEOUT);
    let whole = [frames().damp.concat().repeat(5), frames().stop.repeat(3)].concat();
    for (outlet, begin) in outlets.iter().zip([0, 500]) {
        assert!(outlet.taken.iter().map(|(_, frame)| *frame).eq(whole.iter().copied()));
        assert_eq!(outlet.taken[0].0, BEGIN + Duration::from_millis(begin));
    }
}

/// The torque that a motor at rest makes from a control frame, by the law and the formulas of the
/// MIT document, N·m.
fn torque_at_rest(frame: &Frame, ends: &Ends) -> f64 {
    let word = u64::from_be_bytes(*frame.payload().first_chunk().unwrap());
    let share = |shift: u32| (word >> shift & 0xFFF) as f64 / 4095.0;
    let velocity = (2.0 * share(36) - 1.0) * ends.velocity;
    share(12) * ends.kd * velocity + (2.0 * share(0) - 1.0) * ends.torque
}

/// Goal: damping without a cycle pushes no joint. Neither velocity nor torque has a code for zero.
/// Method: the mean torque at rest of the frames of one stop, for each model.
#[test]
fn damping_without_a_cycle_pushes_no_joint() {
    let models = |profile: &'static Profile| profile.models.iter().map(move |model| (profile, model));
    for (profile, model) in Profile::all().flat_map(models) {
        let protocol = profile.protocols[0];
        let family = protocol.parse::<MotorProtocol>().expect("it is a family").family();
        if !family.has_codes {
            continue;
        }
        let end = if protocol == "mit" { "" } else { "torque-end-nm = 24.0\n" };
        let settings = robot::settings(&format!(
            "[[bus]]\nname = 'a'\ntype = 'simulated'\n[[motor]]\nname = 'hip'\nbus = 'a'\nid = 1\nprotocol = '{protocol}'\n\
             {end}model = '{}'\nlimits = {{ position-rad = [-1.0, 1.0] }}\n",
            model.name
        ));
        let mut outlets = [Jammed { refuses: |_| false, taken: Vec::new() }];
        let frames = BusFrames::of(&settings, 0);
        let stop = frames.stop[0];
        Stopper::new([frames], Duration::from_millis(200)).run(&mut Virtual(BEGIN), &mut outlets);
        let damping = outlets[0].taken.iter().map(|(_, frame)| frame).filter(|frame| **frame != stop);
        let ends = settings.motors[0].scales.ends();
        let torques: Vec<f64> = damping.map(|frame| torque_at_rest(frame, &ends)).collect();
        let mean = torques.iter().sum::<f64>() / torques.len() as f64;
        assert!(torques.len() == 20 && mean.abs() < 1e-9, "{}: {mean} N·m", model.name);
    }
}

// The rounds of safe frames of one bus.

/// Time between two attempts on a bus that refuses for longer than the damping.
const RETRY: Duration = Duration::from_millis(100);
const DAMP: Duration = Duration::from_millis(100);
const FIRST: Instant = Instant::from_nanos(1_000_000_000);

/// Returns the rounds of the bus, in ms since the begin, when it accepts those for which `accepts`
/// is true.
fn given(millis: u64, accepts: impl Fn(u64) -> bool) -> Vec<(u64, SafeFrame)> {
    let mut schedule = Schedule::begin(DAMP, FIRST);
    let mut given = Vec::new();
    for at in 0..millis {
        let now = FIRST + Duration::from_millis(at);
        let Some(order) = schedule.order(now) else { continue };
        given.push((at, order));
        schedule.record(accepts(at), now);
    }
    given
}

/// Returns damping at 100 Hz from `begin` on, then the stops.
fn whole_from(begin: u64) -> Vec<(u64, SafeFrame)> {
    let at = |round: u64| begin + 10 * round;
    (0..10)
        .map(|round| (at(round), SafeFrame::Damp))
        .chain((10..13).map(|round| (at(round), SafeFrame::Stop)))
        .collect()
}

#[test]
fn writable_bus_is_damped_then_stopped_then_idle() {
    assert_eq!(given(1000, |_| true), whole_from(0));
}

#[test]
fn late_bus_receives_full_sequence_at_full_rate() {
    let given = given(5000, |at| at >= 3000);
    let (refused, taken) = given.split_at(given.len() - 13);
    assert_eq!(taken, whole_from(3000));
    assert!(refused.iter().all(|(_, order)| *order == SafeFrame::Damp), "{refused:?}");
    assert_eq!(refused.len(), 10 + 29, "100 Hz for as long as the damping, then 10 Hz");
}

#[test]
fn jammed_bus_gets_the_remaining_rounds() {
    let was_taken = |at| !(20..3000).contains(&at);
    let given = given(5000, was_taken);
    let (late, first): (Vec<_>, Vec<_>) =
        given.into_iter().filter(|(at, _)| was_taken(*at)).partition(|(at, _)| *at >= 3000);
    assert_eq!(first, [(0, SafeFrame::Damp), (10, SafeFrame::Damp)]);
    let late: Vec<_> = late.into_iter().map(|(_, order)| order).collect();
    assert_eq!(late, [[SafeFrame::Damp; 8].as_slice(), &[SafeFrame::Stop; 3]].concat());
}

#[test]
fn bus_lost_while_stopping_gets_stops_later() {
    let given = given(5000, |at| at <= 100 || at >= 3000);
    let later: Vec<_> = given.iter().filter(|(at, _)| *at >= 3000).map(|(_, order)| *order).collect();
    assert_eq!(later, [SafeFrame::Stop; 2]);
}

#[test]
fn bus_that_never_accepts_is_retried_forever() {
    let given = given(100_000, |_| false);
    assert_eq!(given.last(), Some(&(99_900, SafeFrame::Damp)));
}

#[test]
fn a_schedule_that_was_stalled_sends_no_burst() {
    let mut schedule = Schedule::begin(DAMP, FIRST);
    schedule.record(true, FIRST);
    let late = FIRST + Duration::from_millis(35);
    assert_eq!(schedule.order(late), Some(SafeFrame::Damp));
    schedule.record(true, late);
    assert_eq!(schedule.due(), Some(FIRST + Duration::from_millis(40)), "the rounds keep their ticks");
}

#[test]
fn without_a_damping_time_there_are_only_stops() {
    let mut schedule = Schedule::begin(Duration::ZERO, FIRST);
    assert_eq!(schedule.order(FIRST), Some(SafeFrame::Stop));
    schedule.record(false, FIRST);
    assert_eq!(schedule.order(FIRST + RETRY), Some(SafeFrame::Stop));
}
