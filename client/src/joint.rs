//! The state of a joint, with codes as enums instead of numbers.

use motord_ports::clock;
use motord_shared::message::{JOINT_FRESH, JOINT_MISMATCH, JOINT_VALID};
use motord_shared::{Applied, Fault, Field, JointState, Limit, MotorMode};
use std::fmt;
use std::time::Duration;

/// Type of a row's kind in the client library.
macro_rules! view_type {
    ([Optional]) => { Option<f32> };
    ([Command]) => { Applied };
    ([Set Limit]) => { Limits };
    ([Set Fault]) => { Faults };
    ([Code $code:ident]) => { Option<$code> };
    ([Count]) => { u32 };
    ([Latency]) => { Duration };
    ([Time]) => { u64 };
}

/// Value of a row's kind in the client library.
macro_rules! view {
    ([Optional], $value:expr) => {
        Some($value).filter(|value| value.is_finite())
    };
    ([Set Limit], $bits:expr) => {
        Limits($bits)
    };
    ([Set Fault], $bits:expr) => {
        Faults($bits)
    };
    ([Code $code:ident], $number:expr) => {
        $code::try_from($number).ok()
    };
    ([Latency], $nanos:expr) => {
        Duration::from_nanos($nanos.into())
    };
    ([$kind:ident], $value:expr) => {
        $value
    };
}

macro_rules! define {
    (
        { $({ $measured_doc:literal $unit:literal $measured:ident })+ }
        { $({ $doc:literal $kind:tt $name:ident $view:ident })+ }
        { $({ $flag_doc:literal $flag:ident $bits:ident })+ }
    ) => {
        /// One joint after a cycle.
        ///
        /// A mode is `None` for a code that this client does not know. A quantity is `None` when
        /// the motor does not report it.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct Joint {
            $($measured: f32,)+
            $(#[doc = $doc] pub $view: view_type!($kind),)+
            $(#[doc = $flag_doc] pub $flag: bool,)+
        }

        impl Joint {
            $(
                #[doc = $measured_doc]
                #[doc = concat!("\n\nUnit: ", $unit, ".")]
                /// `None` until the motor has reported it after coming online.
                #[must_use]
                pub fn $measured(&self) -> Option<f32> {
                    self.measured(self.$measured)
                }
            )+

            /// Returns the measured quantities with their descriptions.
            pub fn quantities(&self) -> impl Iterator<Item = (&'static Field, Option<f32>)> {
                JointState::FIELDS.iter().zip([$(self.$measured(),)+])
            }
        }

        impl From<&JointState> for Joint {
            fn from(joint: &JointState) -> Self {
                Self {
                    $($measured: joint.$measured,)+
                    $($view: view!($kind, joint.$name),)+
                    $($flag: joint.flags & $bits != 0,)+
                }
            }
        }
    };
}

motord_shared::joint_state!(client define);

impl Joint {
    /// Returns `true` if the group runs without this joint. Its motor need not be connected, and
    /// its setpoints are ignored.
    #[must_use]
    pub fn is_excluded(&self) -> bool {
        self.mode == Some(MotorMode::Excluded)
    }

    /// Returns the time since the motor's last reply. `None` before its first.
    #[must_use]
    pub fn age(&self) -> Option<Duration> {
        self.age_at(clock::now_ns())
    }

    /// Returns the time from the motor's last reply to `time_ns`, ns of `CLOCK_MONOTONIC`. `None`
    /// before its first.
    #[must_use]
    pub fn age_at(&self, time_ns: u64) -> Option<Duration> {
        (self.receive_ns > 0).then(|| Duration::from_nanos(time_ns.saturating_sub(self.receive_ns)))
    }

    fn measured(&self, value: f32) -> Option<f32> {
        (self.valid && value.is_finite()).then_some(value)
    }
}

/// A set of faults. It prints as their names, or as `none`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Faults(u32);

impl Faults {
    /// Returns `true` if the motor reports no fault.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns `true` if the motor reports `fault`.
    #[must_use]
    pub const fn contains(self, fault: Fault) -> bool {
        self.0 & fault.bit() != 0
    }

    /// Returns the faults with a name, lowest bit first.
    pub fn iter(self) -> impl Iterator<Item = Fault> {
        Fault::of_bits(self.0)
    }

    /// Returns the bits as the daemon sent them. The highest byte is the number of an
    /// [unrecognised](Fault::Unrecognised) fault.
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Returns the bits without a name.
    #[must_use]
    pub fn unknown(self) -> u32 {
        Fault::unnamed(self.0)
    }

    /// Returns the names of the faults; the bits without a name as one number.
    pub fn names(self) -> impl Iterator<Item = String> {
        let unknown = Some(self.unknown()).filter(|unknown| *unknown != 0);
        self.iter().map(|fault| fault.name().to_owned()).chain(unknown.map(|bits| format!("{bits:#x}")))
    }
}

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.is_empty() {
            true => f.write_str("none"),
            false => f.write_str(&self.names().collect::<Vec<_>>().join(", ")),
        }
    }
}

/// A set of limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Limits(u32);

impl Limits {
    /// Returns `true` if no limit acted.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns `true` if `limit` acted.
    #[must_use]
    pub const fn contains(self, limit: Limit) -> bool {
        self.0 & limit.bit() != 0
    }

    /// Returns the limits that acted.
    pub fn iter(self) -> impl Iterator<Item = Limit> {
        Limit::ALL.iter().copied().filter(move |limit| self.contains(*limit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joint_without_replies_has_no_position() {
        let silent = JointState { position: 0.5, velocity: 0.5, torque: 0.5, ..JointState::default() };
        let joint = Joint::from(&silent);
        assert_eq!((joint.position(), joint.velocity(), joint.torque()), (None, None, None));
        let reported = Joint::from(&JointState { flags: JOINT_VALID, ..silent });
        assert_eq!(
            (reported.position(), reported.velocity(), reported.torque()),
            (Some(0.5), Some(0.5), Some(0.5))
        );
    }

    #[test]
    fn faults_print_names_and_keep_unnamed_bits() {
        assert_eq!(Faults(0).to_string(), "none");
        assert_eq!(Faults(0x1_0021).to_string(), "foc-frequency, 0x10020");
        assert_eq!(Faults(0x22).to_string(), "over-voltage, 0x20");
        assert!(Faults(0x22).contains(Fault::OverVoltage) && !Faults(0x22).contains(Fault::Overload));
        assert_eq!(Faults(0x1480_0000).to_string(), "unrecognised, 0x14000000");
    }
}
