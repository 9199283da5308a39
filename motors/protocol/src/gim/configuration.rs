//! The stored configuration of a motor. Source: GIM document Tables 6 and 7 and section 3.2.3.
//!
//! The gains have no documented scale, and the baud rate has no documented unit. A host reads them
//! before it writes them.

use crate::gim::value::ValueType::{self, Float, Integer};

/// Key of an item. Integers and floats are numbered separately.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ConfigurationKey {
    /// The ConfType byte, see [`ValueType`]. Kept as received, so that a reply that refuses an
    /// unknown type can be decoded.
    pub conf_type: u8,
    /// The ConfID byte.
    pub conf_id: u8,
}

impl ConfigurationKey {
    /// Returns the key of item `conf_id` of this type.
    #[must_use]
    pub const fn new(value_type: ValueType, conf_id: u8) -> Self {
        Self { conf_type: value_type as u8, conf_id }
    }

    /// Returns the row of Table 7, if there is one.
    #[must_use]
    pub fn item(self) -> Option<&'static ConfigurationItem> {
        CONFIGURATION.iter().find(|item| item.key() == self)
    }

    /// Returns `true` when the item is a position within one turn, see [`single_turn_position`].
    #[must_use]
    pub fn is_position(self) -> bool {
        matches!(self, ConfigurationItem::ZERO_POSITION | ConfigurationItem::POWER_OFF_POSITION)
    }
}

/// Returns the position of the output shaft within one turn, rad, 0 to 2π, of a zero or power-off
/// position. The value has sixteen bits in a field of 32. The meaning of the upper bits is not
/// documented; they are ignored.
#[must_use]
pub fn single_turn_position(value: i32) -> f64 {
    f64::from(value & 0xFFFF) * core::f64::consts::TAU / 65536.0
}

/// Access to an item.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Access {
    /// Read and write.
    ReadWrite,
    /// Read only.
    ReadOnly,
}

/// Time at which a written item takes effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Effective {
    /// Immediately.
    Immediately,
    /// After the motor has been powered off and on.
    AfterReboot,
}

/// A row of Table 7.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConfigurationItem {
    /// Integer or float.
    pub value_type: ValueType,
    /// The ConfID byte.
    pub conf_id: u8,
    /// A short name, usable as a key.
    pub name: &'static str,
    /// The unit. Empty for plain numbers and where the document gives none.
    pub unit: &'static str,
    /// Access to the item.
    pub access: Access,
    /// Time at which a written value takes effect.
    pub effective: Effective,
    /// The values that a motor may have, both ends included, in the unit; `None` where the document
    /// gives no scale. The document gives no ranges: these are wider than any motor of this size,
    /// and narrower than a mistake in the unit.
    pub plausible: Option<(f32, f32)>,
}

const fn item(
    value_type: ValueType,
    conf_id: u8,
    name: &'static str,
    unit: &'static str,
) -> ConfigurationItem {
    let (access, effective) = (Access::ReadWrite, Effective::Immediately);
    ConfigurationItem { value_type, conf_id, name, unit, access, effective, plausible: None }
}

impl ConfigurationItem {
    /// Names of the items that determine torque and angle: the rotor's torque constant, the gear
    /// ratio and the number of pole pairs.
    pub const CONSTANTS: [&str; 3] = ["torque-constant", "gear-ratio", "pole-pairs"];
    /// The motor's CAN id.
    pub const CAN_ID: ConfigurationKey = ConfigurationKey::new(Integer, 0x12);
    /// The arbitration id of the motor's replies.
    pub const HOST_ID: ConfigurationKey = ConfigurationKey::new(Integer, 0x13);
    /// The position that is zero, see [`single_turn_position`].
    pub const ZERO_POSITION: ConfigurationKey = ConfigurationKey::new(Integer, 0x14);
    /// The position at the last power-off, see [`single_turn_position`].
    pub const POWER_OFF_POSITION: ConfigurationKey = ConfigurationKey::new(Integer, 0x15);
    /// 0 for the native protocol over CAN, 1 for MIT. Over CAN, a motor in MIT mode cannot be set
    /// back to native mode.
    pub const PROTOCOL: ConfigurationKey = ConfigurationKey::new(Integer, 0x1C);
    /// Rotor turns per turn of the output shaft. An integer: other ratios cannot be stored.
    pub const GEAR_RATIO: ConfigurationKey = ConfigurationKey::new(Integer, 0x11);
    /// The rotor's torque constant, N·m/A.
    pub const TORQUE_CONSTANT: ConfigurationKey = ConfigurationKey::new(Float, 0x03);

    /// Returns the item's key.
    #[must_use]
    pub const fn key(&self) -> ConfigurationKey {
        ConfigurationKey::new(self.value_type, self.conf_id)
    }

    /// Returns the row with this name, if there is one.
    #[must_use]
    pub fn by_name(name: &str) -> Option<&'static Self> {
        CONFIGURATION.iter().find(|item| item.name == name)
    }

    const fn after_reboot(self) -> Self {
        Self { effective: Effective::AfterReboot, ..self }
    }

    const fn within(self, least: f32, most: f32) -> Self {
        Self { plausible: Some((least, most)), ..self }
    }

    /// Returns `false` for a value that no motor has.
    #[must_use]
    pub fn is_plausible(&self, value: f64) -> bool {
        self.plausible.is_none_or(|(least, most)| (f64::from(least)..=f64::from(most)).contains(&value))
    }

    const fn read_only(self) -> Self {
        Self { access: Access::ReadOnly, ..self }
    }
}

/// Table 7. Resistance and inductance are from phase to phase, as the Chinese edition specifies.
pub const CONFIGURATION: [ConfigurationItem; 30] = [
    item(Integer, 0x00, "pole-pairs", "").within(1.0, 100.0),
    item(Integer, 0x01, "rated-current", "A").within(1.0, 200.0),
    item(Integer, 0x02, "max-speed", "rpm").within(1.0, 20_000.0),
    item(Integer, 0x06, "rated-voltage", "V").within(6.0, 100.0),
    item(Integer, 0x07, "pwm-frequency", "Hz").after_reboot().within(1000.0, 200_000.0),
    item(Integer, 0x08, "current-kp", ""),
    item(Integer, 0x09, "current-ki", ""),
    item(Integer, 0x0C, "speed-kp", ""),
    item(Integer, 0x0D, "speed-ki", ""),
    item(Integer, 0x0E, "position-kp", ""),
    item(Integer, 0x0F, "position-ki", ""),
    item(Integer, 0x10, "position-kd", ""),
    item(Integer, 0x11, "gear-ratio", "").within(1.0, 500.0),
    item(Integer, 0x12, "can-id", ""),
    item(Integer, 0x13, "host-id", ""),
    item(Integer, 0x14, "zero-position", "turn/65536"),
    item(Integer, 0x15, "power-off-position", "turn/65536").read_only(),
    item(Integer, 0x16, "over-voltage", "V").within(6.0, 120.0),
    item(Integer, 0x17, "under-voltage", "V").within(5.0, 100.0),
    item(Integer, 0x18, "can-baud-rate", ""),
    item(Integer, 0x19, "flux-weakening-kp", ""),
    item(Integer, 0x1A, "flux-weakening-ki", ""),
    item(Integer, 0x20, "over-temperature", "°C").within(30.0, 200.0),
    item(Integer, 0x1C, "can-protocol", ""),
    item(Float, 0x00, "phase-resistance", "Ω").within(1e-3, 100.0),
    item(Float, 0x01, "phase-inductance", "H").within(1e-7, 0.1),
    item(Float, 0x02, "back-emf-constant", "Vrms/krpm").within(0.01, 1000.0),
    item(Float, 0x03, "torque-constant", "N·m/A").within(1e-3, 10.0),
    item(Float, 0x04, "sampling-resistance", "Ω").within(1e-5, 1.0),
    item(Float, 0x05, "amplification-gain", "").within(1.0, 1000.0),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gim::{INDICATORS, Indicator, PARAMETERS, Parameter};

    #[test]
    fn table_rows_are_found_by_number_and_name() {
        for item in &CONFIGURATION {
            assert_eq!((item.key().item(), ConfigurationItem::by_name(item.name)), (Some(item), Some(item)));
        }
        for row in &PARAMETERS {
            assert_eq!((Parameter::by_id(row.id), Parameter::by_name(row.name)), (Some(row), Some(row)));
        }
        for row in &INDICATORS {
            assert_eq!((Indicator::by_id(row.id), Indicator::by_name(row.name)), (Some(row), Some(row)));
        }
    }

    /// The voltages are those of motors for 12 to 60 V; a value in centivolts or millivolts is
    /// none.
    #[test]
    fn value_of_another_unit_is_not_plausible() {
        let item = |name| ConfigurationItem::by_name(name).unwrap();
        for (name, good, wrong) in [
            ("over-voltage", 56.0, 5200.0),
            ("under-voltage", 12.0, 1200.0),
            ("max-speed", 3000.0, 3e5),
            ("over-temperature", 90.0, 900.0),
            ("torque-constant", 0.125, 125.0),
            ("phase-resistance", 0.48, 480.0),
        ] {
            assert!(item(name).is_plausible(good) && !item(name).is_plausible(wrong), "{name}");
            assert!(!item(name).is_plausible(-good) && !item(name).is_plausible(f64::NAN), "{name}");
        }
        assert!(item("current-kp").is_plausible(1e9), "the gains have no documented scale");
    }

    #[test]
    fn only_documented_items_are_readonly_or_need_reboot() {
        let read_only = |item: &&ConfigurationItem| item.access == Access::ReadOnly;
        let late = |item: &&ConfigurationItem| item.effective == Effective::AfterReboot;
        assert!(CONFIGURATION.iter().filter(read_only).map(|item| item.name).eq(["power-off-position"]));
        assert!(CONFIGURATION.iter().filter(late).map(|item| item.name).eq(["pwm-frequency"]));
    }

    #[test]
    fn quarter_turn_is_16384_whatever_upper_bits() {
        assert_eq!(single_turn_position(16384), core::f64::consts::FRAC_PI_2);
        assert_eq!(single_turn_position(-49152), core::f64::consts::FRAC_PI_2);
    }
}
