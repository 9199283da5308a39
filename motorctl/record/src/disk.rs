//! The writing thread, and the bounded queue before it. The recording thread never waits for the
//! disk.

use motord_client::{CycleRecord, RobotDescription};
use motord_mcap::{ClockStep, Counts, Origin, Writer};
use std::io::{self, BufWriter, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

/// Limit on the cycles in the queue: 4 s at 1 kHz, 40 MB.
const WAITING_MAX: usize = 4096;
/// Size of a write to the disk, bytes, unless a part of the file is longer.
const WRITE_BYTES: usize = 256 << 10;
/// Interval of flushes, after each of which the file is readable.
const FLUSH_NS: u64 = 1_000_000_000;

/// The destination of a recording. `sync` waits until it is on the disk.
pub(crate) trait Output: Write + Send + 'static {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Output for std::fs::File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_all()
    }
}

impl Output for io::Stdout {}

/// The state of the writing thread, for the recording thread.
#[derive(Debug, Default)]
struct Progress {
    /// Cycles flushed to the file.
    recorded: AtomicU64,
    /// Bytes written.
    bytes: AtomicU64,
    /// `true` once the thread has ended.
    has_ended: AtomicBool,
}

/// A cycle of the queue, and the step of the clock before it.
type Taken = (Box<CycleRecord>, Option<ClockStep>);

/// The input of the queue.
pub(crate) struct Disk {
    sender: Option<SyncSender<Taken>>,
    thread: Option<JoinHandle<io::Result<()>>>,
    progress: Arc<Progress>,
    finish: SyncSender<Counts>,
    /// Cycles passed to the queue, also dropped ones.
    taken: u64,
    max_bytes: u64,
    /// A step whose cycle was dropped: the next cycle takes it along.
    step: Option<ClockStep>,
}

impl Disk {
    /// Starts a file of `robot` in `out`, which is full at `max_bytes`.
    ///
    /// # Errors
    /// The thread cannot be created.
    pub(crate) fn begin(
        out: impl Output,
        robot: &RobotDescription,
        origin: Origin,
        from_ns: u64,
        max_bytes: u64,
    ) -> io::Result<Self> {
        let (sender, records) = sync_channel(WAITING_MAX);
        let (finish, counts) = sync_channel(1);
        let progress = Arc::new(Progress::default());
        let (robot, shared) = (robot.clone(), Arc::clone(&progress));
        let thread = std::thread::Builder::new().name("motorctl-write".to_owned()).spawn(move || {
            let written = write(out, &robot, (origin, from_ns), &records, &counts, &shared);
            shared.has_ended.store(true, Ordering::Release);
            written
        })?;
        Ok(Self {
            sender: Some(sender),
            thread: Some(thread),
            progress,
            finish,
            taken: 0,
            max_bytes,
            step: None,
        })
    }

    /// Queues a cycle, and the `step` of the clock before it; drops the cycle when the queue is
    /// full. Never blocks.
    pub(crate) fn take(&mut self, record: &CycleRecord, step: Option<ClockStep>) {
        self.taken += 1;
        self.step = step.or(self.step);
        let Some(sender) = &self.sender else { return };
        match sender.try_send((Box::new(*record), self.step)) {
            Ok(()) => self.step = None,
            Err(TrySendError::Full(_)) => {}
            Err(TrySendError::Disconnected(_)) => self.sender = None,
        }
    }

    /// Returns `true` if the file has reached its limit, or the disk failed.
    pub(crate) fn is_full(&self) -> bool {
        self.has_ended() || self.bytes() >= self.max_bytes
    }

    pub(crate) fn has_ended(&self) -> bool {
        self.progress.has_ended.load(Ordering::Acquire)
    }

    /// Returns the size of the file, bytes.
    pub(crate) fn bytes(&self) -> u64 {
        self.progress.bytes.load(Ordering::Relaxed)
    }

    /// Returns the cycles flushed to the file, and the other ones: dropped, once the file has
    /// ended.
    pub(crate) fn counts(&self) -> (u64, u64) {
        let recorded = self.progress.recorded.load(Ordering::Relaxed);
        (recorded, self.taken.saturating_sub(recorded))
    }

    /// Lets the thread write the queue, and end the file with `counts`, of which it sets `recorded`
    /// and `dropped`. [`has_ended`](Self::has_ended) reports the end.
    pub(crate) fn finish(&mut self, counts: Counts) {
        let _ended = self.finish.try_send(Counts { dropped: self.taken, ..counts });
        self.sender = None;
    }

    /// Waits for the thread.
    ///
    /// # Errors
    /// The reason why the file could not be completed.
    pub(crate) fn join(&mut self) -> io::Result<()> {
        let ended = self.thread.take().map(JoinHandle::join);
        ended.unwrap_or(Ok(Ok(()))).unwrap_or_else(|_| Err(io::Error::other("the writing thread panicked")))
    }
}

/// Runs the thread.
fn write(
    out: impl Output,
    robot: &RobotDescription,
    (origin, from_ns): (Origin, u64),
    records: &Receiver<Taken>,
    counts: &Receiver<Counts>,
    progress: &Progress,
) -> io::Result<()> {
    let out = BufWriter::with_capacity(WRITE_BYTES, Counting { out, progress });
    let mut writer = Writer::new(out, robot, origin, from_ns)?;
    let (mut written, mut flushed_ns) = (0, from_ns);
    for (record, step) in records {
        step.map_or(Ok(()), |step| writer.write_step(step))?;
        writer.write(&record)?;
        written += 1;
        if record.state.tick_ns.saturating_sub(flushed_ns) >= FLUSH_NS {
            flushed_ns = record.state.tick_ns;
            writer.flush()?;
            progress.recorded.store(written, Ordering::Relaxed);
        }
    }
    let counts = counts.try_recv().unwrap_or_default();
    let taken = counts.dropped;
    let out =
        writer.finish(&Counts { recorded: written, dropped: taken.saturating_sub(written), ..counts })?;
    let mut out = out.into_inner().map_err(io::IntoInnerError::into_error)?;
    out.flush()?;
    out.out.sync()?;
    progress.recorded.store(written, Ordering::Relaxed);
    Ok(())
}

/// Counts the bytes.
struct Counting<'a, W> {
    out: W,
    progress: &'a Progress,
}

impl<W: Write> Write for Counting<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.progress.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_mcap::Reader;
    use std::sync::Mutex;
    use std::time::Duration;

    /// A disk with this space, and this duration of each write.
    #[derive(Clone, Default)]
    struct Space {
        bytes: Arc<Mutex<Vec<u8>>>,
        most: usize,
        delay: Duration,
    }

    impl Write for Space {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            std::thread::sleep(self.delay);
            let mut written = self.bytes.lock().unwrap();
            if written.len() + bytes.len() > self.most {
                return Err(io::ErrorKind::StorageFull.into());
            }
            written.extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Output for Space {}

    fn record(cycle: u64) -> CycleRecord {
        let mut record = CycleRecord { sequence: cycle, ..CycleRecord::default() };
        record.state.cycle = cycle;
        record.state.tick_ns = cycle * 1_000_000;
        record
    }

    fn begin(space: &Space, max_bytes: u64) -> Disk {
        let robot = RobotDescription::default();
        Disk::begin(space.clone(), &robot, Origin::default(), 0, max_bytes).unwrap()
    }

    fn readable(space: &Space) -> u64 {
        let bytes = space.bytes.lock().unwrap().clone();
        let mut reader = Reader::new(&bytes[..]).unwrap();
        let mut cycles = 0;
        while reader.next_cycle().is_some() {
            cycles += 1;
        }
        cycles
    }

    #[test]
    fn slow_disk_delays_nothing_and_counts_drops() {
        let space = Space { most: usize::MAX, delay: Duration::from_millis(100), ..Space::default() };
        let mut disk = begin(&space, u64::MAX);
        let cycles = 4 * WAITING_MAX as u64;
        (1..=cycles).for_each(|cycle| disk.take(&record(cycle), None));
        disk.finish(Counts::default());
        disk.join().unwrap();
        let (recorded, dropped) = disk.counts();
        assert_eq!(recorded + dropped, cycles);
        assert!(dropped > 0 && recorded >= WAITING_MAX as u64, "{recorded} and {dropped}");
        assert_eq!(readable(&space), recorded);
    }

    #[test]
    fn full_disk_ends_file_that_stays_readable() {
        let space = Space { most: 100_000, ..Space::default() };
        let mut disk = begin(&space, u64::MAX);
        let mut cycle = 0;
        while !disk.has_ended() {
            cycle += 1;
            disk.take(&record(cycle), None);
            std::thread::sleep(Duration::from_micros(20));
        }
        disk.finish(Counts::default());
        assert_eq!(disk.join().unwrap_err().kind(), io::ErrorKind::StorageFull);
        let (recorded, dropped) = disk.counts();
        assert_eq!(recorded + dropped, cycle);
        assert!(recorded > 0 && readable(&space) >= recorded, "{recorded} of {cycle}");
    }
}
