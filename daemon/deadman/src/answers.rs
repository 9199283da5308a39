//! The answers of the motors to the frames of `motord safe-stop`.

use motord_bus::socketcan::{InterfaceName, SocketCanBus};
use motord_bus::{Bus, Content, Duration, FrameId, Inbox, clock};
use motord_core::settings::Settings;

/// Longest wait for answers after the last frame: an adapter on USB takes a few milliseconds.
const PATIENCE: Duration = Duration::from_millis(50);
/// Period of the reads.
const TURN: Duration = Duration::from_millis(2);
/// Most reads that empty a receive buffer.
const DRAINS_MAX: usize = 1024;

/// Opens a CAN interface by name to receive every frame; `None` where it cannot be read.
pub type Listen<'a> = &'a mut dyn FnMut(&str) -> Option<Box<dyn Bus>>;

/// A motor that was commanded to stop.
struct Commanded {
    name: String,
    host_id: FrameId,
}

/// An interface with its motors that have not answered yet.
struct Ear {
    interface: String,
    bus: Box<dyn Bus>,
    silent: Vec<Commanded>,
}

/// The interfaces on which answers are awaited.
pub(crate) struct Answers {
    ears: Vec<Ear>,
    unchecked: Vec<String>,
}

impl Answers {
    /// Opens the CAN interfaces among `interfaces`, before the first frame is sent. Serial lines are not read. Allocates.
    pub(crate) fn listen(settings: &Settings, interfaces: &[String], listen: Listen<'_>) -> Self {
        let mut answers = Self { ears: Vec::new(), unchecked: Vec::new() };
        for (index, bus) in settings.buses.iter().enumerate() {
            if !interfaces.iter().any(|interface| interface == bus.device()) {
                continue;
            }
            let motors = settings.motors.iter().filter(|motor| motor.bus == index);
            let commanded =
                motors.map(|motor| Commanded { name: motor.name.clone(), host_id: motor.host_id });
            match bus.interface().and_then(&mut *listen) {
                Some(ear) => {
                    let interface = bus.device().to_owned();
                    answers.ears.push(Ear { interface, bus: ear, silent: commanded.collect() });
                }
                None => answers.unchecked.extend(commanded.map(|motor| motor.name)),
            }
        }
        answers
    }

    /// Reads what has arrived, at most for [`PATIENCE`], and returns the names of the motors that did not answer, except those on
    /// `left_out` interfaces.
    pub(crate) fn silent(&mut self, left_out: &[String]) -> Vec<String> {
        self.ears.retain(|ear| !left_out.contains(&ear.interface));
        let end = clock::monotonic() + PATIENCE;
        loop {
            self.ears.iter_mut().for_each(Ear::read);
            let silent: Vec<_> = self.ears.iter().flat_map(|ear| &ear.silent).collect();
            if silent.is_empty() || clock::monotonic() >= end {
                return silent.into_iter().map(|motor| motor.name.clone()).collect();
            }
            std::thread::sleep(TURN);
        }
    }

    /// The names of the motors whose answers are not read.
    pub(crate) fn unchecked(&self) -> &[String] {
        &self.unchecked
    }
}

impl Ear {
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
                    self.silent.retain(|motor| motor.host_id != frame.id());
                }
            }
        }
    }
}

/// Opens an interface of this machine as it is, to receive.
pub fn listen_on(name: &str) -> Option<Box<dyn Bus>> {
    let interface: InterfaceName = name.parse().ok()?;
    let bus = SocketCanBus::open_as_is(interface);
    bus.inspect_err(|error| tracing::debug!("{error}")).ok().map(|bus| Box::new(bus) as Box<dyn Bus>)
}
