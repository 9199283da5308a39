//! The sensors of a robot. Each kind is a module here, and a field of [`SensorSettings`].

mod frames;
pub mod imu;

pub use frames::SensorFrames;

use imu::ImuSettings;

/// The sensors of a robot, by kind. An index among all sensors counts the kinds in this order.
#[derive(Debug, Clone, Default)]
pub struct SensorSettings {
    /// `[[imu]]`, in the order of the file.
    pub imus: Vec<ImuSettings>,
}

impl SensorSettings {
    /// Returns the name of each sensor, and its words: the kind, and the page of `motorctl explain`
    /// and the advice when it is lost.
    pub fn words(&self) -> impl Iterator<Item = (&str, [&'static str; 3])> {
        self.imus.iter().map(ImuSettings::words)
    }

    /// Returns the frames of the sensors of a CAN bus, of every kind. Allocates.
    pub fn on_bus(&self, bus: usize) -> impl Iterator<Item = SensorFrames> {
        let sensors = self.imus.iter().filter_map(ImuSettings::frames);
        sensors.filter(move |sensor| sensor.bus == bus)
    }
}
