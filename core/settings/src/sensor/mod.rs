//! The sensors of a robot. Each kind is a module here, and a field of [`SensorSettings`].

mod frames;
pub mod imu;

pub use frames::SensorFrames;

use imu::ImuSettings;

/// The sensors of a robot, by kind.
#[derive(Debug, Clone, Default)]
pub struct SensorSettings {
    /// `[[imu]]`, in the order of the file.
    pub imus: Vec<ImuSettings>,
}

impl SensorSettings {
    /// Returns the frames of the sensors of a CAN bus, of every kind. Allocates.
    pub fn on_bus(&self, bus: usize) -> impl Iterator<Item = SensorFrames> {
        let sensors = self.imus.iter().filter_map(ImuSettings::frames);
        sensors.filter(move |sensor| sensor.bus == bus)
    }
}
