//! The state of an inertial measurement unit (IMU).

use crate::field::{Field, Kind};
use crate::plain::plain;

/// [`ImuState::flags`]: a sample was received since the previous states were published.
pub const IMU_FRESH: u32 = 1 << 0;
/// [`ImuState::flags`]: at least one sample was received since the daemon started.
pub const IMU_VALID: u32 = 1 << 1;
/// [`ImuState::flags`]: no sample has been received for longer than `lost-after-ms`, or the device is disconnected. Set until
/// the first sample.
pub const IMU_LOST: u32 = 1 << 2;

plain! {
    /// One IMU in a cycle. [`FIELDS`](Self::FIELDS) describes the fields.
    pub struct ImuState {
        /// Orientation: the unit quaternion w, x, y, z that turns a vector of the body into the world, whose z points up.
        pub orientation: [f32; 4],
        /// Angular velocity of the body, in its frame, rad/s.
        pub angular_velocity: [f32; 3],
        /// Specific force on the body, in its frame, m/s²: at rest 9.81 upwards.
        pub acceleration: [f32; 3],
        /// Temperature of the sensor, °C; NaN when it is not reported.
        pub temperature: f32,
        /// `IMU_*` flags.
        pub flags: u32,
        /// Samples that the device took and motord did not receive, modulo 2³².
        pub missing: u32,
        /// Samples rejected: damaged, not finite, or with an orientation that is no unit quaternion; modulo 2³².
        pub rejected: u32,
        /// Samples received since the daemon started.
        pub sequence: u64,
        /// Time when the sample was received, ns of `CLOCK_MONOTONIC`; 0 before the first.
        pub receive_ns: u64,
    }
}

/// Describes a field of `ImuState`.
macro_rules! field {
    ($name:ident, $doc:literal, $unit:literal, $kind:expr, $json:expr, $proto:expr) => {
        Field {
            name: stringify!($name),
            doc: $doc,
            unit: $unit,
            kind: $kind,
            offset: core::mem::offset_of!(ImuState, $name),
            json: $json,
            proto: $proto,
        }
    };
}

/// Describes a flag of `ImuState`.
macro_rules! flag {
    ($name:literal, $doc:literal, $bit:expr, $number:literal) => {
        Field {
            name: $name,
            doc: $doc,
            unit: "",
            kind: Kind::Flag($bit),
            offset: core::mem::offset_of!(ImuState, flags),
            json: Some($name),
            proto: Some(($name, $number)),
        }
    };
}

impl ImuState {
    /// All fields and flags, in the order of the memory.
    pub const FIELDS: &'static [Field] = &[
        field!(
            orientation,
            "Orientation of the body in the world, whose z points up: a unit quaternion w, x, y, z.",
            "",
            Kind::Vector(4),
            Some("orientation"),
            Some(("orientation", 3))
        ),
        field!(
            angular_velocity,
            "Angular velocity of the body, in its frame.",
            "rad/s",
            Kind::Vector(3),
            Some("angular_velocity"),
            Some(("angular_velocity", 4))
        ),
        field!(
            acceleration,
            "Specific force on the body, in its frame: at rest 9.81 upwards.",
            "m/s²",
            Kind::Vector(3),
            Some("acceleration"),
            Some(("acceleration", 5))
        ),
        field!(
            temperature,
            "Temperature of the sensor.",
            "°C",
            Kind::Optional,
            Some("temperature_celsius"),
            Some(("temperature", 6))
        ),
        field!(flags, "`IMU_*` flags.", "", Kind::Flags, None, None),
        field!(
            missing,
            "Samples that the device took and motord did not receive.",
            "",
            Kind::Count,
            Some("missing"),
            Some(("missing", 10))
        ),
        field!(
            rejected,
            "Samples rejected: damaged, not finite, or with an orientation that is no unit quaternion.",
            "",
            Kind::Count,
            Some("rejected"),
            Some(("rejected", 11))
        ),
        field!(
            sequence,
            "Samples received since the daemon started.",
            "",
            Kind::Total,
            Some("sequence"),
            Some(("sequence", 2))
        ),
        field!(
            receive_ns,
            "Time when the sample was received.",
            "ns",
            Kind::Time,
            None,
            Some(("receive_ns", 12))
        ),
        flag!("fresh", "A sample was received since the previous states were published.", IMU_FRESH, 7),
        flag!("valid", "At least one sample was received since the daemon started.", IMU_VALID, 8),
        flag!(
            "lost",
            "No sample for longer than `lost-after-ms`, or the device is disconnected. True until the first sample.",
            IMU_LOST,
            9
        ),
    ];

    /// The state before the first sample: nothing is known.
    pub const UNKNOWN: Self = Self {
        orientation: [f32::NAN; 4],
        angular_velocity: [f32::NAN; 3],
        acceleration: [f32::NAN; 3],
        temperature: f32::NAN,
        flags: IMU_LOST,
        missing: 0,
        rejected: 0,
        sequence: 0,
        receive_ns: 0,
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A change of this list changes the layout: raise the versions of the messages.
    #[test]
    fn layout_of_an_imu_matches_its_version() {
        let layout = [
            ("orientation", 0, ("f32", 4)),
            ("angular_velocity", 16, ("f32", 3)),
            ("acceleration", 28, ("f32", 3)),
            ("temperature", 40, ("f32", 1)),
            ("flags", 44, ("u32", 1)),
            ("missing", 48, ("u32", 1)),
            ("rejected", 52, ("u32", 1)),
            ("sequence", 56, ("u64", 1)),
            ("receive_ns", 64, ("u64", 1)),
            ("fresh", 44, ("u32", 1)),
            ("valid", 44, ("u32", 1)),
            ("lost", 44, ("u32", 1)),
        ];
        let found: Vec<_> =
            ImuState::FIELDS.iter().map(|field| (field.name, field.offset, field.kind.memory())).collect();
        assert_eq!((found.as_slice(), size_of::<ImuState>()), (&layout[..], 72));
    }
}
