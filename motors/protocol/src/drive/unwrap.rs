//! A position over any number of turns, from a code that wraps round.

use crate::Field;

/// Follows a position whose code wraps round. The turns are counted from accepted states only.
#[derive(Debug)]
pub(crate) struct Unwrap {
    /// The span of all position codes, rad: a position that leaves the range comes back this far
    /// away.
    period: f32,
    turns: f32,
    last: Option<f32>,
}

impl Unwrap {
    /// Of positions with these codes.
    pub(crate) fn new(position: Field) -> Self {
        let codes = f64::from(position.code_max()) + 1.0;
        Self { period: (codes * position.step()) as f32, turns: 0.0, last: None }
    }

    /// Returns the position as a code within its range reports it, rad.
    pub(crate) fn wrapped(&self, position: f32) -> f32 {
        (position + self.period / 2.0).rem_euclid(self.period) - self.period / 2.0
    }

    /// Returns the position over any number of turns, rad. A step of more than half the range is a
    /// wrap.
    pub(crate) fn position(&mut self, reported: f32) -> f32 {
        let step = reported - self.last.unwrap_or(reported);
        if step.abs() > self.period / 2.0 {
            self.turns -= step.signum();
        }
        self.last = Some(reported);
        reported + self.turns * self.period
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_that_wraps_goes_on() {
        let mut unwrap = Unwrap::new(Field::symmetric(16, 12.5));
        let turn = unwrap.period;
        let mut turned = 0.0_f32;
        for _ in 0..1000 {
            turned += 0.11;
            let reported = (turned + turn / 2.0).rem_euclid(turn) - turn / 2.0;
            assert!((unwrap.position(reported) - turned).abs() < 1e-3, "at {turned}");
        }
    }
}
