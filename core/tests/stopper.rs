//! The stopper serves every bus independently of the others.

#![expect(clippy::disallowed_types, reason = "the buses of a test share a log")]
#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_bus::{Clock, Duration, Frame, FrameId, Instant, Readiness, Ready, Refusal};
use motord_core::stopper::{BusFrames, Outlet, REFUSAL_TIMEOUT, Stopper};
use motord_harness::robot;
use motord_protocol::Profile;
use motord_protocol::{Ends, MotorProtocol};
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
