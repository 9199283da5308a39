//! `motord check`: checks a configuration and prints the plan of its buses, without opening any.

mod imus;
mod joints;

use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;

use motord_bus::Duration;
use motord_bus::arithmetic::SERIAL_FRAME_BITS;
use motord_configuration::{self as config, ConfigError, Loaded};
use motord_settings::plan::{BusPlan, WORST_CASE_SOUND};
use motord_settings::settings::{BusSettings, Settings};
use motord_terminal::{json, printable};

use imus::ImuReport;
use joints::JointReport;

/// The exit status of a configuration that is refused.
pub use motord_terminal::exit_status::CONFIG as EXIT_CONFIG;

/// 8N1: a start bit, eight data bits, a stop bit.
const SERIAL_BYTE_BITS: u32 = 10;

/// The columns of the plan, in words.
const LEGEND: &str = "
worst case  part of a cycle that commands, replies and IMUs take with all stuff bits;
            above 80 % is tight
unstuffed   the same without stuff bits: the least that it takes
fault poll  worst case of a cycle that also asks a motor for its faults;
            above 100 % some of these questions wait
highest     the highest cycle.rate-hz; above it the last reply of a cycle is
            expected after the reply deadline, and the rate is refused
";

/// The parts of a check that are printed on request.
#[derive(Debug, Clone, Copy)]
pub struct Wanted {
    /// One JSON object instead of text.
    pub json: bool,
    /// The effective limits of each joint.
    pub joints: bool,
}

/// Checks the file at `path`, prints the verdict to `out`, as JSON or for people, and returns the
/// exit status.
///
/// # Errors
///
/// Those of `out`, except a closed pipe: the exit status is still the verdict.
pub fn check(path: &Path, wanted: Wanted, out: &mut impl Write) -> io::Result<u8> {
    let result = config::load(path);
    match print(path, &result, wanted, out) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => return Err(error),
        Ok(()) | Err(_) => {}
    }
    Ok(if result.is_ok() { 0 } else { EXIT_CONFIG })
}

fn print(
    path: &Path,
    result: &Result<Loaded, ConfigError>,
    wanted: Wanted,
    out: &mut impl Write,
) -> io::Result<()> {
    match wanted.json {
        true => json::write_line(out, &Report::of(result, wanted.joints))?,
        false => print_for_people(path, result, wanted.joints, out)?,
    }
    out.flush()
}

/// The object that `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    errors: Vec<String>,
    warnings: Vec<String>,
    buses: Vec<BusReport<'a>>,
    imus: Vec<ImuReport<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    joints: Option<Vec<JointReport<'a>>>,
}

/// One bus. Utilisations of a CAN bus are fractions of its fullest cycle. Those of a serial line
/// are fractions of the time in which each motor has one turn.
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
    /// The part of the worst case that motors send by themselves.
    #[serde(skip_serializing_if = "is_zero")]
    unprompted_utilisation: f64,
    /// The highest rate of the cycle that this bus allows, rounded down; `None` when nothing is
    /// asked on it.
    rate_hz_max: Option<f64>,
    /// The last reply of a cycle is expected after the reply deadline.
    #[serde(skip)]
    is_late: bool,
    #[serde(skip)]
    has_imu: bool,
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
    /// Turns until each motor has had one, with the one for questions about faults and indicators.
    turns: usize,
    /// The least `every` with which the turns do not overlap.
    every_least: u32,
}

impl LineReport {
    fn of(settings: &Settings, bus: usize, plan: &BusPlan) -> Option<Self> {
        let turnaround = settings.buses[bus].kind.turnaround()?;
        let micros = |time: Duration| 1e6 * time.as_secs_f64();
        Some(Self {
            bytes: 2 * SERIAL_FRAME_BITS / SERIAL_BYTE_BITS,
            wire_us: micros(plan.transaction_least),
            turnaround_us: micros(turnaround),
            turns: settings.turns(bus),
            every_least: plan.every_least,
        })
    }
}

impl<'a> Report<'a> {
    fn of(result: &'a Result<Loaded, ConfigError>, joints: bool) -> Self {
        let lines = |problems: &[config::Problem]| problems.iter().map(ToString::to_string).collect();
        match result {
            Ok(loaded) => Self {
                errors: Vec::new(),
                warnings: lines(&loaded.warnings),
                buses: bus_reports(&loaded.settings),
                imus: imus::reports(&loaded.settings),
                joints: joints.then(|| joints::reports(loaded)),
            },
            Err(error) => Self {
                errors: lines(&error.problems),
                warnings: Vec::new(),
                buses: error.refused.as_deref().map_or_else(Vec::new, bus_reports),
                imus: error.refused.as_deref().map_or_else(Vec::new, imus::reports),
                joints: None,
            },
        }
    }
}

fn is_zero(part: &f64) -> bool {
    *part == 0.0
}

fn bus_reports<'a>(settings: &'a Settings) -> Vec<BusReport<'a>> {
    let report = |(index, (bus, plan)): (usize, (&'a BusSettings, BusPlan))| BusReport {
        name: &bus.name,
        motors: plan.motors,
        rate_hz: settings.cycle.rate_hz / f64::from(bus.every.get()),
        every: bus.every.get(),
        line: LineReport::of(settings, index, &plan),
        worst_case_utilisation: plan.worst_case_utilisation,
        unstuffed_utilisation: plan.unstuffed_utilisation,
        fault_poll_utilisation: plan.fault_poll_utilisation,
        unprompted_utilisation: plan.unprompted_utilisation,
        rate_hz_max: plan.rate_hz_max.is_finite().then(|| plan.rate_hz_max.floor()),
        has_imu: settings.sensors.on_bus(index).next().is_some(),
        is_late: !bus.is_line() && plan.last_reply > settings.cycle.reply_deadline,
    };
    settings.buses.iter().zip(BusPlan::of(settings)).enumerate().map(report).collect()
}

fn print_for_people(
    path: &Path,
    result: &Result<Loaded, ConfigError>,
    joints: bool,
    out: &mut impl Write,
) -> io::Result<()> {
    let file = path.display().to_string();
    let file = printable(&file);
    match result {
        Ok(loaded) => {
            print_problems("warning", &loaded.warnings, out)?;
            print_plan(&file, &loaded.settings, out)?;
            if joints {
                joints::print(loaded, out)?;
            }
            writeln!(out, "\n{file} may run{}", counted(", warnings", loaded.warnings.len()))
        }
        Err(error) => {
            print_problems("error", &error.problems, out)?;
            if let Some(settings) = &error.refused {
                print_plan(&file, settings, out)?;
                writeln!(out)?;
            }
            writeln!(out, "{file} is refused{}", counted(", errors", error.problems.len()))
        }
    }
}

fn print_problems(kind: &str, problems: &[config::Problem], out: &mut impl Write) -> io::Result<()> {
    problems.iter().try_for_each(|problem| writeln!(out, "{kind}: {}", printable(&problem.to_string())))
}

/// `, errors: 2`; nothing of nothing.
fn counted(what: &str, count: usize) -> String {
    if count == 0 { String::new() } else { format!("{what}: {count}") }
}

fn print_plan(file: &str, settings: &Settings, out: &mut impl Write) -> io::Result<()> {
    let (motors, buses, rate_hz) = (settings.motors.len(), settings.buses.len(), settings.cycle.rate_hz);
    writeln!(out, "{file}: motors: {motors}, buses: {buses}, rate: {rate_hz} Hz")?;
    let reports = bus_reports(settings);
    let width = reports.iter().map(|bus| bus.name.len()).max().unwrap_or(0).max("bus".len());
    writeln!(out, "{:<width$}  motors  worst case  unstuffed  fault poll  highest  verdict", "bus")?;
    for bus in reports {
        let [worst, unstuffed, poll] =
            [bus.worst_case_utilisation, bus.unstuffed_utilisation, bus.fault_poll_utilisation]
                .map(|f| 100.0 * f);
        let (name, motors, verdict) = (bus.name, bus.motors, verdict(&bus));
        let highest = bus.rate_hz_max.map_or_else(|| "-".to_owned(), |rate_hz| format!("{rate_hz} Hz"));
        writeln!(
            out,
            "{name:<width$}  {motors:>6}  {worst:>8.1} % {unstuffed:>8.1} % {poll:>9.1} %  {highest:>7}  {verdict}"
        )?;
    }
    write!(out, "{LEGEND}")?;
    imus::print(settings, out)
}

fn verdict(bus: &BusReport<'_>) -> String {
    let sent = match bus.unprompted_utilisation {
        0.0 => String::new(),
        part => format!("; motors send {:.1} % by themselves", 100.0 * part),
    };
    let rate = if bus.every == 1 { String::new() } else { format!("; each motor at {} Hz", bus.rate_hz) };
    match &bus.line {
        Some(line) => format!("{}{rate}; {}", line_verdict(line, bus.every), turns(line, bus.every)),
        None => format!("{}{rate}{sent}", can_verdict(bus)),
    }
}

fn turns(line: &LineReport, every: u32) -> String {
    let LineReport { bytes, wire_us, turnaround_us, turns, .. } = line;
    format!(
        "{turns} turns in {every} cycles, each {bytes} bytes in {wire_us:.0} µs and {turnaround_us:.0} µs of turnaround"
    )
}

fn line_verdict(line: &LineReport, every: u32) -> String {
    match line.every_least {
        least if every < least => format!("TOO FULL: it needs every = {least}"),
        _ => "fits".to_owned(),
    }
}

fn can_verdict(bus: &BusReport<'_>) -> &'static str {
    match bus {
        BusReport { motors: 0, has_imu: false, .. } => "empty",
        BusReport { is_late: true, .. } => "TOO FULL: lower the rate or move a motor",
        bus if bus.motors > 0 && bus.worst_case_utilisation > WORST_CASE_SOUND => {
            "tight: lower the rate or move a motor"
        }
        bus if bus.fault_poll_utilisation > 1.0 => {
            "fits; some fault polls wait for a cycle with free bus time"
        }
        _ => "fits",
    }
}
