//! The indicators of the motors: their values, and which is polled next.
//!
//! The indicators of a motor are polled in rotation at an even rate, when no other question to it
//! is open.

use motord_bus::{Duration, Instant};
use motord_settings::settings::{MotorSettings, Settings};
use motord_shared::JointIndicators;
use motord_shared::limits::{INDICATOR_JOINTS_MAX, INDICATORS_MAX};

/// Lowest rate of polls.
const SLOWEST_HZ: f64 = 0.01;

/// The indicators of the first [`INDICATOR_JOINTS_MAX`] motors that have some; of no motor where
/// none is asked for.
#[derive(Debug)]
pub(super) struct Indicators {
    motors: Vec<IndicatorPoll>,
}

#[derive(Debug)]
struct IndicatorPoll {
    joint: usize,
    bus: usize,
    count: u8,
    next: u8,
    /// When it should be asked next.
    next_at: Instant,
    /// From one question to the next.
    interval: Duration,
    values: [f32; INDICATORS_MAX],
}

impl IndicatorPoll {
    fn new(joint: usize, motor: &MotorSettings, hz: f64) -> Self {
        let count = motor.capabilities.indicators.min(INDICATORS_MAX as u8);
        Self {
            joint,
            bus: motor.bus,
            count,
            next: 0,
            next_at: Instant::ZERO,
            interval: Duration::from_secs_f64(1.0 / (hz * f64::from(count))),
            values: [f32::NAN; INDICATORS_MAX],
        }
    }
}

impl Indicators {
    /// Creates indicators of unknown value. Allocates; nothing after it does.
    pub(super) fn new(settings: &Settings) -> Self {
        let hz = settings.cycle.indicator_hz;
        let motors = settings.motors.iter().enumerate();
        let with = motors.filter(|(_, motor)| hz > 0.0 && motor.capabilities.indicators > 0);
        let asked = with.map(|(joint, motor)| IndicatorPoll::new(joint, motor, hz.max(SLOWEST_HZ)));
        Self { motors: asked.take(INDICATOR_JOINTS_MAX).collect() }
    }

    /// Returns whether no motor is polled.
    pub(super) const fn is_empty(&self) -> bool {
        self.motors.is_empty()
    }

    /// Returns the joint of `bus` to poll at `now`, and the number of the indicator. Of the joints
    /// that `may_be_asked`, this is the one that waits longest. Bounded by
    /// [`INDICATOR_JOINTS_MAX`].
    pub(super) fn next(
        &mut self,
        bus: usize,
        now: Instant,
        may_be_asked: impl Fn(usize) -> bool,
    ) -> Option<(usize, u8)> {
        let due = self.motors.iter_mut().filter(|motor| motor.bus == bus && motor.next_at <= now);
        let asked = due.filter(|motor| may_be_asked(motor.joint)).min_by_key(|motor| motor.next_at)?;
        let number = asked.next;
        asked.next = (number + 1) % asked.count;
        asked.next_at = now + asked.interval;
        Some((asked.joint, number))
    }

    /// Records the value that the motor of `joint` reported; NaN when it refused.
    pub(super) fn take(&mut self, joint: usize, number: u8, value: f32) {
        let asked = self.motors.iter_mut().find(|motor| motor.joint == joint);
        if let Some(kept) = asked.and_then(|motor| motor.values.get_mut(usize::from(number))) {
            *kept = value;
        }
    }

    /// Returns the values by joint; NaN where the state of the joint is not `known`.
    pub(super) fn report(&self, known: impl Fn(usize) -> bool) -> impl Iterator<Item = JointIndicators> {
        self.motors.iter().map(move |motor| JointIndicators {
            joint: motor.joint as u32,
            values: if known(motor.joint) { motor.values } else { [f32::NAN; INDICATORS_MAX] },
        })
    }
}
