//! Normal equations of a few unknowns.

/// A symmetric matrix, by rows.
pub(crate) type Matrix = Vec<Vec<f64>>;

/// Most sweeps of rotations. They converge quadratically: matrices of this size take about six.
const SWEEPS: usize = 30;

/// Adds `weight` times the product of `factors` with themselves.
pub(crate) fn add_square(matrix: &mut Matrix, weight: f64, factors: &[f64]) {
    for (row, factor) in matrix.iter_mut().zip(factors) {
        add(row, weight * factor, factors);
    }
}

/// Adds `weight` times `others` to `values`.
pub(crate) fn add(values: &mut [f64], weight: f64, others: &[f64]) {
    values.iter_mut().zip(others).for_each(|(value, other)| *value += weight * other);
}

/// The sum of the products.
pub(crate) fn dot(values: &[f64], others: &[f64]) -> f64 {
    values.iter().zip(others).map(|(value, other)| value * other).sum()
}

/// The inverse of a positive definite matrix, by the eigenvalues and eigenvectors of its
/// correlation.
#[derive(Debug, Clone)]
pub(crate) struct Inverse {
    scale: Vec<f64>,
    /// Each eigenvalue and its vector.
    eigen: Vec<(f64, Vec<f64>)>,
}

impl Inverse {
    /// Returns `None` where the largest eigenvalue is more than `condition` times the smallest: the
    /// equations do not separate the unknowns.
    pub(crate) fn of(matrix: &Matrix, condition: f64) -> Option<Self> {
        let scale = (0..matrix.len()).map(|at| 1.0 / matrix[at][at].max(f64::MIN_POSITIVE).sqrt());
        let scale: Vec<f64> = scale.collect();
        let scaled = matrix
            .iter()
            .zip(&scale)
            .map(|(row, by)| row.iter().zip(&scale).map(|(entry, other)| entry * by * other).collect());
        let eigen = eigen(scaled.collect());
        let high = eigen.iter().fold(0.0, |high, (value, _)| value.max(high));
        let is_separate = eigen.iter().all(|(value, _)| *value > high / condition);
        is_separate.then_some(Self { scale, eigen })
    }

    /// The product with a vector: the solution for this right side.
    pub(crate) fn times(&self, right: &[f64]) -> Vec<f64> {
        let scaled: Vec<f64> = right.iter().zip(&self.scale).map(|(value, by)| value * by).collect();
        let mut solution = vec![0.0; right.len()];
        for (value, vector) in &self.eigen {
            add(&mut solution, dot(vector, &scaled) / value, vector);
        }
        solution.iter().zip(&self.scale).map(|(value, by)| value * by).collect()
    }
}

/// The eigenvalues and eigenvectors of a symmetric matrix: Jacobi's method with cyclic rotations
/// (Golub and Van Loan, *Matrix Computations*, 4th edition, section 8.5).
fn eigen(mut matrix: Matrix) -> Vec<(f64, Vec<f64>)> {
    let size = matrix.len();
    let mut vectors: Matrix =
        (0..size).map(|row| (0..size).map(|at| f64::from(row == at)).collect()).collect();
    for _ in 0..SWEEPS {
        for (low, high) in (0..size).flat_map(|high| (0..high).map(move |low| (low, high))) {
            rotate(&mut matrix, &mut vectors, low, high);
        }
    }
    matrix.iter().enumerate().map(|(at, row)| row[at]).zip(vectors).collect()
}

/// Rotates the rows and columns `low` and `high` so that their common entry becomes zero. The rows
/// of `vectors` turn with them.
fn rotate(matrix: &mut Matrix, vectors: &mut Matrix, low: usize, high: usize) {
    let common = matrix[low][high];
    // The entries of a correlation are at most 1.
    if common.abs() < f64::EPSILON * f64::EPSILON {
        return;
    }
    let ratio = (matrix[high][high] - matrix[low][low]) / (2.0 * common);
    let tangent = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
    let cosine = 1.0 / tangent.hypot(1.0);
    let sine = tangent * cosine;
    let turned = |a: f64, b: f64| (cosine * a - sine * b, sine * a + cosine * b);
    for row in &mut *matrix {
        (row[low], row[high]) = turned(row[low], row[high]);
    }
    for rows in [&mut *matrix, vectors] {
        let (before, after) = rows.split_at_mut(high);
        for (a, b) in before[low].iter_mut().zip(&mut after[0]) {
            (*a, *b) = turned(*a, *b);
        }
    }
    // Without the error of rounding.
    (matrix[low][high], matrix[high][low]) = (0.0, 0.0);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_solves_equations_of_different_scales() {
        let factors = [[1.0, 2e3, 3e-3], [1.0, -1e3, 5e-3], [1.0, 4e3, -1e-3], [1.0, 5e2, 2e-3]];
        let wanted = [3.0, -2e-3, 7e2];
        let (mut matrix, mut right) = (vec![vec![0.0; 3]; 3], vec![0.0; 3]);
        for factors in &factors {
            add_square(&mut matrix, 2.0, factors);
            add(&mut right, 2.0 * dot(factors, &wanted), factors);
        }
        let found = Inverse::of(&matrix, 1e6).unwrap().times(&right);
        for (found, wanted) in found.iter().zip(&wanted) {
            assert!((found / wanted - 1.0).abs() < 1e-9, "{found} for {wanted}");
        }
    }

    #[test]
    fn unknowns_of_equal_factors_are_not_separated() {
        let mut matrix = vec![vec![0.0; 3]; 3];
        for at in 0..9 {
            let at = f64::from(at);
            add_square(&mut matrix, 1.0, &[1.0, at, 2.0 * at]);
        }
        assert!(Inverse::of(&matrix, 1e6).is_none());
        assert!(Inverse::of(&vec![vec![0.0; 3]; 3], 1e6).is_none(), "no lines");
        assert!(Inverse::of(&vec![vec![f64::NAN; 3]; 3], 1e6).is_none(), "no numbers");
    }

    #[test]
    fn eigenvalues_are_those_of_known_matrix() {
        let matrix = vec![vec![2.0, -1.0, 0.0], vec![-1.0, 2.0, -1.0], vec![0.0, -1.0, 2.0]];
        let mut values: Vec<f64> = eigen(matrix).into_iter().map(|(value, _)| value).collect();
        values.sort_by(f64::total_cmp);
        let root = 2.0_f64.sqrt();
        for (value, wanted) in values.iter().zip([2.0 - root, 2.0, 2.0 + root]) {
            assert!((value - wanted).abs() < 1e-12, "{value} for {wanted}");
        }
    }
}
