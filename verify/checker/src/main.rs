//! `motord-checker`: checks a log of candump by its marks.

use clap::{Args, Parser, Subcommand};
use motord_bus::Duration;
use motord_checker::log::deaths::Deaths;
use motord_checker::log::disturbances::{self, Disturbances};
use motord_checker::log::replies::{self, Replies};
use motord_checker::log::service::Service;
use motord_checker::log::times::Limits;
use motord_checker::log::trot::{self, Trot};
use motord_checker::log::{Verdict, check, marks};
use motord_checker::robot::Wiring;
use std::path::PathBuf;
use std::process::ExitCode;

/// Checks the commands that the motors of a log have received. The exit status is 0 without
/// violations, 1 with some, 2 when the files cannot be read.
#[derive(Debug, Parser)]
#[command(name = "motord-checker")]
struct Arguments {
    /// A configuration of the daemon, which lists the motors of each CAN interface.
    #[arg(long, default_value = "robot.toml")]
    robot: PathBuf,
    /// The marks: events that happened to the robot, each with its time.
    #[arg(long, default_value = "notes")]
    marks: PathBuf,
    /// The log that candump -L has recorded.
    #[arg(long, default_value = "can.log")]
    log: PathBuf,
    #[command(subcommand)]
    rules: Rules,
}

#[derive(Debug, Subcommand)]
enum Rules {
    /// Deaths of processes and threads: damping, then a stop, and no motion until the next start.
    Deaths {
        /// Highest median of a death's times, ms, as DEATH=MILLISECONDS.
        #[arg(long, value_parser = limit, required = true, num_args = 1..)]
        median: Vec<(String, f64)>,
        /// Ratio of the highest time to the limit of the median.
        #[arg(long)]
        maximum_per_median: f64,
    },
    /// Stops of the robot: no motion until the reset.
    Disturbances {
        /// Milliseconds until a stop is detected.
        #[arg(long)]
        notice_ms: u64,
        /// Number of stops in the log.
        #[arg(long)]
        stops: usize,
        /// Interfaces of motors whose owner may reset a stop without a mark.
        #[arg(long, num_args = 1..)]
        others: Vec<String>,
    },
    /// Disturbances outside the buses: every motor replies as fast as without them.
    Replies {
        /// Number of parts with a disturbance, and of parts without one.
        #[arg(long)]
        parts: usize,
        /// Greatest ratio of the times with a disturbance to those without.
        #[arg(long)]
        ratio: f64,
        #[command(flatten)]
        cycles: Cycles,
    },
    /// Starts and stops of systemd units: the commands that each motor receives after each mark.
    Service,
    /// A trot: one command to each motor per cycle, and nearly all cycles.
    Trot(Cycles),
}

/// The cycles that a log must have.
#[derive(Debug, Args)]
struct Cycles {
    /// Ticks per second.
    #[arg(long)]
    rate: f64,
    /// Length of what is checked, s.
    #[arg(long)]
    seconds: f64,
    /// Share of the ticks that have a cycle.
    #[arg(long)]
    share: f64,
}

fn limit(text: &str) -> Result<(String, f64), String> {
    let (death, limit) = text.split_once('=').ok_or("expected DEATH=MILLISECONDS")?;
    Ok((death.into(), limit.parse().map_err(|error| format!("{error}"))?))
}

fn run(arguments: Arguments) -> Result<Verdict, String> {
    let read = |path: &PathBuf| {
        std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))
    };
    let wiring = Wiring::read(&arguments.robot)?;
    let log = read(&arguments.log)?;
    let marks = || marks(&read(&arguments.marks)?);
    Ok(match arguments.rules {
        Rules::Deaths { median, maximum_per_median } => {
            let limits = Limits { medians: median.into_iter().collect(), maximum_per_median };
            check(&mut Deaths::new(&wiring, &limits), &wiring, &marks()?, &log)
        }
        Rules::Disturbances { notice_ms, stops, others } => {
            let demand = disturbances::Demand { notice: Duration::from_millis(notice_ms), stops, others };
            check(&mut Disturbances::new(&wiring, demand), &wiring, &marks()?, &log)
        }
        Rules::Replies { parts, ratio, cycles: Cycles { rate, seconds, share } } => {
            let demand = replies::Demand { parts, ratio, rate, seconds, share };
            check(&mut Replies::new(&wiring, demand), &wiring, &marks()?, &log)
        }
        Rules::Service => check(&mut Service::new(&wiring), &wiring, &marks()?, &log),
        Rules::Trot(Cycles { rate, seconds, share }) => {
            let demand = trot::Demand { rate, seconds, share };
            check(&mut Trot::new(&wiring, demand), &wiring, &[], &log)
        }
    })
}

fn main() -> ExitCode {
    let verdict = match run(Arguments::parse()) {
        Ok(verdict) => verdict,
        Err(error) => {
            eprintln!("motord-checker: {error}");
            return ExitCode::from(2);
        }
    };
    verdict.report.iter().for_each(|line| println!("{line}"));
    verdict.complaints.iter().for_each(|line| eprintln!("{line}"));
    println!("{} wrong", verdict.wrong);
    ExitCode::from(u8::from(verdict.wrong > 0))
}
