//! Checks that orientation and acceleration of an IMU at rest agree about gravity.
//!
//! At rest the specific force is 9.81 m/s², and the orientation turns it onto z of the world. A
//! driver with other conventions, such as a quaternion x, y, z, w or an acceleration in g,
//! contradicts one of them in most poses. Each pose at rest excludes conventions that do not agree
//! in it.
//!
//! Real-time: nothing here allocates, blocks or calls the system; each call takes constant time.

use motord_bus::{Duration, Instant};
use motord_settings::sensor::imu::{ImuSample, Mount};
use motord_shared::ImuContradiction::{
    self, AccelerationAxes, AccelerationInG, Direction, QuaternionInverse, QuaternionNed, QuaternionXyzw,
    Size, WithoutGravity, ZDown,
};

/// Standard acceleration of free fall, m/s².
const GRAVITY: f32 = 9.806_65;
/// Length of a rest. With [`SETTLING`] of the filters a contradiction is reported within 2 s.
const REST: Duration = Duration::from_millis(1700);
/// Time constant of the filters of angular velocity and acceleration, which suppress noise and
/// vibration, s.
const SETTLING: f32 = 0.04;
/// Time until the filter of the acceleration follows a body that stopped.
const SETTLED: Duration = Duration::from_millis(250);
/// A longer time between two samples ends a rest.
const GAP_MAX: Duration = Duration::from_millis(500);
/// Fastest turn at rest, rad/s: above the bias of a gyroscope.
const TURN_MAX: f32 = 0.1;
/// Largest turn within a rest, rad.
const DRIFT_MAX: f32 = 0.05;
/// Largest change of the acceleration within a rest, m/s².
const SHAKE_MAX: f32 = 0.7;
/// Largest angle between the two directions that agree, rad: 10°.
const ANGLE_MAX: f32 = 0.174_533;
/// Largest error of the acceleration that agrees, as a part of 9.81 m/s².
const SIZE_MAX: f32 = 0.1;
/// A contradiction ends at this part of the limits.
const HYSTERESIS: f32 = 0.8;
/// A convention agrees when its angle is at most this much larger than that of the best, rad, and
/// at most this, rad: clearly less than the contradiction.
const BEST_MARGIN: f32 = 0.05;
const CONVENTION_MAX: f32 = ANGLE_MAX / 2.0;
/// Values beyond this count as this, rad/s and m/s²: filters and sums stay finite.
const VALUE_MAX: f32 = 1e4;
/// A weaker acceleration has no direction, m/s².
const WITHOUT_GRAVITY_MAX: f32 = 0.5;

/// The conventions of quaternion and sign, the most frequent ones first. The quaternion in z down
/// with a negated acceleration is left out: it is a turn of the axes.
const CONVENTIONS: [u32; 14] = {
    let [x, i, n, d] = [QuaternionXyzw.bit(), QuaternionInverse.bit(), QuaternionNed.bit(), ZDown.bit()];
    [x, i, n, d, x | i, x | n, i | n, x | d, i | d, x | i | n, x | i | d, x | n | d, i | n | d, x | i | n | d]
};
/// Turns of the axes: three axes in any order, each in both directions, without mirrors. The first
/// is none.
const AXES: usize = 24;
/// The conventions that may agree: those of [`CONVENTIONS`], then the turns.
const CANDIDATES: usize = CONVENTIONS.len() + AXES - 1;

/// The contradictions that name no convention.
const UNKNOWN: u32 = Direction.bit() | Size.bit();
/// Consecutive rests until one of [`UNKNOWN`] is reported of an IMU that agreed before. An elevator
/// or a vehicle accelerates constantly for some seconds.
const UNKNOWN_RESTS: u32 = 3;

/// The contradictions of the size of the acceleration. The others are of directions.
const SIZES: u32 = AccelerationInG.bit() | WithoutGravity.bit() | Size.bit();

/// The outcome of a rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Finding {
    /// Bits of the contradictions; 0 when both agree.
    pub(super) contradictions: u32,
    /// Direction up by the orientation, in the frame of the body.
    pub(super) up: [f32; 3],
    /// Mean acceleration, in the frame of the body, m/s².
    pub(super) acceleration: [f32; 3],
}

/// Compares the directions of gravity by orientation and acceleration, and the size of the
/// acceleration, while an IMU is at rest.
#[derive(Debug, Clone)]
pub(super) struct GravityCheck {
    mount: Mount,
    rest: Option<Rest>,
    /// By candidate, whether it agreed in every rest since the contradiction began.
    agreeing: u64,
    contradictions: u32,
    /// A rest showed no contradiction.
    has_agreed: bool,
}

/// The samples of a rest, in the frame of the body.
#[derive(Debug, Clone, Copy)]
struct Rest {
    begin: Instant,
    last: Instant,
    /// Filtered angular velocity, rad/s.
    turn: [f32; 3],
    /// Filtered acceleration, m/s².
    force: [f32; 3],
    /// Filtered acceleration when its filter had settled, m/s².
    first_force: [f32; 3],
    first: [f32; 4],
    orientations: [f64; 4],
    accelerations: [f64; 3],
    samples: u32,
    /// Rests in a row before this one that showed a contradiction.
    wrong_rests: u32,
}

impl GravityCheck {
    /// Checks an IMU with this mount.
    pub(super) const fn new(mount: Mount) -> Self {
        Self { mount, rest: None, agreeing: u64::MAX, contradictions: 0, has_agreed: false }
    }

    /// Returns the bits of the contradictions that the last rest showed; 0 before the first.
    pub(super) const fn contradictions(&self) -> u32 {
        self.contradictions
    }

    /// Takes a sample in the frame of the body, measured at `at`. Returns the finding at the end of
    /// a rest that changes the contradictions.
    pub(super) fn receive(&mut self, sample: &ImuSample, at: Instant) -> Option<Finding> {
        let sample = &bounded(sample);
        let rest = match self.rest.filter(|rest| at.since(rest.last) <= GAP_MAX) {
            Some(rest) => rest.with(sample, at),
            None => Rest::new(sample, at, sample.angular_velocity, sample.acceleration),
        };
        if at.since(rest.begin) < REST {
            self.rest = Some(rest);
            return None;
        }
        let mean = rest.mean();
        let contradictions = self.direction(&mean) | self.size(&mean);
        let wrong_rests = if contradictions == 0 { 0 } else { rest.wrong_rests.saturating_add(1) };
        // The next rest begins with this sample.
        self.rest = Some(Rest { wrong_rests, ..Rest::new(sample, at, rest.turn, rest.force) });
        self.conclude(&mean, contradictions, wrong_rests)
    }

    fn conclude(&mut self, mean: &ImuSample, contradictions: u32, wrong_rests: u32) -> Option<Finding> {
        let is_unknown = contradictions & !UNKNOWN == 0 && (1..UNKNOWN_RESTS).contains(&wrong_rests);
        if is_unknown && self.has_agreed && self.contradictions & UNKNOWN == 0 {
            return None;
        }
        self.has_agreed |= contradictions == 0;
        let finding = Finding { contradictions, up: up(mean.orientation), acceleration: mean.acceleration };
        let before = core::mem::replace(&mut self.contradictions, contradictions);
        (before != contradictions).then_some(finding)
    }

    fn size(&self, mean: &ImuSample) -> u32 {
        let size = norm(mean.acceleration);
        let is_near = |unit: f32, part: f32| (size - unit).abs() <= part * unit;
        let is_wrong = self.contradictions & SIZES != 0;
        match size {
            _ if is_near(GRAVITY, if is_wrong { HYSTERESIS * SIZE_MAX } else { SIZE_MAX }) => 0,
            ..WITHOUT_GRAVITY_MAX => WithoutGravity.bit(),
            _ if is_near(1.0, SIZE_MAX) => AccelerationInG.bit(),
            _ => Size.bit(),
        }
    }

    fn direction(&mut self, mean: &ImuSample) -> u32 {
        if norm(mean.acceleration) < WITHOUT_GRAVITY_MAX {
            return 0;
        }
        let is_wrong = self.contradictions & !SIZES != 0;
        let limit = if is_wrong { HYSTERESIS * ANGLE_MAX } else { ANGLE_MAX };
        if angle(up(mean.orientation), mean.acceleration) <= limit {
            self.agreeing = u64::MAX;
            return 0;
        }
        let now = agreeing(&self.mount.to_sensor(mean));
        self.agreeing = if self.agreeing & now == 0 { now } else { self.agreeing & now };
        match self.agreeing.trailing_zeros() as usize {
            index if index < CONVENTIONS.len() => CONVENTIONS[index],
            index if index < CANDIDATES => AccelerationAxes.bit(),
            _ => Direction.bit(),
        }
    }
}

impl Rest {
    fn new(sample: &ImuSample, at: Instant, turn: [f32; 3], force: [f32; 3]) -> Self {
        Self {
            begin: at,
            last: at,
            turn,
            force,
            first_force: force,
            first: sample.orientation,
            orientations: sample.orientation.map(f64::from),
            accelerations: sample.acceleration.map(f64::from),
            samples: 1,
            wrong_rests: 0,
        }
    }

    /// Continues the rest with a sample, or begins it again when the body has moved.
    fn with(mut self, sample: &ImuSample, at: Instant) -> Self {
        let seconds = at.since(self.last).as_secs_f32();
        let part = seconds / (seconds + SETTLING);
        self.last = at;
        self.turn = filtered(self.turn, sample.angular_velocity, part);
        self.force = filtered(self.force, sample.acceleration, part);
        if at.since(self.begin) <= SETTLED {
            self.first_force = self.force;
        }
        let side = dot(self.first, sample.orientation);
        let drift = 2.0 * side.abs().min(1.0).acos();
        let shake = norm(difference(self.force, self.first_force));
        if norm(self.turn) > TURN_MAX || drift > DRIFT_MAX || shake > SHAKE_MAX {
            return Self::new(sample, at, self.turn, self.force);
        }
        // A quaternion and its negative are one orientation.
        let sign = f64::from(side).signum();
        for (sum, part) in self.orientations.iter_mut().zip(sample.orientation) {
            *sum += sign * f64::from(part);
        }
        for (sum, part) in self.accelerations.iter_mut().zip(sample.acceleration) {
            *sum += f64::from(part);
        }
        self.samples = self.samples.saturating_add(1);
        self
    }

    fn acceleration(&self) -> [f32; 3] {
        self.accelerations.map(|sum| (sum / f64::from(self.samples)) as f32)
    }

    fn mean(&self) -> ImuSample {
        let norm = self.orientations.iter().map(|part| part * part).sum::<f64>().sqrt();
        ImuSample {
            orientation: self.orientations.map(|part| (part / norm) as f32),
            angular_velocity: self.turn,
            acceleration: self.acceleration(),
            temperature: None,
        }
    }
}

fn bounded(sample: &ImuSample) -> ImuSample {
    let bound = |value: f32| value.clamp(-VALUE_MAX, VALUE_MAX);
    ImuSample {
        angular_velocity: sample.angular_velocity.map(bound),
        acceleration: sample.acceleration.map(bound),
        ..*sample
    }
}

/// Returns the candidates, by bit, in which orientation and acceleration of a sensor agree. Bounded
/// by [`CANDIDATES`].
fn agreeing(sensor: &ImuSample) -> u64 {
    let mut angles = [0.0_f32; CANDIDATES];
    let (conventions, turns) = angles.split_at_mut(CONVENTIONS.len());
    for (found, convention) in conventions.iter_mut().zip(CONVENTIONS) {
        let sign = if convention & ZDown.bit() == 0 { 1.0 } else { -1.0 };
        let force = sensor.acceleration.map(|part| sign * part);
        *found = angle(up(read_as(convention, sensor.orientation)), force);
    }
    for (found, turn) in turns.iter_mut().zip(1..AXES) {
        *found = angle(up(sensor.orientation), turned(turn, sensor.acceleration));
    }
    let best = angles.iter().copied().fold(f32::INFINITY, f32::min);
    let most = CONVENTION_MAX.min(best + BEST_MARGIN);
    angles
        .iter()
        .enumerate()
        .filter(|(_, angle)| **angle <= most)
        .fold(0, |bits, (index, _)| bits | 1 << index)
}

/// Returns the quaternion w, x, y, z from body to world of one that was sent in `convention`.
fn read_as(convention: u32, sent: [f32; 4]) -> [f32; 4] {
    let is = |of: ImuContradiction| convention & of.bit() != 0;
    let [w, x, y, z] = if is(QuaternionXyzw) { [sent[3], sent[0], sent[1], sent[2]] } else { sent };
    let [x, y, z] = if is(QuaternionInverse) { [-x, -y, -z] } else { [x, y, z] };
    if is(QuaternionNed) { [w, x, -y, -z] } else { [w, x, y, z] }
}

/// Returns `vector` in other axes. `turn` is below [`AXES`].
fn turned(turn: usize, vector: [f32; 3]) -> [f32; 3] {
    const ORDERS: [([usize; 3], f32); 6] = [
        ([0, 1, 2], 1.0),
        ([1, 2, 0], 1.0),
        ([2, 0, 1], 1.0),
        ([0, 2, 1], -1.0),
        ([1, 0, 2], -1.0),
        ([2, 1, 0], -1.0),
    ];
    let (order, parity) = ORDERS[turn / 4];
    let [first, second] = [1, 2].map(|bit| if turn & bit == 0 { 1.0 } else { -1.0 });
    let signs = [first, second, parity * first * second];
    [0, 1, 2].map(|axis| signs[axis] * vector[order[axis]])
}

/// Returns z of the world in the frame of a body with this orientation.
fn up([w, x, y, z]: [f32; 4]) -> [f32; 3] {
    [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)]
}

/// Returns the angle between two vectors, rad; 0 when one has no length.
fn angle(one: [f32; 3], other: [f32; 3]) -> f32 {
    let lengths = norm(one) * norm(other);
    if lengths > 0.0 { (dot(one, other) / lengths).clamp(-1.0, 1.0).acos() } else { 0.0 }
}

fn filtered(before: [f32; 3], now: [f32; 3], part: f32) -> [f32; 3] {
    [0, 1, 2].map(|axis| before[axis] + part * (now[axis] - before[axis]))
}

fn difference(one: [f32; 3], other: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|axis| one[axis] - other[axis])
}

fn dot<const N: usize>(one: [f32; N], other: [f32; N]) -> f32 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

fn norm(vector: [f32; 3]) -> f32 {
    dot(vector, vector).sqrt()
}

#[cfg(test)]
mod tests;
