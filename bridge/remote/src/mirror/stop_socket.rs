//! Emergency stops of this computer's programs: from the socket that they know to the robot.
//!
//! ```text
//! client ─ socket ─▶ thread of the socket ── name ──▶ thread of the network ─ zenoh ─▶ robot
//! ```
//!
//! The thread of the socket has descriptors of its own, so it cannot use zenoh.

use super::wire::Wire;
use crate::receipt::Receipt;
use motord_ports::Instance;
use motord_ports::stop_socket::StopError;
use motord_ports::stop_source::StopSource;
use motord_realtime::process;
use motord_stop::Robot;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use zenoh::Wait;

/// Longest time for the receipt of the robot.
const RECEIPT_TIMEOUT: Duration = Duration::from_secs(2);
/// Time until a stop is sent again. A stop of a robot whose motors do not answer takes 0.3 s longer
/// than another one.
const ATTEMPT: Duration = Duration::from_millis(150);
const PAUSE: Duration = Duration::from_millis(10);

/// The end of the thread of the socket.
struct Remote(Sender<Stop>);

/// A requested stop: the name of its requester, and where the receipt goes.
struct Stop(String, Sender<Result<(), StopError>>);

/// Serves the socket of `instance` until `ends`, on threads of its own. Returns that of the socket,
/// which ends at most a quarter of a second later.
pub(super) fn start(instance: &Instance, wire: Arc<Wire>, ends: Arc<AtomicBool>) -> JoinHandle<()> {
    let (sender, stops) = channel::<Stop>();
    std::thread::spawn(move || {
        while let Ok(Stop(name, receipt)) = stops.recv() {
            // The thread of the socket has given up.
            let _late = receipt.send(stop(&wire, &name));
        }
    });
    let instance = instance.clone();
    std::thread::spawn(move || {
        motord_stop::run(&instance, Remote(sender), || ends.load(Ordering::Relaxed));
    })
}

/// Stops the robot, and waits for its receipt. A network may lose the request or the receipt: it is
/// sent again and again.
fn stop(wire: &Wire, name: &str) -> Result<(), StopError> {
    let begun = Instant::now();
    while begun.elapsed() < RECEIPT_TIMEOUT {
        if let Some(receipt) = attempt(wire, name) {
            if !receipt.sent {
                tracing::error!(receipt = receipt.message, "the robot was not stopped");
            }
            return if receipt.sent { Ok(()) } else { Err(StopError::NoCycle) };
        }
    }
    Err(StopError::NoCycle)
}

fn attempt(wire: &Wire, name: &str) -> Option<Receipt> {
    let (sender, receipts) = channel();
    let session = wire.session()?;
    let sent = session.get(wire.keys.stop()).payload(name).timeout(RECEIPT_TIMEOUT);
    let sent = sent.callback(move |reply| {
        let bytes = reply.result().ok().map(|sample| sample.payload().to_bytes().into_owned());
        let _late = sender.send(bytes);
    });
    sent.wait().ok()?;
    match receipts.recv_timeout(ATTEMPT) {
        Ok(bytes) => serde_json::from_slice(&bytes?).ok(),
        // No robot answers at all: the next attempt must not follow at once.
        Err(RecvTimeoutError::Disconnected) => {
            std::thread::sleep(PAUSE);
            None
        }
        Err(RecvTimeoutError::Timeout) => None,
    }
}

impl Robot for Remote {
    fn stop(&self, pid: u32, source: StopSource) -> Result<(), StopError> {
        let (sender, receipts) = channel();
        self.0.send(Stop(self.name(pid, &source), sender)).map_err(|_| StopError::NoCycle)?;
        receipts.recv_timeout(RECEIPT_TIMEOUT).unwrap_or(Err(StopError::NoCycle))
    }

    fn program(&self, pid: u32) -> Option<String> {
        process::program(pid)
    }
}

impl Remote {
    /// Returns the name of the requester, which the robot's log shows.
    fn name(&self, pid: u32, source: &StopSource) -> String {
        let program = self.program(pid).unwrap_or_else(|| format!("process {pid}"));
        match source.text() {
            Some(source) => format!("{program}: {source}"),
            None => program,
        }
    }
}
