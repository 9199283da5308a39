//! `motorctl imu find`: IMUs on serial ports and CAN interfaces. Only listens: these devices send
//! without a request.

use crate::failure::DirectFailure;
use crate::imu_bus::{self, Node};
use motord_bus::serial::{ByteStream as _, OpenError, Port};
use motord_bus::{Duration, Instant, clock, wait};
use motord_protocol::imu::{Sample, SerialDecoder, SerialProtocol};
use motord_terminal::{Cell, Interrupt, Palette, Table, json};
use nix::errno::Errno;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Time for which each baud rate is tried: six samples of a device at 10 Hz.
pub(crate) const PROBE: Duration = Duration::from_millis(600);
/// Samples that make a device: random bytes give one of them at most.
pub(crate) const SAMPLES: usize = 2;
/// Time for which the rate is measured.
const MEASURE: Duration = Duration::from_secs(1);
/// Longest wait for bytes, so that Ctrl-C is seen.
const TURN: Duration = Duration::from_millis(50);
/// The common baud rates come first.
const COMMON_BAUDS: [u32; 4] = [115_200, 921_600, 460_800, 230_400];
/// The rates of the devices, Hz. A measured rate within 4 % is one of them.
const RATES: [f64; 17] = [
    1.0, 2.0, 5.0, 10.0, 20.0, 25.0, 40.0, 50.0, 80.0, 100.0, 125.0, 200.0, 250.0, 400.0, 500.0, 800.0,
    1000.0,
];
/// Directories and beginnings of the names of serial ports.
const PORTS: [(&str, &str); 5] = [
    ("/dev/serial/by-id", ""),
    ("/dev", "ttyUSB"),
    ("/dev", "ttyACM"),
    ("/dev", "ttyAMA"),
    ("/dev", "ttyTHS"),
];

/// The options of `motorctl imu find`.
#[derive(Debug, clap::Args)]
pub struct ImuFind {
    /// The serial port; may be given several times. Without it, every port in /dev/serial/by-id and every other USB port and
    /// UART (ttyUSB, ttyACM, ttyAMA, ttyTHS).
    #[arg(long = "device", value_name = "PATH")]
    devices: Vec<String>,
    /// A CAN interface, on which HiPNUC IMUs send; may be given several times. No serial port is tried then, unless one is given.
    #[arg(long = "bus", value_name = "INTERFACE")]
    buses: Vec<String>,
    /// Try only this baud rate. Without it, all of the vendors.
    #[arg(long, value_name = "BIT/S", value_parser = clap::value_parser!(u32).range(1..))]
    baud: Option<u32>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// An IMU that was found.
#[derive(Debug, Serialize)]
struct FoundImu {
    #[serde(rename = "type")]
    kind: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    baud: Option<u32>,
    /// The CAN interface.
    #[serde(skip_serializing_if = "Option::is_none")]
    bus: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    node_id: Option<u8>,
    /// Samples per second, as measured.
    measured_hz: f64,
    /// The nearest rate of such devices.
    rate_hz: f64,
    /// Each sample has orientation, angular velocity and acceleration.
    complete: bool,
    /// The lines for the configuration.
    lines: String,
}

#[derive(Debug, Serialize)]
struct Found {
    imus: Vec<FoundImu>,
    notes: Vec<String>,
}

impl FoundImu {
    /// Gives it the lines of the IMU with this number: each name occurs once.
    fn named(self, index: usize) -> Self {
        let Self { kind, rate_hz, .. } = self;
        let name = if index == 0 { "base".to_owned() } else { format!("imu-{}", index + 1) };
        let address = match (&self.device, self.baud, &self.bus, self.node_id) {
            (Some(device), Some(baud), ..) => format!("device = \"{device}\"\nbaud = {baud}\n"),
            (_, _, Some(bus), Some(node)) => {
                format!("bus = \"NAME\"  # of the [[bus]] with interface = \"{bus}\"\nnode-id = {node}\n")
            }
            _ => String::new(),
        };
        let lines = format!("[[imu]]\nname = \"{name}\"\ntype = \"{kind}\"\n{address}rate-hz = {rate_hz}\n");
        Self { lines, ..self }
    }

    /// Returns its port or interface, and its baud rate or node.
    fn address(&self) -> [String; 2] {
        let text = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
        match (&self.bus, self.node_id) {
            (Some(bus), Some(node)) => [bus.clone(), format!("node {node}")],
            _ => [text(self.device.clone()), text(self.baud.map(|baud| baud.to_string()))],
        }
    }
}

/// The samples of one protocol among the bytes of a port.
pub(crate) struct SampleStream {
    pub(crate) protocol: SerialProtocol,
    decoder: SerialDecoder,
    pub(crate) count: usize,
    complete: usize,
    first: Option<Instant>,
    last: Instant,
}

impl SampleStream {
    pub(crate) fn new(protocol: SerialProtocol) -> Self {
        let decoder = SerialDecoder::new(protocol);
        Self { protocol, decoder, count: 0, complete: 0, first: None, last: Instant::ZERO }
    }

    fn take(&mut self, bytes: &[u8], received: Instant) {
        for byte in bytes {
            if let Some(Ok(sample)) = self.decoder.push(*byte) {
                self.count += 1;
                self.complete += usize::from(is_complete(&sample));
                self.first.get_or_insert(received);
                self.last = received;
            }
        }
    }

    /// Samples per second, between the first and the last one.
    pub(crate) fn rate_hz(&self) -> Option<f64> {
        let seconds = self.last.since(self.first?).as_secs_f64();
        (seconds > 0.0).then(|| (self.count - 1) as f64 / seconds)
    }
}

fn is_complete(sample: &Sample) -> bool {
    sample.orientation.is_some() && sample.angular_velocity.is_some() && sample.acceleration.is_some()
}

/// The result of one port.
enum Outcome {
    Imu(FoundImu),
    Note(String),
}

/// Finds the IMUs of serial ports, all ports at the same time.
///
/// # Errors
///
/// No IMU was found, or the output cannot be written.
pub fn find(arguments: &ImuFind) -> Result<(), DirectFailure> {
    let interrupt = Interrupt::register();
    let is_given = !arguments.devices.is_empty() || !arguments.buses.is_empty();
    let devices = if is_given { arguments.devices.clone() } else { ports() };
    let bauds = arguments.baud.map_or_else(bauds, |baud| vec![baud]);
    let outcomes: Vec<_> = std::thread::scope(|scope| {
        let started = devices.iter().map(|device| scope.spawn(|| one(device, &bauds, &interrupt)));
        let started: Vec<_> = started.collect();
        started.into_iter().filter_map(|thread| thread.join().ok()).collect()
    });
    if interrupt.is_raised() {
        return Err(motord_protocol::commissioning::Error::Interrupted.into());
    }
    let mut found = Found { imus: Vec::new(), notes: Vec::new() };
    for bus in &arguments.buses {
        let nodes = imu_bus::listen(bus, &interrupt)?;
        if nodes.is_empty() {
            found.notes.push(format!(
                "{bus}: no HiPNUC IMU sends its TPDOs 1, 2 and 4; a Damiao IMU answers requests only: write its ids by hand"
            ));
        }
        for node in nodes {
            found.imus.push(on_bus(bus, &node).named(found.imus.len()));
        }
    }
    for outcome in outcomes {
        match outcome {
            Outcome::Imu(imu) => found.imus.push(imu.named(found.imus.len())),
            Outcome::Note(note) => found.notes.push(note),
        }
    }
    print(&found, arguments.json)?;
    match found.imus.is_empty() {
        true => Err(DirectFailure::NoImu { ports: devices.len() + arguments.buses.len() }),
        false => Ok(()),
    }
}

/// The baud rates of all vendors, the common ones first.
pub(crate) fn bauds() -> Vec<u32> {
    let all: BTreeSet<_> =
        SerialProtocol::ALL.iter().flat_map(|protocol| protocol.bauds()).copied().collect();
    let others = all.into_iter().rev().filter(|baud| !COMMON_BAUDS.contains(baud));
    COMMON_BAUDS.into_iter().chain(others).collect()
}

/// The serial ports of this computer, each under one name.
fn ports() -> Vec<String> {
    let mut seen = BTreeSet::<PathBuf>::new();
    let mut ports = Vec::new();
    for (directory, begin) in PORTS {
        let entries = fs::read_dir(directory).into_iter().flatten().flatten();
        let mut paths: Vec<_> = entries
            .filter(|entry| entry.file_name().to_string_lossy().starts_with(begin))
            .map(|entry| entry.path())
            .collect();
        paths.sort();
        for path in paths {
            if seen.insert(path.canonicalize().unwrap_or_else(|_| path.clone())) {
                ports.push(path.to_string_lossy().into_owned());
            }
        }
    }
    ports
}

/// The name of a port that stays when it is plugged in elsewhere, if it has one.
fn lasting_name(device: &str) -> String {
    let target = Path::new(device).canonicalize().ok();
    let entries = fs::read_dir("/dev/serial/by-id").into_iter().flatten().flatten();
    let mut names = entries.map(|entry| entry.path());
    let same = names.find(|path| target.is_some() && path.canonicalize().ok() == target);
    same.map_or_else(|| device.to_owned(), |path| path.to_string_lossy().into_owned())
}

/// Tries the baud rates on one port.
fn one(device: &str, bauds: &[u32], interrupt: &Interrupt) -> Outcome {
    let mut bytes = 0;
    for &baud in bauds {
        let port = match Port::exclusive(device, baud) {
            Ok(port) => port,
            // The adapter may offer another rate.
            Err(OpenError::Baud { .. }) => continue,
            Err(error) => return Outcome::Note(error.to_string()),
        };
        let mut streams = SerialProtocol::ALL.map(SampleStream::new);
        let is_found = |streams: &[SampleStream]| streams.iter().any(|one| one.count >= SAMPLES);
        bytes += listen(&port, &mut streams, PROBE, |streams| is_found(streams) || interrupt.is_raised());
        if let Some(known) = streams.into_iter().find(|one| one.count >= SAMPLES) {
            let mut measured = [SampleStream::new(known.protocol)];
            listen(&port, &mut measured, MEASURE, |_| interrupt.is_raised());
            let [measured] = measured;
            return Outcome::Imu(report(device, baud, &measured));
        }
        if interrupt.is_raised() {
            break;
        }
    }
    Outcome::Note(match bytes {
        0 => format!("{device}: is silent: check power and wiring, the device's TX to the adapter's RX"),
        _ => format!("{device}: {bytes} bytes, and no sample of a known IMU"),
    })
}

/// Passes the bytes of a port to `streams` for at most `duration`, until `ends`. Returns their number.
pub(crate) fn listen(
    port: &Port,
    streams: &mut [SampleStream],
    duration: Duration,
    ends: impl Fn(&[SampleStream]) -> bool,
) -> usize {
    let mut buffer = [0; 4096];
    let mut total = 0;
    let end = clock::monotonic() + duration;
    loop {
        let now = clock::monotonic();
        if now >= end || ends(streams) {
            return total;
        }
        if !wait(&[port.readiness()], now, end.min(now + TURN)).any() {
            continue;
        }
        match port.read(&mut buffer) {
            Ok(count) if count > 0 => {
                let received = clock::monotonic();
                streams.iter_mut().for_each(|one| one.take(&buffer[..count], received));
                total += count;
            }
            Err(Errno::EAGAIN | Errno::EINTR) => {}
            Ok(_) | Err(_) => return total,
        }
    }
}

fn report(device: &str, baud: u32, streams: &SampleStream) -> FoundImu {
    FoundImu {
        device: Some(lasting_name(device)),
        baud: Some(baud),
        complete: streams.count > 0 && streams.complete == streams.count,
        ..measured(streams.protocol.name(), streams.rate_hz().unwrap_or(0.0))
    }
}

fn on_bus(bus: &str, node: &Node) -> FoundImu {
    FoundImu {
        bus: Some(bus.to_owned()),
        node_id: Some(node.id),
        complete: true,
        ..measured("hipnuc-can", node.measured_hz)
    }
}

/// An IMU at no place yet.
fn measured(kind: &'static str, measured_hz: f64) -> FoundImu {
    let near = RATES.into_iter().find(|rate| (measured_hz / rate - 1.0).abs() < 0.04);
    let rate_hz = near.unwrap_or_else(|| measured_hz.round().max(1.0));
    let (device, baud, bus, node_id) = (None, None, None, None);
    FoundImu { kind, device, baud, bus, node_id, measured_hz, rate_hz, complete: false, lines: String::new() }
}

fn print(found: &Found, as_json: bool) -> Result<(), DirectFailure> {
    let out = &mut io::stdout().lock();
    if as_json {
        return Ok(json::write_line(out, found)?);
    }
    if !found.imus.is_empty() {
        let mut table = Table::new(&["type", "device or bus", "baud or node", "Hz", "samples"]);
        for imu in &found.imus {
            let samples = if imu.complete { "complete" } else { "INCOMPLETE" };
            let [port, baud] = imu.address();
            let cells =
                [imu.kind.to_owned(), port, baud, format!("{:.1}", imu.measured_hz), samples.to_owned()];
            table.row(cells.map(Cell::plain).into());
        }
        table.write(out, Palette::of_stdout())?;
    }
    for imu in &found.imus {
        write!(out, "\n{}", imu.lines)?;
    }
    for imu in found.imus.iter().filter(|imu| !imu.complete) {
        let protocol = SerialProtocol::ALL.into_iter().find(|protocol| protocol.name() == imu.kind);
        let needed = protocol.map_or("", SerialProtocol::complete_samples);
        eprintln!(
            "{}: samples lack a quantity, and motord rejects them; set in the device: {needed}",
            imu.address()[0]
        );
    }
    found.notes.iter().for_each(|note| eprintln!("{note}"));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_baud_rate_is_tried_once() {
        let bauds = bauds();
        assert_eq!(bauds[..4], COMMON_BAUDS);
        assert_eq!(bauds.iter().collect::<BTreeSet<_>>().len(), bauds.len());
        assert!(
            SerialProtocol::ALL.iter().flat_map(|protocol| protocol.bauds()).all(|baud| bauds.contains(baud))
        );
    }

    /// 99 samples in 490 ms, the first and the last of them included, are 200 Hz.
    #[test]
    fn measured_rate_is_rounded_to_that_of_devices() {
        let begin = Instant::from_nanos(1_000_000_000);
        let streams = SampleStream {
            count: 99,
            complete: 99,
            first: Some(begin),
            last: begin + Duration::from_millis(490),
            ..SampleStream::new(SerialProtocol::Xsens)
        };
        let found = report("/dev/ttyUSB0", 460_800, &streams).named(1);
        assert!(found.lines.starts_with("[[imu]]\nname = \"imu-2\"\n"));
        assert_eq!((found.rate_hz, found.complete), (200.0, true));
        assert!(
            found
                .lines
                .ends_with("type = \"xsens\"\ndevice = \"/dev/ttyUSB0\"\nbaud = 460800\nrate-hz = 200\n")
        );
    }
}
