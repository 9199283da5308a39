//! `motorctl scan` and `motorctl ping`.

use crate::failure::DirectFailure;
use crate::output::print_line;
use crate::target::{self, OpenLine, Target};
use motord_bus::FrameId;
use motord_protocol::commissioning::{Error, Family, Found, Progress, Report, Scan, Unprompted, scan};
use motord_terminal::{Cell, Interrupt, Palette, Table, json};
use serde::Serialize;
use std::io::{self, IsTerminal};
use std::ops::RangeInclusive;
use std::sync::mpsc::{self, Receiver, Sender};

/// The options of `motorctl scan`.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// CAN interface or serial device. Repeat the option for several, which are scanned in
    /// parallel.
    #[arg(long = "bus", value_name = "BUS", required = true)]
    buses: Vec<String>,
    /// Bit/s of the serial devices.
    #[arg(long, value_name = "BIT/S", default_value_t = target::BAUD, value_parser = clap::value_parser!(u32).range(1..))]
    baud: u32,
    /// The ids to ask: FIRST-LAST, within 1 to 254.
    #[arg(long, value_name = "IDS", default_value = "1-254", value_parser = parse_ids)]
    ids: RangeInclusive<u8>,
    /// Also ask silent ids for their fault: a motor with a fault may answer nothing else. Only for
    /// buses whose drivers are all SDC101, SDC102 or SDC103: other drivers read the question as a
    /// speed limit.
    #[arg(long)]
    in_fault: bool,
    /// Also ask ids that a CANSimple driver (SDC104, ODrive) on the bus obeys, such as one that sets its node id. Without this
    /// option the command listens first, and leaves out the ids of a driver that reports, and 30, 31, 62 and 63: a silent driver
    /// with a factory id would leave CAN, save its configuration or enter its boot loader.
    #[arg(long)]
    yes: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

fn parse_ids(text: &str) -> Result<RangeInclusive<u8>, String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let ids = target::parse_id(first)?..=target::parse_id(last)?;
    if ids.is_empty() { Err("expected FIRST-LAST".to_owned()) } else { Ok(ids) }
}

#[derive(Serialize)]
struct ScannedMotor<'a> {
    bus: &'a str,
    id: u8,
    host_id: Option<u32>,
    protocol: &'static str,
    family: &'static str,
    refuses: Option<String>,
    answer: Option<String>,
}

impl<'a> ScannedMotor<'a> {
    fn new(bus: &'a str, found: &Found) -> Self {
        let (protocol, answer) = match found.family {
            Family::Native => ("gim", None),
            Family::Mit => ("mit", None),
            Family::OtherMit { .. } => ("mit-other", None),
            Family::RobStride { serial } => {
                ("robstride", Some(format!("serial number {:016X}", u64::from_be_bytes(serial))))
            }
            Family::CanSimple => ("cansimple", None),
            Family::MyActuator => ("myactuator", None),
            Family::Unknown { answer } => ("unknown", Some(format!("{answer:?}"))),
        };
        Self {
            bus,
            id: found.id,
            host_id: found.host_id.map(FrameId::raw),
            protocol,
            family: found.family.describe(),
            refuses: found.refusal.map(|refusal| refusal.to_string()),
            answer,
        }
    }
}

#[derive(Serialize)]
struct ScanOutput<'a> {
    motors: Vec<ScannedMotor<'a>>,
    notes: Vec<String>,
}

/// `motorctl scan`: finds the motors of buses.
pub(crate) fn run(arguments: &Arguments) -> Result<(), DirectFailure> {
    if let Some(bus) =
        arguments.buses.iter().enumerate().find(|(at, bus)| arguments.buses[..*at].contains(bus))
    {
        return Err(DirectFailure::Usage(format!("--bus {} is given twice", bus.1)));
    }
    let interrupt = Interrupt::register();
    let opened = arguments.buses.iter().map(|bus| target::open(bus, arguments.baud));
    let lines = opened.collect::<Result<Vec<OpenLine>, DirectFailure>>()?;
    let settings = Scan {
        ids: arguments.ids.clone(),
        in_fault: arguments.in_fault,
        obeyed: arguments.yes,
        ..Scan::default()
    };
    let (sender, receiver) = mpsc::channel();
    let reports = std::thread::scope(|scope| {
        let scans: Vec<_> = lines
            .into_iter()
            .map(|line| {
                let (sender, interrupt, settings) = (sender.clone(), interrupt.clone(), settings.clone());
                scope.spawn(move || one(line, &settings, &sender, &interrupt))
            })
            .collect();
        drop(sender);
        show_progress(&receiver, &arguments.ids, scans.len());
        let joined = scans.into_iter().map(|scan| scan.join().unwrap_or(Err(Error::Interrupted)));
        joined.collect::<Vec<Result<Report, Error>>>()
    });
    let reports = reports.into_iter().collect::<Result<Vec<Report>, Error>>()?;
    print(&arguments.buses, &reports, arguments.json)
}

fn one(
    mut line: OpenLine,
    settings: &Scan,
    sender: &Sender<Progress>,
    interrupt: &Interrupt,
) -> Result<Report, Error> {
    scan(&mut line.link, settings, &mut |progress| {
        let _unread = sender.send(progress);
        !interrupt.is_raised()
    })
}

/// Shows the progress in one line of a terminal, until the last scan ends.
fn show_progress(receiver: &Receiver<Progress>, ids: &RangeInclusive<u8>, buses: usize) {
    let total = (usize::from(ids.end() - ids.start()) + 1) * buses;
    let mut asked = 0;
    for _ in receiver {
        asked += 1;
        if io::stderr().is_terminal() {
            eprint!("\r{asked} of {total} ids asked");
        }
    }
    if io::stderr().is_terminal() {
        eprint!("\r{:40}\r", "");
    }
}

fn print(buses: &[String], reports: &[Report], as_json: bool) -> Result<(), DirectFailure> {
    let named = || buses.iter().zip(reports);
    let motors: Vec<ScannedMotor<'_>> = named()
        .flat_map(|(bus, report)| report.found.iter().map(|found| ScannedMotor::new(bus, found)))
        .collect();
    let notes: Vec<String> = named().flat_map(|(bus, report)| notes(bus, report)).collect();
    let out = &mut io::stdout().lock();
    if as_json {
        return Ok(json::write_line(out, &ScanOutput { motors, notes })?);
    }
    let mut table = Table::new(&["bus", "id", "host id", "protocol", "driver"]);
    for motor in &motors {
        let host_id = motor.host_id.map_or("-".to_owned(), |id| format!("{id:#05X}"));
        let driver = [Some(motor.family.to_owned()), motor.refuses.clone(), motor.answer.clone()];
        let driver = driver.into_iter().flatten().collect::<Vec<_>>().join("; ");
        let cells = [motor.bus.to_owned(), motor.id.to_string(), host_id, motor.protocol.to_owned(), driver];
        table.row(cells.map(Cell::plain).into());
    }
    table.write(out, Palette::of_stdout())?;
    let count = motors.len();
    let plural = if count == 1 { "" } else { "s" };
    eprintln!(
        "{count} motor{plural}; motors without power, with another bit rate or with a fault are silent"
    );
    notes.iter().for_each(|note| eprintln!("{note}"));
    Ok(())
}

fn notes(bus: &str, report: &Report) -> Vec<String> {
    let mut notes = Vec::new();
    let doubled =
        report.found.windows(2).filter(|pair| is_doubled(&pair[0], &pair[1])).map(|pair| pair[0].id);
    for id in doubled.chain(report.collisions.iter().copied()) {
        notes.push(format!(
            "{bus}: several motors answer as id {id}: connect them one at a time, and give each its own id"
        ));
    }
    for advice in report.unasked_formats.advice() {
        notes.push(format!("{bus}: without a request, {advice}"));
    }
    for id in &report.unasked {
        notes.push(format!(
            "{bus}: frames with id {} arrive without a request, so no answer with this id counts: stop the program or node that sends \
             them, and scan again",
            frame_id(*id)
        ));
    }
    for (id, formats) in &report.formats {
        let is_found = report.found.iter().any(|found| found.id == *id);
        let formats = if is_found { formats.frames() } else { *formats };
        notes.extend(formats.advice().map(|advice| format!("{bus}: while id {id} is asked, {advice}")));
    }
    if !report.lasting.is_empty() {
        let ids = report.lasting.iter().map(u8::to_string).collect::<Vec<_>>().join(", ");
        notes.push(format!(
            "{bus}: not asked: {ids}. A silent CANSimple driver with a factory id would leave CAN, save its configuration or enter its \
             boot loader; with --yes they are asked"
        ));
    }
    for driver in &report.unprompted {
        notes.push(match driver {
            Unprompted::CanSimple { node } => can_simple(bus, *node, !report.skipped.is_empty()),
            Unprompted::CustomFault { id } => format!(
                "{bus}: a driver with the \"custom\" protocol (GDZ, GDS) and id {} reports a fault: not supported",
                id.raw()
            ),
        });
    }
    notes
}

/// Returns an id of a frame as text.
pub(crate) fn frame_id(id: FrameId) -> String {
    format!("{:#05X}", id.raw())
}

/// Returns whether two motors have one id. A node id is another number than an id.
pub(crate) fn is_doubled(one: &Found, other: &Found) -> bool {
    let is_node = |found: &Found| found.family == Family::CanSimple;
    one.id == other.id && is_node(one) == is_node(other)
}

/// The note on a CANSimple driver. Source of the commands: GIM6010-8 manual, chapter 4.
fn can_simple(bus: &str, node: u8, is_skipped: bool) -> String {
    let id = |command: u16| (u16::from(node) << 5) + command;
    let which = if node == 0 { ", those of MIT motors 1 to 31" } else { "" };
    let outcome =
        if is_skipped { "these ids were not asked; with --yes they are" } else { "they were asked" };
    format!(
        "{bus}: the CANSimple driver with node id {node} reports by itself. It obeys the ids {} to {}{which}, such as {} (emergency stop), \
         {} (its node id), {} (axis state), {} (MIT control) and {} (saves; on an ODrive Pro the boot loader): {outcome}. Beside MIT \
         motors with such ids give it another node id, alone on the cable (`motorctl id --protocol cansimple`)",
        id(0),
        id(0x1F),
        id(0x02),
        id(0x06),
        id(0x07),
        id(0x08),
        id(0x1F),
    )
}

/// `motorctl ping`: measures the answer of a motor.
pub(crate) fn ping(target: &Target, as_json: bool) -> Result<(), DirectFailure> {
    #[derive(Serialize)]
    struct Ping<'a> {
        bus: &'a str,
        id: u8,
        host_id: Option<u32>,
        protocol: &'static str,
        answer_us: u64,
    }
    let mut session = target.open()?;
    let begun = session.line.link.now();
    let protocol = match session.protocol {
        target::Protocol::Mit => session.mit().stop().map(|_| "mit"),
        target::Protocol::Gim => session.gim().version().map(|_| "gim"),
        target::Protocol::RobStride => session.private().stop().map(|_| "robstride"),
        target::Protocol::CanSimple => session.axis().estimates().map(|_| "cansimple"),
        target::Protocol::MyActuator => session.rmd().status().map(|_| "myactuator"),
        target::Protocol::ODrive => session.odrive().estimates().map(|_| "odrive"),
    }
    .map_err(|error| session.explain(error))?;
    let elapsed = session.line.link.now().since(begun);
    let host_id = session.host_id.map(FrameId::raw);
    let answer_us = u64::try_from(elapsed.as_micros()).unwrap_or(u64::MAX);
    let out = &mut io::stdout().lock();
    if as_json {
        let ping = Ping { bus: &session.line.name, id: session.id, host_id, protocol, answer_us };
        return Ok(json::write_line(out, &ping)?);
    }
    let host = host_id.map_or_else(String::new, |id| format!(", host id {id:#05X}"));
    let line = format!("{} answers in {answer_us} µs, protocol {protocol}{host}", session.name());
    print_line(&line)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn node_zero_is_named_with_what_it_obeys() {
        let report = Report {
            unprompted: vec![Unprompted::CanSimple { node: 0 }],
            skipped: (1..=31).collect(),
            ..Report::default()
        };
        let [note] = &notes("can0", &report)[..] else { panic!("one note") };
        for part in [
            "node id 0",
            "0 to 31, those of MIT motors 1 to 31",
            "2 (emergency stop)",
            "6 (its node id)",
            "--yes",
        ] {
            assert!(note.contains(part), "{note}");
        }
    }
}
