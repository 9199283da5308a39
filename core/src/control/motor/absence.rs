//! Finds the whole turns that the position of a motor lost while the motor was silent.
//!
//! An encoder of one turn does not know in which turn its motor starts: after a restart, 3.4 rad is
//! reported as −2.88 rad.

use core::f32::consts::{FRAC_PI_2, TAU};

/// A limp joint may move by this much while its motor is silent, rad at the motor.
const DRIFT_MAX: f32 = FRAC_PI_2;

/// The position before a silence, and what its reports lack since. All angles at the motor, rad.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Absence {
    /// The position before the silence.
    left_at: Option<f32>,
    /// The difference from the position before; 0 for none.
    lost: f32,
}

impl Absence {
    /// Records the last `position` before a silence.
    pub(super) fn leave(&mut self, position: f32) {
        self.left_at = Some(position - self.lost);
    }

    /// Compares the first `position` after a silence with the one before it. `end` is that of the
    /// positions that the motor can report. Returns the difference, if it is about whole turns, or
    /// the whole range. Constant time.
    pub(super) fn end(&mut self, position: f32, end: Option<f32>) -> Option<f32> {
        let step = position - self.left_at.take()?;
        let turns = (step / TAU).round() * TAU;
        let range = end.map_or(0.0, |end| (2.0 * end).copysign(step));
        let nearest = if (step - range).abs() < (step - turns).abs() { range } else { turns };
        self.lost = if (step - nearest).abs() <= DRIFT_MAX { nearest } else { 0.0 };
        self.has_lost().then_some(self.lost)
    }

    /// Returns whether whole turns are lost, and no operator has confirmed the position since.
    pub(super) fn has_lost(&self) -> bool {
        self.lost != 0.0
    }

    /// The position is as reported: an operator says so, or it has a new zero.
    pub(super) const fn confirm(&mut self) {
        self.lost = 0.0;
    }
}
