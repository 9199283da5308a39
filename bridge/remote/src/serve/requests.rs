//! Requests of mirrors and watchers, each kind on a thread of its own.

use super::robot::Robot;
use crate::admission::{Refused, only_reads};
use crate::frame::{Up, reply_bytes};
use crate::network::{Keys, NetworkError};
use motord_ports::clock;
use motord_ports::instance::pid_namespace;
use motord_shared::message::{AdminReply, NO_JOINT};
use motord_shared::plain::Plain;
use motord_shared::{AdminRequest, Lease, Operation, Refusal};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// Limit on requests that wait for a thread.
const WAITING_MAX: usize = 16;

/// A request that waited longer is refused: its client has given up, and must not see the robot
/// move later.
const WAIT_MAX: Duration = Duration::from_millis(500);

/// Answers that are kept for requests that arrive again.
const ANSWERS_KEPT: usize = 32;

/// A request that counts.
struct Request {
    query: Query,
    /// The session of its mirror, and its number there. `None` for a watcher, who may ask again.
    from: Option<(u64, u64)>,
    payload: AdminRequest,
    arrived: Instant,
}

/// The newest answers. A network may lose one, and its mirror then sends the request again: it is
/// carried out once.
#[derive(Default)]
struct Answers(VecDeque<((u64, u64), Vec<u8>)>);

impl Answers {
    fn get(&self, from: (u64, u64)) -> Option<&[u8]> {
        self.0.iter().find(|(known, _)| *known == from).map(|(_, answer)| answer.as_slice())
    }

    fn keep(&mut self, from: (u64, u64), answer: Vec<u8>) {
        self.0.truncate(ANSWERS_KEPT - 1);
        self.0.push_front((from, answer));
    }
}

/// Serves requests as long as the result lives.
pub(super) fn serve(
    session: &Session,
    keys: &Keys,
    robot: &Arc<Robot>,
) -> Result<[Queryable<()>; 2], NetworkError> {
    let changing = declare(session, keys.request(), robot, admit)?;
    let reading = declare(session, keys.ask(), robot, |_, query| read_only(query))?;
    Ok([changing, reading])
}

/// From whom a request is, and the request.
type Admitted = (Option<(u64, u64)>, AdminRequest);

fn declare(
    session: &Session,
    key: String,
    robot: &Arc<Robot>,
    admit: impl Fn(&Robot, &Query) -> Result<Admitted, Refused> + Send + Sync + 'static,
) -> Result<Queryable<()>, NetworkError> {
    let (sender, requests) = sync_channel(WAITING_MAX);
    let (of_thread, of_callback) = (Arc::clone(robot), Arc::clone(robot));
    std::thread::spawn(move || answer_all(&of_thread, &requests));
    let declared = session.declare_queryable(key).callback(move |query| match admit(&of_callback, &query) {
        Ok((from, payload)) => hand_over(&sender, Request { query, from, payload, arrived: Instant::now() }),
        Err(reason) => {
            of_callback.counters.refuse(reason);
            let _disconnected = query.reply_err(format!("{reason:?}")).wait();
        }
    });
    declared.wait().map_err(NetworkError::of)
}

/// Takes a request of a mirror, if it counts.
fn admit(robot: &Robot, query: &Query) -> Result<Admitted, Refused> {
    let payload = query.payload().ok_or(Refused::Malformed)?.to_bytes();
    let (up, number, request) = Up::read_request(&payload)?;
    let mut admission = robot.admission();
    admission.admit(&up, clock::now_ns())?;
    if request.lease != 0 {
        admission.check_lease(up.head.from, request.lease)?;
    }
    Ok((Some((up.head.from, number)), request))
}

/// Takes a request of a watcher, if it only reads.
fn read_only(query: &Query) -> Result<Admitted, Refused> {
    let payload = query.payload().ok_or(Refused::Malformed)?.to_bytes();
    let mut bytes = payload.as_ref();
    let request = AdminRequest::read(&mut bytes).filter(|_| bytes.is_empty()).ok_or(Refused::Malformed)?;
    match request.operation() {
        Ok(operation) if only_reads(operation) => Ok((None, request)),
        _ => Err(Refused::Malformed),
    }
}

fn hand_over(sender: &SyncSender<Request>, request: Request) {
    if let Err(TrySendError::Full(request) | TrySendError::Disconnected(request)) = sender.try_send(request) {
        reply(&request.query, &busy());
    }
}

/// Returns the bytes of a refusal: the client may ask again.
fn busy() -> Vec<u8> {
    let busy = AdminReply { lease: 0, refusal: Refusal::Busy.code(), detail: NO_JOINT };
    reply_bytes(&busy, b"")
}

fn answer_all(robot: &Robot, requests: &Receiver<Request>) {
    let mut answers = Answers::default();
    while let Ok(Request { query, from, payload, arrived }) = requests.recv() {
        if let Some(answer) = from.and_then(|from| answers.get(from)) {
            reply(&query, answer);
            continue;
        }
        if arrived.elapsed() > WAIT_MAX {
            reply(&query, &busy());
            // Another attempt of this request may have waited less.
            from.into_iter().for_each(|from| answers.keep(from, busy()));
            continue;
        }
        match carry_out(robot, from, payload) {
            Ok(answer) => {
                reply(&query, &answer);
                from.into_iter().for_each(|from| answers.keep(from, answer.clone()));
            }
            Err(error) => {
                let _disconnected = query.reply_err(error.to_string()).wait();
            }
        }
    }
}

/// Passes a request to the daemon, and returns the bytes of its answer.
fn carry_out(
    robot: &Robot,
    from: Option<(u64, u64)>,
    payload: AdminRequest,
) -> Result<Vec<u8>, super::link::LinkError> {
    // The daemon watches this process: with it, every claim ends.
    let request = AdminRequest { pid: std::process::id(), pid_namespace: pid_namespace(), ..payload };
    let (head, text) = robot.link.ask(request)?;
    let is_claim = payload.operation() == Ok(Operation::Claim);
    if let (Some((session, _)), Some(lease)) = (from, Lease::from_raw(head.lease).filter(|_| is_claim)) {
        robot.admission().granted(session, lease, clock::now_ns());
        robot.link.prepare(lease);
    }
    robot.counters.change(|counts| counts.requests += 1);
    Ok(reply_bytes(&head, &text))
}

/// Releases the group of a mirror that is gone, on a thread of its own: the states go on.
pub(super) fn release(robot: &Arc<Robot>, lease: Lease) {
    let (robot, group) = (Arc::clone(robot), lease.group());
    let operation = Operation::Release.code();
    let request =
        AdminRequest { lease: lease.raw(), operation, group: group as u32, ..AdminRequest::default() };
    std::thread::spawn(move || match robot.link.ask(request) {
        Ok(_) => tracing::warn!(group, "released: its mirror is silent"),
        Err(error) => tracing::error!(group, "its mirror is silent, and it cannot be released: {error}"),
    });
}

fn reply(query: &Query, answer: &[u8]) {
    // A requester that has gone needs no answer.
    let _disconnected = query.reply(query.key_expr(), answer).wait();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn request_that_arrives_again_has_its_answer() {
        let mut answers = Answers::default();
        answers.keep((1, 1), vec![1]);
        answers.keep((1, 2), vec![2]);
        assert_eq!((answers.get((1, 1)), answers.get((2, 1))), (Some(&[1][..]), None));
        (3..100).for_each(|number| answers.keep((1, number), vec![0]));
        assert_eq!((answers.get((1, 2)), answers.0.len()), (None, ANSWERS_KEPT));
    }
}
