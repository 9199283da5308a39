//! `motorctl doctor`: checks whether this computer is fit for a real-time cycle.
//!
//! The checks read the files of the kernel below a [`Tree`] and change nothing. `--tune` first
//! makes the changes that last until the next boot. Then a thread with the scheduling, processor
//! and locked memory of the cycle sleeps from tick to tick for some seconds. Its latency is checked
//! as a share of the period. While a daemon runs its cycle, the measurement is skipped: it would
//! delay a moving robot.

#![forbid(unsafe_code)]

mod change;
mod checks;
mod finding;
mod process;
mod report;
mod robot;
mod tree;
mod tune;
mod wake;

pub use change::Change;
pub use checks::all;
pub use finding::{Finding, Level};
pub use process::RunningDaemon;
pub use robot::{ImuLine, Interface, Robot};
pub use tree::Tree;
pub use wake::{Measurement, Wake};

use motord_terminal::{Interrupt, Palette, exit_status, json, within};
use report::Diagnosis;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The longest measurement, s: a day.
const SECONDS_MAX: f64 = 86_400.0;
/// Time between two lines of progress.
const PROGRESS: Duration = Duration::from_secs(1);

/// The arguments of the command.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// Configuration of the robot: its buses, and the rate, processor and priority of its cycle.
    ///
    /// The default is /etc/motord/motord.toml, and /etc/motord/NAME.toml with --instance NAME. Without that file: 1000 Hz,
    /// priority 80, any processor, and every CAN interface of the computer.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Duration of the measurement, s: 0 to 86400; 0 skips it.
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = parse_seconds)]
    seconds: f64,
    /// First make the changes that last until the next boot and need no decision by a person.
    ///
    /// They are the clock governor, the interrupts of the CAN interfaces, ksoftirqd, coalescing,
    /// the queue, the restart after a bus-off, and the latency timer of serial ports. Needs root.
    /// Refused while motord runs its cycle, because some changes set an interface down.
    #[arg(long)]
    tune: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// The errors of the command.
#[derive(Debug, thiserror::Error)]
pub enum DoctorFailure {
    /// The verdict is bad. It was printed.
    #[error("this computer is not fit for a real-time cycle")]
    Unfit,
    /// A daemon runs its cycle, so nothing was changed.
    #[error(
        "motord runs (process {0}), and some changes set an interface down: stop it first, or leave --tune out"
    )]
    InUse(u32),
    /// Ctrl-C.
    #[error("interrupted")]
    Interrupted,
    /// Standard output cannot be written.
    #[error("cannot write the output: {0}")]
    Output(#[source] io::Error),
    /// The measurement failed.
    #[error("cannot measure the wake-up latency: {0}")]
    Measurement(#[source] io::Error),
}

impl DoctorFailure {
    /// Returns the exit status.
    #[must_use]
    pub const fn status(&self) -> u8 {
        match self {
            Self::Unfit => 1,
            Self::Interrupted => exit_status::INTERRUPTED,
            Self::Output(_) => exit_status::IO,
            Self::InUse(_) | Self::Measurement(_) => exit_status::UNAVAILABLE,
        }
    }
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    within(text, 0.0, SECONDS_MAX)
}

/// The daemons that run, for the choice of one.
#[derive(Debug, Clone, Copy)]
pub struct Daemons<'a> {
    /// The instance that the command line names; `None` for the default.
    pub instance: Option<&'a str>,
    /// Name and process id of each that runs.
    pub running: &'a [(String, u32)],
}

/// Checks the computer, measures, and prints both, with the findings about a running daemon.
///
/// # Errors
///
/// [`DoctorFailure::Unfit`] after a bad verdict; the others without a verdict.
pub fn run(
    arguments: &Arguments,
    daemons: Daemons<'_>,
    of_daemon: Vec<Finding>,
) -> Result<(), DoctorFailure> {
    let tree = Tree::below(Path::new("/"));
    let (mut robot, configuration) = Robot::configured(arguments.config.as_deref(), daemons.instance, &tree);
    robot.daemon = daemons.running.iter().find(|(name, _)| *name == robot.instance).map(|(_, pid)| *pid);
    let daemon = process::daemon(&tree, robot.daemon);
    let tuned = match (arguments.tune, daemon) {
        (true, Some(daemon)) => return Err(DoctorFailure::InUse(daemon.pid)),
        (true, None) => tune::tune(&all(&tree, &robot), Change::apply),
        (false, _) => Vec::new(),
    };
    let mut findings = vec![configuration];
    findings.extend(all(&tree, &robot));
    findings.extend(of_daemon);
    let wake = match daemon {
        None if arguments.seconds > 0.0 => Some(measured(&robot, arguments)?),
        _ => None,
    };
    let report =
        Diagnosis::new(&robot, tuned, findings, wake.as_ref(), daemon.filter(|_| arguments.seconds > 0.0));
    let out = &mut io::stdout().lock();
    let written = match arguments.json {
        true => json::write_line(out, &report),
        false => report.write(out, Palette::of_stdout()),
    };
    written.map_err(DoctorFailure::Output)?;
    if report.verdict == Level::Bad { Err(DoctorFailure::Unfit) } else { Ok(()) }
}

/// Measures for the requested time, and shows the progress on a terminal.
fn measured(robot: &Robot, arguments: &Arguments) -> Result<Wake, DoctorFailure> {
    let interrupt = Interrupt::register();
    let measurement = Measurement::start(robot).map_err(DoctorFailure::Measurement)?;
    let begin = Instant::now();
    let end = begin + Duration::from_secs_f64(arguments.seconds);
    let shows = io::stderr().is_terminal();
    while Instant::now() < end && !interrupt.is_raised() {
        interrupt.pause_until(end.min(Instant::now() + PROGRESS));
        if shows {
            let (passed, whole) = (begin.elapsed().as_secs_f64(), arguments.seconds);
            let text =
                format!("wake-up latency: {passed:.0} of {whole} s, longest {:.0} µs", measurement.max_us());
            let _no_progress = write!(io::stderr(), "\r{text}\x1b[K");
        }
    }
    if shows {
        let _no_progress = write!(io::stderr(), "\r\x1b[K");
    }
    let wake = measurement.end().map_err(DoctorFailure::Measurement)?;
    if interrupt.is_raised() { Err(DoctorFailure::Interrupted) } else { Ok(wake) }
}
