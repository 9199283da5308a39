//! How fast what a motor hears may change.

use super::Meaning;
use motord::config::settings::{LimitSettings, MotorSettings};

/// A value that may fall at once, but rises no faster than its slew.
#[derive(Debug, Clone, Copy, Default)]
struct Ceiling {
    lowest: f64,
    /// Time since `lowest`, s.
    time: f64,
}

impl Ceiling {
    /// `noise` is what rounding to codes can add between two values.
    fn judge(&mut self, name: &str, value: f64, slew: f32, noise: f64) {
        let highest = self.lowest + f64::from(slew) * self.time;
        assert!(value <= highest + noise, "I2: {name} rose to {value}, expected at most {highest}");
        *self = Self { lowest: value.min(highest), time: 0.0 };
    }
}

/// What one motor heard.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Slopes {
    kp: Ceiling,
    kd: Ceiling,
    forward: Ceiling,
    backward: Ceiling,
    position: f64,
    /// Time since `position`, s.
    time: f64,
    /// Of the cycle before, s.
    elapsed: f64,
    /// Where it stood when the stop began, before and after the cycle's reply, rad.
    held: [f64; 2],
}

impl Slopes {
    /// Nothing yet, at rest at `position`, rad.
    pub(super) fn from(position: f64) -> Self {
        Self { position, ..Self::default() }
    }

    /// Time goes by, s.
    pub(super) fn pass(&mut self, elapsed: f64) {
        for ceiling in [&mut self.kp, &mut self.kd, &mut self.forward, &mut self.backward] {
            ceiling.time += elapsed;
        }
        self.time += elapsed;
        self.elapsed = elapsed;
    }

    /// Nothing pulls the motor, which stands at `position`: a pull begins from there.
    pub(super) fn rest_at(&mut self, position: f64) {
        (self.position, self.time) = (position, self.elapsed);
    }

    /// Judges what an active motor hears: joint side, `[kp, kd, torque]`.
    pub(super) fn judge(
        &mut self,
        limits: &LimitSettings,
        position: f64,
        [kp, kd, torque]: [f64; 3],
        torque_code: f64,
    ) {
        self.kp.judge("kp", kp, limits.kp_slew, 0.13);
        self.kd.judge("kd", kd, limits.kd_slew, 0.0013);
        self.forward.judge("torque", torque.max(0.0), limits.torque_slew, 2.0 * torque_code);
        self.backward.judge("negative torque", (-torque).max(0.0), limits.torque_slew, 2.0 * torque_code);
        // Without stiffness the position on the wire means nothing.
        if kp > 0.0 {
            let (step, reach) = ((position - self.position).abs(), f64::from(limits.velocity) * self.time);
            assert!(step <= reach + 4e-4, "I2: the position stepped by {step}, expected at most {reach}");
            (self.position, self.time) = (position, 0.0);
        }
    }

    /// A stop may begin now.
    pub(super) fn may_be_held_at(&mut self, positions: [f64; 2]) {
        self.held = positions;
    }

    /// The command holds the motor where it was when the stop began.
    pub(super) fn is_held(&self, motor: &MotorSettings, command: &Meaning) -> bool {
        let Meaning::Control { position, velocity, torque, .. } = *command else { return false };
        let position = f64::from(motor.direction) * position + f64::from(motor.offset);
        let there = self.held.iter().any(|held| (position - held).abs() < 4e-4);
        there && velocity.abs() < 0.02 && torque.abs() < 0.2
    }
}
