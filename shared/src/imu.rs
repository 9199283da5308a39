//! The state of an inertial measurement unit (IMU).

use crate::codes::ImuContradiction;
use crate::field::{Field, Kind, optional};
use crate::plain::plain;

/// [`ImuState::flags`]: a sample was received since the previous states were published.
pub const IMU_FRESH: u32 = 1 << 0;
/// [`ImuState::flags`]: at least one sample was received since the daemon started.
pub const IMU_VALID: u32 = 1 << 1;
/// [`ImuState::flags`]: no sample has been received for longer than `lost-after-ms`, or the device is disconnected. Set until
/// the first sample.
pub const IMU_LOST: u32 = 1 << 2;
/// [`ImuState::flags`]: the bit of the first [`ImuContradiction`]; the others follow.
pub const IMU_CONTRADICTIONS_SHIFT: u32 = 8;

/// Declares the message and the descriptions of its fields, in the order of the memory. `proto` numbers are never reused.
macro_rules! define {
    (
        fields { $(
            #[doc = $doc:literal] $name:ident: $type:ty, $kind:expr $(, unit $unit:literal)?
            $(, json $json:ident)? $(, proto $number:literal)?;
        )+ }
        flags { $(#[doc = $flag_doc:literal] $flag:ident: $bit:ident, proto $flag_number:literal;)+ }
        sets { $(#[doc = $set_doc:literal] $set:ident: $codes:ident from $shift:ident, proto $set_number:literal;)+ }
    ) => {
        plain! {
            /// One IMU in a cycle. Values that are not known are NaN. [`FIELDS`](Self::FIELDS) describes the fields.
            pub struct ImuState {
                $(#[doc = $doc] $(#[doc = concat!("\n\nUnit: ", $unit, ".")])? pub $name: $type,)+
            }
        }

        impl ImuState {
            /// All fields and flags, in the order of the memory.
            pub const FIELDS: &'static [Field] = &[
                $(Field {
                    name: stringify!($name),
                    doc: $doc.trim_ascii(),
                    unit: concat!("" $(, $unit)?),
                    kind: $kind,
                    offset: core::mem::offset_of!(Self, $name),
                    json: optional!($(stringify!($json))?),
                    proto: optional!($((stringify!($name), $number))?),
                    quantity: None,
                    python: None,
                },)+
                $(Field {
                    name: stringify!($flag),
                    doc: $flag_doc.trim_ascii(),
                    unit: "",
                    kind: Kind::Flag($bit),
                    offset: core::mem::offset_of!(Self, flags),
                    json: Some(stringify!($flag)),
                    proto: Some((stringify!($flag), $flag_number)),
                    quantity: None,
                    python: None,
                },)+
                $(Field {
                    name: stringify!($set),
                    doc: $set_doc.trim_ascii(),
                    unit: "",
                    kind: Kind::FlagSet($shift, $codes::NAMES),
                    offset: core::mem::offset_of!(Self, flags),
                    json: Some(stringify!($set)),
                    proto: Some((stringify!($set), $set_number)),
                    quantity: None,
                    python: None,
                },)+
            ];
        }
    };
}

define! {
    fields {
        /// Orientation of the body in the world, whose z points up: a unit quaternion w, x, y, z.
        orientation: [f32; 4], Kind::Vector(4), json orientation, proto 3;
        /// Angular velocity of the body, in its frame.
        angular_velocity: [f32; 3], Kind::Vector(3), unit "rad/s", json angular_velocity, proto 4;
        /// Specific force on the body, in its frame: at rest 9.81 upwards.
        acceleration: [f32; 3], Kind::Vector(3), unit "m/s²", json acceleration, proto 5;
        /// Temperature of the sensor.
        temperature: f32, Kind::Optional, unit "°C", json temperature_celsius, proto 6;
        /// `IMU_*` flags.
        flags: u32, Kind::Flags;
        /// Samples that the device took and motord did not receive.
        missing: u32, Kind::Count, json missing, proto 10;
        /// Samples rejected: damaged, not finite, or with an orientation that is no unit quaternion.
        rejected: u32, Kind::Count, json rejected, proto 11;
        /// Samples received since the daemon started.
        sequence: u64, Kind::Total, json sequence, proto 2;
        /// Time when the sample was received.
        receive_ns: u64, Kind::Time, unit "ns", proto 12;
        /// The publisher of an external IMU whose samples are used: see `ImuMessage`; 0 for none.
        publisher: u64, Kind::Total;
    }
    flags {
        /// A sample was received since the previous states were published.
        fresh: IMU_FRESH, proto 7;
        /// At least one sample was received since the daemon started.
        valid: IMU_VALID, proto 8;
        /// No sample for longer than `lost-after-ms`, or the device is disconnected. True until the first sample.
        lost: IMU_LOST, proto 9;
    }
    sets {
        /// Conventions in which orientation and acceleration would agree about gravity, while they contradict each other at rest.
        contradictions: ImuContradiction from IMU_CONTRADICTIONS_SHIFT, proto 13;
    }
}

impl ImuState {
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
        publisher: 0,
    };

    /// Returns the bits of the [`ImuContradiction`]s; 0 while orientation and acceleration agree, and before the first rest.
    #[must_use]
    pub const fn contradictions(&self) -> u32 {
        self.flags >> IMU_CONTRADICTIONS_SHIFT
    }
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
            ("publisher", 72, ("u64", 1)),
            ("fresh", 44, ("u32", 1)),
            ("valid", 44, ("u32", 1)),
            ("lost", 44, ("u32", 1)),
            ("contradictions", 44, ("u32", 1)),
        ];
        let found: Vec<_> =
            ImuState::FIELDS.iter().map(|field| (field.name, field.offset, field.kind.memory())).collect();
        assert_eq!((found.as_slice(), size_of::<ImuState>()), (&layout[..], 80));
    }

    #[test]
    fn contradictions_and_flags_share_no_bit() {
        let flags = IMU_FRESH | IMU_VALID | IMU_LOST;
        let all = ImuContradiction::ALL.iter().fold(0, |bits, convention| bits | convention.bit());
        let state = ImuState { flags: flags | all << IMU_CONTRADICTIONS_SHIFT, ..ImuState::UNKNOWN };
        assert_eq!((state.contradictions(), flags & all << IMU_CONTRADICTIONS_SHIFT), (all, 0));
        assert_eq!(ImuState { flags, ..state }.contradictions(), 0);
        assert!(ImuContradiction::of_bits(all).eq(ImuContradiction::ALL.iter().copied()));
    }
}
