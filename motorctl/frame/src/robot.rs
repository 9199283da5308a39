//! The motors and IMUs of a configuration, with the last requests to the motors, for decoding a log
//! of their buses.

use crate::codec::Codec;
use crate::object::Object;
use crate::options::{AnsweredCommand, Direction, FrameProtocol};
use crate::rejected::Rejected;
use crate::scale::Scale;
use motord_bus::{Frame, FrameId};
use motord_configuration::ConfigError;
use motord_protocol::imu::{CanDevice, Measured, SampleField};
use motord_protocol::profile::STEADYWIN;
use motord_protocol::{Profile, register};
use motord_settings::sensor::imu::ImuSettings;
use motord_settings::settings::{BusSettings, MotorSettings};
use std::path::Path;

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
    host_id: FrameId,
    /// `None` for a family that this command does not decode.
    protocol: Option<FrameProtocol>,
    profile: &'static Profile,
    scale: Scale,
    /// The command that its next reply answers.
    asked: AnsweredCommand,
    /// The register whose value its next reply may be.
    asked_register: Option<u8>,
}

impl LoggedRobot {
    /// Reads a configuration. `protocol` replaces the configured protocols.
    pub(super) fn read(path: &Path, protocol: Option<FrameProtocol>) -> Result<Self, ConfigError> {
        let settings = motord_configuration::load(path)?.settings;
        let interfaces: Vec<_> = settings.buses.iter().map(interface).collect();
        let motors = settings.motors.iter().map(|motor| {
            let logged = LoggedMotor::new(motor, interfaces[motor.bus].clone());
            LoggedMotor { protocol: protocol.or(logged.protocol), ..logged }
        });
        let wired = |imu: &ImuSettings| {
            let can = imu.source.can()?;
            Some(LoggedImu::new(imu.name.clone(), interfaces[can.bus].clone(), can.device))
        };
        let imus = settings.sensors.imus.iter().filter_map(wired).collect();
        Ok(Self { motors: motors.collect(), imus, interfaces })
    }

    /// Returns the interface of a channel of a log, from 1 on: that of the bus at this place in the
    /// file.
    pub(super) fn interface(&self, channel: u32) -> Option<&str> {
        let index = usize::try_from(channel).ok()?.checked_sub(1)?;
        self.interfaces.get(index).map(String::as_str)
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

/// Returns the interface of a bus. A bus without one has its name in logs.
fn interface(bus: &BusSettings) -> String {
    bus.kind.interface().unwrap_or(&bus.name).to_owned()
}

impl LoggedMotor {
    fn new(settings: &MotorSettings, interface: String) -> Self {
        let constants = settings.constants.map(|constants| [constants.torque_constant, constants.gear_ratio]);
        Self {
            name: settings.name.clone(),
            interface,
            id: settings.id,
            host_id: settings.host_id,
            protocol: FrameProtocol::over_can(settings.protocol),
            profile: settings.profile,
            scale: Scale { constants, scales: settings.scales },
            asked: AnsweredCommand::State,
            asked_register: None,
        }
    }

    /// Returns the direction of a frame to or from this motor. MIT motors may share a host id: a
    /// reply names its sender.
    fn direction(&self, frame: &Frame) -> Option<Direction> {
        let names_this =
            self.protocol != Some(FrameProtocol::Mit) || self.profile.is_from(self.id, frame.payload());
        let id = frame.id();
        if id == FrameId::from(self.id) {
            Some(Direction::ToMotor)
        } else if id == self.host_id && names_this {
            Some(Direction::ToHost)
        } else {
            None
        }
    }

    fn has_registers(&self) -> bool {
        self.protocol == Some(FrameProtocol::Mit) && self.profile.has_registers
    }

    fn register_object(&self, kind: &str, number: u8) -> Object {
        let mut object = Object::new(self.profile, None);
        object.insert("kind", kind);
        object.insert("register", number);
        object.insert("motor", self.name.as_str());
        object
    }

    /// Decodes the answer to the last request for the value of a register. It is no state, although
    /// it begins like one.
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
        let Self { asked, profile, scale, .. } = *self;
        let protocol = self.protocol.ok_or_else(|| Rejected::Family { motor: self.name.clone() })?;
        let object = Codec { protocol, direction, asked, profile, scale: Some(scale) }.decode(payload)?;
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

/// An IMU on an interface.
pub(super) struct LoggedImu {
    name: String,
    interface: String,
    device: CanDevice,
}

impl LoggedImu {
    pub(super) const fn new(name: String, interface: String, device: CanDevice) -> Self {
        Self { name, interface, device }
    }

    /// Decodes a frame from or to this device; `None` for another frame.
    pub(super) fn decode(&self, interface: &str, frame: &Frame) -> Option<Result<Object, Rejected>> {
        if interface != self.interface {
            return None;
        }
        let id = u16::try_from(frame.id().raw()).ok()?;
        let payload = frame.payload();
        let is_request =
            |request: &motord_protocol::imu::CanRequest| request.id() == id && request.payload() == payload;
        if let Some(number) = self.device.requests().position(|request| is_request(&request)) {
            return Some(Ok(self.object("imu_request", self.device.requested(number))));
        }
        if self.device.start().is_some_and(|start| is_request(&start)) {
            return Some(Ok(self.object("imu_start", None)));
        }
        if !self.device.sent_ids().any(|sent| sent == id) {
            return None;
        }
        Some(match self.device.measured(id, payload) {
            Ok(Some(measured)) => Ok(self.sample(&measured)),
            Ok(None) => Ok(self.object("imu_state", None)),
            Err(error) => Err(Rejected::Imu { imu: self.name.clone(), error }),
        })
    }

    fn sample(&self, measured: &Measured) -> Object {
        let mut object = self.object("imu_sample", Some(measured.field()));
        let values = match measured {
            Measured::Acceleration(values) | Measured::AngularVelocity(values) | Measured::Angles(values) => {
                values.to_vec()
            }
            Measured::Orientation(quaternion) => quaternion.parts().to_vec(),
        };
        object.insert("values", values);
        object
    }

    fn object(&self, kind: &str, quantity: Option<SampleField>) -> Object {
        let mut object = Object::new(&STEADYWIN, None);
        object.insert("kind", kind);
        if let Some(quantity) = quantity {
            object.insert("quantity", quantity.to_string());
        }
        object.insert("imu", self.name.as_str());
        object
    }
}
