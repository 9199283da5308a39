//! `motord-checker`: judges a log of candump by the marks beside it.

use clap::{Parser, Subcommand};
use motord_bus::Duration;
use motord_checker::log::deaths::Deaths;
use motord_checker::log::disturbances::{self, Disturbances};
use motord_checker::log::replies::{self, Replies};
use motord_checker::log::service::Service;
use motord_checker::log::times::Limits;
use motord_checker::log::trot::{self, Trot};
use motord_checker::log::{Verdict, judge, marks};
use motord_checker::robot::Wiring;
use std::path::PathBuf;
use std::process::ExitCode;

/// Judges what the motors of a log have heard. The exit status is 0 when nothing is wrong, 1 when something is, 2 when the
/// files cannot be read.
#[derive(Debug, Parser)]
#[command(name = "motord-checker")]
struct Arguments {
    /// A configuration of the daemon: which motors are on which CAN interface.
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
    /// Processes and threads die: damping, then a stop, and nothing that moves until the next start.
    Deaths {
        /// Most milliseconds that the median of a death may be, as DEATH=MILLISECONDS.
        #[arg(long, value_parser = limit, required = true, num_args = 1..)]
        median: Vec<(String, f64)>,
        /// The maximum may be so many times that.
        #[arg(long)]
        maximum_per_median: f64,
    },
    /// The robot stops: nothing that moves until the reset.
    Disturbances {
        /// Milliseconds until a stop is noticed.
        #[arg(long)]
        notice_ms: u64,
        /// Stops that the log must have.
        #[arg(long)]
        stops: usize,
        /// Interfaces of motors whose owner may reset a stop himself, without a mark.
        #[arg(long, num_args = 1..)]
        others: Vec<String>,
    },
    /// Something beside the buses suffers: every motor replies, as soon as while it is well.
    Replies {
        /// Parts in which something suffers, and as many in which all is well.
        #[arg(long)]
        parts: usize,
        /// Times may be so many times as long as while all is well.
        #[arg(long)]
        ratio: f64,
        /// Ticks per second.
        #[arg(long)]
        rate: f64,
        /// Length of all parts together, s.
        #[arg(long)]
        seconds: f64,
        /// Share of the ticks that have a cycle.
        #[arg(long)]
        share: f64,
    },
    /// Units of systemd come and go: what each motor hears after each mark.
    Service,
    /// A trot: each motor once in a cycle, and nearly all cycles.
    Trot {
        /// Ticks per second.
        #[arg(long)]
        rate: f64,
        /// Length, s.
        #[arg(long)]
        seconds: f64,
        /// Share of the ticks that have a cycle.
        #[arg(long)]
        share: f64,
    },
}

fn limit(text: &str) -> Result<(String, f64), String> {
    let (death, limit) = text.split_once('=').ok_or("expected DEATH=MILLISECONDS")?;
    Ok((death.into(), limit.parse().map_err(|error| format!("{error}"))?))
}

fn check(arguments: Arguments) -> Result<Verdict, String> {
    let read = |path: &PathBuf| {
        std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))
    };
    let wiring = Wiring::read(&arguments.robot)?;
    let log = read(&arguments.log)?;
    let marks = || marks(&read(&arguments.marks)?);
    Ok(match arguments.rules {
        Rules::Deaths { median, maximum_per_median } => {
            let limits = Limits { medians: median.into_iter().collect(), maximum_per_median };
            judge(&mut Deaths::new(&wiring, &limits), &wiring, &marks()?, &log)
        }
        Rules::Disturbances { notice_ms, stops, others } => {
            let demand = disturbances::Demand { notice: Duration::from_millis(notice_ms), stops, others };
            judge(&mut Disturbances::new(&wiring, demand), &wiring, &marks()?, &log)
        }
        Rules::Replies { parts, ratio, rate, seconds, share } => {
            let demand = replies::Demand { parts, ratio, rate, seconds, share };
            judge(&mut Replies::new(&wiring, demand), &wiring, &marks()?, &log)
        }
        Rules::Service => judge(&mut Service::new(&wiring), &wiring, &marks()?, &log),
        Rules::Trot { rate, seconds, share } => {
            let demand = trot::Demand { rate, seconds, share };
            judge(&mut Trot::new(&wiring, demand), &wiring, &[], &log)
        }
    })
}

fn main() -> ExitCode {
    let verdict = match check(Arguments::parse()) {
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
