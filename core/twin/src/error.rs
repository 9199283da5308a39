//! The errors of a twin.

use motord_configuration::ConfigError;

/// Largest position, velocity or acceleration of a plant, rad, rad/s and m/s². The state has `f32`,
/// which resolves less than a degree at a hundredth of it.
pub const NUMBER_MAX: f64 = 1e7;

/// The reason why a configuration has no twin.
#[derive(Debug)]
pub enum TwinError {
    /// The configuration has errors.
    Configuration(ConfigError),
    /// The mechanics begin where no joint can be.
    Begin {
        /// The name of the joint.
        joint: String,
        /// rad.
        position: f64,
    },
    /// The twin has no serial lines.
    SerialBus {
        /// The name of the bus.
        bus: String,
    },
}

impl core::fmt::Display for TwinError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Configuration(error) => error.fmt(f),
            Self::Begin { joint, position } => write!(
                f,
                "the plant begins with {joint} at {position:e} rad: give it a position from {:e} to {NUMBER_MAX:e}",
                -NUMBER_MAX
            ),
            Self::SerialBus { bus } => write!(
                f,
                "bus {bus} is a serial line, which a twin does not have: give its motors a CAN bus for the twin"
            ),
        }
    }
}

impl core::error::Error for TwinError {}
