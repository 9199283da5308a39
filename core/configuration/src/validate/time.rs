//! Durations of keys in milliseconds and microseconds.

use motord_bus::Duration;

/// Returns a duration of `value` ms.
pub(super) fn millis(value: f64) -> Duration {
    Duration::from_secs_f64(value * 1e-3)
}

/// Returns a duration of `value` µs.
pub(super) fn micros(value: f64) -> Duration {
    Duration::from_secs_f64(value * 1e-6)
}
