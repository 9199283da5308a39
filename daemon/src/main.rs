//! `motord`: the daemon's command line.

use clap::{CommandFactory, Parser, Subcommand};
use motord::deadman::will::open_interface;
use motord::deadman::{self, DeadmanError};
use motord::run::RunError;
use motord::safe_stop::{SafeStopError, safe_stop};
use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// Owns every motor of a legged robot: cycles them at a fixed rate, and serves controllers through shared memory.
#[derive(Debug, Parser)]
#[command(
    name = "motord",
    version,
    after_help = "Examples:\n  motord check --config robot.toml    judge a configuration and show how full its buses are\n  motord run --config robot.toml      run; SIGTERM or Ctrl-C damps and stops the motors first\n  motord deadman --config robot.toml  damp and stop the motors when that daemon dies or stands still\n\nExit status: 0 ended on request, 64 usage, 69 a bus or service is unavailable, 75 already running,\n77 no permission, 78 the configuration is refused."
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the daemon.
    Run {
        /// The configuration.
        #[arg(long, value_name = "FILE", default_value = DEFAULT_CONFIG)]
        config: PathBuf,
    },
    /// Be the dead man's switch of the instance: damp and stop its motors when the daemon dies or stands still.
    Deadman {
        /// The configuration.
        #[arg(long, value_name = "FILE", default_value = DEFAULT_CONFIG)]
        config: PathBuf,
    },
    /// Damp and stop every motor on a CAN interface once, when no daemon runs. Waits for a dead man's switch that is at it.
    SafeStop {
        /// The configuration.
        #[arg(long, value_name = "FILE", default_value = DEFAULT_CONFIG)]
        config: PathBuf,
    },
    /// Judge a configuration and show the plan of its buses, without opening any.
    Check {
        /// The configuration.
        #[arg(long, value_name = "FILE", default_value = DEFAULT_CONFIG)]
        config: PathBuf,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Write the manual pages, for a package.
    #[command(hide = true)]
    Manual {
        /// Where to.
        directory: PathBuf,
    },
}

const DEFAULT_CONFIG: &str = "/etc/motord/motord.toml";
const EXIT_USAGE: u8 = 64;
const EXIT_IO: u8 = 74;

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let _unwritable = error.print();
            return ExitCode::from(if error.use_stderr() { EXIT_USAGE } else { 0 });
        }
    };
    match arguments.command {
        Command::Check { config, json } => {
            let status = motord::check::check(&config, json, &mut std::io::stdout().lock());
            ExitCode::from(status.unwrap_or(EXIT_IO))
        }
        Command::Manual { directory } => {
            let written = clap_mangen::generate_to(Arguments::command(), directory);
            ended(written, |_| EXIT_IO)
        }
        Command::Run { config } => {
            log_to_stderr();
            ended(motord::run::run(&config), RunError::exit_status)
        }
        Command::Deadman { config } => {
            log_to_stderr();
            ended(deadman::run(&config), DeadmanError::exit_status)
        }
        Command::SafeStop { config } => {
            log_to_stderr();
            ended(safe_stop(&config, &mut open_interface), SafeStopError::exit_status)
        }
    }
}

fn ended<E: Display>(outcome: Result<(), E>, exit_status: fn(&E) -> u8) -> ExitCode {
    let Err(error) = outcome else { return ExitCode::SUCCESS };
    let _unwritable = writeln!(std::io::stderr(), "motord: {error}");
    ExitCode::from(exit_status(&error))
}

fn log_to_stderr() {
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        // A log that nobody reads any more must not end a thread.
        .log_internal_errors(false)
        .init();
}
