//! The registers of motors, as lines of the log.

use motord_configuration::lock::{Verdict, end_findings, end_lines};
use motord_settings::settings::{MotorSettings, REGISTERS_MAX, Settings};

/// The motors whose registers are read, by joint; empty where no motor has some.
pub(super) struct RegisterLog(Vec<MotorSettings>);

impl RegisterLog {
    pub(super) fn new(settings: &Settings) -> Self {
        let has_some = settings.motors.iter().any(|motor| motor.capabilities.registers > 0);
        Self(if has_some { settings.motors.clone() } else { Vec::new() })
    }

    /// Logs the values that the cycle read, and those with which the group may not start.
    pub(super) fn log(&self, cycle: u64, motor: usize, values: [f32; REGISTERS_MAX], wrong: Option<u8>) {
        let Some(settings) = self.0.get(motor) else { return };
        let motor = &settings.name;
        if wrong.is_some() {
            let found = end_findings(settings, values);
            for finding in found.iter().filter(|finding| finding.verdict == Verdict::Differs) {
                tracing::error!(cycle, see = "mismatch", "{finding}. It is not enabled.");
            }
            return;
        }
        let [position, velocity, torque] = values;
        match end_lines(settings, values) {
            Some(_) => tracing::info!(
                cycle,
                motor,
                "its codes end at {position} rad, {velocity} rad/s and {torque} N·m by its registers: motord uses these ends in place \
                 of those of its model"
            ),
            None => tracing::debug!(cycle, motor, position, velocity, torque, "its registers agree"),
        }
    }

    /// Logs a motor that does not report its registers. With `is_assumed` its group may start with
    /// the ends of the configuration.
    pub(super) fn log_unread(&self, cycle: u64, motor: usize, is_assumed: bool) {
        let Some(MotorSettings { name, .. }) = self.0.get(motor) else { return };
        match is_assumed {
            true => tracing::warn!(
                cycle,
                motor = name,
                see = "unread",
                "answers, but does not report its registers PMAX, VMAX and TMAX (requests to 0x7FF): motord uses the ends that the \
                 configuration has. If they are not the motor's, positions and torques are wrong. motord asks again every second \
                 while the motor is stopped"
            ),
            false => tracing::error!(
                cycle,
                motor = name,
                see = "unread",
                "answers, but does not report its registers PMAX, VMAX and TMAX (requests to 0x7FF): its states are not used, and it \
                 is not enabled. motord asks again every second. If it has reported no end that contradicts the configuration, and \
                 its ends are known, write position-end-rad, velocity-end-rad-s and torque-end-nm"
            ),
        }
    }
}
