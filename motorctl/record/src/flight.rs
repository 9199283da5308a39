//! `motorctl flight`: the last seconds of a robot, as a file after each of its stops.

use crate::failure::RecorderFailure;
use crate::record::{PATIENCE, PAUSE, origin};
use motord_client::{Client, CycleRecord, Error, Records};
use motord_mcap::{Memory, Remembered, Stops};
use motord_terminal::{Absence, Interrupt, printable, within};
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use time::OffsetDateTime;

/// Interval of the checks for an unavailable daemon.
const ABSENCE: Duration = Duration::from_millis(500);
/// Size of a write to the disk, bytes.
const WRITE_BYTES: usize = 256 << 10;

/// The arguments of the command.
#[derive(Debug, Clone, clap::Args)]
pub struct FlightArguments {
    /// The directory of the files. It must exist.
    directory: PathBuf,
    /// Seconds before a stop in its file, 1 to 600.
    #[arg(long, value_name = "S", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// Seconds after a stop in its file, 0 to 60.
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = parse_after)]
    after: f64,
    /// Limit on the files of the instance in the directory: the oldest is removed for a new one.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    files: u64,
    /// Limit on the memory, MB (10⁶ bytes), and roughly on the size of a file.
    #[arg(long, value_name = "MB", default_value_t = 64, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    max_size: u64,
}

fn parse_after(text: &str) -> Result<f64, String> {
    within(text, 0.0, 60.0)
}

/// Remembers cycles, and writes them after each stop, until a signal arrives. Continues with the
/// next daemon after a restart.
///
/// # Errors
///
/// The directory does not exist, or this user may not record. A file that cannot be written is
/// reported, and ends nothing.
pub fn run(instance: &str, arguments: &FlightArguments) -> Result<(), RecorderFailure> {
    let interrupt = Interrupt::register();
    let directory = &arguments.directory;
    fs::read_dir(directory).map_err(|error| RecorderFailure::unwritable(directory, error))?;
    let mut files = Files { place: Place::new(instance, arguments), under_way: None };
    let mut absence = Absence::default();
    while !interrupt.came() {
        match Flight::begin(instance, arguments) {
            Ok(flight) => {
                absence.end();
                let place = directory.display().to_string();
                eprintln!("motorctl: {instance}: a stop is written to {}", printable(&place));
                flight.follow(&mut files, &interrupt);
            }
            Err(error) if error.is_transient() => absence.report(&error),
            Err(error) => return Err(error.into()),
        }
        interrupt.pause_until(Instant::now() + ABSENCE);
    }
    files.wait(&interrupt);
    Ok(())
}

/// The recording of one run of a daemon.
struct Flight {
    records: Records,
    memory: Memory,
    stops: Stops,
    /// A stop, and the tick after which it is written.
    stop: Option<(String, u64)>,
    after_ns: u64,
}

impl Flight {
    /// Waits for the first cycle: from then on no stop is missed.
    fn begin(instance: &str, arguments: &FlightArguments) -> Result<Self, Error> {
        let client = Client::connect(instance)?;
        let mut records = client.records()?;
        let begun = client.wait(PATIENCE)?;
        let after = Duration::from_secs_f64(arguments.after);
        let time = Duration::from_secs(arguments.seconds.saturating_add(after.as_secs()).saturating_add(1));
        let bytes = usize::try_from(arguments.max_size.saturating_mul(1_000_000)).unwrap_or(usize::MAX);
        let memory = Memory::new(&client.description(), origin(&begun), time, bytes);
        let after_ns = u64::try_from(after.as_nanos()).unwrap_or(u64::MAX);
        let (mut stops, mut record) = (Stops::default(), Box::<CycleRecord>::default());
        while !records.take(&mut record)? {
            std::thread::sleep(PAUSE);
        }
        let _latched_before = stops.of(&record);
        Ok(Self { records, memory, stops, stop: None, after_ns })
    }

    /// Records every cycle until the daemon ends or a signal arrives.
    fn follow(mut self, files: &mut Files, interrupt: &Interrupt) {
        let mut record = Box::<CycleRecord>::default();
        while !interrupt.came() {
            match self.records.take(&mut record) {
                Ok(true) => self.take(&record, files),
                Ok(false) => std::thread::sleep(PAUSE),
                Err(_) if self.stops.is_leaving() => break,
                Err(_) => {
                    self.stop.get_or_insert_with(|| ("daemon-gone".to_owned(), 0));
                    break;
                }
            }
        }
        if let Some((why, _)) = self.stop.take() {
            files.write(self.memory.remembered(), why);
        }
    }

    fn take(&mut self, record: &CycleRecord, files: &mut Files) {
        let tick_ns = record.state.tick_ns;
        // Cycles that cannot be encoded are missing in the file: the numbers of the other cycles
        // show the gap.
        let _encoded = self.memory.take(record);
        if let Some(cause) = self.stops.of(record) {
            self.stop.get_or_insert((cause.to_string(), tick_ns.saturating_add(self.after_ns)));
        }
        if let Some((why, _)) = self.stop.take_if(|(_, due_ns)| tick_ns >= *due_ns) {
            files.write(self.memory.remembered(), why);
        }
    }
}

/// The writing thread: the recording thread never waits for the disk.
struct Files {
    place: Place,
    under_way: Option<JoinHandle<()>>,
}

impl Files {
    fn write(&mut self, remembered: io::Result<Remembered>, why: String) {
        if self.under_way.as_ref().is_some_and(|thread| !thread.is_finished()) {
            eprintln!("motorctl: {why} is not written: the disk is still writing the previous file");
            return;
        }
        let place = self.place.clone();
        let thread = std::thread::Builder::new().name("motorctl-write".to_owned()).spawn(move || {
            match remembered.and_then(|remembered| place.write(&remembered, &why)) {
                Ok((path, cycles)) => {
                    eprintln!("motorctl: {}: {cycles} cycles", printable(&path.display().to_string()));
                }
                Err(error) => eprintln!("motorctl: {why} is not written: {error}"),
            }
        });
        match thread {
            Ok(thread) => self.under_way = Some(thread),
            Err(error) => eprintln!("motorctl: a stop is not written: {error}"),
        }
    }

    /// Waits for the disk; a second signal ends the wait.
    fn wait(&self, interrupt: &Interrupt) {
        let _the_first = interrupt.came_again();
        while self.under_way.as_ref().is_some_and(|thread| !thread.is_finished()) && !interrupt.came_again() {
            std::thread::sleep(PAUSE);
        }
    }
}

/// The destination of the files.
#[derive(Debug, Clone)]
struct Place {
    directory: PathBuf,
    instance: String,
    files_max: usize,
}

impl Place {
    fn new(instance: &str, arguments: &FlightArguments) -> Self {
        Self {
            directory: arguments.directory.clone(),
            instance: instance.to_owned(),
            files_max: usize::try_from(arguments.files).unwrap_or(usize::MAX),
        }
    }

    /// Writes a file under a temporary name, and renames it once it is complete. Then removes the
    /// oldest files.
    fn write(&self, remembered: &Remembered, why: &str) -> io::Result<(PathBuf, u64)> {
        let unfinished = self.directory.join(format!("{}.unfinished", self.instance));
        let path = self.directory.join(self.name(OffsetDateTime::now_utc(), why));
        let written = Self::fill(&unfinished, remembered).and_then(|cycles| {
            fs::rename(&unfinished, &path)?;
            Ok((path, cycles))
        });
        if written.is_err() {
            let _gone = fs::remove_file(&unfinished);
        }
        self.remove_oldest();
        written
    }

    fn fill(path: &Path, remembered: &Remembered) -> io::Result<u64> {
        let mut out = BufWriter::with_capacity(WRITE_BYTES, File::create(path)?);
        let cycles = remembered.write(&mut out)?;
        out.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        Ok(cycles)
    }

    fn name(&self, time: OffsetDateTime, why: &str) -> String {
        let (date, clock) = (time.date(), time.time());
        let (year, month, day) = (date.year(), u8::from(date.month()), date.day());
        let (hour, minute, second) = (clock.hour(), clock.minute(), clock.second());
        format!("{}-{year:04}{month:02}{day:02}T{hour:02}{minute:02}{second:02}Z-{why}.mcap", self.instance)
    }

    /// Returns `true` for a file of this instance. The name of another instance may begin with the
    /// name of this one.
    fn is_ours(&self, name: &str) -> bool {
        let rest = name.strip_prefix(&self.instance).and_then(|rest| rest.strip_prefix('-'));
        let form = rest.and_then(|rest| rest.split_once("Z-")).map(|(time, _)| time.as_bytes());
        let is_time = |time: &[u8]| {
            time.len() == 15
                && time
                    .iter()
                    .enumerate()
                    .all(|(index, byte)| if index == 8 { *byte == b'T' } else { byte.is_ascii_digit() })
        };
        name.ends_with(".mcap") && form.is_some_and(is_time)
    }

    /// Removes the oldest files of the instance until at most `files_max` are left. The names sort
    /// by time.
    fn remove_oldest(&self) {
        let Ok(entries) = fs::read_dir(&self.directory) else { return };
        let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        let mut ours: Vec<String> = names.filter(|name| self.is_ours(name)).collect();
        ours.sort_unstable();
        for name in &ours[..ours.len().saturating_sub(self.files_max)] {
            let _next_time = fs::remove_file(self.directory.join(name));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oldest_files_of_this_instance_are_removed() {
        let directory = std::env::temp_dir().join(format!("motord-flight-{}", std::process::id()));
        fs::create_dir(&directory).unwrap();
        let place = Place { directory: directory.clone(), instance: "arm".to_owned(), files_max: 2 };
        let others = ["arm-2-20250101T000000Z-x.mcap", "arm-notes.mcap", "leg-20240101T000000Z-x.mcap"];
        let ours = ["20260101", "20260102", "20260103"].map(|day| format!("arm-{day}T000000Z-x.mcap"));
        let named = place.name(OffsetDateTime::UNIX_EPOCH, "daemon-gone");
        assert_eq!(named, "arm-19700101T000000Z-daemon-gone.mcap");
        for name in others.iter().copied().chain(ours.iter().map(String::as_str)).chain([named.as_str()]) {
            fs::write(directory.join(name), "").unwrap();
        }
        place.remove_oldest();
        let is_there = |name: &str| directory.join(name).exists();
        assert!(others.iter().all(|name| is_there(name)));
        assert_eq!(ours.each_ref().map(|name| is_there(name)), [false, true, true]);
        assert!(!is_there(&named));
        fs::remove_dir_all(&directory).unwrap();
    }
}
