//! The reasons for which a command does not count, and their counters.

use std::sync::atomic::{AtomicU64, Ordering};

macro_rules! refusals {
    ($($variant:ident $name:literal $sentence:literal)+) => {
        /// The reason for which a command does not count.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(crate) enum Refusal {
            $(#[doc = $sentence] $variant,)+
        }

        impl Refusal {
            /// All reasons.
            pub(crate) const ALL: &'static [Self] = &[$(Self::$variant,)+];

            /// Returns the name of the counter in `/diagnostics`.
            pub(crate) const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)+ }
            }

            /// Returns the mistake and its remedy.
            pub(crate) const fn sentence(self) -> &'static str {
                match self { $(Self::$variant => $sentence,)+ }
            }
        }
    };
}

refusals! {
    NoClaim "no-claim" "The bridge does not hold the group: call its service `claim` first."
    ForeignWriter "foreign-writer" "Another writer commands the group: call `release`, then `claim`, to change it."
    Reordered "reordered" "A later command of its writer has arrived before it."
    Undecodable "undecodable" "The message does not have the layout of its type, or one of its lists is too long."
    MissingJoint "missing-joint" "A joint of the group is not named: name each one."
    UnknownJoint "unknown-joint" "A name is that of no joint of the group."
    RepeatedJoint "repeated-joint" "A joint is named twice."
    PositionLength "position-length" "`position` has not one number per joint."
    VelocityLength "velocity-length" "`velocity` has not one number per joint; it may be empty."
    EffortLength "effort-length" "`effort` has not one number per joint; it may be empty."
    KpLength "kp-length" "`kp` has not one number per joint."
    KdLength "kd-length" "`kd` has not one number per joint."
    NotANumber "not-a-number" "A number is NaN."
    Infinite "infinite" "A number is infinite, or too large for a 32-bit float."
    NegativeGain "negative-gain" "A stiffness or damping is negative."
    NoGains "no-gains" "This form has no gains: set [group.NAME] kp and kd in the configuration of the bridge."
    Old "old" "The stamp is older than `max-age-ms`: compare the clocks of both computers."
    Future "future" "The stamp is further ahead than `max-ahead-ms`: compare the clocks of both computers."
    ZeroStamp "zero-stamp" "The stamp is zero: set it, or set `allow-zero-stamp` in the configuration of the bridge."
    InvalidStamp "invalid-stamp" "The stamp is negative, or its nanoseconds are no part of a second."
    Horizon "horizon" "The horizon is negative, or longer than `setpoint-horizon-max-ms` of motord."
    NoPoints "no-points" "The trajectory has no points."
    Times "times" "The times of the points do not rise, or the last is beyond `trajectory-max-s`."
    Jump "jump" "A point is further away than the joint may move in the time to it."
    PositionUnknown "position-unknown" "A joint has not reported its position, where a trajectory begins."
}

/// Counts of the commands of a group.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    /// Commands that counted.
    pub(crate) accepted: AtomicU64,
    /// Commands that counted, with a position outside the limits of a joint, which motord clamps.
    pub(crate) clamped: AtomicU64,
    /// Times that the bridge disabled the group because its writer sent nothing.
    pub(crate) timeouts: AtomicU64,
    refused: [AtomicU64; Refusal::ALL.len()],
}

impl Counters {
    /// Counts a command that does not count.
    pub(crate) fn refuse(&self, refusal: Refusal) {
        self.refused[refusal as usize].fetch_add(1, Ordering::Relaxed);
    }

    /// Returns how many commands were refused for this reason.
    pub(crate) fn refused(&self, refusal: Refusal) -> u64 {
        self.refused[refusal as usize].load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_refusal_has_its_name_and_counter() {
        let counters = Counters::default();
        for (count, refusal) in Refusal::ALL.iter().enumerate() {
            (0..=count).for_each(|_| counters.refuse(*refusal));
        }
        let mut names: Vec<_> = Refusal::ALL.iter().map(|refusal| refusal.name()).collect();
        assert!(
            Refusal::ALL
                .iter()
                .enumerate()
                .all(|(count, refusal)| counters.refused(*refusal) == count as u64 + 1)
        );
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Refusal::ALL.len());
    }
}
