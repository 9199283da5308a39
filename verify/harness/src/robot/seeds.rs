//! Runs of many seeds on all processors.

use std::panic::RefUnwindSafe;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Reads a number from the environment, such as `MOTORD_SEEDS`.
pub fn number(variable: &str) -> Option<u64> {
    std::env::var(variable).ok().and_then(|text| text.parse().ok())
}

/// Runs `count` seeds of the test program `test` on all processors, or `MOTORD_SEEDS` many, or the
/// one in `MOTORD_SEED`. Prints their duration, or the command that repeats a failed seed.
pub fn for_each_seed(test: &str, count: u64, run: impl Fn(u64) + Sync + RefUnwindSafe) {
    let begun = motord_bus::clock::monotonic();
    let seeds = match number("MOTORD_SEED") {
        Some(seed) => seed..seed + 1,
        None => 0..number("MOTORD_SEEDS").unwrap_or(count),
    };
    let (next, failed) = (AtomicU64::new(seeds.start), AtomicU64::new(u64::MAX));
    let work = || {
        while failed.load(Relaxed) == u64::MAX {
            let seed = next.fetch_add(1, Relaxed);
            if seed >= seeds.end {
                return;
            }
            if std::panic::catch_unwind(|| run(seed)).is_err() {
                failed.fetch_min(seed, Relaxed);
            }
        }
    };
    std::thread::scope(|scope| {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        (0..threads).for_each(|_| drop(scope.spawn(work)));
    });
    let seconds = number("MOTORD_ROBOT_SECONDS").map(|seconds| format!("MOTORD_ROBOT_SECONDS={seconds} "));
    let (failed, seconds) = (failed.into_inner(), seconds.unwrap_or_default());
    assert!(
        failed == u64::MAX,
        "run it alone with: MOTORD_SEED={failed} {seconds}cargo test -p motord-core --test {test}"
    );
    let elapsed = motord_bus::clock::monotonic().since(begun);
    println!("{test}: seeds {seeds:?} took {elapsed:.1?}");
}
