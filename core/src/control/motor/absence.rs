//! Finds what the position of a motor lost while the motor was silent.
//!
//! An encoder of one turn does not know in which turn its motor starts: after a restart, 3.4 rad is
//! reported as −2.88 rad. A motor that reports a position which its joint cannot have reached in
//! the meantime has another zero, or is another motor.

use core::f32::consts::{FRAC_PI_2, TAU};
use motord_bus::Instant;

/// A limp joint may move by this much while its motor is silent, rad at the motor.
const DRIFT_MAX: f32 = FRAC_PI_2;

/// The position before a silence, and what its reports lack since. All angles at the motor, rad.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Absence {
    /// The position before the silence, and its time.
    left_at: Option<(f32, Instant)>,
    /// The difference from the position before; 0 for none.
    lost: f32,
}

impl Absence {
    /// Records the last `position` before a silence, which was reported at `at`.
    pub(super) fn leave(&mut self, position: f32, at: Instant) {
        self.left_at = Some((position - self.lost, at));
    }

    /// Compares the first `position` after a silence, reported at `at`, with the one before it.
    /// `end` is that of the positions that the motor can report, `velocity` the highest of its
    /// joint, rad/s. Returns the difference, if it is about whole turns, the whole range, or more
    /// than the joint can have moved. Constant time.
    pub(super) fn end(
        &mut self,
        (position, at): (f32, Instant),
        end: Option<f32>,
        velocity: f32,
    ) -> Option<f32> {
        let (before, left_at) = self.left_at.take()?;
        let step = position - before;
        let turns = (step / TAU).round() * TAU;
        let range = end.map_or(0.0, |end| (2.0 * end).copysign(step));
        let nearest = if (step - range).abs() < (step - turns).abs() { range } else { turns };
        let reach = DRIFT_MAX + velocity * at.since(left_at).as_secs_f32();
        self.lost = if (step - nearest).abs() <= DRIFT_MAX {
            nearest
        } else if step.abs() > reach {
            step
        } else {
            0.0
        };
        self.has_lost().then_some(self.lost)
    }

    /// Returns whether the position differs, and no operator has confirmed it since.
    pub(super) fn has_lost(&self) -> bool {
        self.lost != 0.0
    }

    /// The position is as reported: an operator says so, or it has a new zero.
    pub(super) const fn confirm(&mut self) {
        self.lost = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::Duration;

    /// Returns the difference after a silence of 50 ms, of a joint of 10 rad/s.
    fn lost(before: f32, after: f32) -> Option<f32> {
        let mut absence = Absence::default();
        let at = Instant::from_nanos(1_000_000_000);
        absence.leave(before, at);
        absence.end((after, at + Duration::from_millis(50)), Some(12.5), 10.0)
    }

    #[test]
    fn impossible_step_is_lost() {
        assert_eq!(lost(0.2, 2.2), None, "a quarter turn and 0.5 rad");
        assert_eq!(lost(0.2, 2.5), Some(2.3));
        assert_eq!(lost(0.2, -2.5), Some(-2.7));
        assert_eq!(lost(3.4, 3.4 - TAU), Some(-TAU));
    }
}
