//! Every cycle of the robot, for recorders of this computer.
//!
//! ```text
//!  motorctl record ◀─ shared memory ─ thread of the records ◀─ record/<session> ─ robot
//!                                     main thread ── want, 10 a second ─────────▶
//! ```
//!
//! The robot sends records while a recorder of this computer is connected. A record that the
//! network loses is a gap in their numbers, which recorders count as lost.

use super::wire::{Wire, move_times};
use crate::clocks::Offset;
use crate::frame::{Head, read_record};
use crate::network::NetworkError;
use motord_ports::{RecordSender, Recorders};
use motord_shared::CycleRecord;
use motord_shared::limits::RECORDS_KEPT;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::{Publisher, Subscriber};

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

/// The stream, and the port of the recorders; `None` while no recorder is connected.
#[derive(Debug, Default)]
struct Output(Mutex<Option<(Stream, RecordSender)>>);

impl Output {
    fn lock(&self) -> MutexGuard<'_, Option<(Stream, RecordSender)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the bytes of the robot.
    fn take(&self, wire: &Wire, bytes: &[u8]) {
        let run = wire.run();
        // Without a recorder it is one that was under way when the last recorder left.
        let mut output = self.lock();
        let Some((stream, port)) = output.as_mut() else { return };
        match stream.take(bytes, run) {
            Some((record, lost)) => {
                wire.latencies.count_records(lost);
                // A damaged connection; the other recorders have received it.
                let _damaged = port.send(&record);
            }
            None => wire.latencies.refuse_frame(),
        }
    }
}

/// The recorders of this computer, and the records for them.
pub(super) struct Records<'a> {
    wire: &'a Wire,
    recorders: Recorders,
    boot_id: u64,
    output: Arc<Output>,
    wants: Publisher<'a>,
    checked: Instant,
    wanted: Option<Instant>,
    tried: Option<Instant>,
    _records: Subscriber<()>,
}

impl<'a> Records<'a> {
    /// For the daemon with this `boot_id`.
    pub(super) fn new(wire: &'a Arc<Wire>, recorders: Recorders, boot_id: u64) -> Result<Self, NetworkError> {
        let output = Arc::<Output>::default();
        let (of_thread, of_records) = (Arc::clone(wire), Arc::clone(&output));
        let (sender, waiting) = sync_channel::<ZBytes>(WAITING_MAX);
        // It ends with the subscriber.
        std::thread::spawn(move || {
            waiting.iter().for_each(|bytes| of_records.take(&of_thread, &bytes.to_bytes()));
        });
        let records = wire.session.declare_subscriber(wire.keys.record(wire.id()));
        // The states of the robot use the same thread of zenoh: a record that finds its queue full is lost.
        let records = records.callback(move |sample| drop(sender.try_send(sample.payload().clone())));
        let records = records.wait().map_err(NetworkError::of)?;
        Ok(Self {
            wire,
            recorders,
            boot_id,
            output,
            wants: wire.publisher(wire.keys.want())?,
            checked: Instant::now(),
            wanted: None,
            tried: None,
            _records: records,
        })
    }

    /// Asks the robot for records while a recorder is connected.
    pub(super) fn turn(&mut self) {
        if self.checked.elapsed() < CHECK {
            return;
        }
        self.checked = Instant::now();
        if !self.recorders.are_connected() {
            *self.output.lock() = None;
            self.tried = None;
            return;
        }
        self.open();
        if self.wanted.is_none_or(|wanted| wanted.elapsed() >= WANT) {
            self.wanted = Some(Instant::now());
            let _dropped = self.wants.put(self.wire.up().beat()).wait();
        }
    }

    fn open(&mut self) {
        if self.output.lock().is_some() || self.tried.is_some_and(|tried| tried.elapsed() < RETRY) {
            return;
        }
        let Some(offset) = self.wire.offset() else { return };
        self.tried = Some(Instant::now());
        match self.recorders.open() {
            Ok(port) => {
                let stream = Stream { boot_id: self.boot_id, sequence: 0, offset };
                *self.output.lock() = Some((stream, port));
            }
            Err(error) => tracing::warn!("no records for recorders: {error}"),
        }
    }
}

impl Drop for Records<'_> {
    /// Closes the port of the recorders: the thread of the records may end later than the instance.
    fn drop(&mut self) {
        *self.output.lock() = None;
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
