//! How fast what a motor hears may change.

use motord_core::settings::LimitSettings;

/// A value that may fall at once, but rises no faster than its slew.
#[derive(Debug, Clone, Copy, Default)]
struct Ceiling {
    lowest: f64,
    /// When it was heard, s.
    time: f64,
}

impl Ceiling {
    /// `noise` is what rounding to codes can add between two values.
    fn judge(&mut self, name: &str, value: f64, slew: f32, noise: f64, time: f64) {
        let highest = self.lowest + f64::from(slew) * (time - self.time);
        assert!(value <= highest + noise, "I2: {name} rose to {value}, expected at most {highest}");
        *self = Self { lowest: value.min(highest), time };
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
    /// When `position` was, s.
    time: f64,
}

impl Slopes {
    /// Nothing yet, at rest at `position`, rad, at `time`, s.
    pub(super) fn from(position: f64, time: f64) -> Self {
        let nothing = Ceiling { lowest: 0.0, time };
        Self { kp: nothing, kd: nothing, forward: nothing, backward: nothing, position, time }
    }

    /// Nothing pulls the motor, which stood at `position`, rad, at `time`, s: a pull begins from there.
    pub(super) const fn rest_at(&mut self, position: f64, time: f64) {
        (self.position, self.time) = (position, time);
    }

    /// Judges what an active motor was told at `time`, s: joint side, `[kp, kd, torque]`.
    pub(super) fn judge(
        &mut self,
        time: f64,
        limits: &LimitSettings,
        position: f64,
        [kp, kd, torque]: [f64; 3],
        torque_code: f64,
    ) {
        self.kp.judge("kp", kp, limits.kp_slew, 0.13, time);
        self.kd.judge("kd", kd, limits.kd_slew, 0.0013, time);
        self.forward.judge("torque", torque.max(0.0), limits.torque_slew, 2.0 * torque_code, time);
        self.backward.judge(
            "negative torque",
            (-torque).max(0.0),
            limits.torque_slew,
            2.0 * torque_code,
            time,
        );
        // Without stiffness the position on the wire means nothing.
        if kp > 0.0 {
            let (step, reach) =
                ((position - self.position).abs(), f64::from(limits.velocity) * (time - self.time));
            assert!(step <= reach + 4e-4, "I2: the position stepped by {step}, expected at most {reach}");
            (self.position, self.time) = (position, time);
        }
    }
}
