//! Every cycle of the robot, for recorders of this computer.
//!
//! ```text
//!  motorctl record ◀─ shared memory ─ thread of the records ◀─ record/<session> ─ robot
//!                                     main thread ── want, 10 a second ─────────▶
//! ```
//!
//! The robot sends records while a recorder of this computer is connected. A record that the
//! network loses is a gap in their numbers, which recorders count as lost.

use super::wire::{Sender, Wire, move_times};
use crate::clocks::Offset;
use crate::frame::{Head, read_record};
use crate::network::NetworkError;
use motord_ports::{RecordSender, Recorders};
use motord_shared::CycleRecord;
use motord_shared::limits::RECORDS_KEPT;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use zenoh::bytes::ZBytes;

/// Interval of the checks for recorders.
const CHECK: Duration = Duration::from_millis(20);
/// Interval of wants: the network may lose some.
const WANT: Duration = Duration::from_millis(100);
/// Interval of attempts to open the port.
const RETRY: Duration = Duration::from_secs(1);
/// Limit on the records that wait for the thread: as many as wait for a recorder.
const WAITING_MAX: usize = RECORDS_KEPT;

/// The records of one run of the robot's daemon that count: in their order, each once.
#[derive(Debug)]
struct Stream {
    boot_id: u64,
    /// Number of the last record; 0 before the first.
    sequence: u64,
    /// One for all records: a better comparison of the clocks must not move a tick before another.
    offset: Offset,
}

impl Stream {
    /// Takes a frame of the robot's side with this `run`. Returns the record, with times of the own
    /// clock, and the number of those that were lost before it. `None` for one that does not count.
    fn take(&mut self, bytes: &[u8], run: u64) -> Option<(Box<CycleRecord>, u64)> {
        let (Head { from, .. }, mut record) = read_record(bytes).ok()?;
        let is_next = record.sequence > self.sequence && record.state.boot_id == self.boot_id;
        if from != run || !is_next {
            return None;
        }
        let lost = if self.sequence == 0 { 0 } else { record.sequence - self.sequence - 1 };
        self.sequence = record.sequence;
        move_times(&mut record.state, |time| *time = self.offset.moved(*time));
        Some((record, lost))
    }
}

/// The thread of the records: the port of the recorders is open while one is connected. Opening it
/// takes milliseconds, or longer while the disk is busy, which must not delay a setpoint.
struct Port {
    wire: Arc<Wire>,
    recorders: Recorders,
    boot_id: u64,
    is_open: Arc<AtomicBool>,
    ends: Arc<AtomicBool>,
    open: Option<(Stream, RecordSender)>,
    checked: Option<Instant>,
    /// Time of the last attempt to open the port that failed.
    tried: Option<Instant>,
}

impl Port {
    /// Passes records on until `ends`.
    fn run(mut self, records: &Receiver<ZBytes>) {
        while !self.ends.load(Ordering::Relaxed) {
            if self.checked.is_none_or(|checked| checked.elapsed() >= CHECK) {
                self.checked = Some(Instant::now());
                self.check();
            }
            match records.recv_timeout(CHECK) {
                Ok(bytes) => self.take(&bytes.to_bytes()),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
    }

    fn check(&mut self) {
        match self.recorders.are_connected() {
            true if self.open.is_none() => self.open(),
            true => {}
            false => (self.open, self.tried) = (None, None),
        }
        self.is_open.store(self.open.is_some(), Ordering::Relaxed);
    }

    fn open(&mut self) {
        if self.tried.is_some_and(|tried| tried.elapsed() < RETRY) {
            return;
        }
        let Some(offset) = self.wire.offset() else { return };
        match self.recorders.open() {
            Ok(port) => self.open = Some((Stream { boot_id: self.boot_id, sequence: 0, offset }, port)),
            Err(error) => {
                self.tried = Some(Instant::now());
                tracing::warn!("no records for recorders: {error}");
            }
        }
    }

    /// Takes the bytes of the robot.
    fn take(&mut self, bytes: &[u8]) {
        // Without a recorder it is one that was in transit when the last recorder left.
        let Some((stream, port)) = &mut self.open else { return };
        match stream.take(bytes, self.wire.run()) {
            Some((record, lost)) => {
                self.wire.latencies.count_records(lost);
                // A damaged connection; the other recorders have received it.
                let _damaged = port.send(&record);
            }
            None => self.wire.latencies.refuse_frame(),
        }
    }
}

/// The recorders of this computer, and the records for them.
pub(super) struct Records<'a> {
    wire: &'a Wire,
    wants: Sender<'a>,
    wanted: Option<Instant>,
    /// A recorder is connected, and has its port.
    is_open: Arc<AtomicBool>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl<'a> Records<'a> {
    /// For the daemon with this `boot_id`.
    pub(super) fn new(wire: &'a Arc<Wire>, recorders: Recorders, boot_id: u64) -> Result<Self, NetworkError> {
        let wants = wire.sender(wire.keys.want())?;
        let (sender, records) = sync_channel(WAITING_MAX);
        wire.receive_records(Some(sender));
        let (is_open, ends) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
        let port = Port {
            wire: Arc::clone(wire),
            recorders,
            boot_id,
            is_open: Arc::clone(&is_open),
            ends: Arc::clone(&ends),
            open: None,
            checked: None,
            tried: None,
        };
        let thread = Some(std::thread::spawn(move || port.run(&records)));
        Ok(Self { wire, wants, wanted: None, is_open, ends, thread })
    }

    /// Asks the robot for records while a recorder is connected.
    pub(super) fn turn(&mut self) {
        let is_due = self.wanted.is_none_or(|wanted| wanted.elapsed() >= WANT);
        if is_due && self.is_open.load(Ordering::Relaxed) {
            self.wanted = Some(Instant::now());
            self.wants.put(self.wire.up().beat());
        }
    }
}

impl Drop for Records<'_> {
    /// Waits for the thread: the next instance needs its port.
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        self.wire.receive_records(None);
        let _panicked = self.thread.take().map(JoinHandle::join);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::record_bytes;

    const RUN: u64 = 5;
    const BOOT: u64 = 9;

    fn stream() -> Stream {
        Stream { boot_id: BOOT, sequence: 0, offset: Offset { offset_ns: 1000, bound: Duration::ZERO } }
    }

    fn frame(sequence: u64) -> Vec<u8> {
        let mut record = CycleRecord { sequence, ..CycleRecord::default() };
        record.state.boot_id = BOOT;
        record.state.tick_ns = 5000 + sequence % 1000;
        record_bytes(&Head { from: RUN, sequence, sent_ns: 0 }, &record)
    }

    /// The number of a record that counts, and of those lost before it.
    fn taken(stream: &mut Stream, bytes: &[u8]) -> Option<[u64; 2]> {
        stream.take(bytes, RUN).map(|(record, lost)| [record.sequence, lost])
    }

    #[test]
    fn lost_records_are_counted() {
        let mut stream = stream();
        assert_eq!(taken(&mut stream, &frame(4)), Some([4, 0]), "the first of a recording");
        assert_eq!(taken(&mut stream, &frame(5)), Some([5, 0]));
        assert_eq!(taken(&mut stream, &frame(9)), Some([9, 3]));
    }

    #[test]
    fn repeated_and_reordered_records_are_refused() {
        let mut stream = stream();
        assert_eq!(taken(&mut stream, &frame(4)), Some([4, 0]));
        assert_eq!(taken(&mut stream, &frame(4)), None);
        assert_eq!(taken(&mut stream, &frame(7)), Some([7, 2]));
        assert_eq!(taken(&mut stream, &frame(6)), None);
        assert_eq!(taken(&mut stream, &frame(8)), Some([8, 0]));
    }

    #[test]
    fn hostile_records_are_refused() {
        let mut stream = stream();
        assert!(stream.take(&frame(1), RUN + 1).is_none(), "of another run of serve");
        let mut of_other_daemon = Stream { boot_id: BOOT + 1, ..self::stream() };
        assert_eq!(taken(&mut of_other_daemon, &frame(1)), None);
        let damaged = frame(1).split_last().map(|(_, bytes)| bytes.to_vec()).unwrap();
        assert_eq!(taken(&mut stream, &damaged), None);
        assert_eq!(taken(&mut stream, &[]), None);
        assert_eq!(taken(&mut stream, &frame(0)), None, "numbers begin with 1");
        assert_eq!(taken(&mut stream, &frame(u64::MAX)), Some([u64::MAX, 0]));
        assert_eq!(taken(&mut stream, &frame(1)), None);
    }

    #[test]
    fn times_of_records_keep_their_differences() {
        let mut stream = stream();
        let times = [1, 2, 900].map(|sequence| stream.take(&frame(sequence), RUN).unwrap().0.state.tick_ns);
        assert_eq!(times, [4001, 4002, 4900]);
    }
}
