//! `motord-remote`: a robot of motord on another computer.
//!
//! ```text
//!  motord ◀ shared memory ▶ motord-remote serve ◀═ zenoh ═▶ motord-remote mirror ◀ shared memory ▶ controller
//! ```
//!
//! On the other computer the robot is an instance of motord: programs in all languages, `motorctl`
//! and `motord-bridge` use it as they use a local one.

mod admission;
mod clocks;
mod config;
mod fleet;
mod frame;
mod measure;
mod mirror;
mod network;
mod random;
mod receipt;
mod serve;
mod summary;

use clap::{Parser, Subcommand};
use config::{Config, ConfigError};
use network::NetworkError;
use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tracing_appender::non_blocking::NonBlockingBuilder;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::prelude::*;

/// Limit on lines of the log that wait for standard error.
const LINES_MAX: usize = 1024;

/// Examples in the help.
const EXAMPLES: &str = "\
Examples:
  motord-remote check                          check /etc/motord/remote.toml without starting anything
  motord-remote serve --config remote.toml     on the robot: serve its states, claims and stop
  motord-remote mirror --config remote.toml    on another computer: the robot as an instance of motord

Then, on the other computer, as with a robot of its own:
  motorctl status
  motorctl --instance go7 latency";

/// Examples in the help of `fleet`.
const FLEET_EXAMPLES: &str = "\
Examples:
  motord-remote fleet list                     the robots of /etc/motord/remote.toml and others in its network
  motord-remote fleet list --watch
  motord-remote fleet list --json | jq -r '.[] | select(.is != \"well\") | .robot'
  motord-remote fleet stop go7
  motord-remote fleet stop --all";

/// Serves a robot of motord to other computers, and mirrors it there.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Serves the robot of this computer, as [serve] of the configuration says, until SIGTERM.
    Serve(File),
    /// Makes a robot of another computer an instance on this one, as [mirror] says, until SIGTERM.
    Mirror(File),
    /// Lists the robots of a network, or stops them.
    #[command(subcommand, after_help = FLEET_EXAMPLES)]
    Fleet(Fleet),
    /// Checks the configuration, and prints what `serve` and `mirror` would do.
    Check(File),
}

#[derive(Subcommand)]
enum Fleet {
    /// Prints each robot with its state. Exit status 1: one that is expected is absent, or one needs a look.
    List {
        #[command(flatten)]
        file: File,
        /// Prints JSON.
        #[arg(long)]
        json: bool,
        /// Prints again and again, until Ctrl-C.
        #[arg(long)]
        watch: bool,
    },
    /// Damps and stops robots, and prints the receipt of each. Exit status 1: one is not confirmed.
    ///
    /// A convenience, not the safety of a robot: a network may be down.
    Stop {
        /// The robots.
        #[arg(required_unless_present = "all", conflicts_with = "all")]
        robots: Vec<String>,
        /// All that are in the network.
        #[arg(long)]
        all: bool,
        #[command(flatten)]
        file: File,
        /// Prints JSON.
        #[arg(long)]
        json: bool,
    },
}

#[derive(clap::Args)]
struct File {
    /// The configuration.
    #[arg(long, default_value = config::DEFAULT_FILE)]
    config: PathBuf,
}

/// The reason why the program ends with an error.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Network(#[from] NetworkError),
    #[error(transparent)]
    Mirror(#[from] mirror::MirrorError),
    #[error("{path} has no table [{table}], which `motord-remote {table}` needs", path = path.display())]
    Missing { table: &'static str, path: PathBuf },
    #[error("cannot handle signals: {0}")]
    Signals(std::io::Error),
}

impl Failure {
    /// Returns the exit status, after `sysexits.h`.
    fn exit_status(&self) -> u8 {
        match self {
            Self::Config(ConfigError::Read { .. }) => 66,
            Self::Config(_) | Self::Missing { .. } => 78,
            Self::Network(_) | Self::Mirror(_) => 69,
            Self::Signals(_) => 71,
        }
    }
}

fn main() -> ExitCode {
    let ours =
        Targets::new().with_target("motord_remote", LevelFilter::INFO).with_default(LevelFilter::ERROR);
    // Standard error may block, such as that of a stopped terminal: then lines are lost, and no stop
    // waits.
    let queue = NonBlockingBuilder::default().buffered_lines_limit(LINES_MAX).lossy(true);
    let (queue, written) = queue.thread_name("log").finish(std::io::stderr());
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(queue)
        .with_ansi(std::io::stderr().is_terminal())
        .without_time()
        .with_target(false);
    tracing_subscriber::registry().with(ours).with(lines).init();
    let outcome = match Arguments::parse().command {
        Command::Serve(file) => serve(file).map(|()| true),
        Command::Mirror(file) => mirror(file).map(|()| true),
        Command::Fleet(command) => fleet(command),
        Command::Check(file) => check(&file).map(|()| true),
    };
    // Writes the lines that wait.
    drop(written);
    match outcome {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(failure) => {
            eprintln!("motord-remote: {failure}");
            failure.exit_status().into()
        }
    }
}

fn serve(File { config: path }: File) -> Result<(), Failure> {
    let config = Config::read(&path)?;
    let serve = config.serve.as_ref().ok_or(Failure::Missing { table: "serve", path })?;
    Ok(serve::run(serve, &config.network, &ends()?)?)
}

fn mirror(File { config: path }: File) -> Result<(), Failure> {
    let config = Config::read(&path)?;
    let mirror = config.mirror.as_ref().ok_or(Failure::Missing { table: "mirror", path })?;
    Ok(mirror::run(mirror, &config.network, &ends()?)?)
}

fn fleet(command: Fleet) -> Result<bool, Failure> {
    match command {
        Fleet::List { file: File { config: path }, json, watch } => {
            let config = Config::read(&path)?;
            Ok(fleet::list(&config.fleet, &config.network, json, watch)?)
        }
        Fleet::Stop { robots, all: _, file: File { config: path }, json } => {
            let config = Config::read(&path)?;
            Ok(fleet::stop(&robots, &config.network, json)?)
        }
    }
}

/// Returns what a signal sets.
fn ends() -> Result<Arc<AtomicBool>, Failure> {
    let ends = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&ends)).map_err(Failure::Signals)?;
    }
    Ok(ends)
}

fn check(File { config: path }: &File) -> Result<(), Failure> {
    let config = Config::read(path)?;
    println!("{}: good", path.display());
    if let Some(serve) = &config.serve {
        let claims = match (&config.network.tls, serve.may_claim.as_slice()) {
            (None, _) => "everybody who reaches the port may claim it".to_owned(),
            (Some(_), []) => "nobody may claim it".to_owned(),
            (Some(_), names) => format!("{} may claim it", names.join(", ")),
        };
        println!(
            "serve: instance {} as {}, {} states a second, {claims}",
            serve.instance, serve.robot, serve.states_hz
        );
    }
    if let Some(mirror) = &config.mirror {
        println!("mirror: {} as instance {}", mirror.robot, mirror.instance);
    }
    for address in &config.network.listen {
        println!("listens on {address}");
    }
    for address in &config.network.connect {
        println!("connects to {address}");
    }
    Ok(())
}
