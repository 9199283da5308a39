//! The motors and IMUs of a configuration, with the last requests to the motors, for decoding a log of their buses.

use crate::codec::Codec;
use crate::imu::{ImuConfig, LoggedImu};
use crate::object::Object;
use crate::options::{AnsweredCommand, Direction, FrameProtocol};
use crate::rejected::Rejected;
use crate::scale::Scale;
use motord_bus::{Frame, FrameId};
use motord_configuration::Problem;
use motord_protocol::profile::STEADYWIN;
use motord_protocol::{Ends, Model, Profile, ScaleError, register};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The error of a configuration.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// The file cannot be read, or the daemon would not read it.
    #[error(transparent)]
    File(#[from] Problem),
    /// The file is not TOML, or a bus or motor lacks a key.
    #[error("{}: {source}", .path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        source: Box<toml::de::Error>,
    },
    /// A torque constant or gear ratio is not a positive number.
    #[error("motor {motor}: {source}")]
    Scale {
        /// Its name.
        motor: String,
        source: ScaleError,
    },
}

/// The keys that this command uses. The daemon checks the others.
#[derive(Deserialize)]
struct Config {
    #[serde(default)]
    bus: Vec<BusConfig>,
    #[serde(default)]
    motor: Vec<MotorConfig>,
    #[serde(default)]
    imu: Vec<ImuConfig>,
}

#[derive(Deserialize)]
struct BusConfig {
    name: String,
    interface: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
struct MotorConfig {
    name: String,
    bus: String,
    id: u8,
    host_id: Option<u16>,
    protocol: ProtocolConfig,
    #[serde(default)]
    model: String,
    torque_constant_nm_per_a: Option<f64>,
    gear_ratio: Option<f64>,
    position_end_rad: Option<f64>,
    velocity_end_rad_s: Option<f64>,
    torque_end_nm: Option<f64>,
    kp_end: Option<f64>,
    kd_end: Option<f64>,
}

impl MotorConfig {
    /// Returns the ends of the codes: as written, or those of the model.
    fn ends(&self, model: Ends) -> Ends {
        Ends {
            position: self.position_end_rad.unwrap_or(model.position),
            velocity: self.velocity_end_rad_s.unwrap_or(model.velocity),
            torque: self.torque_end_nm.unwrap_or(model.torque),
            kp: self.kp_end.unwrap_or(model.kp),
            kd: self.kd_end.unwrap_or(model.kd),
        }
    }
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ProtocolConfig {
    Mit,
    Gim,
}

/// The motors of a configuration.
pub(super) struct LoggedRobot {
    motors: Vec<LoggedMotor>,
    imus: Vec<LoggedImu>,
    /// The interfaces of its buses, in the order of the file.
    interfaces: Vec<String>,
}

struct LoggedMotor {
    name: String,
    interface: String,
    id: u8,
    /// `None` when the configured number is no id.
    host_id: Option<FrameId>,
    protocol: FrameProtocol,
    profile: &'static Profile,
    scale: Option<Scale>,
    /// The command that its next reply answers.
    asked: AnsweredCommand,
    /// The register whose value its next reply may be.
    asked_register: Option<u8>,
}

impl LoggedRobot {
    /// Reads a configuration. `protocol` replaces the configured protocols.
    pub(super) fn read(path: &Path, protocol: Option<FrameProtocol>) -> Result<Self, RobotError> {
        let text = motord_configuration::text(path)?;
        let Config { bus, motor, imu } = toml::from_str(&text)
            .map_err(|source| RobotError::Malformed { path: path.into(), source: source.into() })?;
        let mut motors =
            motor.into_iter().map(|motor| LoggedMotor::new(motor, &bus)).collect::<Result<Vec<_>, _>>()?;
        for motor in &mut motors {
            motor.protocol = protocol.unwrap_or(motor.protocol);
        }
        let wired = |imu: ImuConfig| {
            let bus = bus.iter().find(|bus| Some(&bus.name) == imu.bus.as_ref())?;
            LoggedImu::new(imu, bus.interface.clone().unwrap_or_else(|| bus.name.clone()))
        };
        let imus = imu.into_iter().filter_map(wired).collect();
        let interfaces = bus.into_iter().map(|bus| bus.interface.unwrap_or(bus.name)).collect();
        Ok(Self { motors, imus, interfaces })
    }

    /// Returns the interface of a channel of a log, from 1 on: that of the bus at this place in the file.
    pub(super) fn interface(&self, channel: u32) -> Option<&str> {
        let index = usize::try_from(channel).ok()?.checked_sub(1)?;
        self.interfaces.get(index).map(String::as_str)
    }

    /// Returns the interface of a robot with one bus.
    pub(super) fn only_interface(&self) -> Option<&str> {
        match self.interfaces.as_slice() {
            [only] => Some(only),
            _ => None,
        }
    }

    /// Decodes a classic frame with an 11-bit id.
    pub(super) fn decode(&mut self, interface: &str, frame: &Frame) -> Result<Object, Rejected> {
        if let Some(object) = self.register_read(interface, frame) {
            return Ok(object);
        }
        if let Some(decoded) = self.imus.iter().find_map(|imu| imu.decode(interface, frame)) {
            return decoded;
        }
        let (motor, direction) = self
            .motor_of(interface, frame)
            .ok_or_else(|| Rejected::UnexpectedId { interface: interface.into(), id: frame.id() })?;
        let mut object = motor.decode(frame.payload(), direction)?;
        object.insert("motor", motor.name.as_str());
        Ok(object)
    }

    /// Decodes a request for the value of a register, whose id is that of no motor.
    fn register_read(&mut self, interface: &str, frame: &Frame) -> Option<Object> {
        let is_request = FrameId::new(register::REQUEST_ID) == Some(frame.id());
        let &[id, _, _, number, ..] = frame.payload() else { return None };
        let is_read = frame.payload() == register::read(id, number);
        let mut here = self.motors.iter_mut().filter(|motor| motor.interface == interface);
        let motor = here.find(|motor| is_request && is_read && motor.id == id && motor.has_registers())?;
        motor.asked_register = Some(number);
        Some(motor.register_object("register_read", number))
    }

    fn motor_of(&mut self, interface: &str, frame: &Frame) -> Option<(&mut LoggedMotor, Direction)> {
        let here = self.motors.iter_mut().filter(|motor| motor.interface == interface);
        here.filter_map(|motor| motor.direction(frame).map(|direction| (motor, direction))).next()
    }
}

impl LoggedMotor {
    fn new(config: MotorConfig, buses: &[BusConfig]) -> Result<Self, RobotError> {
        let (profile, model) = match Profile::of_model(&config.model) {
            Some((profile, model)) => (profile, Some(model)),
            None => (&STEADYWIN, None),
        };
        let constant =
            config.torque_constant_nm_per_a.or(model.map(|model| f64::from(model.torque_constant)));
        let ratio = config.gear_ratio.or(model.map(|model| f64::from(model.gear_ratio)));
        let scale = constant.zip(ratio).map(|(constant, ratio)| match model {
            Some(Model { ends: Some(ends), .. }) => Ok(Scale::of_ends(&config.ends(*ends))),
            Some(model) => Scale::of_model(model, constant, ratio),
            None => Scale::new(constant, ratio),
        });
        let scale = scale.transpose();
        let bus = buses.iter().find(|bus| bus.name == config.bus);
        Ok(Self {
            scale: scale.map_err(|source| RobotError::Scale { motor: config.name.clone(), source })?,
            name: config.name,
            interface: bus.and_then(|bus| bus.interface.clone()).unwrap_or(config.bus),
            id: config.id,
            host_id: FrameId::new(config.host_id.unwrap_or(profile.ids.reply_offset + u16::from(config.id))),
            protocol: match config.protocol {
                ProtocolConfig::Mit => FrameProtocol::Mit,
                ProtocolConfig::Gim => FrameProtocol::GimCan,
            },
            profile,
            asked: AnsweredCommand::State,
            asked_register: None,
        })
    }

    /// Returns the direction of a frame to or from this motor. MIT motors may share a host id: a
    /// reply names its sender.
    fn direction(&self, frame: &Frame) -> Option<Direction> {
        let names_this =
            self.protocol != FrameProtocol::Mit || self.profile.is_from(self.id, frame.payload());
        let id = frame.id();
        if id == FrameId::from(self.id) {
            Some(Direction::ToMotor)
        } else if Some(id) == self.host_id && names_this {
            Some(Direction::ToHost)
        } else {
            None
        }
    }

    fn has_registers(&self) -> bool {
        self.protocol == FrameProtocol::Mit && self.profile.has_registers
    }

    fn register_object(&self, kind: &str, number: u8) -> Object {
        let mut object = Object::new(self.profile, None);
        object.insert("kind", kind);
        object.insert("register", number);
        object.insert("motor", self.name.as_str());
        object
    }

    /// Decodes the answer to the last request for the value of a register. It is no state, although it begins like one.
    fn register_value(&mut self, payload: &[u8]) -> Option<Object> {
        let number = self.asked_register?;
        let value = register::value(self.id, number, payload)?;
        self.asked_register = None;
        let mut object = self.register_object("register_value", number);
        object.insert("value", f64::from(value));
        Some(object)
    }

    fn decode(&mut self, payload: &[u8], direction: Direction) -> Result<Object, Rejected> {
        if direction == Direction::ToHost
            && let Some(object) = self.register_value(payload)
        {
            return Ok(object);
        }
        let Self { protocol, asked, profile, scale, .. } = *self;
        let object = Codec { protocol, direction, asked, profile, scale }.decode(payload)?;
        if direction == Direction::ToMotor {
            self.asked = match object.kind()? {
                "get_fault" => AnsweredCommand::GetFault,
                "clear_fault" => AnsweredCommand::ClearFault,
                "calibration" => AnsweredCommand::Calibration,
                _ => AnsweredCommand::State,
            };
        }
        Ok(object)
    }
}
