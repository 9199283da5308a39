//! What one motor is told in this cycle.

use super::limit::{self, Circumstances, Limited, limit};
use super::motor::Motor;
use super::{Command, Control};
use crate::joint::Impedance;
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
            MotorMode::Damping => self.damp(index, group.is_held()),
            _ => {
                motor.applied = Impedance::NEUTRAL;
                return motor.command(self.tick.begun);
            }
        };
        let motor = &mut self.motors[index];
        motor.applied = limited.applied;
        motor.applied_mode = mode;
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
            return self.damp(index, false);
        };
        let ramp = self.tick.begun.since(group.since()).as_secs_f32() / self.safety.start_ramp.as_secs_f32();
        let limits = &self.settings[index].limits;
        // Without a pull the position applied before is only a number: the way to a new one begins where the joint is.
        let mut previous = motor.applied;
        if !motor.is_pulled() {
            previous.position = measured.position;
        }
        let circumstances = Circumstances {
            limits,
            mode,
            previous: &previous,
            measured,
            unheard: self.unheard(motor),
            elapsed: self.elapsed,
            ramp,
            winding_torque: motor.heat.allowed(limits.torque),
        };
        (limit(&wanted, &circumstances), mode)
    }

    /// How old its state is beyond a cycle, s.
    fn unheard(&self, motor: &Motor) -> f32 {
        motor.age_cycles() as f32 * self.elapsed
    }

    pub(super) fn damp(&self, index: usize, held: bool) -> (Limited, SetpointMode) {
        let settings = &self.settings[index];
        let motor = &self.motors[index];
        let group = &self.groups[self.group_of[index]];
        let kd = settings.damping_kd * if group.over_voltage { OVER_VOLTAGE_DAMPING } else { 1.0 };
        match (motor.held, motor.measured()) {
            (Some(hold), Some(measured)) if held => {
                let limited = limit::hold(&hold, kd, &settings.limits, measured, self.unheard(motor));
                // A motor without impedance mode holds by itself: its setpoints have no stiffness to hold with.
                let impedance = settings.capabilities.impedance;
                (limited, if impedance { SetpointMode::Impedance } else { SetpointMode::Position })
            }
            (_, measured) => (limit::damp(kd, &settings.limits, measured), SetpointMode::Impedance),
        }
    }

    /// The first motor of the group whose setpoint would make it jump.
    pub(super) fn first_jump(&self, index: usize) -> Option<usize> {
        let group = &self.groups[index];
        group.motors.iter().enumerate().find_map(|(place, &motor)| {
            let (wanted, mode) = group.wanted(place)?;
            let position = self.motors[motor].measured()?.position;
            let [low, high] = self.settings[motor].limits.position;
            // What will be applied, not what is asked for: outside its limits a joint would be pulled back into them.
            let target = wanted.position.clamp(low, high);
            let pulls = mode == SetpointMode::Position || wanted.kp > 0.0;
            (pulls && (target - position).abs() > self.safety.start_jump).then_some(motor)
        })
    }
}
