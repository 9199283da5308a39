//! A source that holds the robot stopped: as long as it demands a stop, a reset or an enable leads to
//! another one. By level, not by edge.

use crate::stop::Receipt;
use async_channel::{Receiver, TryRecvError};
use motord_client::{Cause, Phase, State};
use std::time::{Duration, Instant};

/// States per second that a source needs.
const STATES_HZ: f64 = 100.0;
/// Age of the newest state after which nothing is known of the robot.
const STALE: Duration = Duration::from_millis(500);
/// Time after which an unconfirmed stop is requested again. Doubles while no state arrives.
const RETRY: Duration = Duration::from_secs(1);
/// Limit on the doublings: about a minute.
const DOUBLINGS_MAX: u32 = 6;

/// Returns the number of cycles after which a source needs a state.
pub(crate) fn cycles_between_states(cycle_hz: f64) -> u32 {
    (cycle_hz / STATES_HZ).clamp(1.0, 1000.0) as u32
}

/// The stop that a source demands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub(crate) enum Demand {
    /// None.
    #[default]
    Nothing,
    /// No group may run.
    NoMotion,
    /// Every group has the latched cause of an emergency stop.
    Latch,
}

/// The known state of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum View {
    /// The bridge has begun, and the first state may still arrive.
    Awaited,
    /// No state arrives.
    Lost,
    Known {
        /// A group is starting or active.
        is_running: bool,
        /// Each group has the latched cause of an emergency stop.
        is_latched: bool,
        published: Instant,
    },
}

impl View {
    /// Returns the view by the newest state, at `now`. The source began at `begun`.
    pub(crate) fn of(newest: Option<&State>, begun: Instant, now: Instant) -> Self {
        match newest.map(|state| (state, state.age())) {
            None if now.saturating_duration_since(begun) < STALE => Self::Awaited,
            Some((state, age)) if age < STALE => Self::Known {
                is_running: state
                    .groups()
                    .any(|group| !matches!(group.phase, Some(Phase::Disarmed | Phase::Damping))),
                is_latched: state.groups().all(|group| group.cause == Some(Cause::EmergencyStop)),
                published: now.checked_sub(age).unwrap_or(now),
            },
            _ => Self::Lost,
        }
    }
}

/// A receipt, as far as a source needs it.
#[derive(Debug, Clone, Copy)]
struct Answered {
    at: Instant,
    is_confirmed: bool,
}

/// The stops of one source.
#[derive(Debug, Default)]
pub(crate) struct Hold {
    was: Demand,
    pending: Option<Receiver<Receipt>>,
    /// The last receipt since the demand began.
    answered: Option<Answered>,
    /// Unconfirmed stops, one after the other.
    failures: u32,
}

impl Hold {
    /// Requests a stop by `request` where `demand` needs one. To be called at least as often as states
    /// arrive.
    pub(crate) fn serve(
        &mut self,
        demand: Demand,
        view: View,
        now: Instant,
        request: impl FnOnce() -> Receiver<Receipt>,
    ) {
        self.collect(now);
        if self.was == Demand::Nothing {
            (self.answered, self.failures) = (None, 0);
        }
        let begins = self.was < demand;
        self.was = demand;
        // A person who presses a button gets a receipt, also where another source stopped the robot.
        if begins && demand == Demand::Latch || is_needed(demand, view) && self.is_due(view, now) {
            self.pending = Some(request());
        }
    }

    fn collect(&mut self, now: Instant) {
        let Some(pending) = &self.pending else { return };
        let is_confirmed = match pending.try_recv() {
            Ok(receipt) => receipt.is_confirmed,
            Err(TryRecvError::Empty) => return,
            // Too many requests waited.
            Err(TryRecvError::Closed) => false,
        };
        self.pending = None;
        self.failures = if is_confirmed { 0 } else { self.failures.saturating_add(1) };
        self.answered = Some(Answered { at: now, is_confirmed });
    }

    /// Returns `true` unless the last request may still have its effect.
    fn is_due(&self, view: View, now: Instant) -> bool {
        if self.pending.is_some() {
            return false;
        }
        match (self.answered, view) {
            (None, _) => true,
            (Some(answered), View::Known { published, .. }) if answered.is_confirmed => {
                published > answered.at
            }
            (Some(answered), View::Known { .. }) => now.saturating_duration_since(answered.at) >= RETRY,
            (Some(answered), _) if answered.is_confirmed => false,
            (Some(answered), _) => {
                let doublings = self.failures.saturating_sub(1).min(DOUBLINGS_MAX);
                now.saturating_duration_since(answered.at) >= RETRY * 2_u32.pow(doublings)
            }
        }
    }
}

/// Returns `true` if the robot is not as `demand` wants it. One of which nothing is known may move.
fn is_needed(demand: Demand, view: View) -> bool {
    match (demand, view) {
        (Demand::Nothing, _) | (Demand::NoMotion, View::Awaited) => false,
        (Demand::NoMotion, View::Known { is_running, .. }) => is_running,
        (Demand::Latch, View::Known { is_latched, .. }) => !is_latched,
        (Demand::NoMotion | Demand::Latch, View::Lost) | (Demand::Latch, View::Awaited) => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use async_channel::Sender;
    use motord_client::StateMessage;
    use std::cell::RefCell;

    const TURN: Duration = Duration::from_millis(10);

    /// A robot that executes stops, and a source.
    struct Scene {
        hold: Hold,
        now: Instant,
        requests: RefCell<Vec<Sender<Receipt>>>,
        view: Box<dyn Fn(Instant) -> View>,
    }

    fn known(is_running: bool, is_latched: bool) -> Box<dyn Fn(Instant) -> View> {
        Box::new(move |published| View::Known { is_running, is_latched, published })
    }

    impl Scene {
        fn new(view: Box<dyn Fn(Instant) -> View>) -> Self {
            Self { hold: Hold::default(), now: Instant::now(), requests: RefCell::default(), view }
        }

        /// Serves `turns` turns, and returns the number of requests in them.
        fn run(&mut self, demand: Demand, turns: u32) -> usize {
            let before = self.requests.borrow().len();
            for _ in 0..turns {
                self.now += TURN;
                self.hold.serve(demand, (self.view)(self.now), self.now, || {
                    let (sender, receiver) = async_channel::bounded(1);
                    self.requests.borrow_mut().push(sender);
                    receiver
                });
            }
            self.requests.borrow().len() - before
        }

        fn answer(&self, is_confirmed: bool) {
            let receipt = Receipt {
                is_confirmed,
                message: String::new(),
                confirmed: Vec::new(),
                unconfirmed: Vec::new(),
                after: Duration::ZERO,
            };
            self.requests.borrow().last().unwrap().try_send(receipt).unwrap();
        }
    }

    #[test]
    fn latched_robot_gets_one_request() {
        let mut scene = Scene::new(known(true, false));
        assert_eq!(scene.run(Demand::Latch, 5), 1, "one at a time");
        scene.answer(true);
        scene.view = known(false, true);
        assert_eq!(scene.run(Demand::Latch, 1000), 0);
    }

    #[test]
    fn reset_under_demand_leads_to_another_stop() {
        let mut scene = Scene::new(known(false, false));
        scene.run(Demand::Latch, 1);
        scene.answer(true);
        scene.view = known(false, true);
        scene.run(Demand::Latch, 10);
        scene.view = known(false, false);
        assert_eq!(scene.run(Demand::Latch, 1), 1, "in the next turn");
    }

    #[test]
    fn state_of_before_the_receipt_counts_not() {
        let mut scene = Scene::new(known(true, false));
        scene.run(Demand::Latch, 1);
        scene.answer(true);
        let old = scene.now;
        scene.view = Box::new(move |_| View::Known { is_running: true, is_latched: false, published: old });
        assert_eq!(scene.run(Demand::Latch, 10), 0);
    }

    #[test]
    fn each_press_gets_a_receipt() {
        let mut scene = Scene::new(known(false, true));
        for _ in 0..3 {
            assert_eq!(scene.run(Demand::Latch, 1), 1);
            assert_eq!(scene.run(Demand::Nothing, 1), 0);
        }
    }

    #[test]
    fn resting_robot_needs_no_dead_mans_button() {
        let mut scene = Scene::new(known(false, false));
        assert_eq!(scene.run(Demand::NoMotion, 100), 0);
        scene.view = known(true, false);
        assert_eq!(scene.run(Demand::NoMotion, 1), 1, "a group was enabled");
    }

    #[test]
    fn unknown_robot_counts_as_moving() {
        let mut scene = Scene::new(Box::new(|_| View::Awaited));
        assert_eq!(scene.run(Demand::NoMotion, 1), 0, "it may still arrive");
        assert_eq!(scene.run(Demand::Latch, 1), 1);
        let mut scene = Scene::new(Box::new(|_| View::Lost));
        assert_eq!(scene.run(Demand::NoMotion, 1), 1);
    }

    #[test]
    fn unconfirmed_stop_is_requested_again() {
        let mut scene = Scene::new(known(true, false));
        scene.run(Demand::NoMotion, 1);
        scene.answer(false);
        assert_eq!(scene.run(Demand::NoMotion, 99), 0);
        assert_eq!(scene.run(Demand::NoMotion, 2), 1, "after a second");
    }

    #[test]
    fn dropped_request_counts_as_unconfirmed() {
        let mut scene = Scene::new(known(true, false));
        scene.run(Demand::Latch, 1);
        scene.requests.borrow_mut().clear();
        assert_eq!(scene.run(Demand::Latch, 102), 1);
    }

    #[test]
    fn absent_daemon_is_asked_ever_less_often() {
        let mut scene = Scene::new(Box::new(|_| View::Lost));
        let mut requests = scene.run(Demand::Latch, 1);
        for _ in 0..600 {
            if scene.requests.borrow().last().is_some_and(|last| !last.is_full()) {
                scene.requests.borrow().last().unwrap().close();
            }
            requests += scene.run(Demand::Latch, 100);
        }
        assert!((10..=20).contains(&requests), "{requests} in ten minutes");
    }

    #[test]
    fn view_without_state_is_lost_later() {
        let begun = Instant::now();
        assert_eq!(View::of(None, begun, begun), View::Awaited);
        assert_eq!(View::of(None, begun, begun + STALE), View::Lost);
    }

    #[test]
    fn view_is_that_of_every_group() {
        let now = Instant::now();
        // The time of publishing is never before now.
        let mut message = StateMessage { group_count: 2, publish_ns: u64::MAX, ..StateMessage::default() };
        let mut view = |phase: u32, cause: u32| {
            (message.groups[1].phase, message.groups[1].cause) = (phase, cause);
            message.groups[0].cause = Cause::EmergencyStop.code();
            View::of(Some(&State::from(&message)), now, now)
        };
        let known = |is_running, is_latched| View::Known { is_running, is_latched, published: now };
        assert_eq!(view(Phase::Disarmed.code(), 0), known(false, false));
        assert_eq!(view(Phase::Disarmed.code(), Cause::EmergencyStop.code()), known(false, true));
        assert_eq!(view(Phase::Disarmed.code(), Cause::MotorLost.code()), known(false, false));
        assert_eq!(view(Phase::Starting.code(), 0), known(true, false));
        assert_eq!(view(99, 0), known(true, false), "a phase that this bridge does not know");
    }
}
