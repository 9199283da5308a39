//! `motorctl setup`: compares the motors with their configuration, and writes the lock file.

use crate::failure::DirectFailure;
use crate::memory::outcome_of;
use crate::output::{Confirm, print_line};
use crate::target::{self, DEFAULT_CONFIG, OpenLine};
use motord_configuration as config;
use motord_configuration::lock::{Finding, Lock, Verdict, end_findings, end_lines, findings};
use motord_protocol::commissioning::{
    Error, LISTEN, Native, Private, ReportedMotor, ReportedProtocol, ends, survey,
};
use motord_protocol::gim::{CONFIGURATION, ConfigurationItem, Finite, Value, ValueType};
use motord_protocol::robstride::parameter::{TIMEOUT, TIMEOUT_HZ};
use motord_settings::settings::{MotorSettings, Settings};
use motord_terminal::{Cell, Colour, Interrupt, Palette, Table, json};
use serde::Serialize;
use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};

/// The options of `motorctl setup`.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The configuration.
    #[arg(long, value_name = "FILE", default_value = DEFAULT_CONFIG)]
    config: PathBuf,
    /// Only these motors.
    #[arg(long = "joint", value_name = "NAME")]
    joints: Vec<String>,
    /// Write differing torque constants, gear ratios and pole pairs into the motors, as configured,
    /// and a timeout of 200 ms into RobStride motors without one in their private protocol.
    /// Use `motorctl id` and `motorctl protocol` for ids and the protocol, with one motor
    /// connected.
    #[arg(long)]
    write: bool,
    /// Set up new motors, one after the other, by questions at a terminal: id, bit rate, zero, direction, range, protocol and a first
    /// motion by 2°. Give power to one motor at a time. The guide may be left and goes on where it was.
    #[arg(long, conflicts_with_all = ["write", "yes", "json"])]
    guide: bool,
    #[command(flatten)]
    confirm: Confirm,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Returns the configuration and the joints of `--guide`; `None` without it.
    pub(crate) fn guide(&self) -> Option<(&Path, &[String])> {
        self.guide.then_some((&*self.config, &*self.joints))
    }
}

/// `motorctl setup`. Fails with [`DirectFailure::Differs`] when a motor differs or does not answer.
pub(crate) fn run(arguments: &Arguments) -> Result<(), DirectFailure> {
    let settings = config::load(&arguments.config)?.settings;
    let motors = chosen(&settings, &arguments.joints)?;
    let interrupt = Interrupt::register();
    let mut asked = Vec::new();
    for index in 0..settings.buses.len() {
        let on_bus: Vec<_> = motors.iter().copied().filter(|motor| motor.bus == index).collect();
        let Some(mut line) = open(&settings, index, &on_bus)? else { continue };
        for motor in on_bus {
            if interrupt.is_raised() {
                return Err(Error::Interrupted.into());
            }
            progress(&motor.name);
            let bus = &settings.buses[index].name;
            let before = line.link.formats();
            let answer = ask(&settings, motor, bus, &mut line)?;
            let formats = line.link.formats().since(before);
            let formats = if answer.reported.is_some() { formats.frames() } else { formats };
            formats.advice().for_each(|advice| eprintln!("{}: while it is asked, {advice}", motor.name));
            asked.push(if arguments.write {
                write(&settings, answer, bus, &mut line, arguments.confirm)?
            } else {
                answer
            });
        }
    }
    progress("");
    let lock = store(&arguments.config, &settings, &asked)?;
    print(&asked, &lock, arguments.json)?;
    let differing = asked.iter().flat_map(ComparedMotor::open_findings).count();
    if differing == 0 { Ok(()) } else { Err(DirectFailure::Differs { count: differing }) }
}

/// A configured motor, its answers, and the comparison.
struct ComparedMotor<'s> {
    motor: &'s MotorSettings,
    reported: Option<ReportedMotor>,
    findings: Vec<Finding>,
    /// Lines for its table in the configuration: the ends of codes that it reports, where they are not the configured ones.
    lines: Option<String>,
    /// A RobStride motor continues with its last command when no command arrives.
    lacks_timeout: bool,
}

impl ComparedMotor<'_> {
    /// Returns the differences; for a silent motor, all findings.
    fn open_findings(&self) -> impl Iterator<Item = &Finding> {
        let is_silent = self.reported.is_none();
        self.findings.iter().filter(move |finding| is_silent || finding.verdict == Verdict::Differs)
    }
}

/// Returns the motors with these names, or all, in the order of the configuration.
///
/// # Errors
///
/// A name that no motor has.
pub(crate) fn chosen<'s>(
    settings: &'s Settings,
    joints: &[String],
) -> Result<Vec<&'s MotorSettings>, DirectFailure> {
    let unknown = joints.iter().find(|joint| settings.motors.iter().all(|motor| motor.name != **joint));
    if let Some(joint) = unknown {
        return Err(DirectFailure::Usage(format!("the configuration has no motor {joint}")));
    }
    let is_chosen = |motor: &&MotorSettings| joints.is_empty() || joints.contains(&motor.name);
    Ok(settings.motors.iter().filter(is_chosen).collect())
}

/// Asks the motor of `joint`, and stores its report in the lock file. Returns the differences from
/// the configuration.
///
/// # Errors
///
/// The bus accepts no frame, or the file cannot be written.
pub(crate) fn record(
    config: &Path,
    settings: &Settings,
    joint: &str,
    line: &mut OpenLine,
) -> Result<Vec<String>, DirectFailure> {
    let Some(motor) = settings.motors.iter().find(|motor| motor.name == joint) else { return Ok(Vec::new()) };
    let asked = ask(settings, motor, &settings.buses[motor.bus].name, line)?;
    let differences = asked.open_findings().map(ToString::to_string).collect();
    store(config, settings, &[asked])?;
    Ok(differences)
}

/// Opens the bus, and listens for drivers that report without a request; `None` for a simulated bus and for one without chosen motors.
pub(crate) fn open(
    settings: &Settings,
    index: usize,
    motors: &[&MotorSettings],
) -> Result<Option<OpenLine>, DirectFailure> {
    let bus = &settings.buses[index];
    let Some(address) = bus.kind.address().filter(|_| !motors.is_empty()) else { return Ok(None) };
    let mut line = target::open(address, bus.kind.bitrate())?;
    line.link.listen(LISTEN)?;
    Ok(Some(line))
}

fn ask<'s>(
    settings: &Settings,
    motor: &'s MotorSettings,
    bus: &str,
    line: &mut OpenLine,
) -> Result<ComparedMotor<'s>, DirectFailure> {
    let question = motor.protocol.family().question;
    let survey = survey(&mut line.link, motor.id, question, &CONFIGURATION)?;
    let reported = survey.map(|survey| survey.reported(&motor.name, bus));
    let mut findings = findings(settings, motor, reported.as_ref());
    let has_registers = motor.profile.has_registers && reported.is_some();
    let ends = if has_registers { ends(&mut line.link, motor.id, motor.host_id)? } else { None };
    findings.extend(ends.into_iter().flat_map(|ends| end_findings(motor, ends)));
    let lines = ends.and_then(|ends| end_lines(motor, ends));
    let is_private = reported.as_ref().is_some_and(|motor| motor.protocol == ReportedProtocol::RobStride);
    let lacks_timeout = is_private && lacks_timeout(line, motor.id)?;
    Ok(ComparedMotor { motor, reported, findings, lines, lacks_timeout })
}

/// Writes the differing constants after consent, and asks the motor again.
fn write<'s>(
    settings: &Settings,
    asked: ComparedMotor<'s>,
    bus: &str,
    line: &mut OpenLine,
    confirm: Confirm,
) -> Result<ComparedMotor<'s>, DirectFailure> {
    if asked.lacks_timeout {
        return write_timeout(settings, &asked, bus, line, confirm);
    }
    let changes = changes(&asked);
    if changes.is_empty() {
        return Ok(asked);
    }
    let name = &asked.motor.name;
    let listed: Vec<_> = asked.open_findings().map(|finding| format!("  {finding}")).collect();
    let names: Vec<_> = changes.iter().map(|(item, _)| item.name).collect();
    confirm.ask(&format!(
        "{}\nThis permanently writes {} into {name}.",
        listed.join("\n"),
        names.join(" and ")
    ))?;
    let mut motor = Native::new(&mut line.link, asked.motor.id, None);
    for (item, value) in changes {
        let confirmation = motor.store_configuration(item, value)?;
        eprintln!("{name}: {} {}", item.name, outcome_of(confirmation));
    }
    ask(settings, asked.motor, bus, line)
}

/// Time without commands after which a motor disables itself, ms. It is longer than the slowest
/// cycle, 10 Hz, and short for a robot whose computer has failed.
pub(crate) const TIMEOUT_MS: u32 = 200;

/// Writes the timeout of a RobStride motor after consent, and asks the motor again.
fn write_timeout<'s>(
    settings: &Settings,
    asked: &ComparedMotor<'s>,
    bus: &str,
    line: &mut OpenLine,
    confirm: Confirm,
) -> Result<ComparedMotor<'s>, DirectFailure> {
    let name = &asked.motor.name;
    confirm.ask(&format!(
        "This permanently lets {name} disable itself when it receives no command for {TIMEOUT_MS} ms (canTimeout)."
    ))?;
    store_timeout(line, asked.motor.id)?;
    eprintln!("{name}: canTimeout was 0, confirmed as {TIMEOUT_MS} ms");
    ask(settings, asked.motor, bus, line)
}

/// Stores the timeout in a RobStride motor, and reads it back.
///
/// # Errors
///
/// The motor does not answer, or does not keep it.
pub(crate) fn store_timeout(line: &mut OpenLine, id: u8) -> Result<(), Error> {
    let mut motor = Private::new(&mut line.link, id);
    motor.stop()?;
    motor.store("canTimeout", TIMEOUT, TIMEOUT_MS * (TIMEOUT_HZ / 1000))
}

/// Returns whether a RobStride motor continues with its last command when no command arrives.
///
/// # Errors
///
/// The bus accepts no frame.
pub(crate) fn lacks_timeout(line: &mut OpenLine, id: u8) -> Result<bool, Error> {
    Ok(Private::new(&mut line.link, id).read(TIMEOUT)? == Some([0; 4]))
}

/// Returns the differing constants of a GIM motor with their configured values.
fn changes(asked: &ComparedMotor<'_>) -> Vec<(&'static ConfigurationItem, Value)> {
    let is_native = asked.reported.as_ref().is_some_and(|motor| motor.protocol == ReportedProtocol::Gim);
    let Some(constants) = asked.motor.constants.filter(|_| is_native) else { return Vec::new() };
    let values = [constants.torque_constant, constants.gear_ratio, constants.pole_pairs.into()];
    let differs = |name: &str| asked.open_findings().any(|finding| finding.value == name);
    let named = ConfigurationItem::CONSTANTS.into_iter().zip(values).filter(|(name, _)| differs(name));
    named
        .filter_map(|(name, wanted)| {
            let item = ConfigurationItem::by_name(name)?;
            Some((item, value_of(item, wanted)?))
        })
        .collect()
}

/// Returns the number as a value of the item; `None` when it is not finite.
pub(crate) fn value_of(item: &ConfigurationItem, number: f64) -> Option<Value> {
    match item.value_type {
        ValueType::Integer => Some(Value::Integer(number.round() as i32)),
        ValueType::Float => Finite::new(number as f32).map(Value::Float),
    }
}

/// Writes the lock file. A motor that did not answer keeps its former entry.
fn store(config: &Path, settings: &Settings, asked: &[ComparedMotor<'_>]) -> Result<PathBuf, DirectFailure> {
    let before = Lock::load(config).ok().flatten();
    let now = |name: &str| {
        asked.iter().find(|asked| asked.motor.name == name).and_then(|asked| asked.reported.clone())
    };
    let then = |name: &str| before.as_ref().and_then(|lock| lock.motor(name).cloned());
    let motors = settings.motors.iter().filter_map(|motor| now(&motor.name).or_else(|| then(&motor.name)));
    let lock = Lock::new(motors.collect());
    lock.save(config)
        .map_err(|error| DirectFailure::Malformed { path: Lock::path(config), reason: error.to_string() })
}

/// Shows the motor that is asked, in one line of a terminal.
fn progress(motor: &str) {
    if io::stderr().is_terminal() {
        let text = if motor.is_empty() { String::new() } else { format!("asking {motor}") };
        eprint!("\r{text:60}\r");
    }
}

#[derive(Serialize)]
struct FindingRow<'a> {
    motor: &'a str,
    value: &'a str,
    configured: &'a str,
    reported: Option<&'a str>,
    verdict: &'static str,
    cure: Option<&'a str>,
}

impl<'a> FindingRow<'a> {
    fn of(finding: &'a Finding) -> Self {
        let Finding { motor, value, configured, reported, verdict, cure } = finding;
        Self {
            motor,
            value,
            configured,
            reported: reported.as_deref(),
            verdict: match verdict {
                Verdict::Agrees => "agrees",
                Verdict::Differs => "differs",
                Verdict::Unknown => "unknown",
            },
            cure: (*verdict != Verdict::Agrees).then_some(cure),
        }
    }
}

fn print(asked: &[ComparedMotor<'_>], lock: &Path, as_json: bool) -> Result<(), DirectFailure> {
    #[derive(Serialize)]
    struct Setup<'a> {
        motors: usize,
        answered: usize,
        findings: Vec<FindingRow<'a>>,
        lock: &'a Path,
    }
    let findings: Vec<FindingRow<'_>> =
        asked.iter().flat_map(|asked| asked.findings.iter().map(FindingRow::of)).collect();
    let answered = asked.iter().filter(|asked| asked.reported.is_some()).count();
    let out = &mut io::stdout().lock();
    if as_json {
        return Ok(json::write_line(out, &Setup { motors: asked.len(), answered, findings, lock })?);
    }
    let mut table = Table::new(&["motor", "value", "configured", "in the motor", "verdict"]);
    for row in &findings {
        let colour = match row.verdict {
            "differs" => Colour::Red,
            "unknown" => Colour::Magenta,
            _ => Colour::Plain,
        };
        let cells = [row.motor, row.value, row.configured, row.reported.unwrap_or("-")];
        let cells = cells.map(Cell::plain).into_iter().chain([Cell::new(row.verdict, colour)]);
        table.row(cells.collect());
    }
    table.write(out, Palette::of_stdout())?;
    for finding in asked.iter().flat_map(ComparedMotor::open_findings) {
        print_line(&format!("{finding}"))?;
    }
    for (name, lines) in asked.iter().filter_map(|asked| Some((&asked.motor.name, asked.lines.as_ref()?))) {
        print_line(&format!(
            "{name}: its codes end elsewhere than its model's, and the daemon uses the ends that it reports. To accept only a motor \
             with these, write in its [[motor]]:\n{lines}"
        ))?;
    }
    for ComparedMotor { motor, .. } in asked.iter().filter(|asked| asked.lacks_timeout) {
        print_line(&format!(
            "{}: without commands it continues with the last one, because its timeout (canTimeout, 0x7028) is off. `motorctl setup --write` \
             sets it to {TIMEOUT_MS} ms",
            motor.name
        ))?;
    }
    print_silent(asked)?;
    print_line(&format!(
        "{answered} of {} motors answered; their answers are in {}",
        asked.len(),
        lock.display()
    ))
}

/// Prints the motors that do not answer, in one line.
fn print_silent(asked: &[ComparedMotor<'_>]) -> Result<(), DirectFailure> {
    let silent = asked.iter().filter(|asked| asked.reported.is_none());
    let silent: Vec<_> =
        silent.map(|asked| format!("{} (id {})", asked.motor.name, asked.motor.id)).collect();
    match silent.len() {
        0 => Ok(()),
        1 => print_line(&format!("1 does not answer: {}", silent.join(", "))),
        count => print_line(&format!("{count} do not answer: {}", silent.join(", "))),
    }
}
