//! Requests of clients, passed on to the robot. None of them holds up the states.

use super::wire::Wire;
use crate::frame::read_reply;
use motord_ports::Request;
use motord_shared::description::{Histograms, Telemetry};
use motord_shared::limits::{ANSWER_BYTES_MAX, HISTOGRAMS_MAX};
use motord_shared::message::{AdminReply, NO_JOINT};
use motord_shared::plain::Plain;
use motord_shared::{AdminRequest, Operation, Refusal, StateMessage};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};
use zenoh::Wait;

/// Longest time for an answer of the robot: a little more than clients wait, whose error names the
/// request.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(1100);
/// Time until a request is sent again: its answer, or itself, may be lost. The robot carries it out
/// once.
const ATTEMPT: Duration = Duration::from_millis(150);
/// Longest time for the answer to a claim, also of a client that has given up: the group that it got is
/// released.
const CLAIM_TIMEOUT: Duration = Duration::from_secs(5);

/// An answer of the robot: its head and its text. `None` when it did not come.
type Answer = Option<(AdminReply, Vec<u8>)>;

/// The requests that wait for an answer of the robot.
pub(super) struct Requests {
    wire: Arc<Wire>,
    waiting: BTreeMap<u64, Waiting>,
    sender: Sender<(u64, Answer)>,
    answers: Receiver<(u64, Answer)>,
}

/// A request, when it is given up, and when it is sent again.
struct Waiting {
    request: Request,
    until: Instant,
    again: Instant,
}

impl Waiting {
    /// A client that leaves does not wait for its release, and must not keep the group that it claimed.
    fn is_wanted(&self) -> bool {
        let operation = self.request.payload().operation();
        self.request.is_awaited() || matches!(operation, Ok(Operation::Claim | Operation::Release))
    }
}

impl Requests {
    pub(super) fn new(wire: Arc<Wire>) -> Self {
        let (sender, answers) = channel();
        Self { wire, waiting: BTreeMap::new(), sender, answers }
    }

    /// Passes a request on. Never waits for the answer.
    pub(super) fn pass(&mut self, request: Request) {
        let (number, now) = (self.wire.next_request(), Instant::now());
        self.send(number, &request);
        let is_claim = request.payload().operation() == Ok(Operation::Claim);
        let until = now + if is_claim { CLAIM_TIMEOUT } else { ANSWER_TIMEOUT };
        let waiting = Waiting { request, until, again: now + ATTEMPT };
        self.waiting.insert(number, waiting);
    }

    fn send(&self, number: u64, request: &Request) {
        let sender = self.sender.clone();
        send(&self.wire, number, request.payload(), move |answer| {
            // The mirror has ended.
            let _ended = sender.send((number, answer));
        });
    }

    /// Sends a request again whose answer may be lost, and drops one whose client no longer waits.
    pub(super) fn retry(&mut self) {
        let now = Instant::now();
        self.waiting.retain(|_, waiting| now < waiting.until && waiting.is_wanted());
        let mut late = Vec::new();
        for (number, waiting) in &mut self.waiting {
            if now >= waiting.again {
                waiting.again = now + ATTEMPT;
                late.push(*number);
            }
        }
        for number in late {
            if let Some(waiting) = self.waiting.get(&number) {
                self.send(number, &waiting.request);
            }
        }
    }

    /// Returns a request whose answer has arrived.
    pub(super) fn answered(&mut self) -> Option<(Request, Answer)> {
        loop {
            let (number, answer) = self.answers.try_recv().ok()?;
            // An attempt that failed is followed by another one.
            if answer.is_some()
                && let Some(waiting) = self.waiting.remove(&number)
            {
                return Some((waiting.request, answer));
            }
        }
    }
}

/// Answers a client. `false` when it no longer waits.
pub(super) fn reply(request: Request, answer: Answer) -> bool {
    // A request that is dropped is an error for its requester.
    let Some((head, text)) = answer else { return false };
    request.reply(head, &text).is_ok()
}

/// Refuses a request.
pub(super) fn refuse(request: Request, refusal: Refusal) {
    let head = AdminReply { lease: 0, refusal: refusal.code(), detail: NO_JOINT };
    let _disconnected = reply(request, Some((head, Vec::new())));
}

/// Sends a request, and calls `done` once: with the answer, or without one after a second.
fn send(wire: &Wire, number: u64, payload: &AdminRequest, done: impl FnOnce(Answer) + Send + 'static) {
    let only_reads = payload.operation().is_ok_and(crate::admission::only_reads);
    let (key, bytes) = if only_reads {
        let mut bytes = Vec::new();
        payload.write(&mut bytes);
        (wire.keys.ask(), bytes)
    } else {
        (wire.keys.request(), wire.up().with_request(number, payload))
    };
    let once = Once(Some(done));
    let cell = std::sync::Mutex::new(once);
    let Some(session) = wire.session() else { return };
    let sent = session.get(key).payload(bytes).timeout(ANSWER_TIMEOUT).callback(move |reply| {
        let bytes = reply.result().ok().map(|sample| sample.payload().to_bytes().into_owned());
        let answer = bytes.and_then(|bytes| read_reply(&bytes).map(|(head, text)| (head, text.to_vec())));
        cell.lock().unwrap_or_else(std::sync::PoisonError::into_inner).call(answer);
    });
    // Dropped with its callback: it is called without an answer.
    let _failed = sent.wait();
}

/// Calls a function once: at the latest when it is dropped.
struct Once<F: FnOnce(Answer)>(Option<F>);

impl<F: FnOnce(Answer)> Once<F> {
    fn call(&mut self, answer: Answer) {
        if let Some(done) = self.0.take() {
            done(answer);
        }
    }
}

impl<F: FnOnce(Answer)> Drop for Once<F> {
    fn drop(&mut self) {
        self.call(None);
    }
}

/// Reads the description of the robot whose state this is. `None` when it does not answer, and when
/// another daemon runs already.
pub(super) fn describe(wire: &Wire, state: &StateMessage) -> Option<Vec<u8>> {
    let (sender, answers) = channel();
    let request = AdminRequest { operation: Operation::Describe.code(), ..AdminRequest::default() };
    send(wire, 0, &request, move |answer| {
        let _ended = sender.send(answer);
    });
    let (_, text) = answers.recv_timeout(ANSWER_TIMEOUT).ok()??;
    let robot: motord_shared::description::RobotDescription = serde_json::from_slice(&text).ok()?;
    (robot.boot_id == state.boot_id).then_some(text)
}

/// Adds the network's latencies to an answer of the robot.
pub(super) fn extended(wire: &Wire, operation: Operation, answer: Answer) -> Answer {
    let (head, text) = answer?;
    let text = match operation {
        Operation::Histograms => with_histograms(wire, &text).unwrap_or(text),
        Operation::Telemetry => with_latencies(wire, &text).unwrap_or(text),
        _ => text,
    };
    Some((head, text))
}

/// The daemon's counters and latencies, with those of the network. `None` where they do not fit.
fn with_latencies(wire: &Wire, text: &[u8]) -> Option<Vec<u8>> {
    let telemetry: Telemetry = serde_json::from_slice(text).ok()?;
    let telemetry = Telemetry { network: Some(wire.latencies.report()), ..telemetry };
    serde_json::to_vec(&telemetry).ok().filter(|whole| whole.len() <= ANSWER_BYTES_MAX)
}

/// The last part of the daemon's histograms is followed by those of the network: in the same answer,
/// or in another one where they do not fit.
fn with_histograms(wire: &Wire, text: &[u8]) -> Option<Vec<u8>> {
    let mut part: Histograms = serde_json::from_slice(text).ok()?;
    if part.next.is_some() {
        return None;
    }
    let of_network = [
        ("network_round_trip", &wire.latencies.round_trip),
        ("network_state_age", &wire.latencies.state_age),
        ("network_state_interval", &wire.latencies.state_interval),
    ];
    let daemons = part.histograms.len();
    part.histograms.extend(of_network.iter().filter_map(|(name, latencies)| latencies.encoded(name)));
    let whole = serde_json::to_vec(&part).ok()?;
    if whole.len() <= ANSWER_BYTES_MAX {
        return Some(whole);
    }
    part.histograms.truncate(daemons);
    // The daemon has none with this number, so its answer to it has room.
    part.next = (daemons > 0).then_some(HISTOGRAMS_MAX as u32);
    serde_json::to_vec(&part).ok()
}

/// Sends a release twice, since a network may lose it. The daemon's timeout damps the group later.
pub(super) fn release(wire: &Wire, request: &AdminRequest) {
    let number = wire.next_request();
    for _ in 0..2 {
        send(wire, number, request, |_| ());
    }
}
