//! The indicators and the supplies of the motors: the values of indicators, and which question is next.
//!
//! The indicators of a motor are polled in rotation at an even rate, when no other question to it
//! is open. The supply is polled more often: a gait pulls it down at the rate of its steps.

use motord_bus::{Duration, Instant};
use motord_protocol::SupplyReport;
use motord_protocol::drive::Command;
use motord_settings::settings::{MotorSettings, Settings};
use motord_shared::JointIndicators;
use motord_shared::limits::{INDICATOR_JOINTS_MAX, INDICATORS_MAX};

/// Least number of questions for the supply in the time of one round of indicators.
const SUPPLIES: u8 = 8;
/// Lowest rate of polls.
const SLOWEST_HZ: f64 = 0.01;

/// The motors that are polled, and the indicators of the first [`INDICATOR_JOINTS_MAX`] that have some.
#[derive(Debug)]
pub(super) struct Indicators {
    motors: Vec<IndicatorPoll>,
    /// No motor is due before this time.
    due_at: Instant,
}

#[derive(Debug)]
struct IndicatorPoll {
    joint: usize,
    bus: usize,
    /// Number of its indicators.
    count: u8,
    supply: SupplyReport,
    /// The indicator that is asked for next.
    next: u8,
    /// Indicators until the next question for the supply.
    until_supply: u8,
    /// When it should be asked next.
    next_at: Instant,
    /// From one question to the next.
    interval: Duration,
    values: [f32; INDICATORS_MAX],
}

impl IndicatorPoll {
    fn new(joint: usize, motor: &MotorSettings, hz: f64) -> Self {
        let count = motor.capabilities.indicators.min(INDICATORS_MAX as u8);
        let supplies = count.checked_div(count / SUPPLIES).unwrap_or(SUPPLIES);
        let questions = f64::from(count) + f64::from(supplies);
        Self {
            joint,
            bus: motor.bus,
            count,
            supply: motor.capabilities.supply,
            next: 0,
            until_supply: 0,
            next_at: Instant::ZERO,
            interval: Duration::from_secs_f64(1.0 / (hz * questions)),
            values: [f32::NAN; INDICATORS_MAX],
        }
    }
}

impl IndicatorPoll {
    /// Returns the next question.
    fn question(&mut self) -> Command {
        if self.until_supply == 0 {
            self.until_supply = self.count / SUPPLIES;
            match self.supply {
                SupplyReport::Question => return Command::GetSupply,
                SupplyReport::Indicator(number) => return Command::GetIndicator(number),
                SupplyReport::None | SupplyReport::Unasked => {}
            }
        }
        self.until_supply = self.until_supply.saturating_sub(1);
        let number = self.next;
        self.next = (number + 1) % self.count.max(1);
        Command::GetIndicator(number)
    }
}

impl Indicators {
    /// Creates indicators of unknown value. Allocates; nothing after it does.
    pub(super) fn new(settings: &Settings) -> Self {
        let hz = settings.cycle.indicator_hz;
        let motors = settings.motors.iter().enumerate();
        let is_asked = |motor: &MotorSettings| {
            let abilities = &motor.capabilities;
            abilities.indicators > 0 || abilities.supply == SupplyReport::Question
        };
        let asked = motors.filter(|(_, motor)| hz > 0.0 && is_asked(motor));
        let poll = |(joint, motor)| IndicatorPoll::new(joint, motor, hz.max(SLOWEST_HZ));
        Self { motors: asked.map(poll).collect(), due_at: Instant::ZERO }
    }

    /// Returns whether no motor is polled.
    pub(super) const fn is_empty(&self) -> bool {
        self.motors.is_empty()
    }

    /// Returns whether a motor may be due at `now`.
    pub(super) fn are_due(&self, now: Instant) -> bool {
        !self.is_empty() && now >= self.due_at
    }

    /// Returns the joint of `bus` to poll at `now`, and the question. Of the joints that
    /// `may_be_polled`, this is the one that waits longest. Bounded by joints.
    pub(super) fn next(
        &mut self,
        bus: usize,
        now: Instant,
        may_be_polled: impl Fn(usize) -> bool,
    ) -> Option<(usize, Command)> {
        let due = self.motors.iter_mut().filter(|motor| motor.bus == bus && motor.next_at <= now);
        let asked = due.filter(|motor| may_be_polled(motor.joint)).min_by_key(|motor| motor.next_at)?;
        asked.next_at = now + asked.interval;
        let question = (asked.joint, asked.question());
        self.due_at = self.motors.iter().map(|motor| motor.next_at).min().unwrap_or(Instant::FAR_FUTURE);
        Some(question)
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
        let with = self.motors.iter().filter(|motor| motor.count > 0).take(INDICATOR_JOINTS_MAX);
        with.map(move |motor| JointIndicators {
            joint: motor.joint as u32,
            values: if known(motor.joint) { motor.values } else { [f32::NAN; INDICATORS_MAX] },
        })
    }
}
