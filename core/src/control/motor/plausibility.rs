//! Checks the plausibility of a motor's reports, and whether the motor follows its commands.
//!
//! | observation | for how long | cause |
//! |---|---|---|
//! | a step longer than the motor's top speed allows | 3 replies in a row, or a third of the replies for long | implausible |
//! | three times the motor's peak torque | 50 ms | implausible |
//! | speed, while the code of the position does not change | 50 ms | encoder-stuck |
//! | 1.2 times the joint's speed limit, or the end of the speeds that the motor can report | 5 ms | overspeed |
//! | too far from the position it is pulled to; without a limit, half a turn at the torque limit and not approaching | 50 ms | following-error |
//! | at the temperature limit | 1 s | over-temperature |
//! | a temperature that no motor has | 1 s | temperature-sensor |
//! | the end of the positions that the motor can report | immediately | range-end |
//! | two answers to one question | 5 times in 10 turns | duplicate-id |

use motord_bus::{Duration, Instant};
use motord_protocol::drive::{JointSide, Measured, Setpoint};
use motord_settings::settings::{BeyondRange, LimitSettings, MotorSettings};
use motord_shared::{Cause, SetpointMode};

/// Tolerance of a step against speed times time: codes are coarse, and replies jitter.
const STEP_FACTOR: f32 = 1.5;
const STEP_MARGIN: f32 = 0.02;
/// After this many consecutive implausible replies the last one is used, and the group is stopped.
const STEPS_MAX: u32 = 3;
/// A leaky bucket: an implausible reply adds, every other takes one off. A motor that reports two
/// positions in turn fills it in 40 replies.
const STEP_WEIGHT: u32 = 2;
const STEP_BUCKET: u32 = 20;
/// Below this speed, rad/s, the code of a position may stay the same.
const STUCK_VELOCITY: f32 = 0.5;
const STUCK_TIME: Duration = Duration::from_millis(50);
const OVERSPEED_FACTOR: f32 = 1.2;
/// A reported speed beyond this part of its code's end may be a clamped one. No speed limit reaches
/// so far: the configuration keeps limits 0.5 % away from the end.
const CLAMPED_FROM: f32 = 0.998;
const OVERSPEED_TIME: Duration = Duration::from_millis(5);
/// The peak torque of a model is that of its winding; other windings have up to twice as much.
const TORQUE_FACTOR: f32 = 3.0;
const TORQUE_TIME: Duration = Duration::from_millis(50);
/// Without a limit of its own a joint is too far at half a turn, rad. It must be commanded this
/// share of its torque limit, and not approach the position at [`APPROACH_VELOCITY`], rad/s.
/// Contact and soft gains explain less.
const FOLLOWING_ERROR: f32 = core::f32::consts::PI;
const FULL_SHARE: f32 = 0.9;
const APPROACH_VELOCITY: f32 = 0.5;
const FOLLOWING_TIME: Duration = Duration::from_millis(50);
/// Also the time until a lasting impossible temperature is a cause.
const HOT_TIME: Duration = Duration::from_secs(1);
/// A temperature outside is not used, °C. It means a broken sensor, or another layout of the reply.
const TEMPERATURES: core::ops::RangeInclusive<f32> = -40.0..=180.0;
/// No winding heats up by this much from one reply to the next, K.
const TEMPERATURE_STEP: f32 = 20.0;
/// Distance to the end of the positions that a motor can report, rad, at which it is stopped.
/// Beyond the end it wraps or clamps; the vendors' documents do not state which.
const END_MARGIN: f32 = 0.5;
/// A leaky bucket: a second answer adds, every turn takes one off.
const DUPLICATE_WEIGHT: u32 = 2;
const DUPLICATES_MAX: u32 = 5;

/// The memory of one motor's reports.
#[derive(Debug, Clone, Default)]
pub(super) struct Plausibility {
    steps: u32,
    step_bucket: u32,
    /// The time at which each of the [`CONDITIONS`] began to hold; `None` while none holds.
    since: Option<[Option<Instant>; CONDITIONS.len()]>,
    odd_temperatures: u32,
    duplicates: u32,
}

/// The causes that need time, and how long their conditions must hold.
const CONDITIONS: [(Cause, Duration); 6] = [
    (Cause::EncoderStuck, STUCK_TIME),
    (Cause::Overspeed, OVERSPEED_TIME),
    (Cause::FollowingError, FOLLOWING_TIME),
    (Cause::OverTemperature, HOT_TIME),
    (Cause::TemperatureSensor, HOT_TIME),
    (Cause::Implausible, TORQUE_TIME),
];

/// The data that a report is checked by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expectation<'a> {
    pub(super) settings: &'a MotorSettings,
    /// The previous state and its arrival.
    pub(super) before: Option<(&'a Measured<JointSide>, Instant)>,
    /// The command after all limits.
    pub(super) applied: &'a Setpoint,
    /// The motor follows setpoints.
    pub(super) active: bool,
}

/// The credibility of a reply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Credibility {
    /// It may be used.
    Sound(Measured<JointSide>),
    /// It may be used, but the group must be stopped.
    Stop(Measured<JointSide>, Cause),
    /// It is implausible.
    Unbelievable,
}

impl Plausibility {
    /// Checks `reported`, which arrived at `at`. Constant time.
    #[inline(always)]
    pub(super) fn check(
        &mut self,
        reported: Measured<JointSide>,
        at: Instant,
        expected: &Expectation<'_>,
    ) -> Credibility {
        let temperature = self.believable_temperature(&reported, expected.before);
        let is_impossible = reported.temperature.is_some_and(is_impossible);
        let reported = Measured::new(reported.position, reported.velocity, reported.torque, temperature);
        if self.is_jump(&reported, at, expected) {
            return self.step(reported);
        }
        self.steps = 0;
        self.step_bucket = self.step_bucket.saturating_sub(1);
        match self.cause(&reported, is_impossible, at, expected) {
            Some(cause) => Credibility::Stop(reported, cause),
            None => Credibility::Sound(reported),
        }
    }

    /// Checks a step that is too long.
    #[cold]
    const fn step(&mut self, reported: Measured<JointSide>) -> Credibility {
        self.steps += 1;
        self.step_bucket += STEP_WEIGHT;
        if self.steps < STEPS_MAX && self.step_bucket <= STEP_BUCKET {
            return Credibility::Unbelievable;
        }
        (self.steps, self.step_bucket) = (0, 0);
        Credibility::Stop(reported, Cause::Implausible)
    }

    /// Records a second answer to one question. Returns whether two motors share the id.
    pub(super) fn duplicate(&mut self) -> bool {
        self.duplicates = (self.duplicates + DUPLICATE_WEIGHT).min(4 * DUPLICATES_MAX);
        self.is_doubled()
    }

    /// Returns whether two motors answered to this id recently.
    pub(super) const fn is_doubled(&self) -> bool {
        self.duplicates > DUPLICATES_MAX
    }

    /// Ends a turn.
    pub(super) const fn end_turn(&mut self) {
        self.duplicates = self.duplicates.saturating_sub(1);
    }

    fn is_jump(&self, reported: &Measured<JointSide>, at: Instant, expected: &Expectation<'_>) -> bool {
        let Some((before, then)) = expected.before else { return false };
        let top = expected.settings.max_velocity;
        let reach = STEP_FACTOR * top * at.seconds_since(then) + STEP_MARGIN;
        (reported.position - before.position).abs() > reach
    }

    #[inline(always)]
    fn cause(
        &mut self,
        reported: &Measured<JointSide>,
        has_impossible_temperature: bool,
        at: Instant,
        expected: &Expectation<'_>,
    ) -> Option<Cause> {
        let Expectation { settings, before, applied, active } = *expected;
        let limits = &settings.limits;
        let still =
            before.is_some_and(|(before, _)| before.position.to_bits() == reported.position.to_bits());
        let stuck = still && reported.velocity.abs() > STUCK_VELOCITY;
        let fast = reported.velocity.abs() > overspeed(limits.velocity, settings.capabilities.velocity_end);
        let pulled = applied.pulls();
        let far = active && pulled && is_far(reported, applied, limits);
        let hot = reported.temperature.is_some_and(|temperature| temperature >= limits.temperature);
        let strong = reported.torque.abs() > TORQUE_FACTOR * settings.winding.peak_torque;
        let hold = [stuck, fast, far, hot, has_impossible_temperature, strong];
        // Without a short circuit: six branches cost more.
        if !hold.iter().fold(false, |any, holds| any | holds) {
            self.since = None;
        } else if let Some(cause) = self.lasting(hold, at) {
            return Some(cause);
        }
        (active && is_at_range_end(reported, pulled, settings)).then_some(Cause::RangeEnd)
    }

    /// Returns the first cause whose condition has held long enough. `hold`: which of the
    /// [`CONDITIONS`] hold.
    #[cold]
    fn lasting(&mut self, hold: [bool; CONDITIONS.len()], at: Instant) -> Option<Cause> {
        let since = self.since.get_or_insert_default();
        for (since, holds) in since.iter_mut().zip(hold) {
            *since = holds.then(|| since.unwrap_or(at));
        }
        let mut lasting = CONDITIONS.iter().zip(since);
        lasting.find_map(|((cause, time), since)| {
            since.is_some_and(|since| at.since(since) >= *time).then_some(*cause)
        })
    }

    /// Ignores a single step of the temperature; uses it after many in a row. Never uses an
    /// impossible temperature.
    fn believable_temperature(
        &mut self,
        reported: &Measured<JointSide>,
        before: Option<(&Measured<JointSide>, Instant)>,
    ) -> Option<f32> {
        const ODD_MAX: u32 = 10;
        let temperature = reported.temperature?;
        let last = before.and_then(|(before, _)| before.temperature);
        if is_impossible(temperature) {
            return last;
        }
        let odd = last.is_some_and(|last| (temperature - last).abs() > TEMPERATURE_STEP);
        self.odd_temperatures = if odd { self.odd_temperatures.saturating_add(1) } else { 0 };
        if odd && self.odd_temperatures < ODD_MAX { last } else { Some(temperature) }
    }
}

fn is_impossible(temperature: f32) -> bool {
    !TEMPERATURES.contains(&temperature)
}

/// Returns the speed above which a joint with this limit is too fast, rad/s. The motor reports
/// speeds up to `end`.
fn overspeed(limit: f32, end: Option<f32>) -> f32 {
    let factored = OVERSPEED_FACTOR * limit;
    let clamped = end.map_or(factored, |end| CLAMPED_FROM * end);
    if factored < clamped { factored } else { clamped }
}

fn is_far(reported: &Measured<JointSide>, applied: &Setpoint, limits: &LimitSettings) -> bool {
    let error = applied.values.position - reported.position;
    match limits.following_error {
        Some(most) => error.abs() > most,
        None => error.abs() > FOLLOWING_ERROR && gets_no_nearer(error, reported, applied, limits),
    }
}

/// Returns whether the joint is commanded all its torque, and does not approach the position.
#[cold]
fn gets_no_nearer(
    error: f32,
    reported: &Measured<JointSide>,
    applied: &Setpoint,
    limits: &LimitSettings,
) -> bool {
    let torque = applied.values.predicted_torque(reported.position, reported.velocity);
    // In other modes the drive decides the torque.
    let is_full = applied.mode != SetpointMode::Impedance || torque.abs() >= FULL_SHARE * limits.torque;
    is_full && error.signum() * reported.velocity < APPROACH_VELOCITY
}

/// A motor that wraps may turn beyond the range while no setpoint pulls it to a position: commands
/// cannot contain a position there.
fn is_at_range_end(reported: &Measured<JointSide>, is_pulled: bool, settings: &MotorSettings) -> bool {
    let Some(end) = settings.capabilities.position_end else { return false };
    let position = settings.transmission.position_to_motor(reported.position);
    let free = settings.beyond_range == BeyondRange::Wrap && !is_pulled;
    position.abs() > end - END_MARGIN && !free
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speed_at_code_end_is_overspeed() {
        // RS00: the code ends at 33 rad/s, and so high a limit is the default.
        let (end, limit) = (33.0, 0.995 * 33.0);
        let threshold = overspeed(limit, Some(end));
        assert!(limit < threshold && threshold < end, "{threshold}");
        assert!((overspeed(20.0, Some(end)) - 24.0).abs() < 1e-4);
        assert!((overspeed(limit, None) - 1.2 * limit).abs() < 1e-4);
    }

    #[test]
    fn impossible_temperature_is_never_believed() {
        for celsius in [-204.8, -41.0, 181.0, 204.7, f32::NAN] {
            let reported = Measured::new(0.0, 0.0, 0.0, Some(celsius));
            let warm = Measured::new(0.0, 0.0, 0.0, Some(1.0));
            let mut plausibility = Plausibility::default();
            for _ in 0..100 {
                assert_eq!(plausibility.believable_temperature(&reported, None), None);
                let before = Some((&warm, Instant::ZERO));
                assert_eq!(plausibility.believable_temperature(&reported, before), Some(1.0));
            }
        }
    }
}
