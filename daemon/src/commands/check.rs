//! `motord check`: judges a configuration and prints the plan of its buses, without opening any.

use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;

use motord_bus::Duration;
use motord_bus::arithmetic::SERIAL_FRAME_BITS;
use motord_configuration::{self as config, ConfigError, Loaded};
use motord_core::plan::{BusPlan, WORST_CASE_SOUND};
use motord_core::settings::{BusKind, BusSettings, Settings};
use motord_terminal::printable;

/// Exit status of a configuration that is refused, `EX_CONFIG` of `sysexits.h`.
pub const EXIT_CONFIG: u8 = 78;

/// 8N1: a start bit, eight data bits, a stop bit.
const SERIAL_BYTE_BITS: u32 = 10;

/// Judges the file at `path`, prints the verdict to `out`, as JSON or for people, and returns the exit status.
///
/// # Errors
///
/// Those of `out`.
pub fn check(path: &Path, json: bool, out: &mut impl Write) -> io::Result<u8> {
    let judged = config::load(path);
    match json {
        true => writeln!(out, "{}", serde_json::to_string(&Report::of(&judged))?)?,
        false => print_for_people(path, &judged, out)?,
    }
    out.flush()?;
    Ok(if judged.is_ok() { 0 } else { EXIT_CONFIG })
}

/// The object that `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    errors: Vec<String>,
    warnings: Vec<String>,
    buses: Vec<BusReport<'a>>,
}

/// One bus. Utilisations are fractions of its fullest cycle, those of a serial line of the time for one turn of each motor.
#[derive(Serialize)]
struct BusReport<'a> {
    name: &'a str,
    motors: usize,
    /// Commands to each motor in a second.
    rate_hz: f64,
    /// Cycles between two commands to a motor.
    every: u32,
    worst_case_utilisation: f64,
    unstuffed_utilisation: f64,
    fault_poll_utilisation: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    line: Option<LineReport>,
}

/// One turn on a serial line.
#[derive(Serialize)]
struct LineReport {
    /// Bytes of a request and its reply, headers included.
    bytes: u32,
    /// Their time on the wire, at 10 bits a byte.
    wire_us: f64,
    /// The longest time that is planned between the two.
    turnaround_us: f64,
    /// Turns until each motor has had one, with that of the questions.
    turns: usize,
}

impl LineReport {
    fn of(settings: &Settings, bus: usize, plan: &BusPlan) -> Option<Self> {
        let BusKind::Serial { turnaround, .. } = settings.buses[bus].kind else { return None };
        let micros = |time: Duration| 1e6 * time.as_secs_f64();
        Some(Self {
            bytes: 2 * SERIAL_FRAME_BITS / SERIAL_BYTE_BITS,
            wire_us: micros(plan.transaction_least),
            turnaround_us: micros(turnaround),
            turns: settings.turns(bus),
        })
    }
}

impl<'a> Report<'a> {
    fn of(judged: &'a Result<Loaded, ConfigError>) -> Self {
        let lines = |problems: &[config::Problem]| problems.iter().map(ToString::to_string).collect();
        match judged {
            Ok(Loaded { settings, warnings, .. }) => {
                Self { errors: Vec::new(), warnings: lines(warnings), buses: bus_reports(settings) }
            }
            Err(error) => Self { errors: lines(&error.problems), warnings: Vec::new(), buses: Vec::new() },
        }
    }
}

fn bus_reports<'a>(settings: &'a Settings) -> Vec<BusReport<'a>> {
    let report = |(index, (bus, plan)): (usize, (&'a BusSettings, BusPlan))| BusReport {
        name: &bus.name,
        motors: plan.motors,
        rate_hz: settings.cycle.rate_hz / f64::from(bus.every),
        every: bus.every,
        line: LineReport::of(settings, index, &plan),
        worst_case_utilisation: plan.worst_case_utilisation,
        unstuffed_utilisation: plan.unstuffed_utilisation,
        fault_poll_utilisation: plan.fault_poll_utilisation,
    };
    settings.buses.iter().zip(BusPlan::of(settings)).enumerate().map(report).collect()
}

fn print_for_people(
    path: &Path,
    judged: &Result<Loaded, ConfigError>,
    out: &mut impl Write,
) -> io::Result<()> {
    match judged {
        Ok(Loaded { settings, warnings, .. }) => {
            for warning in warnings {
                writeln!(out, "warning: {}", printable(&warning.to_string()))?;
            }
            print_plan(path, settings, out)
        }
        Err(error) => {
            for problem in &error.problems {
                writeln!(out, "error: {}", printable(&problem.to_string()))?;
            }
            writeln!(out, "{} is refused", path.display())
        }
    }
}

fn print_plan(path: &Path, settings: &Settings, out: &mut impl Write) -> io::Result<()> {
    let (motors, buses, rate_hz) = (settings.motors.len(), settings.buses.len(), settings.cycle.rate_hz);
    writeln!(out, "{}: motors: {motors}, buses: {buses}, rate: {rate_hz} Hz", path.display())?;
    let reports = bus_reports(settings);
    let width = reports.iter().map(|bus| bus.name.len()).max().unwrap_or(0).max("bus".len());
    writeln!(out, "{:<width$}  motors  worst case  unstuffed  fault poll  verdict", "bus")?;
    for bus in reports {
        let [worst, unstuffed, poll] =
            [bus.worst_case_utilisation, bus.unstuffed_utilisation, bus.fault_poll_utilisation]
                .map(|f| 100.0 * f);
        let (name, motors, verdict) = (bus.name, bus.motors, verdict(&bus));
        writeln!(
            out,
            "{name:<width$}  {motors:>6}  {worst:>8.1} % {unstuffed:>8.1} % {poll:>9.1} %  {verdict}"
        )?;
    }
    Ok(())
}

fn verdict(bus: &BusReport<'_>) -> String {
    let rate = if bus.every == 1 { String::new() } else { format!("; each motor at {} Hz", bus.rate_hz) };
    let Some(line) = &bus.line else { return format!("{}{rate}", can_verdict(bus)) };
    let LineReport { bytes, wire_us, turnaround_us, turns } = line;
    format!(
        "fits{rate}; {turns} turns in {} cycles, each {bytes} bytes in {wire_us:.0} µs and {turnaround_us:.0} µs of turnaround",
        bus.every
    )
}

fn can_verdict(bus: &BusReport<'_>) -> &'static str {
    match bus {
        BusReport { motors: 0, .. } => "empty",
        bus if bus.worst_case_utilisation > WORST_CASE_SOUND => "tight: lower the rate or move a motor",
        bus if bus.fault_poll_utilisation > 1.0 => "fits; fault polls only where there happens to be room",
        _ => "fits",
    }
}
