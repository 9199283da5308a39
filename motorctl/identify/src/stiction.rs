//! Static friction: the torque at which a joint that rests begins to move.

use crate::interval::{Value, Why};
use crate::law::Torque;
use crate::sample::Sample;

/// A joint rests after it did not move for this long, s.
const REST: f64 = 0.06;
/// Codes of position that it moves, at most, while it rests, and after which it surely moves.
const RESTING: f64 = 1.5;
const MOVING: f64 = 2.5;
/// Time over which the rise of the torque is measured, s.
const RISE: f64 = 0.05;
/// Fewest and most begins of a motion that are used.
const EVENTS_MIN: usize = 4;
const EVENTS_MAX: usize = 8;

/// Friction before and after a motion began, N·m.
type Event = [f64; 2];

/// Returns the static friction of a joint with this inertia, kg·m². `gravity` is the torque that
/// the position takes, N·m, and `gravity_error` half of its interval.
pub(crate) fn stiction(
    samples: &[Sample],
    torque: &Torque,
    inertia: f64,
    gravity: impl Fn(f64) -> f64,
    gravity_error: f64,
) -> Value {
    let friction = |at: usize| torque.at(at) - gravity(samples[at].position);
    let bracket = |begin: Begin| bracket(samples, begin, inertia, &friction);
    let mut events: Vec<Event> = begins(samples).into_iter().filter_map(bracket).collect();
    // The slower the torque rises, the closer it brackets the begin.
    events.sort_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])));
    events.truncate(EVENTS_MAX);
    if events.len() < EVENTS_MIN {
        return Value::none(Why::Rest);
    }
    let [low, high] = [0, 1].map(|end| of(&events, end));
    let (lower, upper) = (low[0] - low[1] - gravity_error, high[0] + high[1] + gravity_error);
    Value::within((low[0] + high[0]) / 2.0, lower, upper)
}

/// Bounds of the friction at the start of a motion. Upper: at the first sample that shows motion.
/// Lower: at the last sample at which the joint was at rest: the torque rise since then would
/// produce the whole displacement without a step in friction.
fn bracket(
    samples: &[Sample],
    begin: Begin,
    inertia: f64,
    friction: &impl Fn(usize) -> f64,
) -> Option<Event> {
    let Begin { from, last, moved, distance } = begin;
    let time = |at: usize| samples[at].time;
    let middle = (from..last).find(|&at| time(last) - time(at) <= RISE)?;
    let rise = (friction(last) - friction(middle)) / (time(last) - time(middle));
    let direction = friction(moved).signum();
    let rise = rise * direction;
    if !(rise > 0.0 && inertia > 0.0) {
        return None;
    }
    let ago = (6.0 * inertia * distance / rise).cbrt();
    let rest = (from..=moved).rev().find(|&at| time(moved) - time(at) >= ago)?;
    let [low, high] = [rest, moved].map(|at| direction * friction(at));
    (low > 0.0 && high > low).then_some([low, high])
}

/// Mean of one end of the events, and half of its interval.
fn of(events: &[Event], end: usize) -> [f64; 2] {
    let count = events.len() as f64;
    let mean = events.iter().map(|event| event[end]).sum::<f64>() / count;
    let square = events.iter().map(|event| (event[end] - mean).powi(2)).sum::<f64>() / (count - 1.0);
    // Four events have a wide distribution of Student.
    [mean, 3.2 * (square / count).sqrt()]
}

/// A motion that began from rest.
#[derive(Debug, Clone, Copy)]
struct Begin {
    /// First and last sample with the position of the rest.
    from: usize,
    last: usize,
    /// First sample that surely moves, and how far it may have moved, rad.
    moved: usize,
    distance: f64,
}

fn begins(samples: &[Sample]) -> Vec<Begin> {
    let code = code_of(samples);
    let mut found = Vec::new();
    let (mut from, mut last) = (0, 0);
    for at in 1..samples.len() {
        let moved = (samples[at].position - samples[from].position).abs();
        if moved <= RESTING * code {
            last = at;
            continue;
        }
        let rested = samples[last].time - samples[from].time >= REST;
        if rested && moved > MOVING * code {
            // A code that is truncated hides one more.
            found.push(Begin { from, last, moved: at, distance: moved + code });
        }
        if !rested || moved > MOVING * code {
            (from, last) = (at, at);
        }
    }
    found
}

/// The distance of two codes of position, rad.
pub(crate) fn code_of(samples: &[Sample]) -> f64 {
    let mut values: Vec<f64> = samples.iter().map(|sample| sample.position).collect();
    values.sort_by(f64::total_cmp);
    let steps = values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 1e-6);
    steps.fold(f64::INFINITY, f64::min)
}
