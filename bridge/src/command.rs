//! A command that counts.

use crate::setpoints::Setpoints;
use crate::trajectory::Trajectory;
use std::time::{Duration, Instant};

/// The motion that a command requests of the group.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Target {
    Setpoints(Setpoints),
    Trajectory(Trajectory),
}

/// A command that counts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Command {
    /// The number of the claim under which it counts.
    pub(crate) claim: u64,
    pub(crate) arrived: Instant,
    pub(crate) target: Target,
}

impl Command {
    /// Returns the time after its arrival at which the command is fulfilled.
    pub(crate) fn duration(&self) -> Duration {
        match &self.target {
            Target::Setpoints(setpoints) => setpoints.horizon,
            Target::Trajectory(trajectory) => trajectory.duration(),
        }
    }

    /// Returns `true` until `timeout` after the command is fulfilled.
    pub(crate) fn is_in_force(&self, now: Instant, timeout: Duration) -> bool {
        now.saturating_duration_since(self.arrived) <= self.duration() + timeout
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_ends_after_horizon_and_timeout() {
        let (arrived, horizon) = (Instant::now(), Duration::from_millis(50));
        let target = Target::Setpoints(Setpoints { joints: Vec::new(), horizon });
        let command = Command { claim: 1, arrived, target };
        let is_in_force =
            |ms| command.is_in_force(arrived + Duration::from_millis(ms), Duration::from_millis(100));
        assert_eq!([0, 150, 151].map(is_in_force), [true, true, false]);
    }
}
