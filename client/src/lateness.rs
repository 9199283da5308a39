//! Why a group does not follow setpoints, and how late its owner was.

use crate::state::Group;
use motord_shared::Cause;
use std::fmt;
use std::time::Duration;

/// How late the owner of a group was, by the clock of its own process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lateness {
    /// Time without a message.
    pub gap: Duration,
    /// Horizon of the message before it.
    pub horizon: Duration,
    /// The setpoint timeout, which begins at the end of the horizon.
    pub timeout: Duration,
}

impl fmt::Display for Lateness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [gap, horizon, timeout] =
            [self.gap, self.horizon, self.timeout].map(|time| time.as_nanos() as f64 / 1e6);
        write!(f, "this program sent none for {gap:.1} ms, and setpoint-timeout-ms is {timeout}")?;
        if self.horizon.is_zero() { Ok(()) } else { write!(f, " after a horizon of {horizon} ms") }
    }
}

/// The reason why a group does not follow setpoints.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Stop {
    /// No cause is latched: the group was not enabled since its last stop.
    Disabled,
    /// The group is enabled, and still starting.
    Starting,
    /// The group was stopped, and the cause is latched until a reset.
    Cause {
        /// The cause.
        cause: Cause,
        /// The joint that caused the stop, if any.
        joint: Option<String>,
        /// Id of the process that requested the stop, if any.
        pid: Option<u32>,
        /// How late the caller was, if the cause is `setpoint-timeout` and the stop ended its
        /// claim.
        lateness: Option<Lateness>,
    },
    /// The group was stopped for a cause that this client does not know.
    Unknown,
}

impl Stop {
    /// Returns the latched stop of `group`. `joint` is the name of the joint that caused it.
    pub(crate) fn of(group: &Group, joint: Option<String>) -> Self {
        let pid = group.cause_pid;
        group.cause.map_or(Self::Unknown, |cause| Self::Cause { cause, joint, pid, lateness: None })
    }
}

/// Advice for the owner of a group that was late.
const CURE: &str = "A slow loop sends with a horizon, or needs a longer setpoint-timeout-ms in [safety]. Reset the group, then \
                    claim and enable it again";

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Disabled => write!(f, "does not follow setpoints: enable it"),
            Self::Starting => write!(f, "does not follow setpoints yet: it is starting"),
            Self::Cause { cause, lateness: Some(late), .. } => {
                let (sentence, advice) = (cause.sentence().trim_end_matches('.'), cause.advice());
                write!(f, "was stopped: {sentence}: {late}. {advice}. {CURE}")
            }
            Self::Cause { cause, joint, pid, lateness: None } => {
                let at = match (joint, pid) {
                    (Some(joint), _) => format!(" (joint {joint})"),
                    (None, Some(pid)) => format!(" (process {pid})"),
                    (None, None) => String::new(),
                };
                let sentence = cause.sentence().trim_end_matches('.');
                write!(f, "was stopped: {sentence}{at}. {}, then reset the group", cause.advice())
            }
            Self::Unknown => {
                write!(f, "was stopped for a cause that this program does not know: see `motorctl status`")
            }
        }
    }
}

/// The times of the last two messages, ns of `CLOCK_MONOTONIC`.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sent {
    /// Time of the last message; 0 before the first.
    at_ns: u64,
    horizon_ns: u32,
    /// Time between the last two messages, and the horizon of the earlier one.
    gap_ns: u64,
    gap_horizon_ns: u32,
}

impl Sent {
    /// Records a message.
    pub(crate) fn record(&mut self, at_ns: u64, horizon_ns: u32) {
        if self.at_ns > 0 {
            (self.gap_ns, self.gap_horizon_ns) = (at_ns.saturating_sub(self.at_ns), self.horizon_ns);
        }
        (self.at_ns, self.horizon_ns) = (at_ns, horizon_ns);
    }

    /// Returns how long from `now_ns` on the daemon follows the last message.
    pub(crate) fn lasts(&self, now_ns: u64, timeout: Duration) -> Duration {
        let end_ns = self.at_ns.saturating_add(self.horizon_ns.into());
        (Duration::from_nanos(end_ns) + timeout).saturating_sub(Duration::from_nanos(now_ns))
    }

    /// Returns the lateness at `now_ns`: of a message that is missing, or of the last one. `None`
    /// when neither is late.
    pub(crate) fn lateness(&self, now_ns: u64, timeout: Duration) -> Option<Lateness> {
        let open = (now_ns.saturating_sub(self.at_ns), self.horizon_ns);
        let of = |(gap_ns, horizon_ns): (u64, u32)| {
            let (gap, horizon) = (Duration::from_nanos(gap_ns), Duration::from_nanos(horizon_ns.into()));
            (gap > horizon + timeout).then_some(Lateness { gap, horizon, timeout })
        };
        of(open).or_else(|| of((self.gap_ns, self.gap_horizon_ns))).filter(|_| self.at_ns > 0)
    }
}

/// A duration in s, ms or µs with two to three digits: `1.2 s`, `490 ms`, `12 ms`, `35 µs`.
pub(crate) struct Rounded(pub(crate) Duration);

impl fmt::Display for Rounded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = self.0.as_secs_f64();
        let (value, unit) = match seconds {
            0.9995.. => (seconds, "s"),
            0.000_999_5.. => (1e3 * seconds, "ms"),
            _ => (1e6 * seconds, "µs"),
        };
        let is_whole = (value - value.round()).abs() <= 0.005 * value;
        if value < 9.95 && !is_whole {
            write!(f, "{value:.1} {unit}")
        } else {
            write!(f, "{value:.0} {unit}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const TIMEOUT: Duration = Duration::from_millis(20);

    fn gap(sent: &Sent, now_ms: u64) -> Option<u128> {
        sent.lateness(now_ms * MS, TIMEOUT).map(|late| late.gap.as_millis())
    }

    #[test]
    fn gap_is_measured_before_and_after_next_message() {
        let mut sent = Sent::default();
        assert_eq!(gap(&sent, 5000), None, "nothing was sent");
        sent.record(100 * MS, 0);
        assert_eq!((gap(&sent, 120), gap(&sent, 135)), (None, Some(35)));
        sent.record(135 * MS, 0);
        assert_eq!(gap(&sent, 136), Some(35), "the message that came too late");
        sent.record(137 * MS, 0);
        assert_eq!(gap(&sent, 138), None);
    }

    #[test]
    fn timeout_counts_from_end_of_horizon() {
        let mut sent = Sent::default();
        sent.record(100 * MS, 25 * MS as u32);
        assert_eq!((gap(&sent, 145), gap(&sent, 146)), (None, Some(46)));
        assert_eq!(sent.lasts(110 * MS, TIMEOUT), Duration::from_millis(35));
        let late = sent.lateness(146 * MS, TIMEOUT).unwrap();
        assert_eq!(
            late.to_string(),
            "this program sent none for 46.0 ms, and setpoint-timeout-ms is 20 after a horizon of 25 ms"
        );
    }

    #[test]
    fn durations_have_two_to_three_digits() {
        let cases = [
            (489_846_528, "490 ms"),
            (1_000_000_000, "1 s"),
            (1_250_000_000, "1.2 s"),
            (999_700_000, "1 s"),
            (20_000_000, "20 ms"),
            (2_500_000, "2.5 ms"),
            (35_400, "35 µs"),
            (0, "0 µs"),
            (75_000_000_000, "75 s"),
        ];
        for (nanoseconds, text) in cases {
            assert_eq!(Rounded(Duration::from_nanos(nanoseconds)).to_string(), text);
        }
    }
}
