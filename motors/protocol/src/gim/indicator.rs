//! Indicators: the quantities that a motor measures. Source: GIM document Table 10.

/// A row of Table 10.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Indicator {
    /// The IndID byte.
    pub id: u8,
    /// A short name, usable as a key.
    pub name: &'static str,
    /// The unit of its value.
    pub unit: &'static str,
}

const fn indicator(id: u8, name: &'static str, unit: &'static str) -> Indicator {
    Indicator { id, name, unit }
}

/// Table 10. The table gives no unit for the temperatures. The replies to control commands use °C.
pub const INDICATORS: [Indicator; 22] = [
    indicator(0x00, "bus-voltage", "V"),
    indicator(0x01, "board-temperature", "°C"),
    indicator(0x02, "motor-temperature", "°C"),
    indicator(0x03, "power", "W"),
    indicator(0x04, "ia", "A"),
    indicator(0x05, "ib", "A"),
    indicator(0x06, "ic", "A"),
    indicator(0x07, "ialpha", "A"),
    indicator(0x08, "ibeta", "A"),
    indicator(0x09, "iq", "A"),
    indicator(0x0A, "id", "A"),
    indicator(0x0B, "iq-target", "A"),
    indicator(0x0C, "id-target", "A"),
    indicator(0x0D, "vq", "V"),
    indicator(0x0E, "vd", "V"),
    indicator(0x0F, "valpha", "V"),
    indicator(0x10, "vbeta", "V"),
    indicator(0x11, "rotor-electrical-angle", "rad"),
    indicator(0x12, "rotor-mechanical-angle", "rad"),
    indicator(0x13, "shaft-angle", "rad"),
    indicator(0x14, "shaft-speed", "rpm"),
    indicator(0x15, "output-power", "W"),
];

/// One rad/s in rpm.
pub const RPM: f32 = 60.0 / core::f32::consts::TAU;

impl Indicator {
    /// Id of the voltage of the supply, V.
    pub const BUS_VOLTAGE: u8 = 0x00;
    /// Id of the power, W.
    pub const POWER: u8 = 0x03;
    /// Id of the position of the output shaft, rad.
    pub const SHAFT_ANGLE: u8 = 0x13;
    /// Id of the speed of the output shaft, rpm.
    pub const SHAFT_SPEED: u8 = 0x14;

    /// Returns the row with this id, if there is one.
    #[must_use]
    pub fn by_id(id: u8) -> Option<&'static Self> {
        INDICATORS.iter().find(|indicator| indicator.id == id)
    }

    /// Returns the row with this name, if there is one.
    #[must_use]
    pub fn by_name(name: &str) -> Option<&'static Self> {
        INDICATORS.iter().find(|indicator| indicator.name == name)
    }
}
