//! Velocity from positions: local quadratics, which need no drive that measures velocity well.

use crate::normal::Inverse;
use crate::sample::Sample;

/// Samples on each side of the one whose velocity is computed.
const SIDE: usize = 7;
/// Fewer samples than unknowns have a larger ratio of their eigenvalues.
const CONDITION: f64 = 1e12;

/// Returns the velocity at each sample, rad/s: the slope of the quadratic that fits the positions
/// around it.
pub(crate) fn velocities(samples: &[Sample]) -> Vec<f64> {
    (0..samples.len()).map(|at| slope(samples, at)).collect()
}

/// Beyond the ends there are fewer neighbours; the slope is then that of a line.
fn slope(samples: &[Sample], at: usize) -> f64 {
    let side = SIDE.min(at).min(samples.len() - 1 - at);
    let near = &samples[at - side..=at + side];
    let (middle, centre) = (samples[at].time, samples[at].position);
    let [mut s2, mut s3, mut s4, mut x1, mut x2, mut s1, mut s0, mut x0] = [0.0; 8];
    for sample in near {
        let (t, x) = (sample.time - middle, sample.position - centre);
        let t2 = t * t;
        s0 += 1.0;
        s1 += t;
        s2 += t2;
        s3 += t2 * t;
        s4 += t2 * t2;
        x0 += x;
        x1 += x * t;
        x2 += x * t2;
    }
    // Normal equations of a + b·t + c·t².
    let matrix = vec![vec![s0, s1, s2], vec![s1, s2, s3], vec![s2, s3, s4]];
    Inverse::of(&matrix, CONDITION).map_or(0.0, |inverse| inverse.times(&[x0, x1, x2])[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_of_parabola_is_exact() {
        let sample = |step: u32| {
            let time = 5.0 + 0.001 * f64::from(step) + 1e-5 * f64::from(step % 3);
            Sample { time, position: 1.0 + 2.0 * time - 3.0 * time * time, ..Sample::default() }
        };
        let samples: Vec<_> = (0..50).map(sample).collect();
        let found = velocities(&samples);
        for (sample, velocity) in samples.iter().zip(&found).skip(2).take(46) {
            assert!((velocity - (2.0 - 6.0 * sample.time)).abs() < 1e-6, "{velocity}");
        }
    }
}
