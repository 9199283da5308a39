//! Limits of the rates at which the commands to a motor may change.

use crate::protocol::ranges::Ranges;
use crate::robot::Limits;

/// Difference that rounding can add between two values, in codes: half a code for each of them, and
/// a margin for single precision.
const ROUNDING: f64 = 1.04;

/// A value that may fall without a limit, but rises at most with its slew.
#[derive(Debug, Clone, Copy, Default)]
struct Ceiling {
    lowest: f64,
    /// Time of the value, s.
    time: f64,
}

impl Ceiling {
    /// Checks a value. `noise` is the difference that rounding to codes can add between two values.
    fn check(&mut self, name: &str, value: f64, slew: f64, noise: f64, time: f64) {
        let highest = self.lowest + slew * (time - self.time);
        assert!(value <= highest + noise, "I2: {name} rose to {value}, expected at most {highest}");
        *self = Self { lowest: value.min(highest), time };
    }
}

/// The last commands to one motor, and the times of their ceilings.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Slopes {
    kp: Ceiling,
    kd: Ceiling,
    forward: Ceiling,
    backward: Ceiling,
    position: f64,
    /// Time of `position`, s.
    time: f64,
}

impl Slopes {
    /// Returns the record without commands, at rest at `position`, rad, at `time`, s.
    pub(super) fn from(position: f64, time: f64) -> Self {
        let nothing = Ceiling { lowest: 0.0, time };
        Self { kp: nothing, kd: nothing, forward: nothing, backward: nothing, position, time }
    }

    /// Records that no command pulls the motor, which was at `position`, rad, at `time`, s: a pull
    /// begins from there.
    pub(super) const fn rest_at(&mut self, position: f64, time: f64) {
        (self.position, self.time) = (position, time);
    }

    /// Checks the command to an active motor at `time`, s: joint side, `[kp, kd, torque]`.
    pub(super) fn check(
        &mut self,
        time: f64,
        limits: &Limits,
        position: f64,
        [kp, kd, torque]: [f64; 3],
        codes: &Ranges,
    ) {
        self.kp.check("kp", kp, limits.kp.slew, ROUNDING * codes.kp, time);
        self.kd.check("kd", kd, limits.kd.slew, ROUNDING * codes.kd, time);
        self.forward.check("torque", torque.max(0.0), limits.torque.slew, 2.0 * codes.torque, time);
        self.backward.check(
            "negative torque",
            (-torque).max(0.0),
            limits.torque.slew,
            2.0 * codes.torque,
            time,
        );
        // Without stiffness the position on the wire has no meaning.
        if kp > 0.0 {
            let (step, reach) = ((position - self.position).abs(), limits.velocity * (time - self.time));
            assert!(
                step <= reach + ROUNDING * codes.position,
                "I2: the position stepped by {step}, expected at most {reach}"
            );
            (self.position, self.time) = (position, time);
        }
    }
}
