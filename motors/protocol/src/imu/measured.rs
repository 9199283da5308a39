//! One quantity of a sample, for devices that send each in a frame.

use super::error::SampleField;
use super::sample::{Quaternion, Sample};

/// The content of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measured {
    /// Specific force along x, y, z, m/s².
    Acceleration([f32; 3]),
    /// Angular velocity about x, y, z, rad/s.
    AngularVelocity([f32; 3]),
    /// Angles of roll, pitch and yaw, rad, in the vendor's convention. No sample contains them.
    Angles([f32; 3]),
    /// Rotation from the sensor to the world.
    Orientation(Quaternion),
}

impl Measured {
    /// Returns the quantity.
    #[must_use]
    pub const fn field(&self) -> SampleField {
        match self {
            Self::Acceleration(_) => SampleField::Acceleration,
            Self::AngularVelocity(_) => SampleField::AngularVelocity,
            Self::Angles(_) => SampleField::Angles,
            Self::Orientation(_) => SampleField::Orientation,
        }
    }

    /// Stores the value in `sample`.
    pub(super) fn store(self, sample: &mut Sample) {
        match self {
            Self::Acceleration(value) => sample.acceleration = Some(value),
            Self::AngularVelocity(value) => sample.angular_velocity = Some(value),
            Self::Orientation(value) => sample.orientation = Some(value),
            Self::Angles(_) => {}
        }
    }
}
