//! Steps of one joint to both sides, within its limits.
//!
//! ```text
//! gains rise -> hold -> (up -> centre -> down -> centre)…
//! ```

use crate::excitation::{Command, Limits, smooth};
use crate::tuning::Gains;
use core::fmt;

/// Time in which the gains change, s.
const RAMP: f64 = 1.0;
/// Share of the torque limit that the weight of a joint uses at most: a step uses the rest.
const WEIGHT_SHARE: f64 = 1.0 - TORQUE_SHARE;
/// Largest distance that an undamped joint moves, in steps.
const SWING: f64 = 2.0;
/// Share of the time between two steps after which a joint swings less than a step.
const SWUNG: f64 = 0.6;
/// Shares of the limits that a step uses at most.
const TORQUE_SHARE: f64 = 0.7;
const VELOCITY_SHARE: f64 = 0.7;

/// Setpoints over time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steps {
    /// rad.
    pub centre: f64,
    /// Height of a step, rad.
    pub height: f64,
    /// Time between two steps, s.
    pub seconds: f64,
    /// Each is four steps: up, back, down, back.
    pub repetitions: u32,
    /// Gains before.
    pub from: Gains,
    /// Gains of the steps.
    pub gains: Gains,
}

/// A limit that steps break.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StepError {
    /// A joint that swings would leave its positions.
    Narrow {
        /// rad.
        centre: f64,
        /// Lowest and highest position, rad.
        limits: [f64; 2],
        /// Highest step that fits, rad.
        most: f64,
    },
    /// Stiffness times step is near the largest torque.
    Strong {
        /// N·m/rad.
        kp: f64,
        /// Stiffness times step, N·m.
        torque: f64,
        /// The limit, N·m.
        limit: f64,
        /// Highest step that fits, rad.
        most: f64,
    },
    /// The joint would be near its largest speed.
    Fast {
        /// rad/s.
        velocity: f64,
        /// The limit, rad/s.
        limit: f64,
        /// Highest step that fits, rad.
        most: f64,
    },
}

impl fmt::Display for StepError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let most = match self {
            Self::Narrow { centre, limits: [lower, upper], most } => {
                write!(
                    f,
                    "it is at {centre:.2} rad, and may swing to twice the step, but its limits are {lower:.2} to {upper:.2} rad"
                )?;
                most
            }
            Self::Strong { kp, torque, limit, most } => {
                let share = 100.0 * TORQUE_SHARE;
                write!(
                    f,
                    "kp {kp:.1} times the step is {torque:.2} N·m, above {share:.0} % of the limit, {limit:.2} N·m"
                )?;
                most
            }
            Self::Fast { velocity, limit, most } => {
                let share = 100.0 * VELOCITY_SHARE;
                write!(
                    f,
                    "it may reach {velocity:.2} rad/s, above {share:.0} % of the limit, {limit:.2} rad/s"
                )?;
                most
            }
        };
        write!(
            f,
            ": choose --step-rad {:.3} or less, or a lower --kp (without it, a lower --bandwidth)",
            most.max(0.0)
        )
    }
}

impl core::error::Error for StepError {}

impl Steps {
    /// Checks that the steps fit the limits. The speed needs the inertia, kg·m².
    ///
    /// # Errors
    ///
    /// With the numbers.
    pub fn check(&self, limits: &Limits, inertia: Option<f64>) -> Result<(), StepError> {
        let Self { centre, height, gains: Gains { kp, .. }, .. } = *self;
        let [lower, upper] = limits.position;
        let most = (centre - lower).min(upper - centre) / SWING;
        if !(0.0..=most).contains(&height) {
            return Err(StepError::Narrow { centre, limits: limits.position, most });
        }
        let (torque, limit) = (kp * height, limits.torque);
        if torque > TORQUE_SHARE * limit {
            return Err(StepError::Strong { kp, torque, limit, most: TORQUE_SHARE * limit / kp });
        }
        // An undamped joint passes the setpoint at step times natural frequency.
        let (frequency, limit) = (inertia.map_or(0.0, |inertia| (kp / inertia).sqrt()), limits.velocity);
        if height * frequency > VELOCITY_SHARE * limit {
            let most = VELOCITY_SHARE * limit / frequency;
            return Err(StepError::Fast { velocity: height * frequency, limit, most });
        }
        Ok(())
    }

    /// Begin of the first step, s.
    #[must_use]
    pub fn begin(&self) -> f64 {
        RAMP + self.seconds
    }

    /// Duration of everything, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.begin() + 4.0 * f64::from(self.repetitions) * self.seconds
    }

    /// Returns the setpoint at `time`, s; `None` after the end.
    #[must_use]
    pub fn command(&self, time: f64) -> Option<Command> {
        if time >= self.duration() {
            return None;
        }
        let [share, _] = smooth(time / RAMP);
        let between = |from: f64, to: f64| from + share * (to - from);
        let (step, _) = self.step(time);
        let side = if step < 0.0 { 0.0 } else { [1.0, 0.0, -1.0, 0.0][step as usize % 4] };
        Some(Command {
            position: self.centre + side * self.height,
            velocity: 0.0,
            kp: between(self.from.kp, self.gains.kp),
            kd: between(self.from.kd, self.gains.kd),
        })
    }

    /// Number of the step at `time`, s, and the share of the time to the next one that has passed.
    /// -1 is the hold before the first.
    fn step(&self, time: f64) -> (f64, f64) {
        let steps = (time - self.begin()) / self.seconds;
        (steps.floor(), steps - steps.floor())
    }
}

/// A joint that does not come to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Swing {
    /// It left the range of an undamped joint.
    Far {
        /// rad.
        position: f64,
        /// Lowest and highest position of that range, rad.
        range: [f64; 2],
    },
    /// It began further from its setpoint than a weight explains.
    Displaced {
        /// rad.
        position: f64,
        /// The setpoint, rad.
        centre: f64,
    },
    /// It still swings at the end of a step by this distance, rad.
    Long(f64),
}

impl fmt::Display for Swing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Far { position, range: [low, high] } => {
                write!(
                    f,
                    "it reached {position:.3} rad, outside {low:.3} to {high:.3} rad, twice the step beyond its begin and its setpoint"
                )
            }
            Self::Displaced { position, centre } => {
                write!(
                    f,
                    "it is at {position:.3} rad and its setpoint at {centre:.3} rad, further than its weight may turn it"
                )
            }
            Self::Long(range) => {
                write!(f, "it still swings by {range:.3} rad at the end of a step, more than the step")
            }
        }
    }
}

/// Watches a joint that is stepped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guard {
    steps: Steps,
    /// Largest distance from the setpoint to which a weight turns the joint, rad.
    sag: f64,
    /// Lowest and highest position of the steps from where the joint was at first, rad.
    reach: Option<[f64; 2]>,
    /// Number of the step.
    step: f64,
    /// Lowest and highest position at the end of this step, rad.
    range: [f64; 2],
}

impl Guard {
    /// Watches a joint in `steps`, whose largest torque is `torque`, N·m.
    #[must_use]
    pub fn new(steps: Steps, torque: f64) -> Self {
        let sag = WEIGHT_SHARE * torque / steps.from.kp;
        Self { steps, sag, reach: None, step: f64::NAN, range: [f64::INFINITY, f64::NEG_INFINITY] }
    }

    /// Returns the reach of a joint that begins at `start`, rad.
    fn reach(&self, start: f64) -> Result<[f64; 2], Swing> {
        let Steps { centre, height, .. } = self.steps;
        let swing = SWING * height;
        if !(0.0..=swing + self.sag).contains(&(start - centre).abs()) {
            return Err(Swing::Displaced { position: start, centre });
        }
        // A joint that hangs begins below its setpoint.
        Ok([start.min(centre) - swing, start.max(centre) + swing])
    }

    /// Checks the position of the joint, rad, at `time`, s.
    ///
    /// # Errors
    ///
    /// [`Swing`]: the caller stops the joint.
    pub fn check(&mut self, time: f64, position: f64) -> Result<(), Swing> {
        let reach = self.reach.map_or_else(|| self.reach(position), Ok)?;
        self.reach = Some(reach);
        if !(reach[0]..=reach[1]).contains(&position) {
            return Err(Swing::Far { position, range: reach });
        }
        let (step, passed) = self.steps.step(time);
        if step != self.step {
            (self.step, self.range) = (step, [f64::INFINITY, f64::NEG_INFINITY]);
        }
        if step >= -1.0 && passed > SWUNG {
            let [low, high] = self.range;
            self.range = [low.min(position), high.max(position)];
        }
        let range = self.range[1] - self.range[0];
        if range > self.steps.height { Err(Swing::Long(range)) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { position: [-1.0, 1.0], velocity: 6.0, torque: 5.0, kp: 50.0, kd: 2.0 };
    const STEPS: Steps = Steps {
        centre: 0.2,
        height: 0.05,
        seconds: 0.5,
        repetitions: 2,
        from: Gains { kp: 1.0, kd: 0.1 },
        gains: Gains { kp: 20.0, kd: 0.5 },
    };

    #[test]
    fn steps_go_to_both_sides_and_return() {
        let position = |time| STEPS.command(time).map(|command| command.position);
        assert_eq!(STEPS.duration(), 5.5);
        let found: Vec<_> = (0..12).map(|at| position(0.75 + 0.5 * f64::from(at))).collect();
        let cycle = [Some(0.25), Some(0.2), Some(0.2 - 0.05), Some(0.2)];
        let wanted = [&[Some(0.2), Some(0.2)], &cycle[..], &cycle[..], &[None, None]].concat();
        assert_eq!(found, wanted);
    }

    #[test]
    fn gains_change_without_jump() {
        let mut before = STEPS.command(0.0).unwrap();
        assert_eq!((before.kp, before.kd), (1.0, 0.1));
        for at in 1..1500 {
            let now = STEPS.command(1e-3 * f64::from(at)).unwrap();
            assert!((now.kp - before.kp).abs() < 0.03, "{now:?}");
            before = now;
        }
        assert_eq!((before.kp, before.kd), (20.0, 0.5));
    }

    #[test]
    fn steps_beyond_limits_are_refused_with_numbers() {
        let refused = |steps: Steps, inertia| steps.check(&LIMITS, inertia).unwrap_err().to_string();
        assert_eq!(STEPS.check(&LIMITS, Some(0.02)), Ok(()));
        let narrow = refused(Steps { centre: 0.95, ..STEPS }, None);
        assert!(narrow.contains("0.95 rad") && narrow.contains("--step-rad 0.025"), "{narrow}");
        let strong = refused(Steps { height: 0.2, ..STEPS }, None);
        assert!(strong.contains("4.00 N·m") && strong.contains("--step-rad 0.175"), "{strong}");
        let fast = refused(Steps { height: 0.15, ..STEPS }, Some(0.01));
        assert!(fast.contains("6.71 rad/s") && fast.contains("--step-rad 0.094"), "{fast}");
        assert!(STEPS.check(&Limits { position: [f64::NAN; 2], ..LIMITS }, None).is_err());
    }

    #[test]
    fn joint_beyond_a_whole_overshoot_has_left() {
        let far = |start, position| {
            let mut guard = Guard::new(STEPS, 1.0);
            guard.check(0.0, start).and_then(|()| guard.check(0.1, position)).is_err()
        };
        assert!(!far(0.2, 0.29) && far(0.2, 0.31));
        assert!(!far(0.1, 0.01) && !far(0.1, 0.29), "a joint that hangs");
        assert!(far(0.1, -0.01) && far(0.1, 0.31), "a joint that hangs");
        assert!(far(0.2, f64::NAN));
    }

    /// A weight has 0.3 N·m of 1 N·m, and the gains before have 1 N·m/rad: 0.3 rad, and two steps.
    #[test]
    fn joint_begins_where_its_weight_explains() {
        let begun = |start| Guard::new(STEPS, 1.0).check(0.0, start);
        assert_eq!((begun(-0.19), begun(0.59)), (Ok(()), Ok(())));
        assert!(matches!(begun(-0.21), Err(Swing::Displaced { .. })), "{:?}", begun(-0.21));
        assert!(begun(0.61).is_err() && begun(f64::NAN).is_err());
    }

    #[test]
    fn joint_that_swings_on_is_found() {
        let swings = |decay: f64| {
            let mut guard = Guard::new(STEPS, 1.0);
            let mut times = (0..5500).map(|at| 1e-3 * f64::from(at));
            times.find_map(|time| {
                let target = STEPS.command(time).unwrap().position;
                let (_, passed) = STEPS.step(time);
                let deviation = 0.05 * (-decay * passed).exp() * (90.0 * time).cos();
                guard.check(time, target + deviation).err()
            })
        };
        assert_eq!(swings(3.0), None);
        assert!(matches!(swings(0.2), Some(Swing::Long(_))), "{:?}", swings(0.2));
    }
}
