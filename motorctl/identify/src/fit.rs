//! The fit: weighted least squares over the windows, with intervals from leaving out blocks of time.

use crate::delay::{Delay, Wire};
use crate::interval::{Value, Why};
use crate::law::Torque;
use crate::motion::velocities;
use crate::sample::Sample;
use crate::stiction::{code_of, stiction};
use crate::windows::{Row, UNKNOWNS, rows};
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// Length of a block, s. Residuals of different blocks count as independent.
const BLOCK: f64 = 1.0;
/// Fewest blocks, and fewest windows.
const BLOCKS_MIN: usize = 6;
const ROWS_MIN: usize = 40;
/// Columns that are closer to each other are not separated: ratio of the eigenvalues of their correlation.
const CONDITION: f64 = 1e6;
/// Error that remains whatever the data say, as a share of a value: the stiffness of a drive and the time of a computer are not
/// exact.
const FLOOR: f64 = 0.003;
/// Time by which the velocity in a drive may be older than its position, s: a period of its control loop, or a filter.
const VELOCITY_LAG: f64 = 0.2e-3;
/// Unknowns that every fit has: inertia, viscous and Coulomb friction, and the constant.
const LEAST: usize = 4;

/// The result for one joint. Torques are in the N·m of the motor's reports.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// Inertia of everything that turns, kg·m².
    pub inertia: Value,
    /// Viscous friction, N·m·s/rad.
    pub viscous: Value,
    /// Coulomb friction, N·m.
    pub coulomb: Value,
    /// Static friction, at which a joint at rest begins to move, N·m.
    pub stiction: Value,
    /// Torque by the sine of the position, N·m.
    pub gravity_sine: Value,
    /// Torque by the cosine of the position, N·m.
    pub gravity_cosine: Value,
    /// Constant torque, N·m: also the offset of the motor's reports.
    pub offset: Value,
    /// Bounds of the delays; `None` without samples.
    pub delay: Option<Delay>,
    /// Distance from the lowest to the highest position, rad.
    pub range: f64,
    /// Largest speed, rad/s.
    pub fastest: f64,
    /// Windows that were used.
    pub windows: usize,
    /// Notes about the values.
    pub notes: Vec<Note>,
}

/// A property of the recording that limits what the values mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Note {
    /// The reported torque differs from stiffness and damping times errors; it was used as it is.
    TorqueContradicts,
}

impl core::fmt::Display for Note {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TorqueContradicts => f.write_str(
                "the torque that the motor reports differs from stiffness and damping times the errors; the values follow the report",
            ),
        }
    }
}

/// Identifies a joint by what was recorded, in the order of time. Allocates; the time is proportional to the number of samples.
#[must_use]
pub fn identify(samples: &[Sample], wire: Wire) -> Identified {
    let delay = Delay::of(samples, wire);
    let positions = || samples.iter().map(|sample| sample.position);
    let [low, high] =
        [positions().fold(f64::INFINITY, f64::min), positions().fold(f64::NEG_INFINITY, f64::max)];
    let speeds = velocities(samples);
    let unmoved = Identified {
        delay,
        range: (high - low).max(0.0),
        fastest: speeds.iter().fold(0.0, |fastest, speed| f64::max(fastest, speed.abs())),
        ..nothing(Why::Motion)
    };
    if samples.len() < 100 {
        return unmoved;
    }
    let torque = Torque::of(samples, &speeds);
    let centre = positions().sum::<f64>() / samples.len() as f64;
    let lines = rows(samples, &speeds, &torque, centre);
    let blocks = blocks(&lines);
    if lines.len() < ROWS_MIN || blocks.len() < BLOCKS_MIN {
        return unmoved;
    }
    let notes = torque.is_reported.then_some(Note::TorqueContradicts).into_iter().collect();
    let found = Identified { windows: lines.len(), notes, ..unmoved };
    let noise = code_of(samples) / 12.0_f64.sqrt();
    let Some(fit) = Fit::of(&lines, noise) else {
        return Identified { ..found.but(nothing(Why::Separation)) };
    };
    let late = delay.map_or(0.0, |delay| delay.motor.upper);
    fit.values(samples, &torque, centre, late, found)
}

/// No value, for a reason.
fn nothing(why: Why) -> Identified {
    let none = Value::none(why);
    Identified {
        inertia: none,
        viscous: none,
        coulomb: none,
        stiction: none,
        gravity_sine: none,
        gravity_cosine: none,
        offset: none,
        delay: None,
        range: 0.0,
        fastest: 0.0,
        windows: 0,
        notes: Vec::new(),
    }
}

impl Identified {
    /// With the values of another.
    fn but(self, values: Self) -> Self {
        Self {
            delay: self.delay,
            range: self.range,
            fastest: self.fastest,
            windows: self.windows,
            notes: self.notes,
            ..values
        }
    }
}

/// The lines of each block of time.
fn blocks(lines: &[Row]) -> BTreeMap<i64, Vec<usize>> {
    let mut blocks: BTreeMap<i64, Vec<usize>> = BTreeMap::new();
    for (index, line) in lines.iter().enumerate() {
        blocks.entry((line.time / BLOCK).floor() as i64).or_default().push(index);
    }
    blocks
}

/// Normal equations: their matrix, right side, and that of a shift in time.
#[derive(Debug, Clone)]
struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    shift: DVector<f64>,
}

impl Normal {
    /// Those of some lines, in the first `count` unknowns.
    fn of<'a>(lines: impl Iterator<Item = (&'a Row, f64)>, count: usize) -> Self {
        let (matrix, zeros) = (DMatrix::zeros(count, count), DVector::zeros(count));
        let mut sum = Self { matrix, right: zeros.clone(), shift: zeros };
        for (line, weight) in lines {
            let factors = DVector::from_row_slice(&line.factors[..count]);
            sum.matrix.ger(weight, &factors, &factors, 1.0);
            sum.right.axpy(weight * line.torque, &factors, 1.0);
            sum.shift.axpy(weight * line.shift, &factors, 1.0);
        }
        sum
    }

    /// Without the lines of another.
    fn without(&self, other: &Self) -> Self {
        Self {
            matrix: &self.matrix - &other.matrix,
            right: &self.right - &other.right,
            shift: &self.shift - &other.shift,
        }
    }

    /// The solutions for the right side and for the shift, if the unknowns are separated.
    fn solve(&self) -> Option<[DVector<f64>; 2]> {
        let scale = self.matrix.diagonal().map(|entry| 1.0 / entry.max(f64::MIN_POSITIVE).sqrt());
        let by = DMatrix::from_diagonal(&scale);
        let eigen = (&by * &self.matrix * &by).symmetric_eigen();
        let [low, high] = [eigen.eigenvalues.min(), eigen.eigenvalues.max()];
        if low.is_nan() || low <= high / CONDITION {
            return None;
        }
        let inverse = |right: &DVector<f64>| {
            let turned = eigen.eigenvectors.transpose() * (&by * right);
            &by * (&eigen.eigenvectors * turned.component_div(&eigen.eigenvalues))
        };
        Some([inverse(&self.right), inverse(&self.shift)])
    }
}

/// The solution, those without each block, and the change by a shift in time.
struct Fit {
    solution: DVector<f64>,
    left_out: Vec<DVector<f64>>,
    shift: DVector<f64>,
}

impl Fit {
    /// Fits as many unknowns as the lines separate. `noise` is the standard error of a position, rad.
    fn of(lines: &[Row], noise: f64) -> Option<Self> {
        (LEAST..=UNKNOWNS).rev().find_map(|count| {
            let even = vec![1.0; lines.len()];
            let [first, _] = Normal::of(lines.iter().zip(even), count).solve()?;
            Self::weighted(lines, &weights(lines, &first, noise), count)
        })
    }

    fn weighted(lines: &[Row], weights: &[f64], count: usize) -> Option<Self> {
        let all = Normal::of(lines.iter().zip(weights.iter().copied()), count);
        let [solution, shift] = all.solve()?;
        let without = |block: &Vec<usize>| {
            let of_block = block.iter().map(|&index| (&lines[index], weights[index]));
            all.without(&Normal::of(of_block, count)).solve().map(|[solution, _]| solution)
        };
        let left_out = blocks(lines).values().map(without).collect::<Option<_>>()?;
        Some(Self { solution, left_out, shift })
    }

    /// A value that follows from the unknowns, and half of its interval.
    /// `open` is what the interval contains besides.
    fn value(&self, of: impl Fn(&DVector<f64>) -> f64, late: f64, open: f64) -> Value {
        let count = self.left_out.len() as f64;
        let found = of(&self.solution);
        let square: f64 = self.left_out.iter().map(|solution| (of(solution) - found).powi(2)).sum();
        let error = student(count - 1.0) * ((count - 1.0) / count * square).sqrt();
        // Linear in the unknowns, so the change is that of the shift itself.
        let shift = late * of(&self.shift).abs();
        let scale = FLOOR * found.abs();
        Value::around(found, error.hypot(shift).hypot(scale).hypot(open))
    }

    fn values(
        &self,
        samples: &[Sample],
        torque: &Torque,
        centre: f64,
        late: f64,
        found: Identified,
    ) -> Identified {
        let (sin, cos) = centre.sin_cos();
        let entry = |solution: &DVector<f64>, index: usize| solution.get(index).copied().unwrap_or(0.0);
        let value = |of: &dyn Fn(&DVector<f64>) -> f64| self.value(of, late, 0.0);
        let is_curved = self.solution.len() == UNKNOWNS;
        let of_gravity = |of: &dyn Fn(&DVector<f64>) -> f64| {
            if is_curved { value(of) } else { Value::none(Why::Separation) }
        };
        let gravity = |position: f64| {
            let (sin, cos) = (position - centre).sin_cos();
            let [a, b, c] = [3, 4, 5].map(|index| entry(&self.solution, index));
            a + b * sin + c * (1.0 - cos)
        };
        let at_centre = value(&|solution| entry(solution, 3));
        Identified {
            inertia: physical(self.value(|solution| entry(solution, 0), late, damping_lag(samples))),
            viscous: physical(value(&|solution| entry(solution, 1))),
            coulomb: physical(value(&|solution| entry(solution, 2))),
            stiction: stiction(samples, torque, entry(&self.solution, 0), gravity, at_centre.half()),
            gravity_sine: of_gravity(&|solution| entry(solution, 4) * cos - entry(solution, 5) * sin),
            gravity_cosine: of_gravity(&|solution| -entry(solution, 4) * sin - entry(solution, 5) * cos),
            offset: of_gravity(&|solution| entry(solution, 3) + entry(solution, 5)),
            ..found
        }
    }
}

/// Inertia that a damping imitates whose velocity lags, kg·m².
fn damping_lag(samples: &[Sample]) -> f64 {
    samples.iter().map(|sample| sample.applied.kd).fold(0.0, f64::max) * VELOCITY_LAG
}

/// An inertia and a friction are above zero: a negative one says that the equation is not that of the joint.
fn physical(value: Value) -> Value {
    if value.value < 0.0 && value.why.is_none() {
        Value { why: Some(Why::Separation), ..value }
    } else {
        value
    }
}

/// Weights by the errors of short windows, in which positions hardly show an acceleration, and of all.
fn weights(lines: &[Row], solution: &DVector<f64>, noise: f64) -> Vec<f64> {
    let inertia = solution[0];
    let residual = |line: &Row| {
        let model: f64 = solution.iter().zip(line.factors).map(|(unknown, factor)| unknown * factor).sum();
        line.torque - model
    };
    let coarse = |line: &Row| (inertia * noise * line.roughness).powi(2);
    let mut squares: Vec<f64> = lines.iter().map(|line| residual(line).powi(2)).collect();
    squares.sort_by(f64::total_cmp);
    // The median square of a normal distribution is 0.455 of its mean.
    let floor = squares[squares.len() / 2] / 0.455;
    lines.iter().map(|line| 1.0 / (coarse(line) + floor).max(f64::MIN_POSITIVE)).collect()
}

/// The two-sided 95 % quantile of Student's distribution, within 1 % from 5 degrees of freedom on.
fn student(freedom: f64) -> f64 {
    let normal = crate::interval::TWO_SIDED;
    let cube = normal.powi(3);
    normal
        + (cube + normal) / (4.0 * freedom)
        + (5.0 * cube * normal * normal + 16.0 * cube + 3.0 * normal) / (96.0 * freedom * freedom)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        for (freedom, quantile) in [(5.0, 2.571), (10.0, 2.228), (30.0, 2.042)] {
            assert!((student(freedom) / quantile - 1.0).abs() < 0.01, "{freedom}: {}", student(freedom));
        }
    }
}
