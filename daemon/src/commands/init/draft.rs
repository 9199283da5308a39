//! The text of a first configuration.

use super::InitError;
use motord_protocol::{FAMILIES, Model, MotorProtocol, Profile};
use std::fmt::Write;

/// A robot of equal legs, or an arm: one leg.
#[derive(Debug, Clone)]
pub struct Draft {
    /// 1 to 8.
    pub legs: usize,
    /// Names of the joints of each leg.
    pub joints: Vec<String>,
    /// Model of every motor, such as `GIM8108-8`.
    pub model: String,
    /// Protocol of every motor on CAN. Those on a serial line have `gim`.
    pub protocol: MotorProtocol,
    /// Where the motors are.
    pub connection: Connection,
}

/// Where the motors are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Connection {
    /// Inside the daemon, on one simulated bus for each leg.
    Simulated,
    /// On these CAN interfaces (`can0`) and serial devices (`/dev/ttyUSB0`). Neighbouring legs
    /// share one if there are fewer than legs.
    Buses(Vec<String>),
}

impl Connection {
    /// A CAN interface for each leg: can0, can1 and so on.
    #[must_use]
    pub fn one_bus_each(legs: usize) -> Self {
        Self::Buses((0..legs).map(|bus| format!("can{bus}")).collect())
    }
}

const HEAD: &str = "\
# Written by `motord init`. Every key and its default: docs/configuration.md. `motord check FILE` judges the file.
#
# Before the first start:
# - Give the motors the ids and host ids below, one motor at a time. An id is used once on the whole robot, where the vendor has
#   enough: when adapters or cables are exchanged, the motors do not answer, instead of moving with the commands of another leg.
# - Turn each joint by hand while the robot hangs. Set direction = -1 where the angle falls although it should rise.
# - The limits are cautious: half of the rated torque, half a radian to each side. Widen them after the first motion.
";

/// Host id of a motor on a serial line, above its id: above all ids of a robot, and of one byte.
const SERIAL_REPLY_OFFSET: usize = 0x40;

/// Times of a simulated robot, those of `config/quadruped-simulated.toml`.
const SIMULATED_TIMES: &str = "\
# A simulated robot runs without real-time permission and beside other programs, which stall it for tens of milliseconds.
# Delete these times, and [safety], for a robot with motors.
max-lateness-ms = 100.0
max-skipped-percent = 100.0

[safety]
setpoint-timeout-ms = 200.0
lost-cycles = 100
deadman-ms = 250.0
start-timeout-ms = 2000.0
";

/// A key of a serial bus and its reason.
const TURNAROUND: &str =
    "# An adapter on USB delivers its bytes once per millisecond.\nturnaround-us = 1500\n";

const FOUR_LEGS: [(&str, &str); 4] =
    [("fl", "front-left"), ("fr", "front-right"), ("rl", "rear-left"), ("rr", "rear-right")];
const SIX_LEGS: [(&str, &str); 6] = [
    ("fl", "front-left"),
    ("fr", "front-right"),
    ("ml", "middle-left"),
    ("mr", "middle-right"),
    ("rl", "rear-left"),
    ("rr", "rear-right"),
];

impl Draft {
    /// A motor is on a serial line.
    #[must_use]
    pub fn has_serial_bus(&self) -> bool {
        self.buses().iter().any(Bus::is_serial)
    }

    /// The TOML text at this cycle rate. Motors of serial buses get a command once in `every`
    /// cycles. Does not check whether motord can run it: `config::parse` does.
    ///
    /// # Errors
    ///
    /// When the robot has no leg, joint or bus, too many of them, or an unknown model.
    pub fn text(&self, rate_hz: f64, every: u32) -> Result<String, InitError> {
        let (profile, model) = Profile::of_model(&self.model).ok_or_else(|| self.unknown_model())?;
        self.check_counts()?;
        let rate_hz = toml::Value::from(rate_hz);
        let mut text = format!("{HEAD}\n[daemon]\ninstance = \"robot\"\n\n[cycle]\nrate-hz = {rate_hz}\n");
        if matches!(self.connection, Connection::Simulated) {
            text += SIMULATED_TIMES;
        }
        let buses = self.buses();
        for bus in &buses {
            text += &bus.text(every);
        }
        // Without an id that is on two buses, motors that are on the wrong one do not answer.
        let is_unique = self.legs * self.joints.len() <= usize::from(profile.ids.largest);
        for leg in 0..self.legs {
            let (bus, before) = self.bus_of(leg, buses.len());
            let first = if is_unique { leg * self.joints.len() } else { before };
            for (index, joint) in self.joints.iter().enumerate() {
                let motor = Motor { name: self.joint(leg, joint), bus: &buses[bus], id: first + index + 1 };
                text += &motor.text(self.protocol, profile, model);
            }
        }
        text += &self.group();
        Ok(text)
    }

    fn unknown_model(&self) -> InitError {
        let model = &self.model;
        InitError::Answer(format!("no model is called {model:?}: docs/configuration.md lists them"))
    }

    fn check_counts(&self) -> Result<(), InitError> {
        let refuse = |what: &str| Err(InitError::Answer(what.into()));
        match &self.connection {
            _ if !(1..=8).contains(&self.legs) => refuse("a robot has 1 to 8 legs: --legs"),
            _ if !(1..=8).contains(&self.joints.len()) => refuse("a leg has 1 to 8 joints: --joints"),
            Connection::Buses(buses) if buses.is_empty() => refuse("the motors need a bus: --buses"),
            Connection::Buses(buses) if buses.len() > self.legs => {
                refuse("there are more buses than legs: each leg is on one bus")
            }
            _ => Ok(()),
        }
    }

    fn buses(&self) -> Vec<Bus> {
        match &self.connection {
            Connection::Simulated => {
                (0..self.legs).map(|leg| Bus { name: self.leg(leg).1, device: None }).collect()
            }
            Connection::Buses(devices) if devices.len() == self.legs => devices
                .iter()
                .enumerate()
                .map(|(leg, device)| Bus { name: self.leg(leg).1, device: Some(device.clone()) })
                .collect(),
            Connection::Buses(devices) => devices
                .iter()
                .enumerate()
                .map(|(index, device)| Bus { name: format!("bus-{index}"), device: Some(device.clone()) })
                .collect(),
        }
    }

    /// The bus of a leg, and how many motors the legs before it have there.
    fn bus_of(&self, leg: usize, buses: usize) -> (usize, usize) {
        let bus = |leg: usize| leg * buses / self.legs;
        let before = (0..leg).filter(|&other| bus(other) == bus(leg)).count();
        (bus(leg), before * self.joints.len())
    }

    /// Short and long name of a leg; an arm has no short one.
    fn leg(&self, leg: usize) -> (String, String) {
        let names: &[(&str, &str)] = match self.legs {
            1 => &[("", "arm")],
            2 => &[("left", "left"), ("right", "right")],
            4 => &FOUR_LEGS,
            6 => &SIX_LEGS,
            _ => return (format!("l{}", leg + 1), format!("leg-{}", leg + 1)),
        };
        let (short, long) = names[leg];
        (short.into(), long.into())
    }

    fn joint(&self, leg: usize, joint: &str) -> String {
        match self.leg(leg).0.as_str() {
            "" => joint.to_owned(),
            leg => format!("{leg}-{joint}"),
        }
    }

    fn group(&self) -> String {
        let name = if self.legs == 1 { "arm" } else { "legs" };
        let legs = (0..self.legs).map(|leg| {
            let joints: Vec<_> =
                self.joints.iter().map(|joint| quoted(&self.joint(leg, joint)).to_string()).collect();
            format!("    {},\n", joints.join(", "))
        });
        format!("\n[[group]]\nname = \"{name}\"\njoints = [\n{}]\n", legs.collect::<String>())
    }
}

struct Bus {
    name: String,
    /// Interface or device; `None` for a simulated bus.
    device: Option<String>,
}

impl Bus {
    fn is_serial(&self) -> bool {
        self.device.as_ref().is_some_and(|device| device.starts_with('/'))
    }

    fn text(&self, every: u32) -> String {
        let kind = match &self.device {
            None => "type = \"simulated\"".into(),
            Some(device) if self.is_serial() => {
                format!(
                    "type = \"serial\"\ndevice = {}\nbaud = 921600\n{TURNAROUND}every = {every}",
                    quoted(device)
                )
            }
            Some(interface) => {
                format!("type = \"socketcan\"\ninterface = {}\nbitrate = 1000000", quoted(interface))
            }
        };
        format!("\n[[bus]]\nname = {}\n{kind}\n", quoted(&self.name))
    }
}

/// As a TOML string.
fn quoted(text: &str) -> toml::Value {
    toml::Value::from(text)
}

struct Motor<'a> {
    name: String,
    bus: &'a Bus,
    id: usize,
}

impl Motor<'_> {
    fn text(&self, protocol: MotorProtocol, profile: &Profile, model: &Model) -> String {
        let Self { name, bus, id } = self;
        let mut text =
            format!("\n[[motor]]\nname = {}\nbus = {}\nid = {id}\n", quoted(name), quoted(&bus.name));
        if profile.name == "steadywin" {
            let host_id = match u8::try_from(*id) {
                Ok(id) if !bus.is_serial() => profile.ids.reply_id(id).into(),
                _ => SERIAL_REPLY_OFFSET + id,
            };
            let _infallible = writeln!(text, "host-id = {host_id:#x}");
        }
        let can_be =
            |protocol: &MotorProtocol| !bus.is_serial() || protocol.family().answers_on_line.is_some();
        let others = FAMILIES.iter().map(|(_, protocol)| *protocol);
        let protocol = [protocol].into_iter().chain(others).find(can_be).unwrap_or(protocol);
        // Half of the rated torque, rounded down to 0.1 N·m, and 0.1 N·m at least.
        let torque = (model.rated_torque * 5.0).floor().max(1.0) / 10.0;
        let velocity = model.max_velocity.min(5.0);
        let _infallible = writeln!(
            text,
            "protocol = \"{}\"\nmodel = {:?}\ndirection = 1\nlimits = {{ position-rad = [-0.5, 0.5], velocity-rad-s = {velocity:.1}, torque-nm = {torque:.1} }}",
            protocol.name(),
            model.name,
        );
        text
    }
}
