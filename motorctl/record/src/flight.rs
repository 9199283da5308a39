//! `motorctl flight`: the last seconds of a robot, as a file after each of its stops.

use crate::failure::RecorderFailure;
use crate::record::{PAUSE, TIMEOUT, clock};
use crate::store::FileStore;
use motord_client::{Client, CycleRecord, Error, Records};
use motord_mcap::{Clock, Memory, Remembered, Stops};
use motord_terminal::{Absence, FileError, Interrupt, printable, within};
use std::fs;
use std::io;
use std::path::PathBuf;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Interval of the checks for an unavailable daemon.
const ABSENCE: Duration = Duration::from_millis(500);

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

impl FlightArguments {
    fn store(&self, instance: &str) -> FileStore {
        FileStore {
            directory: self.directory.clone(),
            instance: instance.to_owned(),
            files_max: usize::try_from(self.files).unwrap_or(usize::MAX),
        }
    }
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
    fs::read_dir(directory).map_err(FileError::unwritable(directory))?;
    let mut files = Files { store: arguments.store(instance), writer: None };
    let mut absence = Absence::default();
    while !interrupt.is_raised() {
        match Flight::begin(instance, arguments) {
            Ok(flight) => {
                absence.end();
                let shown = directory.display().to_string();
                eprintln!("motorctl: {instance}: a stop is written to {}", printable(&shown));
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
    clock: Clock,
    stops: Stops,
    /// A stop, and the tick after which it is written.
    stop: Option<(String, u64)>,
    after_ns: u64,
}

impl Flight {
    /// Waits for the first cycle: from then on no stop is missed.
    fn begin(instance: &str, arguments: &FlightArguments) -> Result<Self, Error> {
        let client = Client::connect(instance)?;
        client.set_silence(TIMEOUT);
        let mut records = client.records()?;
        let begun = client.wait(TIMEOUT)?;
        let after = Duration::from_secs_f64(arguments.after);
        let time = Duration::from_secs(arguments.seconds.saturating_add(after.as_secs()).saturating_add(1));
        let bytes = usize::try_from(arguments.max_size.saturating_mul(1_000_000)).unwrap_or(usize::MAX);
        let memory = Memory::new(&client.description(), time, bytes);
        let clock = clock(&begun);
        let after_ns = u64::try_from(after.as_nanos()).unwrap_or(u64::MAX);
        let (mut stops, mut record) = (Stops::default(), Box::<CycleRecord>::default());
        while !records.take(&mut record)? {
            std::thread::sleep(PAUSE);
        }
        let _latched_before = stops.of(&record);
        Ok(Self { records, memory, clock, stops, stop: None, after_ns })
    }

    /// Records every cycle until the daemon ends or a signal arrives.
    fn follow(mut self, files: &mut Files, interrupt: &Interrupt) {
        let mut record = Box::<CycleRecord>::default();
        while !interrupt.is_raised() {
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
            files.write(self.memory.remembered(self.clock.origin()), why);
        }
    }

    fn take(&mut self, record: &CycleRecord, files: &mut Files) {
        let tick_ns = record.state.tick_ns;
        if let Some(step) = self.clock.step() {
            self.memory.take_step(step);
        }
        // Cycles that cannot be encoded are missing in the file: the numbers of the other cycles
        // show the gap.
        let _encoded = self.memory.take(record);
        if let Some(cause) = self.stops.of(record) {
            self.stop.get_or_insert((cause.to_string(), tick_ns.saturating_add(self.after_ns)));
        }
        if let Some((why, _)) = self.stop.take_if(|(_, due_ns)| tick_ns >= *due_ns) {
            files.write(self.memory.remembered(self.clock.origin()), why);
        }
    }
}

/// The writing thread: the recording thread never waits for the disk.
struct Files {
    store: FileStore,
    writer: Option<JoinHandle<()>>,
}

impl Files {
    fn write(&mut self, remembered: io::Result<Remembered>, why: String) {
        if self.writer.as_ref().is_some_and(|thread| !thread.is_finished()) {
            eprintln!("motorctl: {why} is not written: the disk is still writing the previous file");
            return;
        }
        let store = self.store.clone();
        let thread = std::thread::Builder::new().name("motorctl-write".to_owned()).spawn(move || {
            match remembered.and_then(|remembered| store.write(&remembered, &why)) {
                Ok((path, cycles)) => {
                    eprintln!("motorctl: {}: {cycles} cycles", printable(&path.display().to_string()));
                }
                Err(error) => {
                    eprintln!("motorctl: {why} is not written: {}", printable(&error.to_string()));
                }
            }
        });
        match thread {
            Ok(thread) => self.writer = Some(thread),
            Err(error) => eprintln!("motorctl: a stop is not written: {}", printable(&error.to_string())),
        }
    }

    /// Waits for the disk; a second signal ends the wait.
    fn wait(&self, interrupt: &Interrupt) {
        let _the_first = interrupt.is_raised_again();
        while self.writer.as_ref().is_some_and(|thread| !thread.is_finished()) && !interrupt.is_raised_again()
        {
            std::thread::sleep(PAUSE);
        }
    }
}
