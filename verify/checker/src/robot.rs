//! The robot: its motors, their addresses and their limits.

use crate::imu::{ImuTable, WiredImu};
use crate::protocol::Protocol;
use crate::protocol::codec::Ids;
use crate::protocol::ranges::Ranges;
use crate::vendor::Vendor;
use motord_bus::{Duration, Frame, FrameId, IdSet};
use serde::Deserialize;
use std::path::Path;

/// A robot whose cycle is checked.
#[derive(Debug, Clone)]
pub struct Robot {
    /// In the order of the published states.
    pub motors: Vec<Motor>,
    /// In the order of the published states.
    pub groups: Vec<Group>,
    /// Number of buses.
    pub buses: usize,
    /// Time between two ticks.
    pub period: Duration,
    /// A setpoint older than this must not move a motor.
    pub setpoint_timeout: Duration,
    /// Number of cycles without a reply after which a motor is lost.
    pub lost_cycles: u32,
}

impl Robot {
    /// Returns the motor whose register 21, 22 or 23 the frame reads; `None` for any other frame,
    /// such as a write.
    pub(crate) fn register_reader(&self, bus: usize, frame: &Frame) -> Option<usize> {
        let [id, 0, 0x33, 21..=23, 0, 0, 0, 0] = *frame.payload() else { return None };
        let is_it =
            |motor: &Motor| motor.protocol.codec().has_registers() && (motor.bus, motor.id) == (bus, id);
        if frame.id().raw() == 0x7FF { self.motors.iter().position(is_it) } else { None }
    }

    /// Returns the number of cycles in which every motor of the bus gets a command.
    #[must_use]
    pub fn turn(&self, bus: usize) -> u32 {
        self.motors.iter().filter(|motor| motor.bus == bus).map(|motor| motor.turn).max().unwrap_or(1)
    }
}

/// One motor.
#[derive(Debug, Clone)]
pub struct Motor {
    /// The joint.
    pub name: String,
    /// Index of its bus.
    pub bus: usize,
    /// The number that identifies it in a payload.
    pub id: u8,
    /// Ids of the commands.
    pub commands: IdSet,
    /// Ids of the replies.
    pub replies: IdSet,
    /// The protocol that it speaks.
    pub protocol: Protocol,
    /// Number of cycles per command to it.
    pub turn: u32,
    /// 1, or -1 when joint and motor turn opposite ways.
    pub direction: f64,
    /// Position of the joint when the motor is at zero, rad.
    pub offset: f64,
    /// Damping of the motor in a safe stop, N·m·s/rad.
    pub damping_kd: f64,
    /// The limits of the commands to the joint.
    pub limits: Limits,
}

impl Motor {
    /// Returns `true` when it gets no command in most cycles. One cycle may then take more than its
    /// turn.
    #[must_use]
    pub const fn has_turns(&self) -> bool {
        self.turn > 1
    }
}

/// Limits of one joint.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Lowest and highest, rad.
    pub position: [f64; 2],
    /// rad/s
    pub velocity: f64,
    /// N·m
    pub torque: Bound,
    /// N·m/rad
    pub kp: Bound,
    /// N·m·s/rad
    pub kd: Bound,
}

/// Limits of a value and of its slope.
#[derive(Debug, Clone, Copy)]
pub struct Bound {
    /// Highest value.
    pub most: f64,
    /// Highest rise, per second.
    pub slew: f64,
}

/// Joints that start and stop together.
#[derive(Debug, Clone)]
pub struct Group {
    /// Indices of its motors.
    pub motors: Vec<usize>,
    /// Its behaviour after its owner is lost.
    pub safe_stop: SafeStop,
}

/// The behaviour of a group after its owner is lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SafeStop {
    /// Brakes, then goes limp.
    Damp,
    /// Holds its position, then as above.
    Hold,
    /// Goes limp.
    Stop,
}

/// Interface and ids of the motors of a log, from a configuration of the daemon. Candump does not
/// record serial lines, so motors on them are left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Wiring {
    /// In the order of the configuration.
    pub motors: Vec<Wired>,
    /// The IMUs on CAN interfaces.
    pub imus: Vec<WiredImu>,
}

/// One motor on its interface.
#[derive(Debug, Clone, PartialEq)]
pub struct Wired {
    /// The joint.
    pub name: String,
    /// Its name in candump.
    pub interface: String,
    /// Its ids.
    pub ids: Ids,
    /// Its protocol. The ranges of the codes are those of one torque: the rules do not need them.
    pub protocol: Protocol,
    /// It has registers: requests to them have an id of their own.
    pub has_registers: bool,
    /// It answers a fault request. Another motor reads the request as a control frame.
    pub answers_question: bool,
    /// It runs only after a start. Another motor runs with its first impedance.
    pub needs_start: bool,
    /// Number of cycles per command to it.
    pub every: usize,
    /// Lowest and highest position of a command with stiffness, rad, of the motor. `None` where the
    /// file gives no limits, or the codes are not SteadyWin's.
    pub position: Option<[f64; 2]>,
}

/// The keys of the configuration that this crate needs. The daemon checks the others.
#[derive(Deserialize)]
struct File {
    bus: Vec<BusTable>,
    motor: Vec<MotorTable>,
    #[serde(default)]
    imu: Vec<ImuTable>,
}

#[derive(Deserialize)]
struct BusTable {
    name: String,
    /// `None` for a serial line.
    interface: Option<String>,
    every: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
struct MotorTable {
    name: String,
    bus: String,
    id: u16,
    host_id: Option<u16>,
    model: Option<String>,
    protocol: Option<String>,
    direction: Option<f64>,
    offset_rad: Option<f64>,
    gear_ratio: Option<f64>,
    limits: Option<LimitsTable>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
struct LimitsTable {
    position_rad: Option<[f64; 2]>,
}

impl MotorTable {
    /// Returns the limits of the joint, as positions of the motor.
    fn position(&self) -> Option<[f64; 2]> {
        let is_steadywin = self.protocol.as_deref() == Some("mit") && self.model.as_ref()?.starts_with("GIM");
        let limits = self.limits.as_ref().filter(|_| is_steadywin)?.position_rad?;
        let (direction, offset) = (self.direction.unwrap_or(1.0), self.offset_rad.unwrap_or(0.0));
        let [one, other] = limits.map(|position| direction * (position - offset));
        Some([one.min(other), one.max(other)])
    }
}

impl Wiring {
    /// Reads a configuration of the daemon whose buses are CAN interfaces or serial lines.
    ///
    /// # Errors
    ///
    /// A sentence with the reason.
    pub fn read(path: &Path) -> Result<Self, String> {
        let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
        Self::parse(&text).map_err(|error| format!("{}: {error}", path.display()))
    }

    /// Parses the text of such a configuration.
    ///
    /// # Errors
    ///
    /// A sentence with the reason.
    pub fn parse(text: &str) -> Result<Self, String> {
        let File { bus: buses, motor: motors, imu } =
            toml::from_str(text).map_err(|error| error.to_string())?;
        let imus = imu.iter().filter_map(|imu| {
            let bus = buses.iter().find(|bus| Some(&bus.name) == imu.bus.as_ref())?;
            imu.wired(bus.interface.clone()?, motors.iter().all(|motor| motor.bus != bus.name))
        });
        let imus = imus.collect();
        let wire = |motor: MotorTable| {
            let bus = buses.iter().find(|bus| bus.name == motor.bus);
            let bus = bus.ok_or_else(|| format!("{} is on no bus of the file", motor.name))?;
            let vendor = Vendor::of_model(motor.model.as_deref().unwrap_or_default());
            let position = motor.position();
            let reply_id = motor.host_id.unwrap_or(vendor.reply_offset.map_or(0, |offset| offset + motor.id));
            let ids = u8::try_from(motor.id).ok().zip(FrameId::new(reply_id));
            let ids = ids.map(|(motor, reply)| Ids { motor, reply });
            let ids = ids.ok_or_else(|| format!("{}: an id is too large", motor.name))?;
            let ranges = Ranges::steadywin(1.0);
            let protocol = Protocol::named(motor.protocol.as_deref().unwrap_or("mit"), ranges, vendor.reply);
            let protocol = motor.gear_ratio.map_or(protocol, |ratio| protocol.with_gear_ratio(ratio));
            Ok(bus.interface.clone().map(|interface| Wired {
                interface,
                position,
                name: motor.name,
                ids,
                protocol,
                has_registers: vendor.reply.registers,
                answers_question: vendor.reply.report.is_some() || !matches!(protocol, Protocol::Mit(_)),
                needs_start: !matches!(protocol, Protocol::MyActuator(_)),
                every: bus.every.unwrap_or(1).max(1),
            }))
        };
        let wired = motors.into_iter().filter_map(|motor| wire(motor).transpose());
        Ok(Self { motors: wired.collect::<Result<_, String>>()?, imus })
    }

    /// Returns the interfaces, each once, in the order of their first motors.
    #[must_use]
    pub fn interfaces(&self) -> Vec<&str> {
        let mut interfaces: Vec<&str> = Vec::new();
        for motor in &self.motors {
            if !interfaces.contains(&motor.interface.as_str()) {
                interfaces.push(&motor.interface);
            }
        }
        interfaces
    }
}

impl Wired {
    /// Returns interface and id in candump's format: in MIT, those of a command.
    #[must_use]
    pub fn address(&self) -> String {
        format!("{} {}", self.interface, FrameId::from(self.ids.motor))
    }
}
