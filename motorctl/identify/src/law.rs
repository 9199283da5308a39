//! The torque of the drive, finer than its codes.
//!
//! A drive adds `torque + kp·(position - q) + kd·(velocity - dq)`, and reports the result in coarse
//! codes: 0.11 N·m for a GIM8108-8. The computed torque is as good as the positions. Where the
//! reports contradict the law, they are used as they are.

use crate::interval::Value;
use crate::normal::{Inverse, add, add_square, dot};
use crate::sample::{Applied, Sample};

/// Share of the root mean square of the torque that reports may differ from the law beside the
/// width of their codes.
const CONTRADICTION: f64 = 0.05;
/// Largest difference of the stiffness by the reports from that of the law, as a share.
const SCALE: f64 = 0.1;
/// Codes that a report may be off the law, root mean square. The rounding of the report gives 0.29,
/// and the daemon, which carries the rounding error of a command into the next, another 0.5.
const CODES: f64 = 0.9;
/// Stiffness, damping and constant are not separated beyond this ratio of eigenvalues: a joint at
/// rest.
const CONDITION: f64 = 1e12;

/// The torque over time.
#[derive(Debug, Clone)]
pub(crate) struct Torque {
    /// At the beginning and at the end of the time from each sample to the next, N·m.
    spans: Vec<[f64; 2]>,
    /// The reports contradict the law, and were used.
    pub(crate) is_reported: bool,
    /// Error of the torque that its codes cause, N·m.
    pub(crate) coarse: f64,
}

/// Result of the reports about the stiffness.
#[derive(Debug, Clone, Copy)]
struct Gains {
    /// Of the drive, by the applied one.
    kp: f64,
    /// Standard error of `kp`.
    error: f64,
    /// Root mean square of what remains, N·m.
    rms: f64,
}

impl Gains {
    /// Codes of the torque are so coarse that only a large difference is one.
    fn is_one(&self) -> bool {
        (self.kp - 1.0).abs() < SCALE.max(4.0 * self.error)
    }
}

impl Torque {
    /// Computes the torque of `samples`, whose velocities are known.
    pub(crate) fn of(samples: &[Sample], velocities: &[f64]) -> Self {
        let fits = [0, 1].map(|behind| gains(samples, velocities, behind));
        let [now, before] = fits.map(|gains| gains.map_or(f64::INFINITY, |gains| gains.rms));
        let behind = usize::from(before < now);
        let most = (CODES * code_of(samples)).max(CONTRADICTION * rms(samples));
        let agrees = fits[behind].is_some_and(|gains| gains.rms < most && gains.is_one());
        let span = |next| {
            if agrees { law(samples, velocities, next) } else { reported(samples, velocities, next, behind) }
        };
        let coarse = if agrees { 0.0 } else { CODES * code_of(samples) };
        Self { spans: (1..samples.len()).map(span).collect(), is_reported: !agrees, coarse }
    }

    /// Integral of the torque times a weight from sample `at` to the next, N·m·s. `weights` are
    /// those at both ends.
    pub(crate) fn impulse(&self, samples: &[Sample], at: usize, weights: [f64; 2]) -> f64 {
        let seconds = samples[at + 1].time - samples[at].time;
        let [begin, end] = self.spans[at];
        let [first, last] = weights;
        // Both are linear over the span.
        seconds * (first * (2.0 * begin + end) + last * (begin + 2.0 * end)) / 6.0
    }

    /// At a sample, after its command, N·m.
    pub(crate) fn at(&self, at: usize) -> f64 {
        self.spans.get(at).map_or(0.0, |span| span[0])
    }
}

/// The torque of the law from the sample before `next` to it.
fn law(samples: &[Sample], velocities: &[f64], next: usize) -> [f64; 2] {
    let Applied { position, velocity, kp, kd, torque } = samples[next - 1].applied;
    [next - 1, next]
        .map(|at| kp * (position - samples[at].position) + kd * (velocity - velocities[at]) + torque)
}

/// The reported torque. The law changes it from one sample to the next, before the next command
/// does.
fn reported(samples: &[Sample], velocities: &[f64], next: usize, behind: usize) -> [f64; 2] {
    let (here, there) = (&samples[next - 1], &samples[next]);
    let Applied { kp, kd, .. } = here.applied;
    let change = kp * (there.position - here.position) + kd * (velocities[next] - velocities[next - 1]);
    if behind == 0 { [here.torque, here.torque - change] } else { [there.torque + change, there.torque] }
}

/// Least squares of the reports by stiffness and damping.
fn gains(samples: &[Sample], velocities: &[f64], behind: usize) -> Option<Gains> {
    let rows: Vec<_> = (behind..samples.len())
        .map(|at| {
            let Applied { position, velocity, kp, kd, torque } = samples[at - behind].applied;
            let sample = &samples[at];
            (
                [kp * (position - sample.position), kd * (velocity - velocities[at]), 1.0],
                sample.torque - torque,
            )
        })
        .collect();
    if rows.len() < 100 {
        return None;
    }
    let (mut matrix, mut right) = (vec![vec![0.0; 3]; 3], vec![0.0; 3]);
    for (factors, torque) in &rows {
        add_square(&mut matrix, 1.0, factors);
        add(&mut right, *torque, factors);
    }
    let inverse = Inverse::of(&matrix, CONDITION)?;
    let solved = inverse.times(&right);
    let square: f64 = rows.iter().map(|(factors, torque)| (dot(factors, &solved) - torque).powi(2)).sum();
    let residual = square / rows.len() as f64;
    let variance = inverse.times(&[1.0, 0.0, 0.0])[0];
    Some(Gains { kp: solved[0], error: (residual * variance).sqrt(), rms: residual.sqrt() })
}

/// The distance of two torque codes, N·m.
fn code_of(samples: &[Sample]) -> f64 {
    let mut values: Vec<f64> = samples.iter().map(|sample| sample.torque).collect();
    values.sort_by(f64::total_cmp);
    let steps = values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 1e-5);
    steps.fold(f64::INFINITY, f64::min)
}

/// Root mean square of the reports, N·m.
fn rms(samples: &[Sample]) -> f64 {
    let square: f64 = samples.iter().map(|sample| sample.torque.powi(2)).sum();
    (square / samples.len().max(1) as f64).sqrt()
}

/// The load that was added to the joint between two identifications.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownLoad {
    /// Its inertia about the axis of the joint, kg·m².
    pub inertia: f64,
}

/// Returns the true torque by the torque that the motor reports. A motor that gives less than it
/// reports needs more of it for the same load: the difference of the identified inertias is too
/// large by the same factor.
#[must_use]
pub fn torque_scale(without: &Value, with: &Value, load: KnownLoad) -> Value {
    let (Some(before), Some(after)) = (without.identified(), with.identified()) else {
        return without.why.or(with.why).map_or(Value::around(f64::NAN, 0.0), Value::none);
    };
    let difference = after - before;
    let half = without.half().hypot(with.half());
    let scale = load.inertia / difference;
    if difference.abs() <= half {
        return Value::within(scale, f64::NEG_INFINITY, f64::INFINITY);
    }
    let ends = [load.inertia / (difference + half), load.inertia / (difference - half)];
    Value::within(scale, ends[0].min(ends[1]), ends[0].max(ends[1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_is_load_by_difference() {
        let [without, with] = [0.02, 0.045].map(|value| Value::around(value, 0.0003));
        let scale = torque_scale(&without, &with, KnownLoad { inertia: 0.02 });
        assert!((scale.value - 0.8).abs() < 1e-12 && scale.why.is_none(), "{scale:?}");
        assert!(scale.lower < 0.79 && scale.upper > 0.81 && scale.half() < 0.02, "{scale:?}");
        let same = torque_scale(&with, &with, KnownLoad { inertia: 0.02 });
        assert!(same.identified().is_none(), "{same:?}");
    }
}
