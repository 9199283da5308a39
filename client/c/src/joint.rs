//! A joint after a cycle, and the names of codes.

use motord_client::{Applied, Cause, Fault, Joint, Limit, MotorMode};
use std::ffi::{CString, c_char};
use std::ptr;
use std::sync::OnceLock;

/// Mode of a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub enum Mode {
    /// The motor has not answered, or stopped answering.
    Offline = 0,
    /// The motor answers and is stopped.
    Idle = 1,
    /// The motor receives neutral commands and is being started.
    Starting = 2,
    /// The motor follows setpoints.
    Active = 3,
    /// The motor is being damped; it will be stopped.
    Damping = 4,
    /// The motor reported a fault; it is stopped until the fault is cleared.
    Fault = 5,
    /// The joint is excluded: its motor gets stop frames only, and its group runs without it.
    Excluded = 6,
    /// This library does not know the mode.
    Unknown = 7,
}

impl From<Option<MotorMode>> for Mode {
    fn from(mode: Option<MotorMode>) -> Self {
        match mode {
            Some(MotorMode::Offline) => Self::Offline,
            Some(MotorMode::Idle) => Self::Idle,
            Some(MotorMode::Starting) => Self::Starting,
            Some(MotorMode::Active) => Self::Active,
            Some(MotorMode::Damping) => Self::Damping,
            Some(MotorMode::Fault) => Self::Fault,
            Some(MotorMode::Excluded) => Self::Excluded,
            None => Self::Unknown,
        }
    }
}

/// A joint after a cycle. A value is NaN while the motor does not report it.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct JointInfo {
    /// Position, rad.
    pub position: f64,
    /// Velocity, rad/s.
    pub velocity: f64,
    /// Torque, N·m.
    pub torque: f64,
    /// Temperature of the motor, °C.
    pub temperature: f64,
    /// Position of the command that the motor got after all limits, rad.
    pub applied_position: f64,
    /// Velocity of that command, rad/s.
    pub applied_velocity: f64,
    /// Stiffness of that command, N·m/rad.
    pub applied_kp: f64,
    /// Damping of that command, N·m·s/rad.
    pub applied_kd: f64,
    /// Torque of that command, N·m.
    pub applied_torque: f64,
    /// Time from the motor's last reply to now, s; NaN before its first.
    pub age: f64,
    /// Age in turns of the motor when the states were published; 0 for a reply to its last command. A turn is a cycle, or N cycles with
    /// `every = N`.
    pub age_cycles: u32,
    /// Turns without a reply since the daemon started.
    pub missed: u32,
    /// Replies that arrived after the end of their turn.
    pub late: u32,
    /// Faults that the motor reports: bits of `motord_fault`.
    pub faults: u32,
    /// Limits that changed the applied command: bits of `motord_limit`.
    pub limits: u32,
    /// Mode of the motor.
    pub mode: Mode,
    /// The motor answered the command of its last turn.
    pub fresh: bool,
    /// The motor differs from its configuration, or has not reported its registers: its group is not enabled. The daemon's log has the
    /// difference.
    pub mismatch: bool,
}

impl JointInfo {
    /// Returns a joint as it is now.
    #[must_use]
    pub fn new(joint: &Joint) -> Self {
        let wide = |value: Option<f32>| value.map_or(f64::NAN, f64::from);
        let Applied { position, velocity, kp, kd, torque } = joint.applied;
        Self {
            position: wide(joint.position()),
            velocity: wide(joint.velocity()),
            torque: wide(joint.torque()),
            temperature: wide(joint.temperature),
            applied_position: position.into(),
            applied_velocity: velocity.into(),
            applied_kp: kp.into(),
            applied_kd: kd.into(),
            applied_torque: torque.into(),
            age: joint.age().map_or(f64::NAN, |age| age.as_secs_f64()),
            age_cycles: joint.age_cycles,
            missed: joint.missed,
            late: joint.late,
            faults: joint.faults.bits(),
            limits: joint.limits.iter().fold(0, |bits, limit| bits | limit.bit()),
            mode: joint.mode.into(),
            fresh: joint.fresh,
            mismatch: joint.mismatch,
        }
    }
}

/// Each code with its name.
type Names = OnceLock<Vec<(u32, CString)>>;

fn name(names: &'static Names, number: u32, all: impl Iterator<Item = (u32, &'static str)>) -> *const c_char {
    let text = |(number, name)| (number, CString::new(name).unwrap_or_default());
    let names = names.get_or_init(|| all.map(text).collect());
    names.iter().find(|(known, _)| *known == number).map_or(ptr::null(), |(_, name)| name.as_ptr())
}

/// Returns the name of a `motord_mode`; null for a number that is none.
pub(crate) fn mode_name(mode: u32) -> *const c_char {
    static NAMES: Names = OnceLock::new();
    let unknown = (Mode::Unknown as u32, "unknown");
    let known = MotorMode::ALL.iter().map(|mode| (Mode::from(Some(*mode)) as u32, mode.name()));
    name(&NAMES, mode, known.chain([unknown]))
}

/// Returns the name of a `motord_fault`; null for a number that is none.
pub(crate) fn fault_name(fault: u32) -> *const c_char {
    static NAMES: Names = OnceLock::new();
    name(&NAMES, fault, Fault::ALL.iter().map(|fault| (fault.bit(), fault.name())))
}

/// Returns the name of a `motord_limit`; null for a number that is none.
pub(crate) fn limit_name(limit: u32) -> *const c_char {
    static NAMES: Names = OnceLock::new();
    name(&NAMES, limit, Limit::ALL.iter().map(|limit| (limit.bit(), limit.name())))
}

/// Returns the name of a cause.
pub(crate) fn cause_name(cause: Cause) -> *const c_char {
    static NAMES: Names = OnceLock::new();
    name(&NAMES, cause.code(), Cause::ALL.iter().map(|cause| (cause.code(), cause.name())))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the name of a variant as the tables write it.
    fn kebab(variant: impl core::fmt::Debug) -> String {
        let name = format!("{variant:?}");
        let words = name.char_indices().flat_map(|(at, letter)| {
            let dash = (at > 0 && letter.is_ascii_uppercase()).then_some('-');
            dash.into_iter().chain([letter.to_ascii_lowercase()])
        });
        words.collect()
    }

    #[test]
    fn modes_match_their_table() {
        for mode in MotorMode::ALL {
            let own = Mode::from(Some(*mode));
            assert_eq!((kebab(own), own as u32), (mode.name().to_owned(), mode.code()));
        }
    }
}
