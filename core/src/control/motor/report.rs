//! The published state of a motor.

use super::Motor;
use motord_protocol::drive::{Impedance, Measured};
use motord_shared::{JointState, message};

impl Motor {
    /// Returns the state of its joint, as clients receive it.
    pub(in crate::control) fn report(&self, publications: u64) -> JointState {
        let measured = self.measured.unwrap_or(Measured::new(f32::NAN, f32::NAN, f32::NAN, None));
        let fresh = if self.replies.is_fresh(publications) { message::JOINT_FRESH } else { 0 };
        let valid = if self.measured.is_some() { message::JOINT_VALID } else { 0 };
        let mismatch = if self.is_mismatched || self.is_unread() { message::JOINT_MISMATCH } else { 0 };
        let Impedance { position, velocity, kp, kd, torque, .. } = self.applied.setpoint.values;
        JointState {
            position: measured.position,
            velocity: measured.velocity,
            torque: measured.torque,
            temperature: measured.temperature.unwrap_or(f32::NAN),
            supply_voltage: self.supply.map_or(f32::NAN, |(supply, _)| supply.voltage),
            supply_current: self.supply.and_then(|(supply, _)| supply.current).unwrap_or(f32::NAN),
            applied: message::Applied { position, velocity, kp, kd, torque },
            limits: self.applied.limits,
            mode: self.mode().code(),
            fault: self.faults.reported.0,
            flags: fresh | valid | mismatch,
            age_cycles: self.replies.age_cycles,
            missed: self.replies.missed,
            reply_latency_ns: self.replies.latency_ns,
            late: self.replies.late,
            implausible: self.replies.implausible,
            foreign_commands: self.foreign.total(),
            clamped: self.clamped,
            receive_ns: self.measured_at.as_nanos(),
        }
    }
}
