//! The answers of the motors to the frames of `motord safe-stop`.

use motord_bus::transport::{self, Nodes};
use motord_bus::{Bus, Content, Duration, Frame, IdFilter, IdSet, Inbox, clock};
use motord_core::drive::safe_frames;
use motord_settings::nodes::nodes;
use motord_settings::settings::{BusSettings, MotorSettings, Settings};

/// Longest wait for answers on CAN after the last frame: an adapter on USB takes a few
/// milliseconds.
const CAN_TIMEOUT: Duration = Duration::from_millis(50);
/// Longest wait for a motor that confirms its stop by a report: a CANSimple driver sends one every
/// 100 ms.
const REPORT_TIMEOUT: Duration = Duration::from_millis(250);
/// Longest wait for the answer of one motor on a line: an adapter on USB may keep bytes for 16 ms.
const LINE_TIMEOUT: Duration = Duration::from_millis(20);
/// Longest wait for the answers of all motors on lines.
const LINES_TIMEOUT: Duration = Duration::from_millis(500);
/// A silent motor on a line is asked this often.
const ATTEMPTS: u32 = 2;
/// Period of the reads.
const TURN: Duration = Duration::from_millis(2);
/// Most reads that empty a receive buffer.
const DRAINS_MAX: usize = 1024;

/// Opens a bus that is no line by its address to receive every frame; `None` where it cannot be
/// read.
pub type Listen<'a> = &'a mut dyn FnMut(&str) -> Option<Box<dyn Bus>>;

/// A motor that was commanded to stop.
struct Commanded {
    name: String,
    /// The ids of its answers.
    answers: IdSet,
    /// A stop that it answers, on a line.
    stop: Option<Frame>,
    /// Returns whether a frame with such an id confirms the stop; `None` where each one does.
    confirms: Option<fn(&Frame) -> bool>,
}

impl Commanded {
    fn is_confirmed_by(&self, frame: &Frame) -> bool {
        self.answers.matches(frame.id()) && self.confirms.is_none_or(|confirms| confirms(frame))
    }
}

/// An interface with its motors that have not answered yet.
struct Ear {
    interface: String,
    bus: Box<dyn Bus>,
    silent: Vec<Commanded>,
    /// The next motor of a line to ask.
    next: usize,
}

/// A line whose motors are asked after their stop.
struct AskedLine {
    settings: BusSettings,
    nodes: Nodes,
    commanded: Vec<Commanded>,
}

/// The interfaces on which answers are awaited.
///
/// An answer on a line names its receiver, and not the motor: each motor is commanded to stop once
/// more, one after another.
pub(crate) struct Answers {
    ears: Vec<Ear>,
    lines: Vec<AskedLine>,
    unchecked: Vec<String>,
}

impl Answers {
    /// Opens the CAN interfaces among `interfaces`, before the first frame is sent. Allocates.
    pub(crate) fn listen(settings: &Settings, interfaces: &[String], listen: Listen<'_>) -> Self {
        let mut answers = Self { ears: Vec::new(), lines: Vec::new(), unchecked: Vec::new() };
        for (index, bus) in settings.buses.iter().enumerate() {
            if !interfaces.iter().any(|interface| interface == bus.device()) {
                continue;
            }
            let commanded = commanded(settings, index);
            if bus.is_line() {
                let nodes = nodes(settings, index, LINE_TIMEOUT);
                answers.lines.push(AskedLine { settings: bus.clone(), nodes, commanded });
                continue;
            }
            match bus.kind.address().and_then(&mut *listen) {
                Some(ear) => answers.ears.push(Ear::new(bus.device(), ear, commanded)),
                None => answers.unchecked.extend(commanded.into_iter().map(|motor| motor.name)),
            }
        }
        answers
    }

    /// Reads what has arrived, asks the motors on lines, and returns the names of those that did
    /// not answer, except those on `left_out` interfaces. The ports must not be in use. Takes at
    /// most [`LINES_TIMEOUT`], or without a line [`REPORT_TIMEOUT`], and the time to open the ports.
    pub(crate) fn silent(&mut self, left_out: &[String]) -> Vec<String> {
        self.ears.retain(|ear| !left_out.contains(&ear.interface));
        self.lines.retain(|line| !left_out.iter().any(|interface| interface == line.settings.device()));
        let longest = self.lines.iter().map(|line| line.commanded.len() as u32).max().unwrap_or(0);
        let timeout = (longest * ATTEMPTS * (LINE_TIMEOUT + TURN)).min(LINES_TIMEOUT).max(CAN_TIMEOUT);
        let awaits_report =
            self.ears.iter().flat_map(|ear| &ear.silent).any(|motor| motor.confirms.is_some());
        let timeout = if awaits_report { timeout.max(REPORT_TIMEOUT) } else { timeout };
        self.open_lines();
        let end = clock::monotonic() + timeout;
        loop {
            self.ears.iter_mut().for_each(Ear::turn);
            let silent: Vec<_> = self.ears.iter().flat_map(|ear| &ear.silent).collect();
            if silent.is_empty() || clock::monotonic() >= end {
                return silent.into_iter().map(|motor| motor.name.clone()).collect();
            }
            std::thread::sleep(TURN);
        }
    }

    fn open_lines(&mut self) {
        for AskedLine { settings, nodes, commanded } in self.lines.drain(..) {
            match settings.kind.hardware().map(|hardware| hardware.open(&nodes, None)) {
                Some(Ok(opened)) => self.ears.push(Ear::new(settings.device(), opened.bus, commanded)),
                outcome => {
                    if let Some(Err(error)) = outcome {
                        tracing::debug!("{error}");
                    }
                    self.unchecked.extend(commanded.into_iter().map(|motor| motor.name));
                }
            }
        }
    }

    /// The names of the motors whose answers are not read.
    pub(crate) fn unchecked(&self) -> &[String] {
        &self.unchecked
    }
}

/// Returns the motors of the bus with this index.
fn commanded(settings: &Settings, index: usize) -> Vec<Commanded> {
    let is_line = settings.buses[index].is_line();
    let commanded = |motor: &MotorSettings| Commanded {
        name: motor.name.clone(),
        answers: if is_line { IdFilter::exact(motor.command_id()).into() } else { motor.addresses().replies },
        stop: safe_frames(motor).map(|(_, stop)| stop).filter(|_| is_line),
        confirms: motor.protocol.family().confirms_stop,
    };
    settings.motors.iter().filter(|motor| motor.bus == index).map(commanded).collect()
}

impl Ear {
    fn new(interface: &str, bus: Box<dyn Bus>, silent: Vec<Commanded>) -> Self {
        Self { interface: interface.to_owned(), bus, silent, next: 0 }
    }

    /// Reads, and asks the next silent motor of a line. The line refuses while it awaits an answer.
    fn turn(&mut self) {
        self.read();
        let next = self.next % self.silent.len().max(1);
        let Some(stop) = self.silent.get(next).and_then(|motor| motor.stop) else { return };
        if self.bus.send(clock::monotonic(), &[stop]).accepted > 0 {
            self.next = next + 1;
        }
    }

    /// Removes the motors whose answers have arrived.
    fn read(&mut self) {
        let mut inbox = Inbox::new();
        for _ in 0..DRAINS_MAX {
            inbox.clear();
            self.bus.receive(clock::monotonic(), &mut inbox);
            if inbox.arrivals().is_empty() {
                return;
            }
            for arrival in inbox.arrivals() {
                if let Content::Frame(frame) = arrival.content {
                    self.silent.retain(|motor| !motor.is_confirmed_by(&frame));
                }
            }
        }
    }
}

/// Opens an interface of this machine as it is, to receive.
pub fn listen_on(name: &str) -> Option<Box<dyn Bus>> {
    let kind = transport::find(name, 0)?;
    let opened = kind.hardware()?.open_as_is(&Nodes::none());
    opened.inspect_err(|error| tracing::debug!("{error}")).ok().map(|opened| opened.bus)
}
