//! The emergency stop: a thread that stops the robot for every source that requests it, and gives
//! each a receipt.

use motord_client::{Client, Error};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Limit on requests that wait for a receipt: more than the page has connections. A request beyond
/// it joins the stop, without a receipt.
const RECEIPTS_MAX: usize = 256;

/// Time after which the thread checks whether its sources have ended.
const POLL: Duration = Duration::from_millis(200);

/// The answer to a request without a receipt.
pub(crate) const NO_RECEIPT: &str = "a stop runs, and too many others wait for its receipt";

/// The outcome of a stop.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Receipt {
    /// The daemon confirmed the stop, and each motor answered after it.
    pub(crate) is_confirmed: bool,
    /// A sentence: which motors did not answer, or why the stop is unconfirmed.
    pub(crate) message: String,
    /// Joints whose motors answered after the stop. Excluded joints are in neither list.
    pub(crate) confirmed: Vec<String>,
    /// Joints whose motors did not answer, or all joints if nothing is known about their answers.
    pub(crate) unconfirmed: Vec<String>,
    /// Time from the request to the receipt.
    pub(crate) after: Duration,
}

/// The last stop through the bridge.
#[derive(Debug, Clone)]
pub(crate) struct LastStop {
    /// The source that requested it first.
    pub(crate) source: String,
    /// Sources that joined it.
    pub(crate) others: usize,
    pub(crate) receipt: Receipt,
    pub(crate) at: Instant,
}

#[derive(Debug)]
struct Request {
    source: String,
    since: Instant,
    receipt: async_channel::Sender<Receipt>,
}

/// Where sources request a stop.
#[derive(Debug, Default)]
pub(crate) struct StopDesk {
    requests: Mutex<VecDeque<Request>>,
    arrived: Condvar,
    is_closed: AtomicBool,
    last: Mutex<Option<LastStop>>,
}

impl StopDesk {
    /// Requests a stop for `source`, which the log names. The receipt arrives after it. Never waits
    /// for the stop.
    pub(crate) fn request(&self, source: String) -> async_channel::Receiver<Receipt> {
        let (sender, receiver) = async_channel::bounded(1);
        let mut requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        if requests.len() >= RECEIPTS_MAX {
            // Sources that have gone need no receipt.
            requests.retain(|request| !request.receipt.is_closed());
        }
        // A full queue is not taken yet: the stop that serves it begins later than this request.
        if requests.len() < RECEIPTS_MAX {
            requests.push_back(Request { source, since: Instant::now(), receipt: sender });
        }
        drop(requests);
        self.arrived.notify_one();
        receiver
    }

    /// Ends the thread of the stops, after those that wait: no source requests another one.
    pub(crate) fn close(&self) {
        self.is_closed.store(true, Ordering::Release);
    }

    /// Returns the last stop.
    pub(crate) fn last(&self) -> Option<LastStop> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the sources of the requests that wait.
    #[cfg(test)]
    pub(crate) fn waiting(&self) -> Vec<String> {
        let requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        requests.iter().map(|request| request.source.clone()).collect()
    }

    /// Returns all requests that wait; waits for one at most for `timeout`.
    fn take(&self, timeout: Duration) -> VecDeque<Request> {
        let requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.arrived.wait_timeout_while(requests, timeout, |requests| requests.is_empty());
        std::mem::take(&mut *waited.unwrap_or_else(PoisonError::into_inner).0)
    }
}

/// Stops the robot `instance` for the requests at `desk`, until it is closed.
pub(crate) fn run(instance: &str, desk: &StopDesk) {
    let mut client = Client::connect_to_stop(instance).ok();
    loop {
        // Before the requests are taken: all that were made before it closed are among them.
        let is_closed = desk.is_closed.load(Ordering::Acquire);
        let requests = desk.take(POLL);
        if requests.is_empty() {
            if is_closed {
                break;
            }
            continue;
        }
        if client.is_none() {
            client = Client::connect_to_stop(instance).ok();
        }
        // One stop serves all; the daemon names the first source.
        let source = requests.front().map_or("", |request| request.source.as_str());
        let outcome = match &client {
            Some(client) => client.emergency_stop_for(source),
            // This one needs no connection.
            None => motord_client::emergency_stop_for(instance, source),
        };
        let joints = client.as_ref().map(joints).unwrap_or_default();
        if matches!(outcome, Err(Error::NotRunning { .. } | Error::NotStopped { .. })) {
            client = None;
        }
        desk.answer(requests, outcome, joints);
    }
}

/// Returns the names of the joints that are not excluded, as far as that is known.
fn joints(client: &Client) -> Vec<String> {
    let state = client.newest().ok().flatten();
    let is_excluded = |index| {
        let joint = state.as_ref().and_then(|state| state.joint(index));
        joint.is_some_and(|joint| joint.is_excluded())
    };
    let robot = client.description();
    let joints = robot.joints.iter().enumerate().filter(|(index, _)| !is_excluded(*index));
    joints.map(|(_, joint)| joint.name.clone()).collect()
}

impl Receipt {
    /// Returns the receipt of a stop of `joints`.
    fn of(outcome: Result<(), Error>, joints: Vec<String>) -> Self {
        let is_confirmed = outcome.is_ok();
        let (message, confirmed, unconfirmed) = match outcome {
            Ok(()) => ("stopped: each motor answered".to_owned(), joints, Vec::new()),
            Err(error) => {
                let message = error.to_string();
                match error {
                    Error::MotorsOffline { joints: offline } => {
                        let confirmed = joints.into_iter().filter(|joint| !offline.contains(joint));
                        (message, confirmed.collect(), offline)
                    }
                    _ => (message, Vec::new(), joints),
                }
            }
        };
        Self { is_confirmed, message, confirmed, unconfirmed, after: Duration::ZERO }
    }
}

impl StopDesk {
    /// Gives each request its receipt.
    fn answer(&self, requests: VecDeque<Request>, outcome: Result<(), Error>, joints: Vec<String>) {
        let receipt = Receipt::of(outcome, joints);
        let others = requests.len().saturating_sub(1);
        for (index, request) in requests.into_iter().enumerate() {
            let receipt = Receipt { after: request.since.elapsed(), ..receipt.clone() };
            let after = receipt.after.as_secs_f64() * 1e3;
            let Request { source, .. } = &request;
            match receipt.is_confirmed {
                true => log::warn!("emergency stop by {source}: confirmed after {after:.1} ms"),
                false => log::error!("emergency stop by {source}: {} ({after:.1} ms)", receipt.message),
            }
            if index == 0 {
                let last =
                    LastStop { source: source.clone(), others, receipt: receipt.clone(), at: Instant::now() };
                *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(last);
            }
            // A source that has gone needs no receipt.
            let _closed = request.receipt.try_send(receipt);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn joints() -> Vec<String> {
        ["fl-hip", "fr-hip"].map(str::to_owned).to_vec()
    }

    #[test]
    fn every_waiting_source_gets_the_receipt() {
        let desk = StopDesk::default();
        let receipts: Vec<_> = (0..RECEIPTS_MAX).map(|number| desk.request(number.to_string())).collect();
        let refused = desk.request("one too many".to_owned());
        desk.answer(desk.take(Duration::ZERO), Ok(()), joints());
        assert!(receipts.iter().all(|receipt| receipt.try_recv().is_ok_and(|receipt| receipt.is_confirmed)));
        assert!(refused.is_closed());
    }

    #[test]
    fn unconfirmed_stop_is_never_reported_as_done() {
        let desk = StopDesk::default();
        let receipt = desk.request("test".to_owned());
        let outcome = Err(Error::MotorsOffline { joints: vec!["fl-hip".to_owned()] });
        desk.answer(desk.take(Duration::ZERO), outcome, joints());
        let receipt = receipt.try_recv().unwrap();
        assert!(!receipt.is_confirmed && receipt.message.contains("fl-hip"), "{receipt:?}");
        assert_eq!((receipt.confirmed, receipt.unconfirmed), (vec!["fr-hip".into()], vec!["fl-hip".into()]));
    }

    #[test]
    fn unchecked_motors_are_all_unconfirmed() {
        let silent = Error::Silent { silent_for: Duration::from_secs(1) };
        let receipt = Receipt::of(Err(Error::MotorsUnchecked { reason: Box::new(silent) }), joints());
        assert_eq!((receipt.is_confirmed, receipt.confirmed, receipt.unconfirmed), (false, vec![], joints()));
    }

    #[test]
    fn stop_before_the_end_is_carried_out() {
        let desk = StopDesk::default();
        let receipt = desk.request("the page".to_owned());
        desk.close();
        run("no-such-robot", &desk);
        assert!(!receipt.try_recv().unwrap().is_confirmed);
    }

    #[test]
    fn last_stop_names_its_first_source() {
        let desk = StopDesk::default();
        let _receipts = ["gamepad", "page"].map(|source| desk.request(source.to_owned()));
        desk.answer(desk.take(Duration::ZERO), Ok(()), joints());
        let last = desk.last().unwrap();
        assert_eq!((last.source.as_str(), last.others), ("gamepad", 1));
    }

    #[test]
    fn vanished_callers_leave_room_for_others() {
        let desk = StopDesk::default();
        for number in 0..10 * RECEIPTS_MAX {
            drop(desk.request(number.to_string()));
        }
        let living = desk.request("living".to_owned());
        assert!(desk.requests.lock().unwrap().len() <= RECEIPTS_MAX);
        desk.answer(desk.take(Duration::ZERO), Ok(()), joints());
        assert!(living.try_recv().is_ok());
    }

    /// One event at the desk.
    #[derive(Debug, Clone, Copy)]
    enum Event {
        Request(u8),
        /// This of the waiting callers vanishes.
        Vanish(usize),
        /// The thread takes what waits, and begins a stop.
        Begin,
        /// The stop that runs is confirmed.
        End,
    }

    fn event() -> impl Strategy<Value = Event> {
        prop_oneof![
            4 => (0..8u8).prop_map(Event::Request),
            2 => any::<usize>().prop_map(Event::Vanish),
            1 => Just(Event::Begin),
            1 => Just(Event::End),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(10_000))]

        /// Every caller that lives gets the receipt of one stop that began after its request, and of
        /// no other. One stop serves all that wait.
        #[test]
        fn each_living_caller_gets_one_receipt(events in prop::collection::vec(event(), 1..80)) {
            let desk = StopDesk::default();
            let (mut waiting, mut running, mut stops) = (Vec::new(), None, 0);
            let end = [Event::End, Event::Begin, Event::End];
            for event in events.into_iter().chain(end) {
                match event {
                    // The number of the first stop that may serve the request.
                    Event::Request(source) => waiting.push((desk.request(source.to_string()), stops)),
                    Event::Vanish(caller) if !waiting.is_empty() => {
                        waiting.swap_remove(caller % waiting.len());
                    }
                    Event::Vanish(_) => {}
                    Event::Begin if running.is_none() => {
                        running = Some(desk.take(Duration::ZERO));
                        stops += 1;
                    }
                    Event::Begin => {}
                    Event::End => {
                        let Some(requests) = running.take() else { continue };
                        // The joint's name is the number of the stop.
                        desk.answer(requests, Ok(()), vec![(stops - 1).to_string()]);
                        for (receiver, first) in std::mem::take(&mut waiting) {
                            if first == stops {
                                prop_assert!(receiver.try_recv().is_err(), "a stop of before");
                                waiting.push((receiver, first));
                                continue;
                            }
                            let receipt: Receipt = receiver.try_recv().expect("no receipt is lost");
                            prop_assert_eq!(receipt.confirmed, vec![(stops - 1).to_string()]);
                            prop_assert_eq!(first, stops - 1, "the next stop serves it");
                            prop_assert!(receiver.try_recv().is_err() && receiver.is_closed());
                        }
                    }
                }
            }
            prop_assert!(waiting.is_empty(), "each caller was served");
        }
    }
}
