//! Losses of a recording: ticks, replies, and time of a simulated plant.

use crate::identify::failure::IdentifyFailure;
use motord_client::{Joint, State};
use serde::Serialize;

/// Largest share of the ticks, of the replies, or of the time that may be lost.
const SHARE_MAX: f64 = 0.1;

/// Counts of the motion, from the first state to the last.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(crate) struct Losses {
    /// Ticks.
    pub(crate) ticks: u64,
    /// Ticks without a cycle.
    pub(crate) missed_ticks: u64,
    /// Replies of the joint's motor.
    pub(crate) replies: u64,
    /// Turns of the motor without a reply.
    pub(crate) missed_replies: u64,
    /// Replies that arrived after the end of their turn.
    pub(crate) late_replies: u64,
    /// Time that the plant of a simulated robot lost, s.
    pub(crate) plant_lost_s: f64,
}

impl Losses {
    /// # Errors
    ///
    /// A share of the motion is lost that no interval accounts for.
    pub(crate) fn check(&self, joint: &str, seconds: f64) -> Result<(), IdentifyFailure> {
        let failure = |reason| IdentifyFailure::Losses { joint: joint.to_owned(), reason };
        self.excess(seconds).map_or(Ok(()), |reason| Err(failure(reason)))
    }

    /// Returns what is lost of a motion of `seconds`, and the cure, if it is too much.
    pub(crate) fn excess(&self, seconds: f64) -> Option<String> {
        const BUS: &str = "check the bus: `motorctl status` counts its errors";
        const LOAD: &str = "reduce the other load of the computer: `motorctl doctor` checks it";
        let share = |lost: f64, all: f64| if all > 0.0 { lost / all } else { 0.0 };
        let turns = (self.replies + self.missed_replies) as f64;
        let losses = [
            (share(self.missed_ticks as f64, self.ticks as f64), "the ticks were missed", LOAD),
            (share(self.missed_replies as f64, turns), "the replies were late or missing", BUS),
            (share(self.plant_lost_s, seconds), "the time was lost by the plant", LOAD),
        ];
        let worst = losses.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        let (share, lost, cure) = worst.filter(|(share, ..)| *share > SHARE_MAX)?;
        let (percent, most) = (100.0 * share, 100.0 * SHARE_MAX);
        Some(format!("{percent:.0} % of {lost}, and {most:.0} % are the most that a fit bears; {cure}"))
    }
}

/// Counts while states arrive.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Counter {
    first: Option<Counts>,
    last: Counts,
    replies: u64,
}

/// Counters of the daemon at a state; those of the joint modulo 2³².
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    cycle: u64,
    overruns: u64,
    missed: u32,
    late: u32,
}

impl Counter {
    /// Takes in a state.
    pub(crate) fn record(&mut self, state: &State, joint: &Joint) {
        let (cycle, overruns) = (state.cycle(), state.overruns());
        self.count(Counts { cycle, overruns, missed: joint.missed, late: joint.late }, joint.fresh);
    }

    fn count(&mut self, counts: Counts, is_fresh: bool) {
        self.first.get_or_insert(counts);
        self.last = counts;
        self.replies += u64::from(is_fresh);
    }

    /// Returns the losses so far. `plant_lost` is the time that a plant lost meanwhile, s.
    pub(crate) fn losses(&self, plant_lost: f64) -> Losses {
        let (first, last) = (self.first.unwrap_or_default(), self.last);
        Losses {
            ticks: last.cycle.saturating_sub(first.cycle),
            missed_ticks: last.overruns.saturating_sub(first.overruns),
            replies: self.replies,
            missed_replies: last.missed.wrapping_sub(first.missed).into(),
            late_replies: last.late.wrapping_sub(first.late).into(),
            plant_lost_s: plant_lost,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_above_a_tenth_are_refused() {
        let few =
            Losses { ticks: 1000, missed_ticks: 90, replies: 950, missed_replies: 50, ..Losses::default() };
        assert!(few.check("knee", 10.0).is_ok());
        for (lossy, named) in [
            (Losses { missed_ticks: 120, ..few }, "12 % of the ticks were missed"),
            (Losses { missed_replies: 300, ..few }, "24 % of the replies were late or missing"),
            (Losses { plant_lost_s: 7.6, ..few }, "76 % of the time was lost by the plant"),
        ] {
            let refused = lossy.check("knee", 10.0).unwrap_err().to_string();
            assert!(refused.contains("knee") && refused.contains(named), "{refused}");
        }
    }

    #[test]
    fn counters_that_wrap_are_differences() {
        let mut counter = Counter::default();
        counter.count(Counts { cycle: 10, overruns: 3, missed: u32::MAX, late: 7 }, true);
        counter.count(Counts { cycle: 30, overruns: 5, missed: 1, late: 8 }, false);
        let losses = counter.losses(0.5);
        let wanted = Losses {
            ticks: 20,
            missed_ticks: 2,
            replies: 1,
            missed_replies: 2,
            late_replies: 1,
            plant_lost_s: 0.5,
        };
        assert_eq!(losses, wanted);
    }
}
