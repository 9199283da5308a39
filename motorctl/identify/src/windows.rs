//! The equation of motion in its weak form: one line for each window of time in which the joint
//! turns in one direction.

use crate::law::Torque;
use crate::sample::Sample;
use core::ops::Range;

/// Slower than this a joint may rest, and its friction be anything, rad/s.
const SLOWEST: f64 = 0.06;
/// Length of windows, s; at low rates they are longer, to have twice the fewest samples.
const LONGEST: f64 = 0.12;
const SHORTEST: f64 = 0.025;
/// Fewest samples in a window.
const SAMPLES_MIN: usize = 12;
/// A longer time between two samples, relative to the median, ends a window.
const GAP: f64 = 1.5;

/// Number of unknowns: inertia, viscous and Coulomb friction, and three of the torque that depends
/// on the position.
pub(crate) const UNKNOWNS: usize = 6;

/// A line of the regression, N·m.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Row {
    /// Samples of the window, and the share of each in its means.
    pub(crate) window: Range<usize>,
    pub(crate) shares: Vec<f64>,
    /// Distance from the reversal before the window to its middle, rad.
    pub(crate) travel: f64,
    /// Middle of the window, s.
    pub(crate) time: f64,
    /// Factors of the unknowns: acceleration, velocity, direction, 1, sine, and 1 - cosine of the
    /// distance from the centre.
    pub(crate) factors: [f64; UNKNOWNS],
    /// Torque, N·m.
    pub(crate) torque: f64,
    /// Change of the torque for each second by which it acts later, N·m/s.
    pub(crate) shift: f64,
    /// Error of the acceleration for an error of each position, 1/s².
    pub(crate) roughness: f64,
}

impl Row {
    /// Weighted mean over the samples of the window.
    pub(crate) fn mean(&self, of: impl Fn(usize) -> f64) -> f64 {
        self.window.clone().zip(&self.shares).map(|(at, share)| share * of(at)).sum()
    }

    /// +1 or -1.
    pub(crate) fn direction(&self) -> f64 {
        self.factors[2].signum()
    }
}

/// Returns the lines of a recording. `centre` is the position from which the gravity is counted,
/// rad.
pub(crate) fn rows(samples: &[Sample], velocities: &[f64], torque: &Torque, centre: f64) -> Vec<Row> {
    let period = period(samples);
    let runs = runs(samples, velocities, GAP * period);
    let windows = runs.into_iter().flat_map(|run| {
        let begin = samples[run.start].position;
        windows(samples, run, period).into_iter().map(move |window| (begin, window))
    });
    let line = |(begin, window): (f64, Range<usize>)| {
        let row: Row = row(samples, velocities, torque, centre, window)?;
        let travel = (row.mean(|at| samples[at].position) - begin).abs();
        Some(Row { travel, ..row })
    };
    windows.filter_map(line).collect()
}

/// Spans of samples without a gap in which the joint turns in one direction.
fn runs(samples: &[Sample], velocities: &[f64], gap: f64) -> Vec<Range<usize>> {
    let direction = |at: usize| if velocities[at].abs() > SLOWEST { velocities[at].signum() } else { 0.0 };
    let (mut runs, mut from) = (Vec::new(), 0);
    for at in 1..=samples.len() {
        let continues = at < samples.len()
            && direction(at) == direction(from)
            && samples[at].time - samples[at - 1].time < gap;
        if !continues {
            if from < at && direction(from) != 0.0 {
                runs.push(from..at);
            }
            from = at;
        }
    }
    runs
}

/// Median time from sample to sample, s.
fn period(samples: &[Sample]) -> f64 {
    let mut steps: Vec<f64> = samples.windows(2).map(|pair| pair[1].time - pair[0].time).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// Windows of equal length that overlap by half.
fn windows(samples: &[Sample], run: Range<usize>, period: f64) -> Vec<Range<usize>> {
    let length = samples[run.end - 1].time - samples[run.start].time;
    let longest = LONGEST.max(2.0 * SAMPLES_MIN as f64 * period);
    let count = (length / longest).ceil().max(1.0);
    let each = run.len() as f64 / count;
    if each < SAMPLES_MIN as f64 || length / count < SHORTEST {
        return Vec::new();
    }
    let begin = |half: usize| run.start + (half as f64 * each / 2.0) as usize;
    (0..2 * count as usize - 1).map(|half| begin(half)..begin(half + 2).min(run.end)).collect()
}

/// The weight `64·s³·(1-s)³`, and its first and second derivative by `s`.
fn weight(s: f64) -> [f64; 3] {
    let (u, slope) = (s * (1.0 - s), 1.0 - 2.0 * s);
    [64.0 * u.powi(3), 192.0 * u * u * slope, 384.0 * u * (slope * slope - u)]
}

/// The line of a window.
fn row(
    samples: &[Sample],
    velocities: &[f64],
    torque: &Torque,
    centre: f64,
    window: Range<usize>,
) -> Option<Row> {
    let (first, last) = (&samples[window.start], &samples[window.end - 1]);
    let length = last.time - first.time;
    let slope = (last.position - first.position) / length;
    let direction = velocities[window.start].signum();
    let [mut area, mut bend, mut turn, mut error] = [0.0; 4];
    let mut gravity = [0.0; 2];
    let [mut impulse, mut shift] = [0.0; 2];
    let at = |index: usize| {
        let [w, w1, w2] = weight((samples[index].time - first.time) / length);
        [w, w1 / length, w2 / length.powi(2)]
    };
    for index in window.clone() {
        let seconds = width(samples, &window, index);
        let [w, w1, w2] = at(index);
        let (elapsed, position) = (samples[index].time - first.time, samples[index].position);
        // A line has no acceleration; without it the sums have small terms only.
        let curved = position - first.position - slope * elapsed;
        let (sin, cos) = (position - centre).sin_cos();
        area += w * seconds;
        bend += w2 * curved * seconds;
        turn += (slope * w - w1 * curved) * seconds;
        error += (w2 * seconds).powi(2);
        gravity[0] += w * sin * seconds;
        gravity[1] += w * (1.0 - cos) * seconds;
        if index + 1 < window.end {
            let [next, next1, _] = at(index + 1);
            impulse += torque.impulse(samples, index, [w, next]);
            shift += torque.impulse(samples, index, [w1, next1]);
        }
    }
    let factors = [bend, turn, direction * area, area, gravity[0], gravity[1]].map(|sum| sum / area);
    let row = Row {
        shares: shares(samples, &window),
        window,
        travel: 0.0,
        time: (first.time + last.time) / 2.0,
        factors,
        torque: impulse / area,
        shift: shift / area,
        roughness: error.sqrt() / area,
    };
    (row.torque.is_finite() && factors.iter().all(|factor| factor.is_finite())).then_some(row)
}

/// The share of each sample of a window in its means.
fn shares(samples: &[Sample], window: &Range<usize>) -> Vec<f64> {
    let (first, last) = (samples[window.start].time, samples[window.end - 1].time);
    let weight = |index: usize| weight((samples[index].time - first) / (last - first))[0];
    let shares: Vec<f64> =
        window.clone().map(|index| weight(index) * width(samples, window, index)).collect();
    let area: f64 = shares.iter().sum();
    shares.into_iter().map(|share| share / area).collect()
}

/// Time that a sample of a window stands for, s (trapezoids).
fn width(samples: &[Sample], window: &Range<usize>, index: usize) -> f64 {
    let before = index.saturating_sub(1).max(window.start);
    let after = (index + 1).min(window.end - 1);
    (samples[after].time - samples[before].time) / 2.0
}
