//! The memory of a motor: configuration (GIM document, table 7) and parameters (table 8).

use crate::settings::{Dialect, MotorSettings};
use crate::wire::result;

/// Integer items that do something here, by ConfID.
pub(super) mod int {
    pub(crate) const SPEED_MAX_RPM: u8 = 0x02;
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
const TORQUE_CONSTANT: usize = 0x03;
const PARAMETERS: usize = 9;
/// ConfIDs of type 0x00 that table 7 leaves out.
const UNASSIGNED: [u8; 9] = [0x03, 0x04, 0x05, 0x0A, 0x0B, 0x1B, 0x1D, 0x1E, 0x1F];
/// Motor Wizard shows the baud rate as a number of 100 kbit/s; the document gives no unit.
const BAUD_UNIT: u32 = 100_000;

/// All items of one motor. Gains are stored and can be read, and have no effect: the document gives no unit for them.
#[derive(Debug, Clone)]
pub(crate) struct Configuration {
    ints: [i32; INTS],
    floats: [f32; FLOATS],
    parameters: [u32; PARAMETERS],
}

impl Configuration {
    /// A motor as it was commissioned, for a bus of `bitrate` bit/s.
    pub(super) fn new(settings: &MotorSettings, bitrate: u32) -> Self {
        let mut new = Self::factory(settings);
        let id = |raw: u16| i32::from(raw.min(0x7FF));
        *new.item(int::CAN_ID) = id(settings.id);
        *new.item(int::HOST_ID) = id(settings.host_id);
        *new.item(int::PROTOCOL) = i32::from(settings.dialect == Dialect::Mit);
        *new.item(int::BAUD) = baud(bitrate);
        new
    }

    /// The values after a reset of the configuration. The vendor prints no defaults but protocol 0; the id 1 is seen in the field.
    pub(super) fn factory(settings: &MotorSettings) -> Self {
        let mut ints = [0; INTS];
        let rated_current = settings.torque_peak / (settings.torque_constant * settings.gear_ratio) / 3.0;
        let items: [(u8, i32); 14] = [
            (0x00, i32::from(settings.pole_pairs)),
            (0x01, rated_current as i32),
            (int::SPEED_MAX_RPM, rpm(settings.velocity_max).ceil() as i32),
            (0x06, settings.supply_voltage as i32),
            (0x07, 20_000),
            (0x08, 100),
            (0x0C, 100),
            (0x0E, 100),
            (int::GEAR_RATIO, settings.gear_ratio.round() as i32),
            (int::CAN_ID, 1),
            (int::OVER_VOLTAGE, 56),
            (int::UNDER_VOLTAGE, 12),
            (int::BAUD, 10),
            (int::OVER_TEMPERATURE, 100),
        ];
        for (id, value) in items {
            ints[usize::from(id)] = value;
        }
        let constant = settings.torque_constant as f32;
        let (resistance, inductance) =
            (settings.winding_resistance as f32, settings.winding_inductance as f32);
        let floats = [resistance, inductance, constant * 74.0, constant, 0.001, 20.0];
        Self { ints, floats, parameters: [100, 0, 100, 0, 100, 0, 0, 0, 0] }
    }

    pub(crate) fn int(&self, id: u8) -> i32 {
        self.ints.get(usize::from(id)).copied().unwrap_or(0)
    }

    pub(super) fn set_int(&mut self, id: u8, value: i32) {
        *self.item(id) = value;
    }

    fn item(&mut self, id: u8) -> &mut i32 {
        &mut self.ints[usize::from(id) % INTS]
    }

    /// Rotor side, N·m/A.
    pub(super) fn torque_constant(&self) -> f64 {
        f64::from(self.floats[TORQUE_CONSTANT])
    }

    /// A motor with this configuration can follow a CAN bus of `bitrate` bit/s.
    pub(super) fn listens_at(&self, bitrate: u32) -> bool {
        self.int(int::BAUD) == baud(bitrate)
    }

    /// Retrieve configuration: the item's bytes, or a result code.
    pub(super) fn retrieve(&self, kind: u8, id: u8) -> Result<[u8; 4], u8> {
        match kind {
            0x00 if is_int(id) => Ok(self.int(id).to_le_bytes()),
            0x01 => self
                .floats
                .get(usize::from(id))
                .map(|value| value.to_le_bytes())
                .ok_or(result::UNKNOWN_REGISTER),
            0x00 => Err(result::UNKNOWN_REGISTER),
            _ => Err(result::DATA_FORMAT),
        }
    }

    /// Modify configuration. `Err` holds a result code.
    pub(super) fn modify(&mut self, kind: u8, id: u8, data: [u8; 4]) -> Result<(), u8> {
        self.retrieve(kind, id)?;
        if kind == 0x00 {
            return self.modify_int(id, i32::from_le_bytes(data));
        }
        let value = f32::from_le_bytes(data);
        if !value.is_finite() || (usize::from(id) == TORQUE_CONSTANT && value <= 0.0) {
            return Err(result::DATA_FORMAT);
        }
        self.floats[usize::from(id)] = value;
        Ok(())
    }

    fn modify_int(&mut self, id: u8, value: i32) -> Result<(), u8> {
        let allowed = match id {
            int::POWER_OFF_POSITION => return Err(result::READ_ONLY),
            int::CAN_ID | int::HOST_ID => 0..=0x7FF,
            int::PROTOCOL => 0..=1,
            int::ZERO_POSITION => 0..=0xFFFF,
            int::GEAR_RATIO | int::SPEED_MAX_RPM | int::BAUD => 1..=i32::MAX,
            _ => i32::MIN..=i32::MAX,
        };
        if !allowed.contains(&value) {
            return Err(result::DATA_FORMAT);
        }
        self.set_int(id, value);
        Ok(())
    }

    /// Retrieve parameter.
    pub(super) fn parameter(&self, id: u8) -> Result<[u8; 4], u8> {
        self.parameters.get(usize::from(id)).map(|value| value.to_le_bytes()).ok_or(result::UNKNOWN_REGISTER)
    }

    /// Modify parameter.
    pub(super) fn modify_parameter(&mut self, id: u8, data: [u8; 4]) -> Result<(), u8> {
        let item = self.parameters.get_mut(usize::from(id)).ok_or(result::UNKNOWN_REGISTER)?;
        *item = u32::from_le_bytes(data);
        Ok(())
    }
}

fn baud(bitrate: u32) -> i32 {
    (bitrate / BAUD_UNIT) as i32
}

fn is_int(id: u8) -> bool {
    usize::from(id) < INTS && !UNASSIGNED.contains(&id)
}

/// From rad/s.
pub(super) fn rpm(velocity: f64) -> f64 {
    velocity * 30.0 / core::f64::consts::PI
}
