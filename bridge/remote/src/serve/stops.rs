//! Emergency stops from the network: one thread, which gives each requester a receipt. One stop
//! serves all that wait; its cause names the first.

use super::robot::Robot;
use crate::network::{Keys, NetworkError};
use crate::receipt::Receipt;
use motord_client::{Client, Error};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// Limit on requesters that wait for a receipt. The stop that runs, or the next one, serves others,
/// too.
const WAITING_MAX: usize = 64;
/// Longest name of a requester that is read.
const SOURCE_BYTES_MAX: usize = 128;

/// Serves stops as long as the result lives.
pub(super) fn serve(
    session: &Session,
    keys: &Keys,
    robot: &Arc<Robot>,
    instance: &str,
) -> Result<Queryable<()>, NetworkError> {
    let (sender, requests): (SyncSender<Query>, _) = sync_channel(WAITING_MAX);
    let (robot, instance, key) = (Arc::clone(robot), instance.to_owned(), keys.stop());
    std::thread::spawn(move || stop_all(&robot, &instance, &key, &requests));
    let declared = session.declare_queryable(keys.stop()).callback(move |query| {
        // A full queue has not begun its stop: it serves this requester without a receipt.
        let _full = sender.try_send(query);
    });
    declared.wait().map_err(NetworkError::of)
}

fn stop_all(robot: &Robot, instance: &str, key: &str, requests: &Receiver<Query>) {
    let mut client = Client::connect_to_stop(instance).ok();
    while let Ok(first) = requests.recv() {
        let others: Vec<_> = requests.try_iter().collect();
        let source = source(&first);
        let outcome = match &client {
            Some(client) => client.emergency_stop_for(&source),
            // This one needs no connection.
            None => motord_client::emergency_stop_for(instance, &source),
        };
        if client.is_none() || matches!(outcome, Err(Error::NotRunning { .. } | Error::NotStopped { .. })) {
            client = Client::connect_to_stop(instance).ok();
        }
        robot.counters.change(|counts| counts.stops += 1);
        let receipt = Receipt::of(outcome);
        let json = serde_json::to_string(&receipt).unwrap_or_default();
        for query in [first].iter().chain(&others) {
            // The request may be to all robots: the receipt names this one. A requester that has gone
            // needs none.
            let _disconnected = query.reply(key, json.as_str()).wait();
        }
        tracing::warn!(source, confirmed = receipt.confirmed, "emergency stop: {}", receipt.message);
    }
}

/// Returns the name of the requester, as it calls itself.
fn source(query: &Query) -> String {
    let name = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
    let name = &name[..name.len().min(SOURCE_BYTES_MAX)];
    format!("network: {}", String::from_utf8_lossy(name))
}
