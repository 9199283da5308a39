//! Stamps: the wall clock of a time on the daemon's clock.

use crate::clock::wall_ns;
use crate::ros2::messages::{Header, Time};
use std::time::Duration;

/// Returns a header whose stamp is `age` ago.
pub(crate) fn header(age: Duration, frame_id: &str) -> Header {
    let age_ns = u64::try_from(age.as_nanos()).unwrap_or(u64::MAX);
    Header { stamp: Time::of_ns(wall_ns().saturating_sub(age_ns)), frame_id: frame_id.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamp_is_that_of_the_state() {
        let before = wall_ns();
        let stamp = header(Duration::from_secs(5), "").stamp;
        let after = wall_ns();
        let stamp_ns = stamp.sec as u64 * 1_000_000_000 + u64::from(stamp.nanosec);
        assert!((before..=after).contains(&(stamp_ns + 5_000_000_000)));
    }
}
