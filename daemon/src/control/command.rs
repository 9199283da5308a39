//! What one motor is told in this cycle.

use super::limit::{self, Circumstances, Limited, limit};
use super::{Command, Control};
use crate::config::settings::SafeStop;
use crate::joint::Impedance;
use motord_bus::Instant;
use motord_shared::{MotorMode, SetpointMode};

/// Damping that is left when a motor tells over-voltage.
const OVER_VOLTAGE_DAMPING: f32 = 0.25;

impl Control {
    pub(super) fn command(&mut self, index: usize) -> Command {
        let group = &self.groups[self.group_of[index]];
        let motor = &mut self.motors[index];
        motor.limits = 0;
        if let Some(errand) = &mut motor.errand {
            return errand.command();
        }
        if motor.doubts() {
            return Command::GetFault;
        }
        let (limited, mode) = match motor.mode() {
            MotorMode::Active => self.follow(index),
            MotorMode::Damping => (self.damp(index, group.safe_stop, group.since()), SetpointMode::Impedance),
            _ => {
                motor.applied = Impedance::NEUTRAL;
                return motor.command(self.tick.begun);
            }
        };
        let motor = &mut self.motors[index];
        motor.applied = limited.applied;
        motor.limits = limited.acted;
        Command::Control(limited.applied, mode)
    }

    pub(super) fn follow(&self, index: usize) -> (Limited, SetpointMode) {
        let group = &self.groups[self.group_of[index]];
        let motor = &self.motors[index];
        let place = group.motors.iter().position(|&motor| motor == index);
        let (Some((wanted, mode)), Some(measured)) =
            (place.and_then(|place| group.wanted(place)), motor.measured())
        else {
            return (self.damp(index, SafeStop::Damp, group.since()), SetpointMode::Impedance);
        };
        let ramp = self.tick.begun.since(group.since()).as_secs_f32() / self.safety.start_ramp.as_secs_f32();
        let limits = &self.settings[index].limits;
        let circumstances =
            Circumstances { limits, previous: &motor.applied, measured, elapsed: self.elapsed, ramp };
        (limit(&wanted, &circumstances), mode)
    }

    pub(super) fn damp(&self, index: usize, safe_stop: SafeStop, since: Instant) -> Limited {
        let settings = &self.settings[index];
        let motor = &self.motors[index];
        let holding = safe_stop == SafeStop::Hold && self.tick.begun.since(since) < self.safety.damp;
        let gentle = self.groups[self.group_of[index]].over_voltage;
        let kd = settings.damping_kd * if gentle { OVER_VOLTAGE_DAMPING } else { 1.0 };
        match (motor.held, motor.measured()) {
            (Some(held), Some(measured)) if holding => limit::hold(&held, kd, &settings.limits, measured),
            (_, measured) => limit::damp(kd, &settings.limits, measured),
        }
    }

    /// The first motor of the group whose setpoint would make it jump.
    pub(super) fn first_jump(&self, index: usize) -> Option<usize> {
        let group = &self.groups[index];
        group.motors.iter().enumerate().find_map(|(place, &motor)| {
            let (wanted, mode) = group.wanted(place)?;
            let position = self.motors[motor].measured()?.position;
            let pulls = mode == SetpointMode::Position || wanted.kp > 0.0;
            (pulls && (wanted.position - position).abs() > self.safety.start_jump).then_some(motor)
        })
    }
}
