//! The terms of the equation: those of every joint, and those that some joints have besides.

use crate::sample::Sample;
use crate::windows::{Row, UNKNOWNS};
use core::fmt;

/// Indexes of [`Row::factors`].
pub(crate) const INERTIA: Term = Term::Basic(0);
pub(crate) const VISCOUS: Term = Term::Basic(1);
pub(crate) const COULOMB: Term = Term::Basic(2);
pub(crate) const CONSTANT: Term = Term::Basic(3);
pub(crate) const SINE: Term = Term::Basic(4);
pub(crate) const COSINE: Term = Term::Basic(5);

/// Knots of a torque that depends on the position in any way.
pub(crate) const KNOTS: usize = 24;

/// A term of the equation, linear in its unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Term {
    /// One of [`Row::factors`].
    Basic(usize),
    /// A spring, N·m/rad, less what the sine has of it.
    Spring,
    /// Friction that falls with the speed, N·m at rest: `exp(-(speed / at)^power)`.
    Stribeck { at: f64, power: i32 },
    /// The torque acts later than the stamps say, s.
    Late,
    /// Torque around a position, N·m: one for a triangle between two neighbours, the first and the
    /// last up to the end.
    Knot(usize),
    /// The part of a basic term in the upper half of a property.
    Split(usize, By),
}

impl Term {
    pub(crate) const fn is_stribeck(&self) -> bool {
        matches!(self, Self::Stribeck { .. })
    }
}

/// A property of windows by which the equation is tested.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum By {
    /// First half of the time, the multisine, and second half, the slow sweeps.
    Time,
    /// Low and high speed.
    Speed,
    /// Lower and upper positions.
    Position,
    /// Low and high acceleration.
    Acceleration,
    /// Shortly after a reversal and later.
    Travel,
    /// Falling and rising position.
    Direction,
}

impl fmt::Display for By {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Time => "between the multisine and the slow sweeps",
            Self::Speed => "between low and high speed",
            Self::Position => "between lower and upper positions",
            Self::Acceleration => "between low and high acceleration",
            Self::Travel => "between the motion after a reversal and later",
            Self::Direction => "between the two directions",
        })
    }
}

/// Every property.
pub(crate) const PROPERTIES: [By; 6] =
    [By::Time, By::Speed, By::Position, By::Acceleration, By::Travel, By::Direction];

/// The motion from which terms are computed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion<'a> {
    pub(crate) samples: &'a [Sample],
    pub(crate) velocities: &'a [f64],
    /// Position from which others are counted, rad.
    pub(crate) centre: f64,
    /// Between which the knots are, from the centre, rad.
    pub(crate) ends: [f64; 2],
    /// The middle of each property.
    pub(crate) middles: [f64; PROPERTIES.len()],
}

impl<'a> Motion<'a> {
    pub(crate) fn new(samples: &'a [Sample], velocities: &'a [f64], centre: f64, rows: &[Row]) -> Self {
        let mut motion =
            Self { samples, velocities, centre, ends: [0.0; 2], middles: [0.0; PROPERTIES.len()] };
        let quantiles = |by: By, shares: [f64; 2]| {
            let mut values: Vec<f64> = rows.iter().map(|row| motion.property(by, row)).collect();
            values.sort_by(f64::total_cmp);
            shares.map(|share| values[(share * (values.len() - 1) as f64) as usize])
        };
        let ends = quantiles(By::Position, [0.02, 0.98]);
        let middle = |by| if by == By::Direction { 0.0 } else { quantiles(by, [0.5, 0.5])[0] };
        let middles = PROPERTIES.map(middle);
        (motion.ends, motion.middles) = (ends, middles);
        motion
    }

    /// A property of a window.
    fn property(&self, by: By, row: &Row) -> f64 {
        match by {
            By::Time => row.time,
            By::Speed => row.factors[1].abs(),
            By::Position => row.mean(|at| self.samples[at].position) - self.centre,
            By::Acceleration => row.factors[0].abs(),
            By::Travel => row.travel,
            By::Direction => row.direction(),
        }
    }

    /// The factor of a term in a line.
    pub(crate) fn factor(&self, term: Term, row: &Row) -> f64 {
        match term {
            Term::Basic(index) => row.factors[index],
            Term::Stribeck { at, power } => {
                row.direction() * row.mean(|index| (-(self.velocities[index].abs() / at).powi(power)).exp())
            }
            Term::Late => -row.shift,
            Term::Spring | Term::Knot(_) => row.mean(|at| self.at(term, self.samples[at].position)),
            Term::Split(index, by) => {
                let middle = PROPERTIES.iter().zip(self.middles).find(|(one, _)| **one == by);
                let is_upper = middle.is_some_and(|(_, middle)| self.property(by, row) > middle);
                if is_upper { row.factors[index] } else { 0.0 }
            }
        }
    }

    /// The factor of a term at a position, rad, of a joint at rest; 0 for those of the motion.
    pub(crate) fn at(&self, term: Term, position: f64) -> f64 {
        let distance = position - self.centre;
        match term {
            CONSTANT => 1.0,
            SINE => distance.sin(),
            COSINE => 1.0 - distance.cos(),
            Term::Spring => distance - distance.sin(),
            Term::Knot(index) => {
                let [low, high] = self.ends;
                let last = (KNOTS - 1) as f64;
                let knot = ((distance - low) / (high - low) * last).clamp(0.0, last);
                (1.0 - (knot - index as f64).abs()).max(0.0)
            }
            _ => 0.0,
        }
    }
}

/// The first basic terms.
pub(crate) fn basic(count: usize) -> Vec<Term> {
    (0..count.min(UNKNOWNS)).map(Term::Basic).collect()
}
