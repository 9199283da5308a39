//! The command of a motor that follows its group: active, or damped.

use super::Motor;
use super::group_command::GroupCommand;
use super::limit::{self, Applied, Circumstances, limit};
use super::mode::Mode;
use crate::control::context::Context;
use motord_protocol::drive::{Command, Impedance, JointSide, Setpoint};
use motord_shared::{Limit, SetpointMode};

/// Damping, or the slope of a braked speed, that is left when a motor reports over-voltage.
const OVER_VOLTAGE_DAMPING: f32 = 0.25;
/// Largest age of a state that answers the last turn, in turns, jitter included.
const LATE_TURNS: f32 = 1.5;

impl Motor {
    pub(super) fn command_by_mode(&mut self, group_command: &GroupCommand, cx: &Context) -> Command {
        // Nearly all motors are active.
        let applied = if matches!(self.mode, Mode::Active) {
            let applied = self.follow(group_command, cx);
            if applied.limits & Limit::CLAMPS != 0 {
                self.count_clamp(&applied);
            }
            applied
        } else if let Mode::Damping { held } = self.mode {
            self.damp(held.filter(|_| group_command.held), group_command, cx)
        } else {
            self.applied = Applied::NEUTRAL;
            return self.mode.command(cx.now);
        };
        self.applied = applied;
        let sent = self.executable(applied.setpoint, cx);
        self.response.command(&sent);
        Command::Control(sent)
    }

    /// Counts a cycle with a clamped value. Without a pull the position has no effect: a torque
    /// alone has position 0.
    #[cold]
    fn count_clamp(&mut self, applied: &Applied) {
        let position = if applied.setpoint.pulls() { 0 } else { Limit::Position.bit() };
        let is_clamped = applied.limits & Limit::CLAMPS & !position != 0;
        self.clamped = self.clamped.wrapping_add(u32::from(is_clamped));
    }

    /// Returns the `applied` setpoint as the motor can execute it. A motor without impedance
    /// control gets the torque of the setpoint at its last plausible state.
    fn executable(&self, applied: Setpoint, cx: &Context) -> Setpoint {
        let Setpoint { values, mode } = applied;
        if self.settings.capabilities.impedance || mode != SetpointMode::Impedance {
            return applied;
        }
        let by_state = self.measured().map_or(0.0, |state| {
            self.share_of_gains(cx)
                * (values.predicted_torque(state.position, state.velocity) - values.torque)
        });
        let torque = Impedance::new(0.0, 0.0, 0.0, 0.0, values.torque + by_state);
        Setpoint { values: torque, mode: SetpointMode::Torque }
    }

    /// Returns the factor for stiffness and damping at the age of the state, 1 down to 0. A control
    /// loop over a late state becomes unstable at lower gains, so gain times age is at most that of
    /// a state of the last turn.
    fn share_of_gains(&self, cx: &Context) -> f32 {
        let turn = self.turn_time(cx);
        let age = cx.now.since(self.measured_at).as_secs_f32();
        if age <= LATE_TURNS * turn { 1.0 } else { LATE_TURNS * turn / age }
    }

    /// Returns the start of the interpolation to `target`: the command of the last cycle, with the
    /// torque of the previous setpoint `wanted`. The limits may have reduced the torque of the
    /// command temporarily.
    pub(in crate::control) fn interpolation_origin(
        &self,
        wanted: Option<Setpoint>,
        target: Setpoint,
    ) -> Setpoint {
        let applied = self.applied.setpoint;
        let (Some(wanted), Some(measured)) = (wanted, self.measured()) else { return target };
        if self.mode != Mode::Active || wanted.mode != target.mode || applied.mode != target.mode {
            return target;
        }
        let position = if applied.pulls() { applied.values.position } else { measured.position };
        let most = self.settings.limits.torque;
        let torque = wanted.values.torque.clamp(-most, most);
        let values = Impedance::new(position, applied.values.velocity, 0.0, 0.0, torque);
        Setpoint { values, ..target }
    }

    fn follow(&self, group_command: &GroupCommand, cx: &Context) -> Applied {
        let (Some(wanted), Some(measured)) = (group_command.wanted, self.measured()) else {
            return self.damp(None, group_command, cx);
        };
        // The last setpoint did not use these values: slew from the measured ones.
        let mut previous = self.applied.setpoint;
        if !previous.pulls() {
            previous.values.position = measured.position;
        }
        if wanted.mode == SetpointMode::Speed && previous.mode != SetpointMode::Speed {
            let most = self.settings.limits.velocity;
            previous.values.velocity = measured.velocity.clamp(-most, most);
        }
        let limits = &self.settings.limits;
        let circumstances = Circumstances {
            limits,
            previous: &previous.values,
            measured,
            age: self.age(cx),
            elapsed: self.turn_time(cx),
            ramp: group_command.ramp,
            winding_torque: self.heat.allowed(limits.torque),
        };
        limit(&wanted, &circumstances)
    }

    fn damp(
        &self,
        held: Option<Impedance<JointSide>>,
        group_command: &GroupCommand,
        cx: &Context,
    ) -> Applied {
        let limits = &self.settings.limits;
        let share = if group_command.over_voltage { OVER_VOLTAGE_DAMPING } else { 1.0 };
        let kd = self.settings.damping_kd * share;
        // The drive of a motor without impedance mode holds and brakes: its setpoints have no
        // gains.
        let impedance = self.settings.capabilities.impedance;
        match (held, self.measured()) {
            (Some(held), Some(measured)) => {
                let mode = if impedance { SetpointMode::Impedance } else { SetpointMode::Position };
                limit::hold(Setpoint { values: held, mode }, kd, limits, measured, self.age(cx))
            }
            (_, measured) if impedance => limit::damp(kd, limits, measured),
            (_, measured) => {
                limit::brake(&self.applied.setpoint, share, limits, measured, self.turn_time(cx))
            }
        }
    }

    /// Returns the time that a command lasts, s.
    fn turn_time(&self, cx: &Context) -> f32 {
        self.turn.elapsed.unwrap_or(cx.elapsed)
    }

    /// Returns the age of its state, s. Where every cycle is a turn, this counts the cycles without
    /// a state, and at least the unanswered ones.
    fn age(&self, cx: &Context) -> f32 {
        match self.turn.outlasts_cycle {
            true => cx.now.since(self.measured_at).as_secs_f32(),
            false => self.replies.age_cycles.max(self.replies.unanswered) as f32 * cx.elapsed,
        }
    }
}
