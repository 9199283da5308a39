//! Durations in messages to people.

use std::fmt;
use std::time::Duration;

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
