//! The names of the parts of a robot.

use motord_settings::settings::Settings;

/// Names of the parts of the robot, in the order of the configuration.
#[derive(Debug, Clone, Default)]
pub struct Names {
    /// Names of joints and their motors.
    pub joints: Vec<String>,
    /// Names of groups.
    pub groups: Vec<String>,
    /// Names of buses.
    pub buses: Vec<String>,
    /// Names of IMUs.
    pub imus: Vec<String>,
}

impl Names {
    /// Returns the names of a configuration.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        Self {
            joints: settings.motors.iter().map(|motor| motor.name.clone()).collect(),
            groups: settings.groups.iter().map(|group| group.name.clone()).collect(),
            buses: settings.buses.iter().map(|bus| bus.name.clone()).collect(),
            imus: settings.sensors.imus.iter().map(|imu| imu.name.clone()).collect(),
        }
    }
}
