//! `motord`: the daemon's command line.

use clap::{CommandFactory, Parser, Subcommand};
use motord::commands::check::{Wanted, check};
use motord::commands::init::{InitError, Options};
use motord::commands::run;
use motord::host::log::Log;
use motord::run_error::RunError;
use motord_deadman::DeadmanError;
use motord_deadman::answers::listen_on;
use motord_deadman::interfaces::open_interface;
use motord_deadman::safe_stop::{SafeStopError, safe_stop};
use motord_realtime::set_heap_reserve;
use motord_terminal::{Pages, exit_status, parse_arguments, printable};
use std::fmt::Display;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use tracing_subscriber::filter::LevelFilter;

/// Owns every motor of a legged robot: cycles them at a fixed rate, and serves controllers through shared memory.
#[derive(Debug, Parser)]
#[command(
    name = "motord",
    version = VERSION,
    after_help = "Examples:\n  motord check robot.toml             judge a configuration and show how full its buses are\n  motord init --file robot.toml       write a first configuration\n  motord run robot.toml               run; SIGTERM or Ctrl-C damps and stops the motors first\n  motord deadman robot.toml           damp and stop the motors when that daemon dies or stalls\n  motord completions bash >motord.sh  write the completions for a shell\n  motord manual man                   write the manual pages\n\nExit status: 0 ended on request with every motor stopped, 64 usage, 69 a bus, a service or a motor is unavailable,\n73 a file cannot be written, 75 already running,\n77 no permission, 78 the configuration is refused, 80 safe-stop was sent, but motors do not answer."
)]
struct Arguments {
    /// The least important lines of the log: error, warn, info or debug. Every change of every motor is debug.
    #[arg(long, global = true, value_name = "LEVEL", env = "MOTORD_LOG", default_value = "info")]
    log: LevelFilter,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the daemon.
    Run {
        #[command(flatten)]
        config: ConfigFile,
        /// Wait at most this time for interfaces and ports that are missing or down, s. The service waits for 10 minutes: an
        /// adapter may be plugged in after the computer has started.
        #[arg(long, value_name = "SECONDS", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=86_400))]
        wait_for_buses: u32,
        /// Open no bus: simulate all motors and IMUs of the configuration, whose joints the plant on this Unix socket moves.
        /// `python -m motord.sim live` starts a plant and the daemon. docs/twin.md describes the socket.
        #[arg(long, value_name = "SOCKET", conflicts_with = "wait_for_buses")]
        plant: Option<PathBuf>,
    },
    /// Run the dead man's switch of the instance: damp and stop its motors when the daemon dies or stalls.
    Deadman {
        #[command(flatten)]
        config: ConfigFile,
    },
    /// Damp and stop every motor on a CAN interface or serial port once, when no daemon runs. Waits for a dead man's switch that is
    /// at it.
    ///
    /// Every motor must answer, also on a serial line: if some do not, the command names them, and the exit status is 80. Cut the
    /// power then. Answers to the dead man's switch are not read.
    SafeStop {
        #[command(flatten)]
        config: ConfigFile,
    },
    /// Judge a configuration and show the plan of its buses, without opening any.
    #[command(
        after_help = "Examples:\n  motord check robot.toml\n  motord check robot.toml --joints\n  motord check --config robot.toml --joints --json\n\nExit status: 0 may run, 78 the configuration is refused."
    )]
    Check {
        #[command(flatten)]
        config: ConfigFile,
        /// Show the effective limits of the joints, and where each comes from: a line of the file, the model, a default. Joints with
        /// equal limits share a table.
        #[arg(long)]
        joints: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Write a first configuration: for N equal legs, or for an arm. On a terminal, asks for everything that the options do not say,
    /// also for the file.
    ///
    /// The limits in it are cautious. The rate is the highest for which the buses have time.
    #[command(
        after_help = "Examples:\n  motord init --file motord.toml\n  motord init --legs 4 --model GIM8108-8 --buses can0,can1,can2,can3 --file motord.toml\n  motord init --legs 2 --simulated --yes\n  motord init --legs 1 --joints shoulder,elbow,wrist --protocol gim --buses can0 --yes"
    )]
    Init(Options),
    #[command(flatten)]
    Pages(Pages),
}

/// The configuration of a command, with or without its option.
#[derive(Debug, clap::Args)]
struct ConfigFile {
    /// The configuration [default: /etc/motord/motord.toml].
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// The same, as an option.
    #[arg(long, value_name = "FILE", conflicts_with = "file")]
    config: Option<PathBuf>,
}

impl ConfigFile {
    fn path(self) -> PathBuf {
        self.file.or(self.config).unwrap_or_else(|| DEFAULT_CONFIG.into())
    }
}

/// A build that panics on request says so, lest it is packaged.
const VERSION: &str = if cfg!(feature = "panic-on-request") {
    concat!(env!("CARGO_PKG_VERSION"), " (panics on request: for tests only)")
} else {
    env!("CARGO_PKG_VERSION")
};
/// The default of glibc, 128 KiB, takes 1 MB of locked memory for all threads.
const HEAP_RESERVE_BYTES: u16 = 8 * 1024;
const DEFAULT_CONFIG: &str = "/etc/motord/motord.toml";

fn main() -> ExitCode {
    let arguments: Arguments = match parse_arguments() {
        Ok(arguments) => arguments,
        Err(status) => return status,
    };
    let log = arguments.log;
    match arguments.command {
        Command::Check { config, joints, json } => {
            let status = check(&config.path(), Wanted { json, joints }, &mut std::io::stdout().lock());
            ExitCode::from(status.unwrap_or(exit_status::IO))
        }
        Command::Init(init) => ended(init.run(), InitError::exit_status, &mut std::io::stderr()),
        Command::Pages(pages) => {
            ended(pages.write(Arguments::command()), |_| exit_status::IO, &mut std::io::stderr())
        }
        Command::Run { config, wait_for_buses, plant } => {
            let options = run::Options { bus_timeout: Duration::from_secs(wait_for_buses.into()), plant };
            logged(log, || run::run(&config.path(), &options), RunError::exit_status)
        }
        Command::Deadman { config } => {
            logged(log, || motord_deadman::run(&config.path()), DeadmanError::exit_status)
        }
        Command::SafeStop { config } => logged(
            log,
            || safe_stop(&config.path(), &mut open_interface, &mut listen_on),
            SafeStopError::exit_status,
        ),
    }
}

fn ended<E: Display>(outcome: Result<(), E>, exit_status: fn(&E) -> u8, out: &mut impl Write) -> ExitCode {
    let Err(error) = outcome else { return ExitCode::SUCCESS };
    let _unwritable = out.write_all(format!("motord: {}\n", printable(&error.to_string())).as_bytes());
    ExitCode::from(exit_status(&error))
}

/// Runs a command that logs. A reader of the log cannot delay it.
fn logged<E: Display>(
    most: LevelFilter,
    command: impl FnOnce() -> Result<(), E>,
    exit_status: fn(&E) -> u8,
) -> ExitCode {
    set_heap_reserve(HEAP_RESERVE_BYTES);
    let log = match Log::to_stderr() {
        Ok(log) => log,
        Err(error) => return ended(Err(error), |_| exit_status::OS, &mut std::io::stderr()),
    };
    log.capture_panics();
    log.capture_tracing(most);
    let status = match command() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            log.error(&format!("motord: {}", printable(&error.to_string())));
            ExitCode::from(exit_status(&error))
        }
    };
    log.finish();
    status
}
