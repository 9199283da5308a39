//! Distribution of the times from each death to the first damping frame.

use std::collections::BTreeMap;

/// Limits of the times of each death.
#[derive(Debug, Clone)]
pub struct Limits {
    /// Highest median, ms, by death, or by the word before the first dash that several deaths
    /// share.
    pub medians: BTreeMap<String, f64>,
    /// Ratio of the highest maximum to the limit of the median.
    pub maximum_per_median: f64,
}

impl Limits {
    /// Returns the limit of `death`: its own, or that of the word before the first dash.
    fn of(&self, death: &str) -> Option<f64> {
        let family = death.split('-').next().unwrap_or(death);
        self.medians.get(death).or_else(|| self.medians.get(family)).copied()
    }
}

/// The times of one death, in milliseconds.
#[derive(Debug, Clone, PartialEq)]
pub struct Distribution(Vec<f64>);

impl Distribution {
    /// Returns the times, or `None` when there are none.
    #[must_use]
    pub fn of(mut times: Vec<f64>) -> Option<Self> {
        times.sort_by(f64::total_cmp);
        (!times.is_empty()).then_some(Self(times))
    }

    /// Returns the smallest time.
    #[must_use]
    pub fn minimum(&self) -> f64 {
        self.0[0]
    }

    /// Returns the median; the upper of two.
    #[must_use]
    pub fn median(&self) -> f64 {
        self.0[self.0.len() / 2]
    }

    /// Returns the time that nine of ten do not exceed.
    #[must_use]
    pub fn ninety_percent(&self) -> f64 {
        self.0[(9 * self.0.len()).div_ceil(10) - 1]
    }

    /// Returns the largest time.
    #[must_use]
    pub fn maximum(&self) -> f64 {
        self.0[self.0.len() - 1]
    }
}

/// Returns a line for display, and `true` when the times are within the limits.
#[must_use]
pub fn check(death: &str, times: Vec<f64>, limits: &Limits) -> (String, bool) {
    let count = times.len();
    let (Some(times), Some(limit)) = (Distribution::of(times), limits.of(death)) else {
        return (format!("{death}: no times, or no limit for them"), false);
    };
    let most = limits.maximum_per_median * limit;
    let median_late = if times.median() > limit { ": MEDIAN TOO LATE" } else { "" };
    let maximum_late = if times.maximum() > most { ": MAX TOO LATE" } else { "" };
    let line = format!(
        "{death:<16} {count:4} times: min {:6.2}, median {:6.2}, p90 {:6.2}, max {:6.2} ms; \
         limits {limit} and {most} ms{median_late}{maximum_late}",
        times.minimum(),
        times.median(),
        times.ninety_percent(),
        times.maximum(),
    );
    (line, median_late.is_empty() && maximum_late.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distribution_of_ten_times_matches_hand_calculation() {
        let times = Distribution::of([10, 9, 8, 7, 6, 5, 4, 3, 2, 1].map(f64::from).to_vec()).unwrap();
        assert_eq!(
            [times.minimum(), times.median(), times.ninety_percent(), times.maximum()],
            [1.0, 6.0, 9.0, 10.0]
        );
    }

    #[test]
    fn a_death_without_a_limit_is_refused() {
        let limits = Limits { medians: [("panic".to_string(), 5.0)].into(), maximum_per_median: 4.0 };
        assert!(check("panic-main", vec![5.0], &limits).1);
        assert!(!check("panic-main", vec![5.1], &limits).1);
        assert!(!check("freeze", vec![1.0], &limits).1);
        assert!(!check("panic-main", Vec::new(), &limits).1);
    }
}
