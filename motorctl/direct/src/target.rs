//! The motor of a command, and its connection.

use crate::failure::DirectFailure;
use motord_bus::transport::{self, Nodes, OpenedAsIs};
use motord_bus::{BusLock, Duration, FrameId, Monotonic};
use motord_configuration as config;
use motord_protocol::commissioning::{
    Axis, Error, Family, Found, Link, Mit, Native, Odrive, Private, Question, Rmd, Wire, answers, ends,
    identify_by,
};
use motord_protocol::profile::STEADYWIN;
use motord_protocol::robstride::{self, WideScales};
use motord_protocol::{Ends, Scales, cansimple, gim, mit, myactuator, odrive};
use motord_settings::settings::MotorSettings;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Bit/s of a serial line (GIM document, Table 1).
pub(crate) const BAUD: u32 = 921_600;
/// The configuration that a daemon reads by default.
pub(crate) const DEFAULT_CONFIG: &str = "/etc/motord/motord.toml";
/// Longest wait for the answer to a serial request.
const REPLY_TIMEOUT: Duration = Duration::from_millis(50);

/// Rotor turns per turn of the output shaft of a GIM6010-8.
const GEAR_RATIO: f32 = 8.0;

/// A protocol, as it is named on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Protocol {
    /// The MIT protocol, on CAN only.
    Mit,
    /// The GIM protocol, on CAN and serial lines.
    Gim,
    /// RobStride's private protocol, on CAN only.
    #[value(name = "robstride")]
    RobStride,
    /// CANSimple of SteadyWin's SDC104, GDS68 and GDZ drivers, on CAN only.
    #[value(name = "cansimple")]
    CanSimple,
    /// MyActuator's protocol of the RMD series, on CAN only.
    #[value(name = "myactuator")]
    MyActuator,
    /// CANSimple of an ODrive Pro, S1 or Micro, on CAN only.
    #[value(name = "odrive")]
    ODrive,
}

impl Protocol {
    /// Returns the protocol of a motor that answered like this. A motor of an unknown family is only stopped, as
    /// in MIT.
    pub(crate) const fn of(family: Family) -> Self {
        match family {
            Family::Native => Self::Gim,
            Family::RobStride { .. } => Self::RobStride,
            Family::CanSimple => Self::CanSimple,
            Family::MyActuator => Self::MyActuator,
            Family::Mit | Family::OtherMit { .. } | Family::Unknown { .. } => Self::Mit,
        }
    }

    /// Returns whether `motorctl` sets the whole address of its motors by one id. Those of the others also have
    /// a host id.
    pub(crate) const fn has_one_id(self) -> bool {
        matches!(self, Self::RobStride | Self::CanSimple | Self::MyActuator)
    }

    /// Returns its name in configurations.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Mit => mit::FAMILY.name,
            Self::Gim => gim::FAMILY.name,
            Self::RobStride => robstride::FAMILY.name,
            Self::CanSimple => cansimple::FAMILY.name,
            Self::MyActuator => myactuator::FAMILY.name,
            Self::ODrive => odrive::FAMILY.name,
        }
    }
}

/// The bus that a command uses, without a daemon.
#[derive(Debug, Clone, clap::Args)]
pub struct BusArguments {
    /// CAN interface (can0) or serial device (/dev/ttyUSB0) of the motor. The command uses the bus
    /// without a daemon.
    #[arg(long, value_name = "BUS")]
    pub bus: Option<String>,
    /// Bit/s of a serial device.
    #[arg(long, value_name = "BIT/S", default_value_t = BAUD, value_parser = clap::value_parser!(u32).range(1..))]
    pub baud: u32,
}

/// A motor on a bus, without a daemon.
#[derive(Debug, Clone, clap::Args)]
pub struct Target {
    /// The bus.
    #[command(flatten)]
    pub line: BusArguments,
    /// The motor's id, 1 to 254.
    #[arg(long, value_name = "ID", value_parser = parse_id)]
    pub id: Option<u8>,
    /// The CAN id of the motor's answers. By default it is read from the first answer. A serial
    /// line does not use it.
    #[arg(long, value_name = "ID", value_parser = parse_host_id)]
    pub host_id: Option<FrameId>,
    /// The motor's protocol. By default the command asks the motor, which stops if it is in MIT
    /// mode.
    #[arg(long, value_name = "PROTOCOL")]
    pub protocol: Option<Protocol>,
    /// A configuration of motord with the address of the motor. Use it with --joint, in place of
    /// --bus and --id.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bus", "id"])]
    pub config: Option<PathBuf>,
    /// The motor's name in the configuration.
    #[arg(long, value_name = "NAME", requires = "config")]
    pub joint: Option<String>,
}

/// Reads an id, decimal or with 0x.
///
/// # Errors
///
/// The expected range.
pub(crate) fn parse_id(text: &str) -> Result<u8, String> {
    match number(text) {
        Some(id @ 1..=254) => Ok(id as u8),
        _ => Err("expected 1 to 254".to_owned()),
    }
}

/// Reads a host id, decimal or with 0x.
///
/// # Errors
///
/// The expected range.
pub(crate) fn parse_host_id(text: &str) -> Result<FrameId, String> {
    let id = number(text).and_then(|raw| u16::try_from(raw).ok()).and_then(FrameId::new);
    id.ok_or_else(|| "expected 0 to 0x7FF".to_owned())
}

pub(crate) fn number(text: &str) -> Option<u32> {
    match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(hex) => u32::from_str_radix(hex, 16).ok(),
        None => text.parse().ok(),
    }
}

/// A bus that is open and locked.
pub struct OpenLine {
    /// Its name on the command line.
    pub name: String,
    pub link: Link,
    /// Bit rate of the CAN interface; `None` for a serial or virtual one.
    pub bitrate: Option<u32>,
    /// `None` for a bus inside a test.
    _lock: Option<BusLock>,
}

#[cfg(test)]
impl OpenLine {
    /// Returns the line of a simulated bus, whose interface has `bitrate`.
    pub(crate) fn simulated(link: Link, bitrate: Option<u32>) -> Self {
        Self { name: "can0".to_owned(), link, bitrate, _lock: None }
    }
}

#[cfg(test)]
impl Session {
    /// Returns a session with the motor `id` of a simulated bus, without settings.
    pub(crate) fn simulated(
        motors: Vec<motord_simulator::MotorSettings>,
        id: u8,
        protocol: Protocol,
    ) -> Self {
        let bus = motord_simulator::SimulatedBus::new(motord_simulator::BusSettings::default(), motors, 1);
        let clock = motord_bus::VirtualClock::new(motord_bus::Instant::ZERO);
        let link = Link::can(motord_simulator::SharedBus::new(bus), clock);
        Self { line: OpenLine::simulated(link, None), id, host_id: None, protocol, settings: None }
    }
}

/// Returns a simulated motor for the bus of an arm: a Damiao in MIT, or a SteadyWin in its native protocol.
#[cfg(test)]
pub(crate) fn arm_motor(name: &str, id: u16, is_damiao: bool) -> motord_simulator::MotorSettings {
    use motord_simulator::Dialect;
    motord_simulator::MotorSettings {
        name: name.into(),
        id,
        host_id: if is_damiao { 0x10 + id } else { 0x100 + id },
        dialect: if is_damiao { Dialect::Mit } else { Dialect::Gim },
        vendor: if is_damiao { "damiao" } else { "steadywin" },
        ends: is_damiao.then_some([12.5, 30.0, 10.0]),
        initial_position: 0.1 * f64::from(id),
        ..motord_simulator::MotorSettings::default()
    }
}

/// Opens and locks the bus `name`.
///
/// # Errors
///
/// The bus cannot be used.
pub(crate) fn open(name: &str, baud: u32) -> Result<OpenLine, DirectFailure> {
    let unknown = || {
        DirectFailure::Usage(format!(
            "`{name}` is neither a CAN interface, as `ip link` lists them, nor the path of a device"
        ))
    };
    let kind = transport::find(name, baud).ok_or_else(unknown)?;
    let hardware = kind.hardware().ok_or_else(unknown)?;
    let lock = hardware.lock()?;
    let nodes = Nodes { reply_timeout: REPLY_TIMEOUT, answers, ..Nodes::none() };
    let OpenedAsIs { bus, bitrate, hides_bitrate } = hardware.open_as_is(&nodes)?;
    if hides_bitrate {
        let _unread = writeln!(
            std::io::stderr(),
            "motorctl: the bit rate of {name} is unknown, because another program set it in the adapter: make sure that it is that of \
             the motors, 1000000 bit/s by default"
        );
    }
    let wire = if kind.is_line() { Wire::Serial } else { Wire::Can };
    Ok(OpenLine { name: name.to_owned(), link: Link::over(bus, Monotonic, wire), bitrate, _lock: Some(lock) })
}

/// Returns whether `bus` names a line. The bit rate does not matter.
fn is_line(bus: &str) -> bool {
    transport::find(bus, BAUD).is_some_and(|kind| kind.is_line())
}

/// An open bus with the motor of the command.
pub struct Session {
    pub line: OpenLine,
    pub id: u8,
    pub host_id: Option<FrameId>,
    pub protocol: Protocol,
    /// Its settings, when it came from a configuration.
    pub settings: Option<MotorSettings>,
}

impl Target {
    /// Returns true when the command uses a bus, not a daemon.
    pub fn is_given(&self) -> bool {
        self.line.bus.is_some() || self.config.is_some()
    }

    /// Opens the bus, and finds the motor and its protocol.
    ///
    /// # Errors
    ///
    /// The motor cannot be reached.
    pub fn open(&self) -> Result<Session, DirectFailure> {
        let address = self.address()?;
        if self.host_id.is_some() && is_line(&address.bus) {
            let usage = "answers on a serial line have no id: leave --host-id out";
            return Err(DirectFailure::Usage(usage.to_owned()));
        }
        let line = open(&address.bus, address.baud)?;
        let MotorAddress { id, host_id, settings, .. } = address;
        let mut session =
            Session { line, id, host_id, protocol: self.protocol.unwrap_or(Protocol::Gim), settings };
        match (self.protocol, session.line.link.wire()) {
            (Some(protocol), Wire::Serial) if protocol != Protocol::Gim => {
                Err(session.unfit("a serial line always has the GIM protocol: leave --protocol out"))
            }
            (Some(_), _) => Ok(session),
            (None, _) => session.identify().map(|()| session),
        }
    }

    /// As [`open`](Self::open), for a command of the GIM protocol.
    ///
    /// # Errors
    ///
    /// The motor cannot be reached, or speaks another protocol.
    pub fn open_gim(&self) -> Result<Session, DirectFailure> {
        self.open()?.require_gim()
    }

    /// Returns the target for a joint of the given or the default configuration.
    pub(crate) fn named(&self, joint: &str) -> Self {
        let config = self.config.clone().unwrap_or_else(|| DEFAULT_CONFIG.into());
        Self { config: Some(config), joint: Some(joint.to_owned()), ..self.clone() }
    }

    fn address(&self) -> Result<MotorAddress, DirectFailure> {
        match (&self.line.bus, self.id, &self.config, &self.joint) {
            (Some(bus), Some(id), None, _) => {
                let (bus, baud) = (bus.clone(), self.line.baud);
                Ok(MotorAddress { bus, baud, id, host_id: self.host_id, settings: None })
            }
            (None, None, Some(file), Some(joint)) => self.configured(file, joint),
            _ => Err(DirectFailure::Usage(
                "name the motor: --bus and --id, or --config and --joint".to_owned(),
            )),
        }
    }

    fn configured(&self, file: &Path, joint: &str) -> Result<MotorAddress, DirectFailure> {
        let settings = config::load(file)?.settings;
        let motor = settings.motors.iter().find(|motor| motor.name == joint);
        let motor = motor
            .ok_or_else(|| DirectFailure::Usage(format!("{}: there is no motor {joint}", file.display())))?;
        let kind = &settings.buses[motor.bus].kind;
        let bus = kind.address().ok_or_else(|| {
            DirectFailure::Usage(format!("{joint} is simulated inside the daemon, without a bus"))
        })?;
        let (bus, baud) = (bus.to_owned(), kind.bitrate());
        let settings = Some(motor.clone());
        Ok(MotorAddress { bus, baud, id: motor.id, host_id: self.host_id.or(Some(motor.host_id)), settings })
    }
}

/// Returns the scales of a motor by the ends that it reports; its configured ones where it has no registers.
fn reported_scales(link: &mut Link, motor: &MotorSettings) -> Result<Scales, Error> {
    if !motor.profile.has_registers {
        return Ok(motor.scales);
    }
    let silent = Error::Silent { id: motor.id, request: "registers PMAX, VMAX and TMAX" };
    Ok(motor.scales.with_ends(ends(link, motor.id, motor.host_id)?.ok_or(silent)?))
}

/// The bus and the ids of a motor.
struct MotorAddress {
    bus: String,
    baud: u32,
    id: u8,
    host_id: Option<FrameId>,
    settings: Option<MotorSettings>,
}

impl Session {
    /// Returns a session with a motor that a scan found, without settings.
    pub(crate) fn with(line: OpenLine, found: &Found) -> Self {
        let protocol = Protocol::of(found.family);
        Self { line, id: found.id, host_id: found.host_id, protocol, settings: None }
    }

    /// Returns the session, for a command of the GIM protocol.
    ///
    /// # Errors
    ///
    /// The motor speaks another protocol.
    pub fn require_gim(self) -> Result<Self, DirectFailure> {
        let reason = match self.protocol {
            Protocol::Gim => return Ok(self),
            Protocol::Mit => {
                "it is in MIT mode, which has no such command: use its serial port (RS485 or RS232), which has the GIM protocol"
            }
            Protocol::RobStride => {
                "it speaks RobStride's private protocol, for which motorctl has no such command"
            }
            Protocol::CanSimple => "it speaks CANSimple, for which motorctl has no such command",
            Protocol::MyActuator => "it speaks MyActuator's protocol, for which motorctl has no such command",
            Protocol::ODrive => "it is an ODrive, for which motorctl has no such command: use odrivetool",
        };
        Err(self.unfit(reason))
    }

    /// Returns the motor's GIM transactions.
    pub fn gim(&mut self) -> Native<'_> {
        Native::new(&mut self.line.link, self.id, self.host_id)
    }

    /// Returns the motor's MIT transactions. Without a configuration the vendor is SteadyWin, and
    /// torques are fractions of the full scale.
    pub fn mit(&mut self) -> Mit<'_> {
        let profile = self.settings.as_ref().map_or_else(|| &*STEADYWIN, |settings| settings.profile);
        let scales = self.scales();
        Mit::new(&mut self.line.link, self.id, self.host_id, scales).with_profile(profile)
    }

    /// Returns the motor's transactions in RobStride's private protocol.
    pub fn private(&mut self) -> Private<'_> {
        Private::new(&mut self.line.link, self.id)
    }

    /// Returns the motor's transactions in CANSimple.
    pub fn axis(&mut self) -> Axis<'_> {
        Axis::new(&mut self.line.link, self.id)
    }

    /// Returns the motor's transactions in MyActuator's protocol.
    pub fn rmd(&mut self) -> Rmd<'_> {
        Rmd::new(&mut self.line.link, self.id)
    }

    /// Returns the motor's transactions as an ODrive.
    pub fn odrive(&mut self) -> Odrive<'_> {
        let gear_ratio = self.gear_ratio();
        Odrive::new(&mut self.line.link, self.id, gear_ratio)
    }

    /// Stops the motor.
    ///
    /// # Errors
    ///
    /// The motor does not answer, or refuses.
    pub(crate) fn stop(&mut self) -> Result<(), Error> {
        match self.protocol {
            Protocol::Mit => self.mit().stop().map(drop),
            Protocol::Gim => self.gim().stop(),
            Protocol::RobStride => self.private().stop().map(drop),
            Protocol::CanSimple => self.axis().stop(),
            Protocol::MyActuator => self.rmd().stop(),
            Protocol::ODrive => self.odrive().stop(),
        }
    }

    /// Returns the rotor turns per turn of the output shaft. Without a configuration they are those of
    /// a GIM6010-8, and an ODrive has no gear.
    pub(crate) fn gear_ratio(&self) -> f32 {
        let constants = self.settings.as_ref().and_then(|settings| settings.constants);
        let unknown = if self.protocol == Protocol::ODrive { 1.0 } else { GEAR_RATIO };
        constants.map_or(unknown, |constants| constants.gear_ratio as f32)
    }

    /// Returns the scales of [`private`](Self::private). Without a configuration only the position
    /// has a meaning: its scale is that of every model.
    pub(crate) fn wide_scales(&self) -> WideScales {
        let unknown = || Scales::of(&Ends::new(robstride::POSITION_END, 1.0, 1.0));
        WideScales::of(&self.settings.as_ref().map_or_else(unknown, |settings| settings.scales))
    }

    /// Returns the scales of [`mit`](Self::mit) and [`axis`](Self::axis): those of the configuration.
    pub(crate) fn scales(&self) -> Scales {
        let unknown = || match self.protocol {
            Protocol::CanSimple => Scales::of(&cansimple::ENDS),
            _ => Scales::WITHOUT_CONSTANTS,
        };
        self.settings.as_ref().map_or_else(unknown, |settings| settings.scales)
    }

    /// Returns the configured scales of a motor whose torque codes no source gives for certain.
    ///
    /// # Errors
    ///
    /// [`Error::Protocol`] without a configuration.
    pub(crate) fn configured_scales(&self) -> Result<Scales, Error> {
        let reason = "the largest torque code of its motor must be known: use --config and --joint, with torque-end-nm in the file";
        self.settings.as_ref().map(|settings| settings.scales).ok_or(Error::Protocol { id: self.id, reason })
    }

    /// Uses the ends of its codes that the motor reports, where it has registers, in place of those of its model.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] when it does not report them.
    pub fn read_ends(&mut self) -> Result<(), Error> {
        if let Some(settings) = &mut self.settings {
            settings.scales = reported_scales(&mut self.line.link, settings)?;
        }
        Ok(())
    }

    /// Describes the motor for messages.
    pub fn name(&self) -> String {
        match &self.settings {
            Some(settings) => format!("{} (motor {} on {})", settings.name, self.id, self.line.name),
            None => format!("motor {} on {}", self.id, self.line.name),
        }
    }

    /// Returns the position limits of the joint, rad on the motor's side. Without a configuration
    /// they are infinite.
    pub fn allowed(&self) -> [f64; 2] {
        let Some(settings) = &self.settings else { return [f64::NEG_INFINITY, f64::INFINITY] };
        let ends =
            settings.limits.position.map(|end| f64::from(settings.transmission.position_to_motor(end)));
        [ends[0].min(ends[1]), ends[0].max(ends[1])]
    }

    pub fn unfit(&self, reason: &str) -> DirectFailure {
        DirectFailure::Unfit { id: self.id, reason: reason.to_owned() }
    }

    /// Returns the error of a transaction. For a silent motor it names other formats in which frames arrived.
    pub fn explain(&self, error: Error) -> DirectFailure {
        match error {
            Error::Silent { .. } => self.with_formats(error.into()),
            error => error.into(),
        }
    }

    fn with_formats(&self, source: DirectFailure) -> DirectFailure {
        let formats: Vec<_> = self.line.link.formats().advice().collect();
        if formats.is_empty() {
            return source;
        }
        let formats = format!("but {}", formats.join("; "));
        DirectFailure::OtherFormat { source: Box::new(source), formats }
    }

    /// Asks by the requests of the configured family; without a configuration by the frames of a scan.
    fn find(&mut self) -> Result<Option<Found>, Error> {
        let question = |motor: &MotorSettings| motor.protocol.family().question;
        let question = self.settings.as_ref().map_or(Question::Both, question);
        identify_by(&mut self.line.link, self.id, question)
    }

    fn identify(&mut self) -> Result<(), DirectFailure> {
        let Found { host_id, family, .. } = self.find()?.ok_or_else(|| {
            self.with_formats(DirectFailure::NoMotor { id: self.id, bus: self.line.name.clone() })
        })?;
        let is_unnamed = matches!(family, Family::OtherMit { .. }) && self.settings.is_none();
        if is_unnamed || matches!(family, Family::Unknown { .. }) {
            return Err(self.unfit(family.describe()));
        }
        let is_odrive = |motor: &MotorSettings| {
            family == Family::CanSimple && motor.protocol.name() == odrive::FAMILY.name
        };
        // Its heartbeats are those of a CANSimple driver.
        self.protocol = match self.settings.as_ref().is_some_and(is_odrive) {
            true => Protocol::ODrive,
            false => Protocol::of(family),
        };
        if self.line.link.wire() == Wire::Can && matches!(self.protocol, Protocol::Gim | Protocol::Mit) {
            let expected = self.host_id.or(host_id);
            if expected != host_id {
                let raw = |id: Option<FrameId>| id.map_or(0, FrameId::raw);
                let reason =
                    format!("its answers have the id {:#05X}, not {:#05X}", raw(host_id), raw(expected));
                return Err(self.unfit(&reason));
            }
        }
        self.host_id = host_id;
        match &self.settings {
            Some(settings)
                if settings.protocol.name() != self.protocol.name() && self.line.link.wire() == Wire::Can =>
            {
                let reason =
                    format!("it does not speak {}, the configured protocol", settings.protocol.name());
                Err(self.unfit(&reason))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::{Instant, VirtualClock};
    use motord_simulator::{BusSettings, Dialect, MotorSettings as Simulated, SimulatedBus};

    /// A jog by the ends of the model would turn the joint by four times the requested angle.
    #[test]
    fn scales_of_motor_follow_its_registers() {
        let text = "[[bus]]\nname = 'arm'\ntype = 'socketcan'\ninterface = 'can0'\n[[motor]]\nname = 'hip'\nbus = 'arm'\nid = 1\n\
                    protocol = 'mit'\nmodel = 'DM-J4310-2EC'\n";
        let loaded = config::parse(Path::new("robot.toml"), text.as_bytes(), &config::Machine::here());
        let motor = &loaded.unwrap().settings.motors[0];
        let hip = |ends| Simulated {
            id: 1,
            host_id: 0x11,
            dialect: Dialect::Mit,
            vendor: "damiao",
            ends,
            ..Default::default()
        };
        let scales = |ends| {
            let bus = SimulatedBus::new(BusSettings::default(), vec![hip(ends)], 1);
            reported_scales(&mut Link::can(bus, VirtualClock::new(Instant::ZERO)), motor)
        };
        let ends = scales(Some([3.125, 30.0, 20.0])).unwrap().ends();
        assert_eq!(ends, Ends::new(3.125, 30.0, 20.0));
        assert!(matches!(scales(None), Err(Error::Silent { id: 1, .. })));
    }

    /// Goal: a configured ODrive, whose heartbeats are those of a CANSimple driver, is spoken to as one.
    #[test]
    fn odrive_is_known_by_its_configuration() {
        let text = "[[bus]]\nname = 'arm'\ntype = 'socketcan'\ninterface = 'can0'\nevery = 10\n[[motor]]\nname = 'hip'\nbus = 'arm'\n\
                    id = 3\nprotocol = 'odrive'\nmodel = 'ODrive-S1'\n";
        let loaded = config::parse(Path::new("robot.toml"), text.as_bytes(), &config::Machine::here());
        let hip = Simulated {
            name: "hip".into(),
            id: 3,
            dialect: Dialect::ODrive,
            vendor: "odrive",
            ..Default::default()
        };
        let mut session = Session::simulated(vec![hip], 3, Protocol::Mit);
        session.settings = Some(loaded.unwrap().settings.motors[0].clone());
        session.identify().unwrap();
        assert_eq!(session.protocol, Protocol::ODrive);
        session.stop().unwrap();
        session.odrive().set_zero().unwrap();
        let [position, _] = session.odrive().estimates().unwrap();
        assert!(position.abs() < 0.01 && session.odrive().fault().unwrap().is_none());
    }
}
