//! Weighted least squares over the windows, with the solutions without each block of time.

use crate::interval::Value;
use crate::normal::{Inverse, Matrix, add, add_square, dot};
use crate::terms::{Motion, Term};
use crate::windows::Row;
use std::collections::BTreeMap;

/// Length of a block, s. Residuals of different blocks count as independent.
const BLOCK: f64 = 1.0;
/// Columns that are closer to each other are not separated: ratio of the eigenvalues of their
/// correlation.
const CONDITION: f64 = 1e6;
/// Error that remains whatever the data say, as a share of a value: the stiffness of a drive and
/// the time of a computer are not exact.
const FLOOR: f64 = 0.003;

/// The lines of each block of time.
pub(crate) fn blocks(rows: &[Row]) -> Vec<Vec<usize>> {
    let mut blocks: BTreeMap<i64, Vec<usize>> = BTreeMap::new();
    for (index, row) in rows.iter().enumerate() {
        blocks.entry((row.time / BLOCK).floor() as i64).or_default().push(index);
    }
    blocks.into_values().collect()
}

/// Normal equations: their matrix, right side, and that of a shift in time.
#[derive(Debug, Clone)]
struct Normal {
    matrix: Matrix,
    right: Vec<f64>,
    shift: Vec<f64>,
}

impl Normal {
    /// `design` has the factors of the unknowns in each line.
    fn of(
        design: &[Vec<f64>],
        rows: &[Row],
        weights: &[f64],
        unknowns: usize,
        lines: impl Iterator<Item = usize>,
    ) -> Self {
        let zeros = vec![0.0; unknowns];
        let mut sum = Self { matrix: vec![zeros.clone(); unknowns], right: zeros.clone(), shift: zeros };
        for line in lines {
            let (factors, weight) = (&design[line], weights[line]);
            add_square(&mut sum.matrix, weight, factors);
            add(&mut sum.right, weight * rows[line].torque, factors);
            add(&mut sum.shift, weight * rows[line].shift, factors);
        }
        sum
    }

    /// Without the lines of another.
    fn without(&self, other: &Self) -> Self {
        let mut rest = self.clone();
        rest.matrix.iter_mut().zip(&other.matrix).for_each(|(row, other)| add(row, -1.0, other));
        add(&mut rest.right, -1.0, &other.right);
        add(&mut rest.shift, -1.0, &other.shift);
        rest
    }

    /// The solutions for the right side and for the shift, if the unknowns are separated.
    fn solve(&self) -> Option<[Vec<f64>; 2]> {
        let inverse = Inverse::of(&self.matrix, CONDITION)?;
        Some([inverse.times(&self.right), inverse.times(&self.shift)])
    }
}

/// A fit of some terms: the solution, those without each block, and the change by a shift in time.
#[derive(Debug, Clone)]
pub(crate) struct Fit {
    pub(crate) terms: Vec<Term>,
    solution: Vec<f64>,
    left_out: Vec<Vec<f64>>,
    shift: Vec<f64>,
    /// Residual of each line, N·m.
    pub(crate) residuals: Vec<f64>,
    /// Weighted sum of the squares by which the blocks differ from what the others predict.
    pub(crate) unpredicted: f64,
}

impl Fit {
    /// Fits terms; `None` where the lines do not separate them.
    pub(crate) fn of(motion: &Motion<'_>, rows: &[Row], weights: &[f64], terms: Vec<Term>) -> Option<Self> {
        let factors = |row| terms.iter().map(|term| motion.factor(*term, row)).collect();
        let design: Vec<Vec<f64>> = rows.iter().map(factors).collect();
        let all = Normal::of(&design, rows, weights, terms.len(), 0..rows.len());
        let [solution, shift] = all.solve()?;
        let (mut left_out, mut unpredicted) = (Vec::new(), 0.0);
        let residual = |solution: &[f64], line: usize| rows[line].torque - dot(&design[line], solution);
        for block in blocks(rows) {
            let of_block = Normal::of(&design, rows, weights, terms.len(), block.iter().copied());
            let [without, _] = all.without(&of_block).solve()?;
            unpredicted +=
                block.iter().map(|&line| weights[line] * residual(&without, line).powi(2)).sum::<f64>();
            left_out.push(without);
        }
        let residuals = (0..rows.len()).map(|line| residual(&solution, line)).collect();
        Some(Self { terms, solution, left_out, shift, residuals, unpredicted })
    }

    /// The unknown of a term; 0 without it.
    pub(crate) fn unknown(&self, solution: &[f64], term: Term) -> f64 {
        self.terms.iter().position(|one| *one == term).map_or(0.0, |index| solution[index])
    }

    /// The solution for a term; 0 without it.
    pub(crate) fn found(&self, term: Term) -> f64 {
        self.unknown(&self.solution, term)
    }

    /// Returns whether the friction of [`Term::Stribeck`], if it has that, falls with the speed.
    /// Friction that rises with the speed and levels off is not described by the term.
    pub(crate) fn is_physical(&self) -> bool {
        self.terms.iter().filter(|term| term.is_stribeck()).all(|term| self.found(*term) > 0.0)
    }

    pub(crate) fn has(&self, term: Term) -> bool {
        self.terms.contains(&term)
    }

    /// A value that is linear in the unknowns, and half of its interval. The torque acts up to
    /// `late` later, s. `open` is what the interval contains besides.
    pub(crate) fn value(&self, of: impl Fn(&Self, &[f64]) -> f64, late: f64, open: f64) -> Value {
        let count = self.left_out.len() as f64;
        let found = of(self, &self.solution);
        let square: f64 = self.left_out.iter().map(|solution| (of(self, solution) - found).powi(2)).sum();
        let error = student(count - 1.0) * ((count - 1.0) / count * square).sqrt();
        let late = if self.has(Term::Late) { 0.0 } else { late };
        let shift = late * of(self, &self.shift).abs();
        let scale = FLOOR * found.abs();
        Value::around(found, error.hypot(shift).hypot(scale).hypot(open))
    }
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
