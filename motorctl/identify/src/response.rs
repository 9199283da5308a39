//! The response of a joint to steps of its position setpoint, the mean over all of them.

use crate::sample::Sample;

/// The setpoint stays this long before a step, s. A shorter change belongs to the same step.
const QUIET: f64 = 0.05;
/// Time before a step that the curve contains, s.
const LEAD: f64 = 0.03;
/// Share of the time between two steps, at its end, that counts as the end position.
const REST: f64 = 0.2;
/// Settled: this close to the end, as a share of the step.
const SETTLED: f64 = 0.05;
/// Smallest swing around the end position, as a share of the step.
const RING_MIN: f64 = 0.04;

/// A time of the mean response.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Since the step, s; negative before it.
    pub time: f64,
    /// Distance of the setpoint from where the joint rested, rad.
    pub target: f64,
    /// Distance of the joint from where it rested, rad.
    pub position: f64,
    /// Torque in the direction of the step, N·m.
    pub torque: f64,
}

/// Oscillation around the end position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ring {
    /// Hz.
    pub frequency: f64,
    /// From the logarithmic decrement of the swings.
    pub damping_ratio: f64,
}

/// The mean response of a joint to steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    /// Over time.
    pub curve: Vec<Point>,
    /// Number of steps.
    pub steps: usize,
    /// From 10 % to 90 % of the way to the end position, s.
    pub rise: Option<f64>,
    /// Beyond the end position, as a share of the way.
    pub overshoot: f64,
    /// Until the joint stays within 5 % of the end position, s; `None` if it does not.
    pub settling: Option<f64>,
    /// `None` for a joint that does not swing.
    pub ring: Option<Ring>,
    /// Until the limited setpoint was at 90 % of its way, s.
    pub reference: f64,
    /// Distance of joint and setpoint at the end of a step, rad: weight and dry friction.
    pub error: f64,
    /// Largest torque, N·m.
    pub torque_peak: f64,
}

/// A step: its samples, and those before it.
struct Step<'a> {
    samples: &'a [Sample],
    begin: f64,
    /// Where joint and setpoint rested, rad.
    from: [f64; 2],
    /// Distance that the setpoint moved, rad.
    height: f64,
}

impl Response {
    /// Computes the mean response from all steps in `samples`, whose setpoint moves back and forth.
    /// `period` is the time between two samples, s. `None` without two whole steps.
    #[must_use]
    pub fn of(samples: &[Sample], period: f64) -> Option<Self> {
        let steps = steps(samples);
        let curve = mean(&steps, period);
        let last = curve.last()?.time;
        let rests = |point: &&Point| point.time > (1.0 - REST) * last;
        let end = average(curve.iter().filter(rests).map(|point| point.position))?;
        let height = average(steps.iter().map(|step| step.height.abs()))?;
        let response: Vec<[f64; 2]> = curve
            .iter()
            .filter(|point| point.time >= 0.0)
            .map(|point| [point.time, point.position])
            .collect();
        let targets: Vec<[f64; 2]> = curve.iter().map(|point| [point.time, point.target]).collect();
        let highest = response.iter().map(|[_, position]| *position).fold(0.0, f64::max);
        let crossed = |share: f64| crossing(&response, share * end);
        let moved = end > SETTLED * height;
        Some(Self {
            steps: steps.len(),
            rise: crossed(0.9).zip(crossed(0.1)).map(|(high, low)| high - low).filter(|_| moved),
            overshoot: if moved { (highest / end - 1.0).max(0.0) } else { 0.0 },
            settling: settling(&response, end, SETTLED * height).filter(|_| moved),
            ring: ring(&response, end, RING_MIN * height).filter(|_| moved),
            reference: crossing(&targets, 0.9 * height).unwrap_or(0.0),
            error: average(steps.iter().map(Step::error))?,
            torque_peak: samples.iter().map(|sample| sample.torque.abs()).fold(0.0, f64::max),
            curve,
        })
    }
}

fn average(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// The steps of a recording. The last one ends with the recording.
fn steps(samples: &[Sample]) -> Vec<Step<'_>> {
    let mut begins = Vec::new();
    let mut changed = f64::NEG_INFINITY;
    for (at, pair) in samples.windows(2).enumerate() {
        if pair[0].applied.position != pair[1].applied.position {
            if pair[1].time - changed > QUIET {
                begins.push(at + 1);
            }
            changed = pair[1].time;
        }
    }
    let ends = begins.iter().skip(1).copied().chain([samples.len()]);
    begins.iter().zip(ends).filter_map(|(begin, end)| Step::of(samples, *begin, end)).collect()
}

impl<'a> Step<'a> {
    fn of(samples: &'a [Sample], begin: usize, end: usize) -> Option<Self> {
        let at = samples[begin].time;
        let first = samples[..begin].iter().rposition(|sample| at - sample.time > LEAD)?;
        let before = average(samples[first..begin].iter().map(|sample| sample.position))?;
        let from = samples[begin - 1].applied.position;
        let height = samples[end - 1].applied.position - from;
        Some(Self { samples: &samples[first..end], begin: at, from: [before, from], height })
    }

    /// Distance of joint and setpoint at the end, rad.
    fn error(&self) -> f64 {
        let count = (REST * self.samples.len() as f64).ceil() as usize;
        let last = &self.samples[self.samples.len() - count..];
        average(last.iter().map(|sample| sample.applied.position - sample.position)).unwrap_or(0.0).abs()
    }

    /// Time since the begin and values in the direction of the step.
    fn points(&self) -> impl Iterator<Item = Point> {
        let (sign, [position, target]) = (self.height.signum(), self.from);
        self.samples.iter().map(move |sample| Point {
            time: sample.time - self.begin,
            target: sign * (sample.applied.position - target),
            position: sign * (sample.position - position),
            torque: sign * sample.torque,
        })
    }
}

/// Mean of the steps in bins of a period, up to the end of the shortest.
fn mean(steps: &[Step<'_>], period: f64) -> Vec<Point> {
    let lead = (LEAD / period).floor();
    let lasts = steps.iter().filter_map(|step| step.points().last());
    let last = lasts.map(|point| point.time).fold(f64::INFINITY, f64::min);
    if steps.len() < 2 || !last.is_finite() || period <= 0.0 {
        return Vec::new();
    }
    let mut bins = vec![
        (Point { time: 0.0, target: 0.0, position: 0.0, torque: 0.0 }, 0_u32);
        (last / period + lead) as usize + 1
    ];
    for point in steps.iter().flat_map(Step::points) {
        let index = (point.time / period).round() + lead;
        if let Some((sum, count)) = bins.get_mut(index as usize).filter(|_| index >= 0.0) {
            sum.target += point.target;
            sum.position += point.position;
            sum.torque += point.torque;
            *count += 1;
        }
    }
    let mean = |(index, (sum, count)): (usize, &(Point, u32))| {
        let share = 1.0 / f64::from(*count);
        let [target, position, torque] = [sum.target, sum.position, sum.torque].map(|sum| share * sum);
        (*count > 0).then_some(Point { time: (index as f64 - lead) * period, target, position, torque })
    };
    bins.iter().enumerate().filter_map(mean).collect()
}

/// The time at which the response first reaches `level`, between two of its points.
fn crossing(response: &[[f64; 2]], level: f64) -> Option<f64> {
    let pair = response.windows(2).find(|pair| pair[0][1] < level && pair[1][1] >= level)?;
    let [[before, low], [after, high]] = [pair[0], pair[1]];
    Some(before + (after - before) * (level - low) / (high - low))
}

/// The first time from which the response stays within `band` of `end`.
fn settling(response: &[[f64; 2]], end: f64, band: f64) -> Option<f64> {
    let outside = response.iter().rposition(|[_, position]| (position - end).abs() > band);
    response.get(outside.map_or(0, |outside| outside + 1)).map(|[time, _]| *time)
}

/// The oscillation around `end`, from the extremes of swings larger than `least`. With a single
/// swing, the step is the one before it.
fn ring(response: &[[f64; 2]], end: f64, least: f64) -> Option<Ring> {
    let mut extremes: Vec<[f64; 2]> = Vec::new();
    for [time, position] in response {
        let deviation = position - end;
        match extremes.last_mut() {
            _ if deviation.abs() < least => {}
            Some(last) if last[1].signum() == deviation.signum() => {
                if deviation.abs() > last[1].abs() {
                    *last = [*time, deviation];
                }
            }
            _ => extremes.push([*time, deviation]),
        }
    }
    // The first extreme is the step itself: it has no other before it.
    let swings = if extremes.len() > 2 { &extremes[1..] } else { &extremes[..] };
    let ([begin, first], [finish, last]) = (*swings.first()?, *swings.last()?);
    let halves = f64::from(u32::try_from(swings.len() - 1).ok()?);
    if halves == 0.0 {
        return None;
    }
    let decrement = (first / last).abs().ln() / halves;
    let damping_ratio = decrement / decrement.hypot(core::f64::consts::PI);
    Some(Ring { frequency: halves / (2.0 * (finish - begin)), damping_ratio })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Applied;
    use core::f64::consts::{PI, TAU};

    const PERIOD: f64 = 1e-3;
    const HEIGHT: f64 = 0.05;
    const SECONDS: f64 = 1.0;

    /// Second-order response to a step of 1.
    fn analytic(omega: f64, ratio: f64, time: f64) -> f64 {
        if time <= 0.0 {
            return 0.0;
        }
        if ratio >= 1.0 {
            return 1.0 - (1.0 + omega * time) * (-omega * time).exp();
        }
        let damped = omega * (1.0 - ratio * ratio).sqrt();
        let (sin, cos) = (damped * time).sin_cos();
        1.0 - (-ratio * omega * time).exp() * (cos + ratio * omega / damped * sin)
    }

    /// Steps to and fro, with a joint that hangs 0.01 rad below its setpoint.
    fn steps_of(omega: f64, ratio: f64) -> Vec<Sample> {
        let count = (SECONDS / PERIOD) as usize;
        let sample = |at: usize| {
            let (index, inside) = (at / count, (at % count) as f64 * PERIOD);
            let [from, to] = if index % 2 == 1 { [0.0, HEIGHT] } else { [HEIGHT, 0.0] };
            let [from, to] = if index == 0 { [0.0, 0.0] } else { [from, to] };
            let position = from + (to - from) * analytic(omega, ratio, inside) - 0.01;
            let applied = Applied { position: to, ..Applied::default() };
            Sample { time: at as f64 * PERIOD, position, torque: to - position, applied, ..Sample::default() }
        };
        (0..5 * count).map(sample).collect()
    }

    #[track_caller]
    fn assert_near(value: f64, wanted: f64, share: f64) {
        assert!((value - wanted).abs() <= share * wanted.abs(), "{value} is not {wanted}");
    }

    #[test]
    fn underdamped_response_has_analytic_numbers() {
        let (omega, ratio) = (TAU * 6.0, 0.2);
        let response = Response::of(&steps_of(omega, ratio), PERIOD).unwrap();
        let damped = omega * (1.0 - ratio * ratio).sqrt();
        let ring = response.ring.unwrap();
        assert_eq!(response.steps, 4);
        assert_near(response.overshoot, (-PI * ratio / (1.0 - ratio * ratio).sqrt()).exp(), 0.01);
        assert_near(ring.frequency, damped / TAU, 0.01);
        assert_near(ring.damping_ratio, ratio, 0.03);
        // The envelope reaches 5 % at 3/(ratio·omega) = 0.398 s; the last swing ends before.
        assert!((0.3..0.4).contains(&response.settling.unwrap()), "{:?}", response.settling);
        assert_near(response.error, 0.01, 0.01);
        assert_near(response.torque_peak, HEIGHT + 0.01, 0.2);
    }

    #[test]
    fn critically_damped_response_does_not_swing() {
        let omega = TAU * 5.0;
        let response = Response::of(&steps_of(omega, 1.0), PERIOD).unwrap();
        assert_near(response.rise.unwrap(), 3.358 / omega, 0.01);
        assert!(response.overshoot < 1e-3 && response.ring.is_none(), "{:?}", response.ring);
        assert_near(response.settling.unwrap(), 4.744 / omega, 0.02);
        let before: Vec<_> = response.curve.iter().filter(|point| point.time < 0.0).collect();
        assert!(before.len() > 20 && before.iter().all(|point| point.target == 0.0));
    }

    #[test]
    fn single_overshoot_gives_its_damping_ratio() {
        let (omega, ratio) = (TAU * 5.0, 0.7);
        let ring = Response::of(&steps_of(omega, ratio), PERIOD).unwrap().ring.unwrap();
        assert_near(ring.damping_ratio, ratio, 0.02);
        assert_near(ring.frequency, omega * (1.0 - ratio * ratio).sqrt() / TAU, 0.02);
    }

    #[test]
    fn joint_that_stays_has_no_rise() {
        let mut samples = steps_of(30.0, 1.0);
        samples.iter_mut().for_each(|sample| sample.position = 0.3);
        let response = Response::of(&samples, PERIOD).unwrap();
        assert_eq!((response.rise, response.settling, response.ring), (None, None, None));
        assert!(Response::of(&samples[..1500], PERIOD).is_none(), "one step");
        assert!(Response::of(&[], PERIOD).is_none());
    }

    /// A bus loses replies, and a slow reference takes several cycles.
    #[test]
    fn lost_samples_and_slewed_setpoint_change_little() {
        let (omega, ratio) = (TAU * 6.0, 0.3);
        let mut samples = steps_of(omega, ratio);
        let count = (SECONDS / PERIOD) as usize;
        (0..4).for_each(|at| samples[count + at].applied.position = HEIGHT * 0.2 * (at + 1) as f64);
        let kept: Vec<Sample> =
            samples.iter().enumerate().filter(|(at, _)| at % 7 != 3).map(|(_, sample)| *sample).collect();
        let response = Response::of(&kept, PERIOD).unwrap();
        assert_eq!(response.steps, 4);
        assert_near(response.ring.unwrap().damping_ratio, ratio, 0.05);
        assert!((2e-3..6e-3).contains(&response.reference), "{}", response.reference);
    }
}
