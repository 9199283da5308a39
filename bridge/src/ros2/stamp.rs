//! Stamps: the wall clock of a time on the daemon's clock.

use crate::ros2::messages::{Header, Time};
use std::time::{Duration, SystemTime};

/// Returns ns since 1970.
pub(crate) fn wall_ns() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

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
