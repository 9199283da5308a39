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
use std::sync::mpsc::{Receiver, Sender, channel};
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
/// sent again and again, and the receipt of each attempt counts.
fn stop(wire: &Wire, name: &str) -> Result<(), StopError> {
    let begun = Instant::now();
    let (sender, replies) = channel();
    while begun.elapsed() < RECEIPT_TIMEOUT {
        if let Some(receipt) = attempt(wire, name, &sender, &replies) {
            if !receipt.sent {
                tracing::error!(receipt = receipt.message, "the robot was not stopped");
            }
            return if receipt.sent { Ok(()) } else { Err(StopError::NoCycle) };
        }
    }
    Err(StopError::NoCycle)
}

/// The bytes of a receipt. `None` for an attempt that ended without one.
type Reply = Option<Vec<u8>>;

/// Sends the request, and returns a receipt of this attempt, or of one before it.
fn attempt(wire: &Wire, name: &str, sender: &Sender<Reply>, replies: &Receiver<Reply>) -> Option<Receipt> {
    let Some(session) = wire.session() else {
        std::thread::sleep(PAUSE);
        return None;
    };
    let ended = Ended(sender.clone());
    let sent = session.get(wire.keys.stop()).payload(name).timeout(RECEIPT_TIMEOUT);
    let sent = sent.callback(move |reply| {
        let bytes = reply.result().ok().map(|sample| sample.payload().to_bytes().into_owned());
        // The stop has its receipt already.
        let _late = ended.0.send(bytes);
    });
    // Dropped with its callback where it cannot be sent.
    let _failed = sent.wait();
    match replies.recv_timeout(ATTEMPT) {
        Ok(Some(bytes)) => serde_json::from_slice(&bytes).ok(),
        // No robot answers at all: the next attempt must not follow at once.
        Ok(None) => {
            std::thread::sleep(PAUSE);
            None
        }
        Err(_) => None,
    }
}

/// Tells the end of an attempt when it is dropped with the callback.
struct Ended(Sender<Reply>);

impl Drop for Ended {
    fn drop(&mut self) {
        let _late = self.0.send(None);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Network;
    use crate::network::{self, Keys};
    use zenoh::Session;

    fn open(text: &str) -> Session {
        let network: Network = toml::from_str(&format!("plaintext = true\n{text}")).unwrap();
        network::open(&network, None, || false).unwrap().unwrap()
    }

    #[test]
    fn receipt_of_slow_robot_counts() {
        let socket = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = socket.local_addr().unwrap();
        drop(socket);
        let robot = open(&format!("listen = [\"tcp/{address}\"]\n"));
        let keys = Keys::of("go7");
        let answering = robot.declare_queryable(keys.stop()).callback(|query| {
            // As long as a stop takes while a motor is silent.
            std::thread::spawn(move || {
                std::thread::sleep(3 * ATTEMPT);
                let receipt = serde_json::to_string(&Receipt::of(Ok(()))).unwrap();
                let _late = query.reply(query.key_expr(), receipt).wait();
            });
        });
        let _answering = answering.wait().unwrap();
        let wire = Arc::new(Wire::new(keys).unwrap());
        wire.link(open(&format!("connect = [\"tcp/{address}\"]\n"))).unwrap();
        assert!(stop(&wire, "test").is_ok());
    }
}
