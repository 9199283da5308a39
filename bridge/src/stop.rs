//! The emergency stop: a thread that stops the robot for every source that requests it, and gives
//! each a receipt.

use motord_client::{Client, Error};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Limit on requests that wait for a receipt. A request beyond it joins the stop, without a receipt.
const RECEIPTS_MAX: usize = 64;

/// Time after which the thread checks whether the bridge ends.
const POLL: Duration = Duration::from_millis(200);

/// The outcome of a stop.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Receipt {
    /// The daemon confirmed the stop, and each motor answered after it.
    pub(crate) is_confirmed: bool,
    /// A sentence: which motors did not answer, or why the stop is unconfirmed.
    pub(crate) message: String,
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
}

impl StopDesk {
    /// Requests a stop for `source`, which the log names. The receipt arrives after it. Never waits
    /// for the stop.
    pub(crate) fn request(&self, source: String) -> async_channel::Receiver<Receipt> {
        let (sender, receiver) = async_channel::bounded(1);
        let mut requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        if requests.len() < RECEIPTS_MAX {
            requests.push_back(Request { source, since: Instant::now(), receipt: sender });
        }
        drop(requests);
        self.arrived.notify_one();
        receiver
    }

    /// Returns all requests that wait; waits for one at most for `timeout`.
    fn take(&self, timeout: Duration) -> VecDeque<Request> {
        let requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.arrived.wait_timeout_while(requests, timeout, |requests| requests.is_empty());
        std::mem::take(&mut *waited.unwrap_or_else(PoisonError::into_inner).0)
    }
}

/// Stops the robot `instance` for the requests at `desk`, until the bridge ends.
pub(crate) fn run(instance: &str, desk: &StopDesk, ends: &Arc<AtomicBool>) {
    let mut client = Client::connect_to_stop(instance).ok();
    while !ends.load(Ordering::Relaxed) {
        let requests = desk.take(POLL);
        if requests.is_empty() {
            continue;
        }
        if client.is_none() {
            client = Client::connect_to_stop(instance).ok();
        }
        let outcome = match &client {
            Some(client) => client.emergency_stop(),
            // This one needs no connection.
            None => motord_client::emergency_stop(instance),
        };
        if matches!(outcome, Err(Error::NotRunning { .. } | Error::NotStopped { .. })) {
            client = None;
        }
        answer(requests, outcome);
    }
}

fn answer(requests: VecDeque<Request>, outcome: Result<(), Error>) {
    let receipt = match outcome {
        Ok(()) => Receipt { is_confirmed: true, message: "stopped: each motor answered".to_owned() },
        Err(error) => Receipt { is_confirmed: false, message: error.to_string() },
    };
    for request in requests {
        let after = request.since.elapsed().as_secs_f64() * 1e3;
        let Request { source, .. } = &request;
        match receipt.is_confirmed {
            true => log::warn!("emergency stop by {source}: confirmed after {after:.1} ms"),
            false => log::error!("emergency stop by {source}: {} ({after:.1} ms)", receipt.message),
        }
        // A source that has gone needs no receipt.
        let _gone = request.receipt.try_send(receipt.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_waiting_source_gets_the_receipt() {
        let desk = StopDesk::default();
        let receipts: Vec<_> = (0..RECEIPTS_MAX).map(|number| desk.request(number.to_string())).collect();
        let refused = desk.request("one too many".to_owned());
        answer(desk.take(Duration::ZERO), Ok(()));
        assert!(receipts.iter().all(|receipt| receipt.try_recv().is_ok_and(|receipt| receipt.is_confirmed)));
        assert!(refused.is_closed());
    }

    #[test]
    fn unconfirmed_stop_is_never_reported_as_done() {
        let desk = StopDesk::default();
        let receipt = desk.request("test".to_owned());
        answer(desk.take(Duration::ZERO), Err(Error::MotorsOffline { joints: vec!["fl-hip".to_owned()] }));
        let receipt = receipt.try_recv().unwrap();
        assert!(!receipt.is_confirmed && receipt.message.contains("fl-hip"), "{receipt:?}");
    }
}
