//! Records of each cycle for the mirrors whose computers record.
//!
//! ```text
//!  mirror ── want, 10 a second ─▶ Readers
//!  mirror ◀─ record/<session> ─── thread of the records ◀─ shared memory ─ motord
//! ```
//!
//! The daemon makes records only while a mirror wants them. A slow network loses records: they have
//! the lowest priority, and none is sent while the network delays the frames of the mirror.

use super::robot::Robot;
use crate::frame::{Head, record_bytes};
use crate::network::{Keys, NetworkError};
use motord_client::CycleRecord;
use motord_ports::{ClientPorts, RecordPort, clock};
use motord_shared::limits::RECORDS_KEPT;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::{Session, Wait};

/// Interval of the checks for new records, of which a quarter of a second is kept.
const PAUSE: Duration = Duration::from_millis(5);
/// Interval of the checks for mirrors that want records.
const IDLE: Duration = Duration::from_millis(20);
/// Interval of attempts to become a recorder of the daemon.
const RETRY: Duration = Duration::from_secs(1);

/// Sends records until `ends`, on a thread of its own.
pub(super) fn start(
    session: &Session,
    keys: &Keys,
    robot: &Arc<Robot>,
    run: u64,
    ends: &Arc<AtomicBool>,
) -> JoinHandle<()> {
    let (session, keys, robot, ends) = (session.clone(), keys.clone(), Arc::clone(robot), Arc::clone(ends));
    std::thread::spawn(move || {
        let mut sender = Sender {
            session: &session,
            keys: &keys,
            robot: &robot,
            run,
            readers: Vec::new(),
            port: None,
            tried: None,
            has_reported: false,
        };
        while !ends.load(Ordering::Relaxed) {
            sender.turn();
            std::thread::sleep(if sender.readers.is_empty() { IDLE } else { PAUSE });
        }
    })
}

/// The recorder of the daemon, and the mirrors that it serves.
struct Sender<'a> {
    session: &'a Session,
    keys: &'a Keys,
    robot: &'a Robot,
    run: u64,
    readers: Vec<(u64, Publisher<'static>)>,
    /// The port, and the connection to the daemon to which it belongs, which must be dropped last.
    port: Option<(RecordPort, Arc<ClientPorts>)>,
    /// Time of the last attempt to open the port that failed.
    tried: Option<Instant>,
    /// The log has the reason already why there are no records.
    has_reported: bool,
}

impl Sender<'_> {
    fn turn(&mut self) {
        let wanted = self.robot.readers().current(clock::now_ns());
        self.readers.retain(|(session, _)| wanted.contains(session));
        for session in wanted {
            if !self.readers.iter().any(|(known, _)| *known == session) {
                match self.publisher(session) {
                    Ok(publisher) => self.readers.push((session, publisher)),
                    Err(error) => self.report(&error),
                }
            }
        }
        let ports = self.robot.link.ports();
        let is_same = |(_, known): &(RecordPort, Arc<ClientPorts>)| {
            ports.as_ref().is_some_and(|ports| Arc::ptr_eq(ports, known))
        };
        if self.readers.is_empty() || !self.port.as_ref().is_some_and(is_same) {
            self.port = None;
        }
        if let Some(ports) = ports.filter(|_| !self.readers.is_empty()) {
            self.open(ports);
            self.pass();
        }
    }

    fn publisher(&self, session: u64) -> Result<Publisher<'static>, NetworkError> {
        let publisher = self.session.declare_publisher(self.keys.record(session));
        let publisher = publisher.congestion_control(CongestionControl::Drop).priority(Priority::Background);
        // Where the link has both kinds, a lost packet of a reliable message is sent again.
        publisher.reliability(Reliability::Reliable).wait().map_err(NetworkError::of)
    }

    /// Becomes a recorder of the daemon.
    fn open(&mut self, ports: Arc<ClientPorts>) {
        if self.port.is_some() || self.tried.is_some_and(|tried| tried.elapsed() < RETRY) {
            return;
        }
        match ports.record_port() {
            Ok(port) => {
                (self.tried, self.has_reported) = (None, false);
                self.port = Some((port, ports));
            }
            Err(error) => {
                self.tried = Some(Instant::now());
                self.report(&error);
            }
        }
    }

    /// Logs a reason once, until there are records again.
    fn report(&mut self, error: &dyn std::error::Error) {
        if !std::mem::replace(&mut self.has_reported, true) {
            tracing::warn!("no records for the mirrors: {error}");
        }
    }

    /// Sends the records since the last turn. Never waits for the network.
    fn pass(&mut self) {
        let Some((port, _)) = &self.port else { return };
        let (admission, now_ns) = (self.robot.admission(), clock::now_ns());
        let has_capacity = |reader: &&(u64, _)| admission.has_capacity(reader.0, now_ns);
        let ready: Vec<_> = self.readers.iter().filter(has_capacity).collect();
        drop(admission);
        let mut record = Box::<CycleRecord>::default();
        let (mut sent, mut is_damaged) = (0, false);
        for _ in 0..RECORDS_KEPT {
            match port.take(&mut record) {
                Ok(true) => {}
                Ok(false) => break,
                Err(_) => {
                    is_damaged = true;
                    break;
                }
            }
            let head = Head { from: self.run, sequence: record.sequence, sent_ns: clock::now_ns() };
            let bytes = record_bytes(&head, &record);
            for (_, publisher) in &ready {
                // A slow link drops the record.
                let _dropped = publisher.put(bytes.clone()).wait();
                sent += 1;
            }
        }
        self.robot.counters.change(|counts| counts.records += sent);
        if is_damaged {
            (self.port, self.tried) = (None, Some(Instant::now()));
        }
    }
}
