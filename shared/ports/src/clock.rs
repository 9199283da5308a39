//! The clock of every time stamp that crosses the process boundary.

use nix::time::{ClockId, clock_gettime};

/// Returns the current `CLOCK_MONOTONIC`, ns. Never allocates or blocks.
#[must_use]
pub fn now_ns() -> u64 {
    read(ClockId::CLOCK_MONOTONIC).expect("every Linux kernel has CLOCK_MONOTONIC")
}

/// Largest difference between a time and a clock that it fits, ns.
const FIT_NS: u64 = 1_000_000_000;

/// Returns the name of another clock, or of another unit of `CLOCK_MONOTONIC`, that `time_ns` fits
/// within 1 s. Never allocates or blocks; at most 4 system calls.
#[must_use]
pub fn other_clock(time_ns: u64) -> Option<&'static str> {
    let fits = |time_ns: u64, clock| read(clock).is_some_and(|now| now.abs_diff(time_ns) <= FIT_NS);
    let clocks = [
        (ClockId::CLOCK_REALTIME, "CLOCK_REALTIME (time.time())"),
        (ClockId::CLOCK_TAI, "CLOCK_TAI"),
        (ClockId::CLOCK_BOOTTIME, "CLOCK_BOOTTIME"),
    ];
    let units = [(1_000, "µs of CLOCK_MONOTONIC"), (1_000_000, "ms of CLOCK_MONOTONIC")];
    let of_clock = clocks.into_iter().find(|(clock, _)| fits(time_ns, *clock));
    let of_unit = || {
        let in_ns = |factor: u64| time_ns.saturating_mul(factor);
        units.into_iter().find(|(factor, _)| fits(in_ns(*factor), ClockId::CLOCK_MONOTONIC))
    };
    of_clock.map(|(_, name)| name).or_else(|| of_unit().map(|(_, name)| name))
}

fn read(clock: ClockId) -> Option<u64> {
    let now = clock_gettime(clock).ok()?;
    Some(now.tv_sec().unsigned_abs() * 1_000_000_000 + now.tv_nsec().unsigned_abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_of_another_clock_is_named() {
        let realtime = read(ClockId::CLOCK_REALTIME).unwrap();
        assert_eq!(other_clock(realtime), Some("CLOCK_REALTIME (time.time())"));
        assert_eq!(other_clock(now_ns() / 1_000), Some("µs of CLOCK_MONOTONIC"));
        assert_eq!(other_clock(u64::MAX), None);
        assert_eq!(other_clock(realtime / 2), None);
    }
}
