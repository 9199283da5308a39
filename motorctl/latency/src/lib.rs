//! `motorctl latency`: the latencies of a daemon as tables, HdrHistogram files and pictures.
//!
//! The daemon keeps totals. An interval is the difference of two totals, so several commands with
//! different intervals do not disturb each other.

#![forbid(unsafe_code)]

mod failure;
mod hgrm;
mod hlog;
mod picture;
mod run;
mod snapshot;
mod table;

pub use failure::LatencyFailure;
pub use table::percentiles as percentile_table;

use hlog::Hlog;
use motord_client::{Client, named_telemetry};
use motord_terminal::{Absence, FileError, Interrupt, Palette, json, within};
use run::Run;
use snapshot::{Interval, Snapshot};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Longest time without a state.
const TIMEOUT: Duration = Duration::from_secs(1);

/// The arguments of the command.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// Files of earlier runs, in place of the daemon: interval logs (.hlog) and percentiles
    /// (.hgrm).
    #[arg(value_name = "RUN", conflicts_with_all = ["json", "watch", "reset", "hlog"])]
    runs: Vec<PathBuf>,
    /// Print one JSON object; with --watch, one per interval.
    #[arg(long)]
    json: bool,
    /// Print the latencies of each interval, until Ctrl-C.
    #[arg(long)]
    watch: bool,
    /// Write each interval to an interval log of HdrHistogram, until Ctrl-C.
    ///
    /// Each quantity with samples has a line, in ns, with its name as tag, such as `wake_latency`
    /// or `reply_latency/fl-hip`. The log is complete after every interval.
    #[arg(long, value_name = "FILE")]
    hlog: Option<PathBuf>,
    /// Length of the intervals of --watch and --hlog, s: 0.1 to 3600.
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = parse_interval)]
    interval: f64,
    /// End --watch and --hlog after this time, s: at most 86400.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// First reset the counters and histograms of the daemon, for all clients.
    ///
    /// Every user with access to the daemon may reset them; its log names the process. The metrics
    /// for Prometheus are also reset, apart from those in the states.
    #[arg(long, conflicts_with_all = ["hgrm", "svg"])]
    reset: bool,
    /// Write the percentiles of one quantity, µs, in the format of HdrHistogram.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["watch", "hlog"])]
    hgrm: Option<PathBuf>,
    /// Draw the percentiles of one quantity, with a curve per run.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["watch", "hlog"])]
    svg: Option<PathBuf>,
    /// The quantity of --hgrm and --svg.
    #[arg(long = "of", value_name = "QUANTITY", default_value = "wake_latency")]
    quantity: String,
}

fn parse_interval(text: &str) -> Result<f64, String> {
    within(text, 0.1, 3600.0)
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    within(text, 0.1, 86_400.0)
}

/// Does what the arguments say, with the daemon of `instance` or the files of earlier runs.
///
/// # Errors
///
/// When no daemon answers, a file has mistakes or cannot be written, or it lacks the quantity.
pub fn run(instance: &str, arguments: &Arguments) -> Result<(), LatencyFailure> {
    if !arguments.runs.is_empty() {
        let runs: Vec<Run> = arguments.runs.iter().map(|path| Run::read(path)).collect::<Result<_, _>>()?;
        return if write_files(arguments, &runs)? { Ok(()) } else { print_runs(&runs) };
    }
    let client = Client::connect(instance)?;
    client.set_silence(TIMEOUT);
    if arguments.reset {
        client.reset_telemetry()?;
    }
    if arguments.watch || arguments.hlog.is_some() {
        return follow(&client, arguments);
    }
    if arguments.hgrm.is_some() || arguments.svg.is_some() {
        let total = Snapshot::take(&client)?;
        write_files(arguments, &[Run::of(instance, total.histograms)])?;
        return Ok(());
    }
    if arguments.reset && !arguments.json {
        return Ok(writeln!(io::stdout(), "the latencies were reset")?);
    }
    let (robot, telemetry) = (client.description(), client.telemetry()?);
    let out = &mut io::stdout().lock();
    match arguments.json {
        true => json::write_line(out, &named_telemetry(&robot, &telemetry))?,
        false => table::write(out, &robot, &telemetry)?,
    }
    Ok(())
}

/// Writes the requested files. Returns true if there is one.
fn write_files(arguments: &Arguments, runs: &[Run]) -> Result<bool, LatencyFailure> {
    let quantity = &arguments.quantity;
    if let Some(path) = &arguments.hgrm {
        let [run] = runs else { return Err(LatencyFailure::OneRun) };
        let histogram = run.histogram(quantity)?;
        write_file(path, |out| hgrm::write(out, histogram))?;
    }
    if let Some(path) = &arguments.svg {
        let curves = runs.iter().map(|run| run.curve(quantity)).collect::<Result<Vec<_>, _>>()?;
        let picture = picture::draw(quantity, &curves)?;
        write_file(path, |out| out.write_all(picture.as_bytes()))?;
    }
    Ok(arguments.hgrm.is_some() || arguments.svg.is_some())
}

/// Writes the file at `path`, or standard output for `-`.
fn write_file(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), LatencyFailure> {
    if path.as_os_str() == "-" {
        return Ok(write(&mut io::stdout().lock())?);
    }
    let written = File::create(path).and_then(|file| {
        let mut out = BufWriter::new(file);
        write(&mut out)?;
        out.flush()
    });
    Ok(written.map_err(FileError::unwritable(path))?)
}

fn print_runs(runs: &[Run]) -> Result<(), LatencyFailure> {
    let out = &mut io::stdout().lock();
    for run in runs {
        writeln!(out, "{}", motord_terminal::printable(&run.name))?;
        run.table().write(out, Palette::of_stdout())?;
    }
    Ok(())
}

/// Prints and logs each interval, also across restarts of the daemon.
fn follow(client: &Client, arguments: &Arguments) -> Result<(), LatencyFailure> {
    let interrupt = Interrupt::register();
    let mut log =
        arguments.hlog.as_deref().map(|path| Hlog::create(path, &client.description())).transpose()?;
    let (begun, length) = (Instant::now(), Duration::from_secs_f64(arguments.interval));
    let ends = arguments.seconds.map(|seconds| begun + Duration::from_secs_f64(seconds));
    let (mut before, mut next, mut absence) = (Snapshot::take(client)?, begun, Absence::default());
    while !interrupt.is_raised() && ends.is_none_or(|ends| Instant::now() < ends) {
        next = (next + length).max(Instant::now());
        interrupt.pause_until(ends.map_or(next, |ends| ends.min(next)));
        let now = match Snapshot::take(client) {
            Ok(now) => now,
            Err(LatencyFailure::Client(error)) => {
                absence.report(&error);
                continue;
            }
            Err(failure) => return Err(failure),
        };
        absence.end();
        let interval = now.since(&before);
        if let Some(log) = &mut log {
            log.append(&interval)?;
        }
        if arguments.watch {
            print_interval(client, &interval, arguments.json)?;
        }
        before = now;
    }
    Ok(())
}

fn print_interval(client: &Client, interval: &Interval, as_json: bool) -> Result<(), LatencyFailure> {
    let robot = client.description();
    let telemetry = interval.telemetry(&robot);
    let out = &mut io::stdout().lock();
    if as_json {
        json::write_line(out, &named_telemetry(&robot, &telemetry))?;
    } else {
        table::write(out, &robot, &telemetry)?;
        writeln!(out)?;
    }
    Ok(out.flush()?)
}
