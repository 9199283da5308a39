//! The memory of a motor: configuration (GIM document, table 7) and parameters (table 8).

use crate::dialect::Dialect;
use crate::settings::{MotorSettings, Persistence};
use crate::wire::result;
use core::fmt::Write;
use core::ops::RangeInclusive;

/// ConfIDs of the integer items that the simulator uses.
pub(super) mod int {
    pub(crate) const SPEED_MAX_RPM: u8 = 0x02;
    pub(crate) const PWM_FREQUENCY: u8 = 0x07;
    pub(crate) const GEAR_RATIO: u8 = 0x11;
    pub(crate) const CAN_ID: u8 = 0x12;
    pub(crate) const HOST_ID: u8 = 0x13;
    pub(crate) const ZERO_POSITION: u8 = 0x14;
    pub(crate) const POWER_OFF_POSITION: u8 = 0x15;
    pub(crate) const OVER_VOLTAGE: u8 = 0x16;
    pub(crate) const UNDER_VOLTAGE: u8 = 0x17;
    pub(crate) const BAUD: u8 = 0x18;
    pub(crate) const PROTOCOL: u8 = 0x1C;
    pub(crate) const OVER_TEMPERATURE: u8 = 0x20;
}

const INTS: usize = 0x21;
const FLOATS: usize = 6;
const INT: u8 = 0x00;
const FLOAT: u8 = 0x01;
const TORQUE_CONSTANT: usize = 0x03;
/// 1000 rpm, rad/s.
const KRPM: f64 = 1000.0 * core::f64::consts::PI / 30.0;
/// Effective line-to-line voltage of a phase amplitude of 1 V: the square root of 3/2. Resistance
/// and inductance are also line to line.
const EFFECTIVE_LINE_TO_LINE: f64 = 1.224_744_871_391_589;
/// ConfIDs of type 0x00 that table 7 leaves out.
const UNASSIGNED: [u8; 9] = [0x03, 0x04, 0x05, 0x0A, 0x0B, 0x1B, 0x1D, 0x1E, 0x1F];
/// Motor Wizard shows the baud rate in units of 100 kbit/s. The document gives no unit.
const BAUD_UNIT: u32 = 100_000;
/// The default of each parameter of table 8, by ConfID.
const DEFAULT_GAINS: [u8; 9] = [0x08, 0x09, 0x0C, 0x0D, 0x0E, 0x0F, 0x10, 0x19, 0x1A];

/// The values of table 7.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Items {
    ints: [i32; INTS],
    floats: [f32; FLOATS],
}

/// All items of one motor, in effect and stored. Gains have no effect: the document gives no unit
/// for them.
#[derive(Debug, Clone)]
pub(crate) struct Configuration {
    items: Items,
    /// Non-volatile.
    stored: Items,
    /// Number of writes into `stored`.
    revision: u32,
    persistence: Persistence,
    parameters: [u32; DEFAULT_GAINS.len()],
    /// Takes effect only after a reboot (table 7).
    pwm_frequency: i32,
}

impl Configuration {
    /// Returns the configuration of a commissioned motor, or the vendor's for a new one. `bitrate`
    /// is that of the CAN bus, bit/s; `None` on a serial line, which has a separate rate.
    pub(super) fn new(settings: &MotorSettings, bitrate: Option<u32>) -> Self {
        let mut items = Items::factory(settings);
        if !settings.is_new {
            let id = |raw: u16| i32::from(raw.min(0x7FF));
            *items.int(int::CAN_ID) = id(settings.id);
            *items.int(int::HOST_ID) = id(settings.host_id);
            *items.int(int::PROTOCOL) = settings.dialect.number();
            if let Some(bitrate) = bitrate {
                *items.int(int::BAUD) = baud(bitrate);
            }
        }
        let persistence = settings.behaviour.persistence;
        let mut new =
            Self { items, stored: items, revision: 0, persistence, parameters: [0; 9], pwm_frequency: 0 };
        new.boot();
        new
    }

    /// Loads the stored items when the power returns.
    pub(super) fn boot(&mut self) {
        self.items = self.stored;
        self.pwm_frequency = self.int(int::PWM_FREQUENCY);
        self.parameters = DEFAULT_GAINS.map(|id| self.int(id).cast_unsigned());
    }

    /// Executes reset configuration: restores the vendor's values.
    pub(super) fn reset(&mut self, settings: &MotorSettings) {
        self.items = Items::factory(settings);
        DEFAULT_GAINS.iter().for_each(|id| self.apply_gain(*id));
        self.written();
    }

    /// Executes refresh configuration: stores the modified items.
    pub(super) fn refresh(&mut self) {
        self.store();
    }

    fn written(&mut self) {
        if self.persistence == Persistence::AtOnce {
            self.store();
        }
    }

    fn store(&mut self) {
        self.stored = self.items;
        self.revision = self.revision.wrapping_add(1);
    }

    pub(super) fn int(&self, id: u8) -> i32 {
        self.items.ints.get(usize::from(id)).copied().unwrap_or(0)
    }

    /// Writes an integer item, if it may have this value. It lasts until the power is lost.
    pub(super) fn set_int(&mut self, id: u8, value: i32) {
        if range(id).contains(&value) {
            *self.items.int(id) = value;
        }
    }

    /// Writes and stores an item for the drive itself.
    pub(super) fn keep_int(&mut self, id: u8, value: i32) {
        *self.items.int(id) = value;
        *self.stored.int(id) = value;
        self.revision = self.revision.wrapping_add(1);
    }

    /// Stores an item that takes effect when the power returns.
    pub(super) fn keep_for_boot(&mut self, id: u8, value: i32) {
        *self.stored.int(id) = value;
        self.revision = self.revision.wrapping_add(1);
    }

    /// Returns the torque constant of the rotor, N·m/A.
    pub(super) fn torque_constant(&self) -> f64 {
        f64::from(self.items.floats[TORQUE_CONSTANT])
    }

    /// Returns the PWM frequency in effect, Hz.
    pub(super) fn pwm_frequency(&self) -> i32 {
        self.pwm_frequency
    }

    /// Returns `true` when a motor with this configuration can receive frames at `bitrate` bit/s.
    pub(super) fn listens_at(&self, bitrate: u32) -> bool {
        self.int(int::BAUD) == baud(bitrate)
    }

    /// Executes retrieve configuration: returns the item's bytes, or a result code.
    pub(super) fn retrieve(&self, kind: u8, id: u8) -> Result<[u8; 4], u8> {
        match kind {
            INT if is_int(id) => Ok(self.int(id).to_le_bytes()),
            FLOAT => {
                let value = self.items.floats.get(usize::from(id));
                value.map(|value| value.to_le_bytes()).ok_or(result::UNKNOWN_REGISTER)
            }
            INT => Err(result::UNKNOWN_REGISTER),
            _ => Err(result::DATA_FORMAT),
        }
    }

    /// Executes modify configuration. `Err` holds a result code: then nothing has changed.
    pub(super) fn modify(&mut self, kind: u8, id: u8, data: [u8; 4]) -> Result<(), u8> {
        self.retrieve(kind, id)?;
        self.items.set(kind, id, data)?;
        if kind == INT {
            self.apply_gain(id);
        }
        self.written();
        Ok(())
    }

    /// Applies a default gain immediately (table 7): the parameter of the running loop gets its
    /// value.
    fn apply_gain(&mut self, id: u8) {
        if let Some(index) = DEFAULT_GAINS.iter().position(|gain| *gain == id) {
            self.parameters[index] = self.int(id).cast_unsigned();
        }
    }

    /// Executes retrieve parameter.
    pub(super) fn parameter(&self, id: u8) -> Result<[u8; 4], u8> {
        self.parameters.get(usize::from(id)).map(|value| value.to_le_bytes()).ok_or(result::UNKNOWN_REGISTER)
    }

    /// Executes modify parameter, which lasts until the next reboot.
    pub(super) fn modify_parameter(&mut self, id: u8, data: [u8; 4]) -> Result<(), u8> {
        let item = self.parameters.get_mut(usize::from(id)).ok_or(result::UNKNOWN_REGISTER)?;
        *item = u32::from_le_bytes(data);
        Ok(())
    }

    /// Returns a number that differs after each write into the non-volatile memory.
    pub(super) fn revision(&self) -> u32 {
        self.revision
    }

    /// Returns the non-volatile values: a line for each item, with its type, its ConfID and its
    /// value.
    pub(super) fn memory(&self) -> String {
        let mut text = String::new();
        for (id, value) in (0_u8..).zip(self.stored.ints).filter(|(id, _)| is_int(*id)) {
            let _written = writeln!(text, "int 0x{id:02X} {value}");
        }
        for (id, value) in (0_u8..).zip(self.stored.floats) {
            let _written = writeln!(text, "float 0x{id:02X} {value:?}");
        }
        text
    }

    /// Reads the text of [`memory`](Self::memory). Items that are not in `text` keep their values.
    /// `None` when a line is not an item: then nothing has changed.
    pub(super) fn remember(&mut self, text: &str) -> Option<()> {
        let mut stored = self.stored;
        text.lines().try_for_each(|line| stored.read(line))?;
        self.stored = stored;
        self.boot();
        Some(())
    }
}

impl Items {
    /// Returns the values after a reset of the configuration. The vendor prints no default except
    /// protocol 0. The id 1 was observed on real motors, the host id 0 on motors of the same
    /// family. A driver with CANSimple has 500 kbit/s, an ODrive 250 kbit/s. RobStride's drives begin
    /// in their private protocol, with the host id of the vendor's examples. Damiao's begin in MIT
    /// (ESC_ID 1, MST_ID 0, mode 1).
    fn factory(settings: &MotorSettings) -> Self {
        let mut ints = [0; INTS];
        let rated_current = settings.torque_peak / (settings.torque_constant * settings.gear_ratio) / 3.0;
        let (protocol, host_id) = match settings.vendor {
            _ if settings.dialect == Dialect::CanSimple => (Dialect::CanSimple, 0),
            _ if settings.dialect == Dialect::MyActuator => (Dialect::MyActuator, 0),
            _ if settings.dialect == Dialect::ODrive => (Dialect::ODrive, 0),
            "steadywin" => (Dialect::Gim, 0),
            "robstride" => (Dialect::RobStride, 0xFD),
            _ => (Dialect::Mit, 0),
        };
        let bitrate = match protocol {
            Dialect::CanSimple => 500_000,
            Dialect::ODrive => 250_000,
            _ => 1_000_000,
        };
        let items: [(u8, i32); 16] = [
            (0x00, i32::from(settings.pole_pairs)),
            (0x01, rated_current as i32),
            (int::SPEED_MAX_RPM, rpm(settings.velocity_max).ceil() as i32),
            (0x06, settings.supply_voltage as i32),
            (int::PWM_FREQUENCY, 20_000),
            (0x08, 100),
            (0x0C, 100),
            (0x0E, 100),
            (int::GEAR_RATIO, settings.gear_ratio.round() as i32),
            (int::CAN_ID, 1),
            (int::HOST_ID, host_id),
            (int::PROTOCOL, protocol.number()),
            (int::OVER_VOLTAGE, 56),
            (int::UNDER_VOLTAGE, 12),
            (int::BAUD, baud(bitrate)),
            (int::OVER_TEMPERATURE, 100),
        ];
        for (id, value) in items {
            ints[usize::from(id)] = value;
        }
        let constant = settings.torque_constant as f32;
        let (resistance, inductance) =
            (settings.winding_resistance as f32, settings.winding_inductance as f32);
        let back_emf = (settings.back_emf() * KRPM * EFFECTIVE_LINE_TO_LINE) as f32;
        Self { ints, floats: [resistance, inductance, back_emf, constant, 0.001, 20.0] }
    }

    fn int(&mut self, id: u8) -> &mut i32 {
        &mut self.ints[usize::from(id) % INTS]
    }

    /// Sets an item, which must exist. `Err` holds a result code.
    fn set(&mut self, kind: u8, id: u8, data: [u8; 4]) -> Result<(), u8> {
        if kind == FLOAT {
            let value = f32::from_le_bytes(data);
            let is_constant = usize::from(id) == TORQUE_CONSTANT;
            if !value.is_finite() || is_constant && value <= 0.0 {
                return Err(result::DATA_FORMAT);
            }
            self.floats[usize::from(id) % FLOATS] = value;
            return Ok(());
        }
        let value = i32::from_le_bytes(data);
        match id {
            int::POWER_OFF_POSITION => return Err(result::READ_ONLY),
            _ if !range(id).contains(&value) => return Err(result::DATA_FORMAT),
            _ => *self.int(id) = value,
        }
        Ok(())
    }

    /// Reads a line of a motor's memory.
    fn read(&mut self, line: &str) -> Option<()> {
        let mut words = line.split_whitespace();
        let (kind, id, value) = (words.next()?, words.next()?, words.next()?);
        let id = u8::from_str_radix(id.strip_prefix("0x")?, 16).ok()?;
        match kind {
            "int" if is_int(id) => *self.int(id) = value.parse().ok()?,
            "float" => *self.floats.get_mut(usize::from(id))? = value.parse().ok()?,
            _ => return None,
        }
        words.next().is_none().then_some(())
    }
}

/// Returns the values that an integer item may have, by table 7 and 3.2.3. Values that are invalid
/// for any motor are excluded.
fn range(id: u8) -> RangeInclusive<i32> {
    match id {
        int::CAN_ID | int::HOST_ID => 0..=0x7FF,
        int::PROTOCOL => 0..=1,
        int::ZERO_POSITION => 0..=0xFFFF,
        // At most 1 Mbit/s (table 1).
        int::BAUD => 1..=10,
        int::GEAR_RATIO | int::SPEED_MAX_RPM | int::PWM_FREQUENCY | 0x00 => 1..=i32::MAX,
        _ => i32::MIN..=i32::MAX,
    }
}

fn baud(bitrate: u32) -> i32 {
    (bitrate / BAUD_UNIT) as i32
}

fn is_int(id: u8) -> bool {
    usize::from(id) < INTS && !UNASSIGNED.contains(&id)
}

/// Converts rad/s to rpm.
pub(super) fn rpm(velocity: f64) -> f64 {
    velocity * 30.0 / core::f64::consts::PI
}
