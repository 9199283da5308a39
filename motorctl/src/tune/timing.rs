//! The delay of the loop of stiffness and damping.

use motord_client::{Joint, JointDescription};
use serde::Serialize;

/// Delay of the loop in a drive, s: a control period, and the velocity that it computes from
/// positions. Assumed: no vendor states it.
const DRIVE: f64 = 0.25e-3;
/// Share of the replies that are not later than the latency that counts.
const SHARE: f64 = 0.9;

/// Where stiffness and damping become a torque.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Site {
    /// In the drive (MIT).
    Drive,
    /// In the daemon's cycle (native protocol).
    Cycle,
}

impl Site {
    /// The site of the loop of `joint`.
    pub(crate) fn of(joint: &JointDescription) -> Self {
        if joint.protocol == "mit" { Self::Drive } else { Self::Cycle }
    }

    /// The distance of two codes of the velocity that the damping uses, of the reported one: a drive
    /// damps with its own velocity, which it does not report.
    pub(crate) fn damped(self, velocity_code: f64) -> f64 {
        match self {
            Self::Drive => 0.0,
            Self::Cycle => velocity_code,
        }
    }

    /// The change of the damping that calms a joint: one that is late does not damp.
    pub(crate) fn calmer(self) -> &'static str {
        match self {
            Self::Drive => "a larger --kd",
            Self::Cycle => "a smaller --kd",
        }
    }
}

/// Times of the replies of one motor.
#[derive(Debug, Clone, Default)]
pub(crate) struct Timing {
    /// Receipt of the newest state, ns.
    last: Option<u64>,
    turns: Vec<f64>,
    latencies: Vec<f64>,
}

impl Timing {
    /// Records the state of `joint`. Returns false for one that was recorded before.
    pub(crate) fn record(&mut self, joint: &Joint) -> bool {
        let is_new = joint.receive_ns > 0 && self.last != Some(joint.receive_ns);
        if is_new {
            self.add(joint.receive_ns, joint.reply_latency.as_secs_f64());
        }
        is_new
    }

    /// Adds a state that arrived at this time, ns, with this latency, s.
    fn add(&mut self, time_ns: u64, latency: f64) {
        if let Some(last) = self.last.replace(time_ns) {
            self.turns.push(time_ns.saturating_sub(last) as f64 / 1e9);
        }
        self.latencies.push(latency);
    }

    /// Returns the time from one command of the motor to the next, s; `None` without replies.
    pub(crate) fn turn(&self) -> Option<f64> {
        quantile(&self.turns, 0.5).filter(|turn| *turn > 0.0)
    }

    /// Returns the delay of a loop at `site`, s.
    ///
    /// In the cycle, a command uses the state of a previous turn, and its torque lasts for one turn.
    pub(crate) fn delay(&self, site: Site) -> Option<f64> {
        let (turn, latency) = (self.turn()?, quantile(&self.latencies, SHARE)?);
        match site {
            Site::Drive => Some(DRIVE),
            Site::Cycle => Some(((latency / turn).ceil().max(1.0) + 0.5) * turn),
        }
    }
}

fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values.get((share * values.len() as f64) as usize).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timing(turn_us: u64, latency: f64) -> Timing {
        let mut timing = Timing::default();
        (0..100).for_each(|at| timing.add(at * turn_us * 1000, latency));
        timing
    }

    #[test]
    fn reported_codes_are_noise_in_the_cycle_only() {
        assert_eq!([Site::Drive, Site::Cycle].map(|site| site.damped(0.1)), [0.0, 0.1]);
    }

    #[test]
    fn loop_over_bus_waits_for_cycles() {
        let delay = |turn_us, latency| timing(turn_us, latency).delay(Site::Cycle).unwrap();
        let [prompt, slow] = [delay(1000, 0.3e-3), delay(1000, 2.3e-3)];
        assert!((prompt - 1.5e-3).abs() < 1e-9 && (slow - 3.5e-3).abs() < 1e-9, "{prompt} {slow}");
        assert_eq!(timing(1000, 2.3e-3).delay(Site::Drive), Some(DRIVE));
        assert_eq!(Timing::default().delay(Site::Cycle), None);
    }
}
