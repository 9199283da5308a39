//! `motorctl record`: writes every cycle of a daemon to a file.

use crate::disk::{Disk, Output};
use crate::failure::RecorderFailure;
use motord_client::{Client, CycleRecord, Error, Records, State};
use motord_mcap::{Clock, Counts};
use motord_terminal::{FileError, Interrupt, json, printable, within};
use serde::Serialize;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Pause between two reads of the shared memory, which holds 50 ms at 10 kHz.
pub(crate) const PAUSE: Duration = Duration::from_millis(5);

/// Longest time to wait for the first state.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(1);

/// The arguments of the command.
#[derive(Debug, Clone, clap::Args)]
pub struct RecordArguments {
    /// The file, which must not exist yet; `-` is the standard output.
    file: PathBuf,
    /// End after this many seconds, at most 86400. Without it the recording ends with Ctrl-C.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// End at this size of the file, MB (10⁶ bytes). The file becomes a few MB longer.
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    max_size: Option<u64>,
    /// Write to FILE.unfinished, and give the file its name when it is complete: for programs that collect recordings.
    #[arg(long)]
    rename: bool,
    /// Print the result as one JSON object.
    #[arg(long)]
    json: bool,
}

impl RecordArguments {
    /// Returns the path under which the file grows.
    fn growing(&self) -> PathBuf {
        let mut name = self.file.clone().into_os_string();
        if self.rename {
            name.push(".unfinished");
        }
        name.into()
    }

    /// Creates the file.
    fn create(&self) -> io::Result<File> {
        if self.file.symlink_metadata().is_ok() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        File::create_new(self.growing())
    }

    /// Gives a complete file its name.
    fn complete(&self) -> io::Result<()> {
        let (growing, file) = (self.growing(), &self.file);
        if growing == *file || is_stdout(file) {
            return Ok(());
        }
        match file.symlink_metadata() {
            // Another program made it meanwhile.
            Ok(_) => Err(io::ErrorKind::AlreadyExists.into()),
            Err(_) => fs::rename(growing, file),
        }
    }
}

fn is_stdout(path: &Path) -> bool {
    path.as_os_str() == "-"
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    within(text, 0.1, 86_400.0)
}

/// The result, as `--json` prints it.
#[derive(Debug, Serialize)]
struct RecordReport {
    /// The file; `-` for the standard output.
    file: String,
    /// Cycles in the file.
    recorded: u64,
    /// Number of the first cycle; 0 when there is none.
    first_cycle: u64,
    /// Number of the last cycle that the recorder took; 0 when there is none.
    last_cycle: u64,
    /// From the first cycle to the last one, s.
    seconds: f64,
    /// Bytes that were written.
    bytes: u64,
    /// Ticks that the daemon missed: they have no cycle.
    missed_ticks: u64,
    /// Cycles that the daemon was too slow to publish.
    unpublished: u64,
    /// Cycles that the recorder was too slow to take out of shared memory.
    lost: u64,
    /// Cycles that the disk was too slow for, or did not accept.
    dropped: u64,
    /// Why the recording ended.
    ended: &'static str,
}

/// Records until the arguments, a signal, the disk or the daemon end it.
///
/// # Errors
///
/// The daemon does not answer or ends; the file exists or cannot be written. A started file can be
/// read.
pub fn run(instance: &str, arguments: &RecordArguments) -> Result<(), RecorderFailure> {
    let interrupt = Interrupt::register();
    let client = Client::connect(instance)?;
    client.set_silence(TIMEOUT);
    // The slot of a recorder is taken before the file is created: without a free slot, no file
    // remains.
    let records = client.records()?;
    let path = &arguments.file;
    match is_stdout(path) {
        true => record(&client, records, arguments, &interrupt, io::stdout()),
        false => {
            let file = arguments.create().map_err(FileError::unwritable(path))?;
            record(&client, records, arguments, &interrupt, file)
        }
    }
}

fn record(
    client: &Client,
    records: Records,
    arguments: &RecordArguments,
    interrupt: &Interrupt,
    out: impl Output,
) -> Result<(), RecorderFailure> {
    let mut session = Session::begin(client, records, arguments, out)?;
    let mut ended = session.take_all(interrupt);
    session.disk.finish(session.counts());
    let _the_first = interrupt.is_raised_again();
    // A second Ctrl-C ends the wait for the disk.
    while !session.disk.has_ended() && !interrupt.is_raised_again() {
        std::thread::sleep(PAUSE);
    }
    let written = match session.disk.has_ended() {
        true => session.disk.join(),
        false => Err(io::Error::other("interrupted while the disk did not answer")),
    };
    let written = written.and_then(|()| arguments.complete());
    if written.is_err() {
        ended = End::Disk;
    }
    session.report(&arguments.file, &ended).print(arguments)?;
    written.map_err(FileError::unwritable(&arguments.file))?;
    if let End::Daemon(error) = ended { Err(error.into()) } else { Ok(()) }
}

/// Returns the clocks of this computer, from the times of `begun`.
pub(crate) fn clock(begun: &State) -> Clock {
    Clock::system(begun.publish_ns().saturating_add(nanos(begun.age())))
}

/// The reason for the end of a recording.
enum End {
    Interrupted,
    Seconds,
    MaxSize,
    Disk,
    Daemon(Error),
}

impl End {
    fn name(&self) -> &'static str {
        match self {
            Self::Interrupted => "interrupted",
            Self::Seconds => "seconds",
            Self::MaxSize => "max-size",
            Self::Disk => "disk",
            Self::Daemon(_) => "daemon",
        }
    }
}

/// A running recording.
struct Session {
    records: Records,
    disk: Disk,
    clock: Clock,
    tally: Tally,
    ends: Option<Instant>,
}

impl Session {
    fn begin(
        client: &Client,
        records: Records,
        arguments: &RecordArguments,
        out: impl Output,
    ) -> Result<Self, RecorderFailure> {
        let begun = client.wait(TIMEOUT)?;
        let max_bytes = arguments.max_size.map_or(u64::MAX, |megabytes| megabytes.saturating_mul(1_000_000));
        let mut clock = clock(&begun);
        let disk = Disk::begin(out, &client.description(), clock.origin(), begun.tick_ns(), max_bytes)
            .map_err(FileError::unwritable(&arguments.file))?;
        let ends = arguments.seconds.map(|seconds| Instant::now() + Duration::from_secs_f64(seconds));
        Ok(Self { records, disk, clock, tally: Tally::default(), ends })
    }

    /// Records every cycle until a condition ends it.
    fn take_all(&mut self, interrupt: &Interrupt) -> End {
        let mut record = Box::<CycleRecord>::default();
        loop {
            loop {
                match self.records.take(&mut record) {
                    Ok(true) => {
                        self.tally.take(&record);
                        self.disk.take(&record, self.clock.step());
                    }
                    Ok(false) => break,
                    Err(error) => return End::Daemon(error),
                }
            }
            if interrupt.is_raised() {
                return End::Interrupted;
            }
            if self.disk.has_ended() {
                return End::Disk;
            }
            if self.disk.is_full() {
                return End::MaxSize;
            }
            if self.ends.is_some_and(|ends| Instant::now() >= ends) {
                return End::Seconds;
            }
            std::thread::sleep(PAUSE);
        }
    }

    fn counts(&self) -> Counts {
        let Tally { missed_ticks, gap, .. } = self.tally;
        let lost = self.records.lost();
        let unpublished = gap.saturating_sub(missed_ticks).saturating_sub(lost);
        let (recorded, dropped) = self.disk.counts();
        Counts { recorded, missed_ticks, unpublished, lost, dropped }
    }

    fn report(&self, file: &Path, ended: &End) -> RecordReport {
        let Counts { recorded, missed_ticks, unpublished, lost, dropped } = self.counts();
        let Tally { first, last, .. } = self.tally;
        let nanoseconds =
            last.map_or(0, |(_, tick_ns, _)| tick_ns).saturating_sub(first.map_or(0, |(_, tick_ns)| tick_ns));
        RecordReport {
            file: file.display().to_string(),
            recorded,
            first_cycle: first.map_or(0, |(cycle, _)| cycle),
            last_cycle: last.map_or(0, |(cycle, ..)| cycle),
            seconds: nanoseconds as f64 / 1e9,
            bytes: self.disk.bytes(),
            missed_ticks,
            unpublished,
            lost,
            dropped,
            ended: ended.name(),
        }
    }
}

/// Counts from the numbers of the cycles.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    /// Number and tick of the first cycle.
    first: Option<(u64, u64)>,
    /// Number, tick and overruns of the last one.
    last: Option<(u64, u64, u64)>,
    /// Missing numbers.
    gap: u64,
    missed_ticks: u64,
}

impl Tally {
    fn take(&mut self, record: &CycleRecord) {
        let state = &record.state;
        if let Some((cycle, _, overruns)) = self.last {
            self.gap += state.cycle.saturating_sub(cycle).saturating_sub(1);
            self.missed_ticks += state.overruns.saturating_sub(overruns);
        }
        self.first.get_or_insert((state.cycle, state.tick_ns));
        self.last = Some((state.cycle, state.tick_ns, state.overruns));
    }
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

impl RecordReport {
    /// Prints to standard output, unless the recording was written there.
    fn print(&self, arguments: &RecordArguments) -> io::Result<()> {
        let mut text = Vec::new();
        match arguments.json {
            true => json::write_line(&mut text, self)?,
            false => self.write(&mut text)?,
        }
        match arguments.file.as_os_str() == "-" {
            true => io::stderr().lock().write_all(&text),
            false => io::stdout().lock().write_all(&text),
        }
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { recorded, seconds, missed_ticks, unpublished, lost, dropped, .. } = self;
        let megabytes = self.bytes as f64 / 1e6;
        writeln!(out, "{}: {recorded} cycles in {seconds:.3} s, {megabytes:.1} MB", printable(&self.file))?;
        writeln!(
            out,
            "not recorded: {missed_ticks} ticks that the daemon missed, {unpublished} cycles that it could not hand out, {lost} \
             lost in shared memory, {dropped} dropped for the disk"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gap_in_cycle_numbers_counts_missed_ticks() {
        let mut tally = Tally::default();
        let mut record = CycleRecord::default();
        for (cycle, overruns) in [(7, 3), (8, 3), (12, 5), (13, 5)] {
            (record.state.cycle, record.state.overruns) = (cycle, overruns);
            tally.take(&record);
        }
        assert_eq!(
            (tally.gap, tally.missed_ticks),
            (3, 2),
            "one cycle more than the missed ticks is not there"
        );
        assert_eq!((tally.first, tally.last), (Some((7, 0)), Some((13, 0, 5))));
    }
}
