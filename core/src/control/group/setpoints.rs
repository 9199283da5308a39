//! The setpoints of a group, kept until newer ones arrive.
//!
//! ```text
//!  setpoint                                         ┌──── target, kept until the timeout
//!     │                                    ·  ·  ·  ·
//!     │                          ·  ·  ·
//!     │   applied ───────·  ·  ·
//!     └──────────────────┬────────────────────────┬──────────────────────────────▶ time
//!                        begun: the cycle         sent + horizon: the timeout begins
//!                        before the message
//! ```

use motord_bus::{Duration, Instant};
use motord_protocol::drive::{Impedance, JointSide, Setpoint};

/// A longer distance between two messages is a pause: the mean begins again. The longest setpoint
/// timeout.
const PERIOD_MAX: u64 = 1_000_000_000;

/// The newest setpoints that passed every check, by place in the group.
#[derive(Debug)]
pub(super) struct Setpoints {
    /// When they were sent, or when they arrived if that was earlier. `None`: there are none.
    pub(super) at: Option<Instant>,
    /// They are reached this long after they were sent; zero: at once.
    pub(super) horizon: Duration,
    /// When the cycle began to move towards them.
    begun: Instant,
    /// The cycle whose states they answer; 0 when their owner names no past cycle.
    pub(super) answered: u64,
    /// The cycle that first used them; 0 before it.
    pub(super) used: u64,
    targets: Vec<Setpoint>,
    /// Where the cycle began to move. Used only within a horizon.
    origins: Vec<Setpoint>,
    /// Mean time between two messages of this owner, ns; 0 before the second. The newest distance
    /// weighs 1/8.
    period: u64,
    /// Mean time and horizon when their owner was stopped last for sending none.
    pub(super) at_stop: Option<(Duration, Duration)>,
}

impl Setpoints {
    /// Creates an empty buffer for a group of `joints` joints. Allocates; nothing after it does.
    pub(super) fn new(joints: usize) -> Self {
        let neutral = vec![Setpoint::NEUTRAL; joints];
        Self {
            at: None,
            horizon: Duration::ZERO,
            begun: Instant::ZERO,
            answered: 0,
            used: 0,
            targets: neutral.clone(),
            origins: neutral,
            period: 0,
            at_stop: None,
        }
    }

    /// Returns the setpoint that is reached at the end of the horizon.
    fn target(&self, slot: usize) -> Option<Setpoint> {
        self.at.and_then(|_| self.targets.get(slot)).copied()
    }

    /// Returns the setpoint at this [`share`](Self::share) of the way.
    #[inline]
    pub(super) fn get(&self, slot: usize, share: f32) -> Option<Setpoint> {
        let target = self.target(slot)?;
        if share >= 1.0 { Some(target) } else { Some(between(self.origins[slot], target, share)) }
    }

    /// Returns the share of the way to the targets that is over at `now`, 0 to 1.
    #[inline]
    pub(super) fn share(&self, now: Instant) -> f32 {
        match self.at {
            Some(at) if !self.horizon.is_zero() => {
                let all = (at + self.horizon).since(self.begun);
                let elapsed = now.since(self.begun);
                if elapsed >= all { 1.0 } else { elapsed.as_secs_f32() / all.as_secs_f32() }
            }
            _ => 1.0,
        }
    }

    pub(super) fn age(&self, now: Instant) -> Option<Duration> {
        self.at.map(|at| now.since(at))
    }

    /// Returns the time since the end of the horizon; zero within it.
    pub(super) fn age_after_horizon(&self, now: Instant) -> Option<Duration> {
        self.at.map(|at| now.since(at + self.horizon))
    }

    /// Records that the newest were sent at `sent`.
    pub(super) fn sent(&mut self, sent: Instant) {
        if let Some(before) = self.at.replace(sent) {
            let distance = sent.as_nanos().saturating_sub(before.as_nanos());
            self.period = match self.period {
                _ if distance > PERIOD_MAX => 0,
                0 => distance,
                period => period - period / 8 + distance / 8,
            };
        }
    }

    /// Replaces the target at `slot`.
    #[inline]
    pub(super) fn set_target(&mut self, slot: usize, target: Setpoint) {
        self.targets[slot] = target;
    }

    /// The way to the newest targets begins at `begun`, at their [origins](Self::set_origin).
    pub(super) const fn begin_interpolation(&mut self, begun: Instant, horizon: Duration) {
        (self.begun, self.horizon) = (begun, horizon);
    }

    /// Ends the way: the targets are reached now, and the timeout begins when they were sent.
    pub(super) const fn end_interpolation(&mut self) {
        self.horizon = Duration::ZERO;
    }

    /// The way to the target at `slot` begins at `origin`.
    pub(super) fn set_origin(&mut self, slot: usize, origin: Setpoint) {
        self.origins[slot] = origin;
    }

    /// Returns the mean time between two messages of this owner.
    pub(super) fn period(&self) -> Option<Duration> {
        (self.period > 0).then_some(Duration::from_nanos(self.period))
    }

    pub(super) const fn forget(&mut self) {
        (self.at, self.answered, self.used, self.period) = (None, 0, 0, 0);
        self.end_interpolation();
    }

    /// Records that the cycle with this number uses them, if there are any.
    pub(super) const fn begin_use(&mut self, cycle: u64) {
        if self.at.is_some() && self.used == 0 {
            self.used = cycle;
        }
    }
}

/// Returns position, velocity and torque between two finite setpoints, with the gains and the mode
/// of the second. Each value stays between the two, and does not overflow.
#[cold]
fn between(origin: Setpoint, target: Setpoint, share: f32) -> Setpoint {
    let mix = |from: f32, to: f32| from * (1.0 - share) + to * share;
    let (from, to) = (origin.values, target.values);
    let values: Impedance<JointSide> = Impedance::new(
        mix(from.position, to.position),
        mix(from.velocity, to.velocity),
        to.kp,
        to.kd,
        mix(from.torque, to.torque),
    );
    Setpoint { values, ..target }
}
