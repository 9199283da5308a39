//! The record of a cycle of the joint, and what follows from such records alone: the time that the
//! motor needs to answer, and velocity from positions. The velocity comes from local quadratics, which
//! need no drive that measures it well.

use crate::interval::{Value, Why};
use crate::normal::Inverse;

/// The command that the motor had, joint side, after all limits.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Applied {
    /// rad.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
    /// Stiffness, N·m/rad.
    pub kp: f64,
    /// Damping, N·m·s/rad.
    pub kd: f64,
    /// N·m.
    pub torque: f64,
}

/// The answer of the motor to one command.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// When the command was sent, s, on any clock that does not jump. The state is younger by a
    /// part of `latency`.
    pub time: f64,
    /// Time from the command to the answer, s.
    pub latency: f64,
    /// rad.
    pub position: f64,
    /// Torque as the motor reports it, N·m.
    pub torque: f64,
    /// The command that it answered.
    pub applied: Applied,
}

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

/// Bits of the shortest frame of 8 bytes by those of the longest, with stuff bits and the space
/// between frames: 108 of 135.
const SHORTEST_SHARE: f64 = 0.8;
/// Largest half of the distance of bounds that bound anything, s.
const WIDEST: f64 = 50e-6;

/// The wire between the computer and the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BusTiming {
    /// The longest time of a frame, s.
    pub frame: f64,
    /// Other motors on the bus.
    pub others: usize,
    /// Its frames are those of CAN. On a serial line nothing bounds the answer from below.
    pub is_can: bool,
}

/// Times from a command to its answer, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Delay {
    /// Shortest, median and longest time from the sending of a command to the receipt of its
    /// answer.
    pub answers: [f64; 3],
    /// From the end of a command to the begin of its answer: `reply-latency-us`. Includes what
    /// computer and adapter add.
    pub motor: Value,
    /// From the sending of a command until its torque acts. Lower end: its frame. Upper end: its
    /// answer was under way.
    pub action: [f64; 2],
}

impl Delay {
    /// Returns the bounds from the stamps; `None` without samples.
    pub(crate) fn of(samples: &[Sample], wire: BusTiming) -> Option<Self> {
        let mut times: Vec<f64> =
            samples.iter().map(|sample| sample.latency).filter(|time| *time > 0.0).collect();
        times.sort_by(f64::total_cmp);
        let (shortest, longest) = (*times.first()?, *times.last()?);
        let least = if wire.is_can { SHORTEST_SHARE * wire.frame } else { 0.0 };
        let most = 2.0 * wire.frame * (1.0 + wire.others as f64);
        let upper = (shortest - 2.0 * least).max(0.0);
        let lower = if wire.is_can { (shortest - most).max(0.0) } else { 0.0 };
        let why = ((upper - lower) / 2.0 > WIDEST).then_some(Why::Stamps);
        Some(Self {
            answers: [shortest, times[times.len() / 2], longest],
            motor: Value { value: (lower + upper) / 2.0, lower, upper, why },
            action: [least, shortest - least],
        })
    }
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
