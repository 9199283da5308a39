//! `motord-sim`: a configuration's motors, simulated, on its CAN interfaces.

use clap::Parser;
use motord::buses;
use motord::config::{self, ConfigError};
use motord_bus::socketcan::{InvalidName, OpenError};
use motord_bus::{Duration, Instant, Readiness, clock, wait};
use motord_core::settings::{BusKind, Settings};
use motord_simulator::{Bridge, FaultVerb, InjectError, SimulatedBus, VerbError};
use std::convert::Infallible;
use std::io::{Stdin, Write};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Puts the motors of a configuration, simulated, on its CAN interfaces: `motord` drives them as if they were real.
///
/// Faults are read from standard input, one a line, and each is answered by a line: `ok`, or `error:` and why.
#[derive(Debug, Parser)]
#[command(
    name = "motord-sim",
    version,
    after_help = "Example:\n  motord-sim --config /etc/motord/motord.toml\n\nLines: TARGET FAULT [ARGUMENT], where TARGET is a motor or a bus of the configuration:\n  fl-hip off\n  fl-hip delayed 2ms\n  fl-hip intermittent 50%\n  front-left bus-off\n  front-left ok\n\nExit status: 64 usage, 69 an interface is unavailable, 78 the configuration is refused."
)]
struct Arguments {
    /// The configuration. Its buses of type socketcan are served.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Bit rate of the simulated wire, instead of the configuration's. The kernel takes its own time on top: on a slow
    /// machine or a real wire, a high rate brings the answers when they would come without it.
    #[arg(long, value_name = "BIT/S", value_parser = clap::value_parser!(u32).range(1..))]
    wire_bitrate: Option<u32>,
}

const EXIT_USAGE: u8 = 64;
const EXIT_UNAVAILABLE: u8 = 69;
const EXIT_CONFIG: u8 = 78;

#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error("no bus of this configuration is of type socketcan")]
    NoBus,
    #[error(transparent)]
    Name(#[from] InvalidName),
    #[error(transparent)]
    Open(#[from] OpenError),
}

impl Failure {
    fn exit_status(&self) -> u8 {
        match self {
            Self::Config(_) | Self::NoBus | Self::Name(_) => EXIT_CONFIG,
            Self::Open(_) => EXIT_UNAVAILABLE,
        }
    }
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let _unwritable = error.print();
            return ExitCode::from(if error.use_stderr() { EXIT_USAGE } else { 0 });
        }
    };
    let Err(failure) = run(&arguments.config, arguments.wire_bitrate);
    let _unread = writeln!(std::io::stderr(), "motord-sim: {failure}");
    ExitCode::from(failure.exit_status())
}

/// Serves until the process is ended.
fn run(file: &Path, wire_bitrate: Option<u32>) -> Result<Infallible, Failure> {
    const IDLE: Duration = Duration::from_secs(1);
    let settings = config::load(file)?.settings;
    let mut bridges = open(&settings, wire_bitrate)?;
    let mut commands = Commands::new();
    say("ready");
    loop {
        let now = clock::monotonic();
        bridges.iter_mut().for_each(|bridge| bridge.serve(now));
        let readiness: Vec<Readiness<'_>> =
            bridges.iter().map(Bridge::readiness).chain([commands.readiness()]).collect();
        let until = bridges.iter().map(Bridge::due).min().unwrap_or(now).min(now + IDLE);
        if wait(&readiness, now, until).contains(bridges.len()) {
            for line in commands.read() {
                match obey(&mut bridges, clock::monotonic(), &line) {
                    Ok(()) => say("ok"),
                    Err(reason) => say(&format!("error: {reason}")),
                }
            }
        }
    }
}

/// Whoever stopped listening still has motors.
fn say(line: &str) {
    let _unread = writeln!(std::io::stdout(), "{line}");
}

fn open(settings: &Settings, wire_bitrate: Option<u32>) -> Result<Vec<Bridge>, Failure> {
    let mut bridges = Vec::new();
    for (index, bus) in settings.buses.iter().enumerate() {
        let BusKind::SocketCan { interface, bitrate } = &bus.kind else { continue };
        let (mut wire, motors) = buses::physics(settings, index);
        wire.bitrate = wire_bitrate.unwrap_or(*bitrate);
        let simulated = SimulatedBus::new(wire, motors, index as u64);
        bridges.push(Bridge::open(simulated, interface.parse()?, *bitrate)?);
    }
    if bridges.is_empty() { Err(Failure::NoBus) } else { Ok(bridges) }
}

#[derive(Debug, thiserror::Error)]
enum Refused {
    #[error(transparent)]
    Verb(#[from] VerbError),
    #[error(transparent)]
    Inject(#[from] InjectError),
}

fn obey(bridges: &mut [Bridge], now: Instant, line: &str) -> Result<(), Refused> {
    let verb: FaultVerb = line.parse()?;
    for bridge in bridges {
        match bridge.inject(now, &verb) {
            Err(InjectError::NoSuchTarget) => {}
            result => return Ok(result?),
        }
    }
    Err(InjectError::NoSuchTarget.into())
}

/// Standard input, by lines, without waiting for one.
#[derive(Debug)]
struct Commands {
    input: Stdin,
    unfinished: Vec<u8>,
    closed: bool,
}

impl Commands {
    /// A longer line is none of ours: it is cut here.
    const LINE_MAX: usize = 256;

    fn new() -> Self {
        Self { input: std::io::stdin(), unfinished: Vec::new(), closed: false }
    }

    fn readiness(&self) -> Readiness<'_> {
        if self.closed { Readiness::Never } else { Readiness::Readable(self.input.as_fd()) }
    }

    /// The lines that are complete. Called when there is something to read.
    fn read(&mut self) -> Vec<String> {
        let mut bytes = [0; Self::LINE_MAX];
        let count = nix::unistd::read(&self.input, &mut bytes).unwrap_or(0);
        self.closed = count == 0;
        let mut lines = Vec::new();
        for &byte in &bytes[..count] {
            if byte == b'\n' || self.unfinished.len() == Self::LINE_MAX {
                let line = String::from_utf8_lossy(&self.unfinished).into_owned();
                self.unfinished.clear();
                lines.push(line);
            } else {
                self.unfinished.push(byte);
            }
        }
        lines
    }
}
