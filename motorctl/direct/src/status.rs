//! `motorctl version`, `fault` and `indicator` on the bus.

use crate::failure::DirectFailure;
use crate::memory::expected_one_of;
use crate::motor;
use crate::output::{Confirm, print_line};
use crate::target::{Protocol, Session, Target};
use motord_protocol::Faults;
use motord_protocol::commissioning::Error;
use motord_protocol::gim::{INDICATORS, Indicator};
use motord_shared::Fault;
use motord_terminal::{Cell, Interrupt, Palette, Table, json};
use serde::Serialize;
use std::io;
use std::time::{Duration, Instant};

/// `motorctl version`.
pub(crate) fn version(target: &Target, as_json: bool) -> Result<(), DirectFailure> {
    #[derive(Serialize)]
    struct Version {
        id: u8,
        version: u32,
    }
    let mut session = target.open()?;
    if session.protocol == Protocol::RobStride {
        let numbers =
            session.private().version()?.ok_or_else(|| session.unfit("its firmware reports no version"))?;
        let version = u32::from_be_bytes(numbers);
        if as_json {
            return Ok(json::write_line(&mut io::stdout().lock(), &Version { id: session.id, version })?);
        }
        let [a, b, c, d] = numbers;
        return print_line(&format!("{}: firmware version {a}.{b}.{c}.{d}", session.name()));
    }
    if session.protocol == Protocol::MyActuator {
        let version = session.rmd().version()?;
        if as_json {
            return Ok(json::write_line(&mut io::stdout().lock(), &Version { id: session.id, version })?);
        }
        return print_line(&format!("{}: firmware of {version}", session.name()));
    }
    let mut session = session.require_gim()?;
    let version = session.gim().version().map_err(|error| session.explain(error))?;
    if as_json {
        return Ok(json::write_line(&mut io::stdout().lock(), &Version { id: session.id, version })?);
    }
    print_line(&format!("{}: firmware version {version} ({version:#010X})", session.name()))
}

/// A fault with its meaning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct NamedFault {
    /// A word for scripts.
    pub name: &'static str,
    /// The fault in a sentence.
    pub meaning: &'static str,
}

/// `motorctl fault get` on the bus.
pub(crate) fn fault(target: &Target, as_json: bool) -> Result<(), DirectFailure> {
    #[derive(Serialize)]
    struct ReportedFaults {
        id: u8,
        bits: u32,
        faults: Vec<NamedFault>,
        unknown_bits: u32,
    }
    let mut session = target.open()?;
    let reported = read_faults(&mut session)?;
    let named = |fault: Fault| NamedFault { name: fault.name(), meaning: fault.sentence() };
    let faults: Vec<NamedFault> = Fault::of_bits(reported.0).map(named).collect();
    let unknown_bits = Fault::unnamed(reported.0);
    if as_json {
        let report = ReportedFaults { id: session.id, bits: reported.0, faults, unknown_bits };
        return Ok(json::write_line(&mut io::stdout().lock(), &report)?);
    }
    print_faults(&session.name(), &faults, unknown_bits)
}

/// Prints the faults of a motor or joint, one per line. `unknown_bits` have no name.
///
/// # Errors
///
/// When the output cannot be written.
pub fn print_faults(subject: &str, faults: &[NamedFault], unknown_bits: u32) -> Result<(), DirectFailure> {
    if faults.is_empty() && unknown_bits == 0 {
        return print_line(&format!("{subject}: no fault"));
    }
    for NamedFault { name, meaning } in faults {
        print_line(&format!("{subject}: {name}: {meaning}"))?;
    }
    match unknown_bits {
        0 => Ok(()),
        bits => print_line(&format!("{subject}: fault bits {bits:#04X}, which are in no document")),
    }
}

/// Reads the faults. A motor in MIT mode is stopped first, because other firmware reads the
/// question as a control frame of full stiffness. A motor with a fault may not answer the stop.
fn read_faults(session: &mut Session) -> Result<Faults, Error> {
    match session.protocol {
        Protocol::Mit => {
            let _silent = session.mit().stop();
            session.mit().fault()
        }
        Protocol::Gim => Ok(session.gim().fault()?.faults()),
        Protocol::RobStride => session.private().fault(),
        Protocol::CanSimple => session.axis().fault(),
        Protocol::MyActuator => session.rmd().fault(),
        Protocol::ODrive => session.odrive().fault(),
    }
}

/// `motorctl fault clear --bus`: clears the fault and reads the faults again.
pub fn clear_fault(target: &Target) -> Result<(), DirectFailure> {
    let mut session = target.open()?;
    if session.protocol == Protocol::Mit {
        let _silent = session.mit().stop();
    }
    motor::clear_fault(&mut session)?;
    let left = read_faults(&mut session)?;
    if left.is_none() {
        return print_line(&format!("{}: the fault is cleared", session.name()));
    }
    let names: Vec<&str> = Fault::of_bits(left.0).map(Fault::name).collect();
    let reason = format!(
        "the motor reports the fault again, because its cause remains: {} (bits {:#04X})",
        names.join(", "),
        left.0
    );
    Err(session.unfit(&reason))
}

/// `motorctl start`: enters the running state, without a command to follow.
pub(crate) fn start(target: &Target, confirm: Confirm) -> Result<(), DirectFailure> {
    let mut session = target.open_gim()?;
    confirm.ask(&format!(
        "This starts {}: it is energised and follows the next control command.",
        session.name()
    ))?;
    session.gim().start()?;
    print_line(&format!("{}: started; `motorctl stop` stops it", session.name()))
}

/// `motorctl stop`: leaves the running state. `control_only` ends only the present command.
pub(crate) fn stop(target: &Target, control_only: bool) -> Result<(), DirectFailure> {
    let mut session = target.open()?;
    let done = match (session.protocol, control_only) {
        (_, false) => session.stop(),
        (Protocol::Gim, true) => session.gim().stop_control(),
        (_, true) => return Err(session.unfit("its protocol has no such command: leave --control out")),
    };
    done?;
    print_line(&format!(
        "{}: {}",
        session.name(),
        if control_only { "the control command ended" } else { "stopped" }
    ))
}

/// The options of `motorctl indicator`.
#[derive(Debug, Clone, clap::Args)]
pub struct Indicators {
    /// The joint, without --bus and --config. Then names or numbers of indicators; the default is
    /// all.
    #[arg(value_name = "NAME")]
    names: Vec<String>,
    #[command(flatten)]
    target: Target,
    /// Read again every second until Ctrl-C.
    #[arg(long)]
    watch: bool,
    /// Print one JSON array for each reading.
    #[arg(long)]
    json: bool,
}

impl Indicators {
    /// Returns the joint whose indicators the daemon returns; `None` with a bus.
    #[must_use]
    pub fn joint(&self) -> Option<&str> {
        self.names.first().filter(|_| !self.target.is_given()).map(String::as_str)
    }

    fn wanted(&self) -> Result<Vec<&'static Indicator>, DirectFailure> {
        let names = &self.names[usize::from(self.joint().is_some())..];
        if names.is_empty() {
            return Ok(INDICATORS.iter().collect());
        }
        let wanted = names.iter().map(|name| {
            parse_indicator(name)
                .map_err(|expected| DirectFailure::Usage(format!("no indicator is `{name}`: {expected}")))
        });
        wanted.collect()
    }

    /// Prints the chosen indicators, once or every second until Ctrl-C. `read` returns the value of
    /// the indicator with a number (GIM document, table 10), or `None` to leave it out.
    ///
    /// # Errors
    ///
    /// An unknown name, output that cannot be written, and the errors of `read`.
    pub fn print<E: From<DirectFailure>>(
        &self,
        mut read: impl FnMut(u8) -> Result<Option<f32>, E>,
    ) -> Result<(), E> {
        let interrupt = Interrupt::register();
        let wanted = self.wanted()?;
        loop {
            let mut readings = Vec::with_capacity(wanted.len());
            for &&Indicator { id, name, unit } in &wanted {
                readings.extend(read(id)?.map(|value| IndicatorReading { name, value, unit }));
            }
            write_readings(&readings, self.json).map_err(DirectFailure::Output)?;
            if self.watch {
                interrupt.pause_until(Instant::now() + Duration::from_secs(1));
            }
            if !self.watch || interrupt.is_raised() {
                return Ok(());
            }
        }
    }
}

#[derive(Serialize)]
struct IndicatorReading {
    name: &'static str,
    value: f32,
    unit: &'static str,
}

fn write_readings(readings: &[IndicatorReading], as_json: bool) -> io::Result<()> {
    let out = &mut io::stdout().lock();
    if as_json {
        return json::write_line(out, &readings);
    }
    let mut table = Table::new(&["indicator", "value", "unit"]);
    for IndicatorReading { name, value, unit } in readings {
        let value = Cell::number(Some(f64::from(*value)), 3);
        table.row(vec![Cell::plain(*name), value, Cell::plain(*unit)]);
    }
    table.write(out, Palette::of_stdout())
}

fn parse_indicator(text: &str) -> Result<&'static Indicator, String> {
    let by_number = || u8::try_from(super::target::number(text)?).ok().and_then(Indicator::by_id);
    let unknown = || expected_one_of(INDICATORS.iter().map(|indicator| indicator.name));
    Indicator::by_name(text).or_else(by_number).ok_or_else(unknown)
}

/// `motorctl indicator` on the bus.
pub(crate) fn indicators(arguments: &Indicators) -> Result<(), DirectFailure> {
    // Reject wrong names before a motor is asked.
    arguments.wanted()?;
    let mut session = arguments.target.open()?;
    if session.protocol == Protocol::CanSimple {
        return arguments.print(|number| Ok(supply(&mut session, number)?));
    }
    let mut session = session.require_gim()?;
    arguments.print(|number| Ok(Some(session.gim().indicator(number)?)))
}

/// Returns voltage or power of the supply of a CANSimple driver; `None` for other indicators.
fn supply(session: &mut Session, number: u8) -> Result<Option<f32>, Error> {
    if ![Indicator::BUS_VOLTAGE, Indicator::POWER].contains(&number) {
        return Ok(None);
    }
    let supply = session.axis().supply()?;
    Ok(supply.map(|[volts, amperes]| if number == Indicator::BUS_VOLTAGE { volts } else { volts * amperes }))
}
