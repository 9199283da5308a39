//! A value with its 95 % interval, or the reason why the data do not give one.

use core::fmt;

/// Number of standard errors of a 95 % interval.
pub(crate) const TWO_SIDED: f64 = 1.96;
/// Widest half of an interval, as a share of the value.
const WIDEST: f64 = 0.5;

/// The reason for which a value is not identifiable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Why {
    /// The joint moved too little, or never for long enough in one direction.
    Motion,
    /// The motion does not separate this value from others.
    Separation,
    /// The interval contains zero.
    Zero,
    /// Half of the interval is more than half of the value.
    Wide,
    /// The joint never rested before it moved.
    Rest,
    /// The stamps leave more open than 50 µs.
    Stamps,
    /// The equation is not that of the joint.
    Misfit,
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Motion => "the joint moved too little",
            Self::Separation => "this motion does not separate it from the other values",
            Self::Zero => "its interval contains 0",
            Self::Wide => "its interval is wider than the value",
            Self::Rest => "the joint seldom rested before it moved",
            Self::Misfit => "the joint does not fit the equation",
            Self::Stamps => "other frames of the bus, or a serial line, hide it",
        })
    }
}

/// An identified value. Without `why` the truth is between `lower` and `upper` with a probability
/// of 95 %.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Value {
    /// The estimate; NaN without data.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub lower: f64,
    /// Upper end of the 95 % interval.
    pub upper: f64,
    /// The reason for which the value must not be used.
    pub why: Option<Why>,
}

impl Value {
    /// No value.
    pub(crate) const fn none(why: Why) -> Self {
        Self { value: f64::NAN, lower: f64::NAN, upper: f64::NAN, why: Some(why) }
    }

    /// An estimate with half of its interval. It is not identifiable if the interval contains 0 or
    /// is wide.
    pub(crate) fn around(value: f64, half: f64) -> Self {
        Self::within(value, value - half, value + half)
    }

    /// As [`around`](Self::around), with both ends.
    pub(crate) fn within(value: f64, lower: f64, upper: f64) -> Self {
        let why = if !value.is_finite() || !lower.is_finite() || !upper.is_finite() {
            Some(Why::Separation)
        } else if lower <= 0.0 && upper >= 0.0 {
            Some(Why::Zero)
        } else if (upper - lower) / 2.0 > WIDEST * value.abs() {
            Some(Why::Wide)
        } else {
            None
        };
        Self { value, lower, upper, why }
    }

    /// Returns the value if it is identifiable.
    #[must_use]
    pub fn identified(&self) -> Option<f64> {
        self.why.is_none().then_some(self.value)
    }

    /// Half of the width of the interval.
    #[must_use]
    pub fn half(&self) -> f64 {
        (self.upper - self.lower) / 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_interval_or_zero_is_no_value() {
        assert_eq!(Value::around(1.0, 0.1).identified(), Some(1.0));
        assert_eq!(Value::around(-1.0, 0.1).identified(), Some(-1.0));
        assert_eq!(Value::around(1.0, 0.6).why, Some(Why::Wide));
        assert_eq!(Value::around(0.05, 0.1).why, Some(Why::Zero));
        assert_eq!(Value::around(f64::NAN, 0.1).why, Some(Why::Separation));
    }
}
