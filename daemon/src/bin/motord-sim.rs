//! `motord-sim`: a configuration's motors and IMUs, simulated, on its CAN interfaces and on pseudo
//! terminals.

use clap::{CommandFactory, Parser};
use motord::buses::fault_line::FaultLineError;
use motord::buses::{self, fault_line};
use motord::imus;
use motord_bus::transport::{Cause, Hardware, MotorsEnd, OpenError};
use motord_bus::{BusLock, Duration, Instant, Readiness, clock, wait};
use motord_configuration::{self as config, ConfigError};
use motord_settings::settings::{BusSettings, Settings};
use motord_simulator::{
    Bridge, FaultTarget, FaultVerb, ImuPort, InjectError, SerialPort, SerialSlave, SimulatedBus, Store, Verb,
};
use motord_terminal::{Pages, exit_status, parse_arguments, printable};
use std::convert::Infallible;
use std::io::{Stdin, Write};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Puts the motors of a configuration, simulated, on its CAN interfaces, and those of its serial buses on pseudo
/// terminals: `motord` drives them as if they were real. IMUs on serial lines get pseudo terminals as well.
///
/// At the start it prints a line for each serial bus and IMU, its name and the device to open instead of the configured one,
/// and then `ready`. Faults are read from standard input, one a line, and each is answered by a line: `ok`, or `error:` and why.
/// A serial bus or IMU that is plugged in again tells its device once more before its `ok`.
#[derive(Debug, Parser)]
#[command(
    name = "motord-sim",
    version,
    after_help = after_help(),
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
struct Arguments {
    #[command(subcommand)]
    pages: Option<Pages>,
    /// The configuration. Its buses of type socketcan and serial and its IMUs on serial lines are served.
    #[arg(long, value_name = "FILE", required = true)]
    config: Option<PathBuf>,
    /// Bit rate of the simulated wire, instead of the configuration's. The kernel adds its own transfer time:
    /// on a slow machine or a real wire, give a higher rate to compensate.
    #[arg(long, value_name = "BIT/S", value_parser = clap::value_parser!(u32).range(1..))]
    wire_bitrate: Option<u32>,
    /// Makes a symbolic link to each pseudo terminal in this directory, named as the configured device: `ttyUSB0` of
    /// `/dev/ttyUSB0`. A configuration whose devices are in this directory finds the simulated motors by itself.
    #[arg(long, value_name = "DIR")]
    link: Option<PathBuf>,
    /// The motors are as the vendor delivers them, whatever the configuration says: CAN id 1, host id 0, 1 Mbit/s,
    /// SteadyWin's with the native protocol and others with MIT. SteadyWin publishes no default but the protocol, Damiao none: the
    /// others are what motors in the field had.
    #[arg(long)]
    new: bool,
    /// All motors start without power. The line `MOTOR on` gives one power.
    #[arg(long)]
    off: bool,
    /// Keeps what each motor remembers without power in this directory, and starts the motors with it.
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
    /// Determines everything random: jitter, losses, corruption.
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    seed: u64,
}

const EXAMPLES: &str = "\
Example:
  motord-sim --config /etc/motord/motord.toml

Lines: TARGET FAULT [ARGUMENT], where TARGET is a motor or a bus of the configuration:
  fl-hip off
  fl-hip delayed 2ms
  fl-hip intermittent 50%
  front-left bus-off
  front-left ok
  fl-hip power-off
  fl-hip on

Lines for a serial bus:
  gripper echo
  gripper glue 16ms
  gripper loss 1%
  gripper corrupt 1%
  gripper silent
  gripper blocked
  gripper gone
  gripper ok

Lines for an IMU on a serial line:
  base off
  base stuck
  base garbage
  base delayed 20ms
  base intermittent 50%
  base corrupt 1%
  base gone
  base ok
";

const EXIT_STATUSES: &str = "Exit status: 64 usage, 69 an interface or a directory is unavailable, 74 a file cannot be written, 75 another motord-sim serves an interface, 78 the configuration is refused.";

/// The examples, and every fault that there is.
fn after_help() -> String {
    use FaultTarget::{Any, Bus, Line, Motor};
    let sections = [("Every target", Any), ("A motor", Motor), ("A bus", Bus), ("A serial bus", Line)];
    let lists = sections.map(|(title, target)| format!("{title}:\n{}\n", Verb::list(&[target])));
    format!("{EXAMPLES}\n{}{EXIT_STATUSES}", lists.concat())
}

#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error("no bus of this configuration is of type socketcan or serial, and no IMU is on a serial line")]
    NoBus,
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error("no pseudo terminal for {name}: {error}")]
    Terminal { name: String, error: std::io::Error },
    #[error("the memories of the motors: {0}")]
    Store(std::io::Error),
    #[error("cannot write: {0}")]
    Pages(std::io::Error),
}

impl Failure {
    fn exit_status(&self) -> u8 {
        match self {
            Self::Config(_) | Self::NoBus => exit_status::CONFIG,
            Self::Pages(_) => exit_status::IO,
            Self::Open(error) if error.cause() == Cause::Locked => exit_status::BUSY,
            Self::Open(_) | Self::Terminal { .. } | Self::Store(_) => exit_status::UNAVAILABLE,
        }
    }
}

fn main() -> ExitCode {
    let arguments: Arguments = match parse_arguments() {
        Ok(arguments) => arguments,
        Err(status) => return status,
    };
    let ended = match (&arguments.pages, &arguments.config) {
        (Some(pages), _) => pages.write(Arguments::command()).map_err(Failure::Pages),
        (None, Some(config)) => run(config, &arguments).map(|never| match never {}),
        (None, None) => unreachable!("clap requires one of them"),
    };
    let Err(failure) = ended else { return ExitCode::SUCCESS };
    let _unread = writeln!(std::io::stderr(), "motord-sim: {}", printable(&failure.to_string()));
    ExitCode::from(failure.exit_status())
}

/// Serves until the process is ended.
fn run(config: &Path, arguments: &Arguments) -> Result<Infallible, Failure> {
    const IDLE: Duration = Duration::from_secs(1);
    let settings = config::load(config)?.settings;
    let _locks = lock(&settings)?;
    let mut endpoints = open(&settings, arguments)?;
    let mut store = restore(arguments.store.as_deref(), &mut endpoints).map_err(Failure::Store)?;
    let mut commands = Commands::new();
    endpoints.iter().for_each(print_device);
    print_line("ready");
    loop {
        let now = clock::monotonic();
        endpoints.iter_mut().for_each(|endpoint| endpoint.serve(now));
        if let Some(store) = &mut store {
            buses(&mut endpoints).try_for_each(|bus| store.save(bus.motors())).map_err(Failure::Store)?;
        }
        let readiness: Vec<Readiness<'_>> =
            endpoints.iter().map(Endpoint::readiness).chain([commands.readiness()]).collect();
        let until = endpoints.iter().map(Endpoint::due).min().unwrap_or(now).min(now + IDLE);
        if wait(&readiness, now, until).contains(endpoints.len()) {
            for command in commands.read() {
                match obey(&settings, &mut endpoints, clock::monotonic(), &command) {
                    Ok(()) => print_line("ok"),
                    Err(reason) => print_line(&format!("error: {reason}")),
                }
            }
        }
    }
}

/// Locks the motors' ends: two programs would simulate the same motors, and each command would have two replies.
fn lock(settings: &Settings) -> Result<Vec<BusLock>, Failure> {
    settings.buses.iter().filter_map(motors_end).map(|end| Ok(end.lock()?)).collect()
}

/// Returns the motors' end of a bus that has one.
fn motors_end(bus: &BusSettings) -> Option<&dyn MotorsEnd> {
    bus.kind.hardware().and_then(Hardware::motors_end)
}

/// Gives the motors the memories that were kept of them.
fn restore(folder: Option<&Path>, endpoints: &mut [Endpoint]) -> std::io::Result<Option<Store>> {
    let Some(folder) = folder else { return Ok(None) };
    let store = Store::open(folder)?;
    buses(endpoints).try_for_each(|bus| store.load(bus))?;
    Ok(Some(store))
}

/// The simulated buses.
fn buses(endpoints: &mut [Endpoint]) -> impl Iterator<Item = &mut SimulatedBus> {
    endpoints.iter_mut().filter_map(Endpoint::bus)
}

/// A bus or an IMU on its way to other processes.
enum Endpoint {
    Can(Bridge),
    Serial(SerialPort),
    Imu(ImuPort),
}

impl Endpoint {
    fn serve(&mut self, now: Instant) {
        match self {
            Self::Can(bridge) => bridge.serve(now),
            Self::Serial(port) => port.serve(now),
            Self::Imu(port) => port.serve(now),
        }
    }

    fn readiness(&self) -> Readiness<'_> {
        match self {
            Self::Can(bridge) => bridge.readiness(),
            Self::Serial(port) => port.readiness(),
            Self::Imu(port) => port.readiness(),
        }
    }

    fn due(&self) -> Instant {
        match self {
            Self::Can(bridge) => bridge.due(),
            Self::Serial(port) => port.due(),
            Self::Imu(port) => port.due(),
        }
    }

    fn bus(&mut self) -> Option<&mut SimulatedBus> {
        match self {
            Self::Can(bridge) => Some(bridge.bus()),
            Self::Serial(port) => Some(port.bus()),
            Self::Imu(_) => None,
        }
    }

    /// The name and the device of a pseudo terminal that is plugged in.
    fn device(&self) -> Option<(&str, &Path)> {
        match self {
            Self::Can(_) => None,
            Self::Serial(port) => Some((port.name(), port.path()?)),
            Self::Imu(port) => Some((port.name(), port.path()?)),
        }
    }

    fn inject(&mut self, now: Instant, verb: &FaultVerb) -> Result<(), InjectError> {
        match self {
            Self::Can(bridge) => bridge.inject(now, verb),
            Self::Serial(port) => port.inject(now, verb),
            Self::Imu(port) => port.inject(verb),
        }
    }
}

/// The device of a serial bus or an IMU that is plugged in.
fn print_device(endpoint: &Endpoint) {
    if let Some((name, device)) = endpoint.device() {
        print_line(&format!("{name}: {}", device.display()));
    }
}

/// Prints a line. The simulation continues when standard output is closed.
fn print_line(line: &str) {
    let _unread = writeln!(std::io::stdout(), "{line}");
}

fn open(settings: &Settings, arguments: &Arguments) -> Result<Vec<Endpoint>, Failure> {
    let mut endpoints = Vec::new();
    for (index, bus) in settings.buses.iter().enumerate() {
        let seed = arguments.seed.wrapping_add(index as u64);
        let (mut wire, mut motors) = buses::physics(settings, index);
        for motor in &mut motors {
            (motor.is_new, motor.has_power) = (arguments.new, !arguments.off);
        }
        if let Some(end) = motors_end(bus) {
            wire.wire_bitrate = arguments.wire_bitrate;
            let simulated = SimulatedBus::new(wire, motors, seed);
            endpoints.push(Endpoint::Can(Bridge::open(simulated, end)?));
        } else if let Some(device) = bus.kind.port() {
            let slave = SerialSlave::new(SimulatedBus::new(wire, motors, seed), seed);
            let port = SerialPort::open(slave, link(arguments, device));
            let port = port.map_err(|error| Failure::Terminal { name: bus.name.clone(), error })?;
            endpoints.push(Endpoint::Serial(port));
        }
    }
    open_imus(settings, arguments, &mut endpoints)?;
    if endpoints.is_empty() { Err(Failure::NoBus) } else { Ok(endpoints) }
}

fn open_imus(
    settings: &Settings,
    arguments: &Arguments,
    endpoints: &mut Vec<Endpoint>,
) -> Result<(), Failure> {
    let start = clock::monotonic();
    for (index, imu) in settings.sensors.imus.iter().enumerate() {
        let seed = arguments.seed.wrapping_add(index as u64);
        let link = imu.source.serial().and_then(|line| link(arguments, &line.device));
        let Some(port) = imus::simulated_port(imu, start, link, seed) else { continue };
        let port = port.map_err(|error| Failure::Terminal { name: imu.name.clone(), error })?;
        endpoints.push(Endpoint::Imu(port));
    }
    Ok(())
}

/// The symbolic link to the pseudo terminal of `device`, where links are requested.
fn link(arguments: &Arguments, device: &str) -> Option<PathBuf> {
    let file_name = Path::new(device).file_name().unwrap_or_default();
    arguments.link.as_ref().map(|folder| folder.join(file_name))
}

fn obey(
    settings: &Settings,
    endpoints: &mut [Endpoint],
    now: Instant,
    command: &str,
) -> Result<(), FaultLineError> {
    let verb = fault_line::read(command, settings)?;
    for endpoint in endpoints {
        let device = endpoint.device().map(|(_, device)| device.to_owned());
        match endpoint.inject(now, &verb) {
            Err(InjectError::NoSuchTarget) => continue,
            result => result?,
        }
        if endpoint.device().map(|(_, device)| device) != device.as_deref() {
            print_device(endpoint);
        }
        return Ok(());
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
