//! Requests of mirrors and watchers, each kind on a thread of its own.

use super::Robot;
use crate::admission::{Refused, only_reads};
use crate::frame::{Up, reply_bytes};
use crate::network::{Keys, NetworkError};
use motord_ports::clock;
use motord_ports::instance::pid_namespace;
use motord_shared::message::{AdminReply, NO_JOINT};
use motord_shared::plain::Plain;
use motord_shared::{AdminRequest, Lease, Operation, Refusal};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// Limit on requests that wait for a thread.
const WAITING_MAX: usize = 16;

/// A request that counts.
struct Request {
    query: Query,
    /// The session of its mirror; 0 for a watcher.
    session: u64,
    payload: AdminRequest,
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

fn declare(
    session: &Session,
    key: String,
    robot: &Arc<Robot>,
    admit: impl Fn(&Robot, &Query) -> Result<(u64, AdminRequest), Refused> + Send + Sync + 'static,
) -> Result<Queryable<()>, NetworkError> {
    let (sender, requests) = sync_channel(WAITING_MAX);
    let (of_thread, of_callback) = (Arc::clone(robot), Arc::clone(robot));
    std::thread::spawn(move || answer_all(&of_thread, &requests));
    let declared = session.declare_queryable(key).callback(move |query| match admit(&of_callback, &query) {
        Ok((session, payload)) => hand_over(&sender, Request { query, session, payload }),
        Err(reason) => {
            of_callback.counters.refuse(reason);
            let _gone = query.reply_err(format!("{reason:?}")).wait();
        }
    });
    declared.wait().map_err(NetworkError::of)
}

/// Takes a request of a mirror, if it counts.
fn admit(robot: &Robot, query: &Query) -> Result<(u64, AdminRequest), Refused> {
    let payload = query.payload().ok_or(Refused::Malformed)?.to_bytes();
    let (up, request) = Up::read_request(&payload)?;
    let mut admission = robot.admission();
    admission.admit(&up, clock::now_ns())?;
    if request.lease != 0 {
        admission.check_lease(up.head.from, request.lease)?;
    }
    Ok((up.head.from, request))
}

/// Takes a request of a watcher, if it only reads.
fn read_only(query: &Query) -> Result<(u64, AdminRequest), Refused> {
    let payload = query.payload().ok_or(Refused::Malformed)?.to_bytes();
    let mut bytes = payload.as_ref();
    let request = AdminRequest::read(&mut bytes).filter(|_| bytes.is_empty()).ok_or(Refused::Malformed)?;
    match request.operation() {
        Ok(operation) if only_reads(operation) => Ok((0, request)),
        _ => Err(Refused::Malformed),
    }
}

fn hand_over(sender: &SyncSender<Request>, request: Request) {
    if let Err(TrySendError::Full(request) | TrySendError::Disconnected(request)) = sender.try_send(request) {
        let busy = AdminReply { lease: 0, refusal: Refusal::Busy.code(), detail: NO_JOINT };
        reply(&request.query, &busy, b"");
    }
}

fn answer_all(robot: &Robot, requests: &Receiver<Request>) {
    while let Ok(Request { query, session, payload }) = requests.recv() {
        // The daemon watches this process: with it, every claim ends.
        let request = AdminRequest { pid: std::process::id(), pid_namespace: pid_namespace(), ..payload };
        match robot.link.ask(request) {
            Ok((head, text)) => {
                let is_claim = payload.operation() == Ok(Operation::Claim);
                if let Some(lease) = Lease::from_raw(head.lease).filter(|_| is_claim) {
                    robot.admission().granted(session, lease, clock::now_ns());
                }
                robot.counters.change(|counts| counts.requests += 1);
                reply(&query, &head, &text);
            }
            Err(error) => {
                let _gone = query.reply_err(error.to_string()).wait();
            }
        }
    }
}

fn reply(query: &Query, head: &AdminReply, text: &[u8]) {
    // A requester that has gone needs no answer.
    let _gone = query.reply(query.key_expr(), reply_bytes(head, text)).wait();
}
