//! The state of a joint: one table from which the message, the client library, JSON and recordings
//! come.

use crate::codes::{Fault, Limit, MotorMode};
use crate::field::{Field, Kind, optional};
use crate::plain::plain;

/// Name and version of the message with the states of all joints. Each change of the table or of
/// the meaning of a field raises the version, here and in [`RECORD_TYPE`].
pub(crate) const STATE_TYPE: &str = "motord.State.v11";
/// Name and version of the message for recorders, which contains the state.
pub(crate) const RECORD_TYPE: &str = "motord.CycleRecord.v7";

/// [`JointState::flags`]: position, velocity and torque were received since the previous states
/// were published, in answer to the command of their turn.
pub const JOINT_FRESH: u32 = 1 << 0;
/// [`JointState::flags`]: position, velocity and torque have been received at least once since the motor came online.
pub const JOINT_VALID: u32 = 1 << 1;
/// [`JointState::flags`]: the motor differs from its configuration, or has not reported its registers. Its group is not enabled.
pub const JOINT_MISMATCH: u32 = 1 << 2;

plain! {
    /// The command that was sent to the motor in a cycle, after all limits, joint side.
    pub struct Applied {
        /// rad.
        pub position: f32,
        /// rad/s.
        pub velocity: f32,
        /// Stiffness, N·m/rad.
        pub kp: f32,
        /// Damping, N·m·s/rad.
        pub kd: f32,
        /// N·m.
        pub torque: f32,
    }
}

/// Calls the macro `$with` with the rows of a joint's state that `$list` needs: `joint_list!` has
/// the form of each list.
///
/// The rows have the order of the memory. A row has the name in the message, its type, its [`Kind`]
/// in brackets, and where the field appears. `view` is the name in the client library, `json` the
/// key in JSON, `proto` the name and number in recordings. `measured` quantities are `f32`, have
/// the same name everywhere but in Python, and are plotted; `quantity` is the number in `motord_quantity`
/// of C, `python` the property of `State` in Python. `flags` are bits of the field `flags`. Numbers are
/// never reused. A key in JSON ends with its unit.
#[macro_export]
macro_rules! joint_state {
    ($list:ident $with:ident) => {
        $crate::joint_list! {
            $list $with
            measured {
                /// Position as last received.
                position, unit "rad", json position_rad, proto 2, quantity 0, python q;
                /// Velocity as last received.
                velocity, unit "rad/s", json velocity_rad_s, proto 3, quantity 1, python dq;
                /// Torque as the motor estimates it.
                torque, unit "N·m", json torque_nm, proto 4, quantity 2, python tau;
            }
            fields {
                /// Temperature of the motor.
                temperature: f32, [Optional], unit "°C", view temperature, json temperature_celsius, proto temperature = 5;
                /// Voltage of the supply as the motor last reported it, eight times a second by default (`indicator-hz`).
                supply_voltage: f32, [Optional], unit "V", view supply_voltage, json supply_voltage_v, proto supply_voltage = 20;
                /// Current from the supply as the motor last reported it.
                supply_current: f32, [Optional], unit "A", view supply_current, json supply_current_a, proto supply_current = 21;
                /// The command that was sent to the motor last, after all limits.
                applied: Applied, [Command], view applied, proto applied = 7;
                /// The limits that changed the applied command.
                limits: u32, [Set Limit], view limits, json limits, proto limits = 10;
                /// The mode of the motor.
                mode: u32, [Code MotorMode], view mode, json mode, proto mode = 8;
                /// The faults that the motor reports.
                fault: u32, [Set Fault], view faults, json faults, proto faults = 9;
                /// `JOINT_*` flags.
                flags: u32, [Flags];
                /// Age of the state in turns of the motor; 0 for an answer to its last command. A turn is a cycle, or N cycles with `every = N`. Contains the lateness of a motor whose answers are constantly late.
                age_cycles: u32, [Count], view age_cycles, json age_cycles, proto age_cycles = 12;
                /// Turns without a reply since the daemon started.
                missed: u32, [Count], view missed, json missed, proto missed = 13;
                /// Time from a command to the last reply, which answers it; 0 before the first.
                reply_latency_ns: u32, [Latency], unit "ns", view reply_latency, json reply_latency_us, proto reply_latency_ns = 16;
                /// Replies that arrived after the end of their turn.
                late: u32, [Count], view late, json late, proto late = 14;
                /// Physically impossible states; none of them was used.
                implausible: u32, [Count], view implausible, json implausible, proto implausible = 15;
                /// Frames with a command to the motor that motord did not send, of another master.
                foreign_commands: u32, [Count], view foreign_commands, json foreign_commands, proto foreign_commands = 18;
                /// Cycles in which a value of the setpoint was beyond the limits of the joint, such as `kp-max`, and was clamped. A position without stiffness does not count.
                clamped: u32, [Count], view clamped, json clamped, proto clamped = 19;
                /// Time of the last reply, on `CLOCK_MONOTONIC`, less the lateness of a motor whose answers are constantly late; 0 before the first.
                receive_ns: u64, [Time], unit "ns", view receive_ns, proto receive_ns = 17;
            }
            flags {
                /// Position, velocity and torque were received since the previous states were published, in answer to the command of their turn.
                fresh: JOINT_FRESH, proto 11;
                /// Position, velocity and torque were received at least once since the motor came online.
                valid: JOINT_VALID, json valid;
                /// The motor differs from its configuration: the daemon's log names the difference. Its group is not enabled.
                mismatch: JOINT_MISMATCH, json mismatch;
            }
        }
    };
}

/// Turns the table of a joint's state into a list, `$with! { … }`. Each `[kind]` is that of the
/// row, `[Measured]` or `[Flag BITS]`.
#[doc(hidden)]
#[macro_export]
macro_rules! joint_list {
    (
        $list:ident $with:ident
        measured { $(
            #[doc = $measured_doc:literal] $measured:ident, unit $measured_unit:literal, json $measured_json:ident,
            proto $measured_number:literal, quantity $quantity:literal, python $python:ident;
        )+ }
        fields { $(
            #[doc = $doc:literal] $name:ident: $type:ident, $kind:tt $(, unit $unit:literal)?
            $(, view $view:ident $(, json $json:ident)?)? $(, proto $proto:ident = $number:literal)?;
        )+ }
        flags { $(#[doc = $flag_doc:literal] $flag:ident: $bits:ident $(, json $flag_json:ident)? $(, proto $flag_number:literal)?;)+ }
    ) => {
        $crate::joint_list! {
            @$list $with
            {
                {
                    $({ $measured_doc ($measured_unit) $measured f32 })+
                    $({ $doc ($($unit)?) $name $type })+
                }
                {
                    $({ $measured_doc ($measured_unit) $measured $measured [Measured] ($measured_json) ($measured $measured_number) ($quantity) ($python) })+
                    $({ $doc ($($unit)?) $name $name $kind ($($($json)?)?) ($($proto $number)?) () () })+
                    $({ $flag_doc () $flag flags [Flag $bits] ($($flag_json)?) ($($flag $flag_number)?) () () })+
                }
            }
            {
                { $({ $measured_doc $measured_unit $measured })+ }
                { $($({ $doc $kind $name $view })?)+ }
                { $({ $flag_doc $flag $bits })+ }
            }
            {
                $({ $measured_doc [Measured] $measured $measured_json })+
                $($($({ $doc $kind $view $json })?)?)+
                $($({ $flag_doc [Flag $bits] $flag $flag_json })?)+
            }
            {
                {
                    $({ [Measured] $measured $measured })+
                    $($({ $kind $name $proto })?)+
                }
                { $($({ $flag $bits $flag_number })?)+ }
            }
            {
                $({ $measured_doc $measured_unit $measured $python })+
            }
        }
    };
    // `{ doc (unit) name type }` of each field in the memory;
    // `{ doc (unit) name field [kind] (json) (proto number) (quantity) (python) }` of each row.
    (@memory $with:ident $list:tt $client:tt $json:tt $recording:tt $python:tt) => { $with! $list };
    // `{ doc unit name }` of measured quantities; `{ doc [kind] name view }`; `{ doc flag BITS }`.
    (@client $with:ident $memory:tt $list:tt $json:tt $recording:tt $python:tt) => { $with! $list };
    // `{ doc [kind] view key }`.
    (@json $with:ident $memory:tt $client:tt $list:tt $recording:tt $python:tt) => { $with! $list };
    // `{ [kind] name proto }`; `{ flag BITS number }`.
    (@recording $with:ident $memory:tt $client:tt $json:tt $list:tt $python:tt) => { $with! $list };
    // `{ doc unit name python }` of measured quantities.
    (@python $with:ident $memory:tt $client:tt $json:tt $recording:tt $list:tt) => { $with! $list };
}

/// The [`Kind`] of a row.
macro_rules! kind {
    ([Code $codes:ident]) => {
        Kind::Code($codes::NAMES)
    };
    ([Set $codes:ident]) => {
        Kind::Set($codes::NAMES)
    };
    ([Flag $bits:ident]) => {
        Kind::Flag($bits)
    };
    ([$kind:ident]) => {
        Kind::$kind
    };
}

macro_rules! define {
    (
        { $({ $doc:literal ($($unit:literal)?) $name:ident $type:ident })+ }
        { $({ $about:literal ($($in:literal)?) $row:ident $field:ident $kind:tt ($($json:ident)?)
            ($($proto:ident $number:literal)?) ($($quantity:literal)?) ($($python:ident)?) })+ }
    ) => {
        plain! {
            /// One joint in a cycle. [`FIELDS`](Self::FIELDS) describes the fields.
            pub struct JointState {
                $(#[doc = $doc] $(#[doc = concat!("\n\nUnit: ", $unit, ".")])? pub $name: $type,)+
            }
        }

        impl JointState {
            /// All fields and flags, in the order of the table.
            pub const FIELDS: &'static [Field] = &[
                $(Field {
                    name: stringify!($row),
                    doc: $about.trim_ascii(),
                    unit: concat!("" $(, $in)?),
                    kind: kind!($kind),
                    offset: core::mem::offset_of!(Self, $field),
                    json: optional!($(stringify!($json))?),
                    proto: optional!($((stringify!($proto), $number))?),
                    quantity: optional!($($quantity)?),
                    python: optional!($(stringify!($python))?),
                },)+
            ];
        }
    };
}

joint_state!(memory define);

#[cfg(test)]
mod tests {
    use super::*;

    /// A change of this list changes the layout: raise [`STATE_TYPE`] and [`RECORD_TYPE`].
    #[test]
    fn layout_of_a_joint_matches_its_version() {
        let layout = [
            ("position", 0, "f32"),
            ("velocity", 4, "f32"),
            ("torque", 8, "f32"),
            ("temperature", 12, "f32"),
            ("supply_voltage", 16, "f32"),
            ("supply_current", 20, "f32"),
            ("applied", 24, "f32"),
            ("limits", 44, "u32"),
            ("mode", 48, "u32"),
            ("fault", 52, "u32"),
            ("flags", 56, "u32"),
            ("age_cycles", 60, "u32"),
            ("missed", 64, "u32"),
            ("reply_latency_ns", 68, "u32"),
            ("late", 72, "u32"),
            ("implausible", 76, "u32"),
            ("foreign_commands", 80, "u32"),
            ("clamped", 84, "u32"),
            ("receive_ns", 88, "u64"),
            ("fresh", 56, "u32"),
            ("valid", 56, "u32"),
            ("mismatch", 56, "u32"),
        ];
        let fields = JointState::FIELDS.iter();
        let found: Vec<_> = fields.map(|field| (field.name, field.offset, field.kind.memory().0)).collect();
        assert_eq!((found.as_slice(), size_of::<JointState>()), (&layout[..], 96));
        assert_eq!((STATE_TYPE, RECORD_TYPE), ("motord.State.v11", "motord.CycleRecord.v7"));
    }

    #[test]
    fn no_name_key_or_number_occurs_twice() {
        let is_unique = |mut keys: Vec<String>| {
            keys.sort();
            keys.windows(2).all(|pair| pair[0] != pair[1])
        };
        let fields = || JointState::FIELDS.iter();
        assert!(is_unique(fields().map(|field| field.name.into()).collect()));
        assert!(is_unique(fields().filter_map(|field| field.json.map(Into::into)).collect()));
        assert!(is_unique(fields().filter_map(|field| Some(field.proto?.1.to_string())).collect()));
    }
}
