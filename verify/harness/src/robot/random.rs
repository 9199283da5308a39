//! Random numbers that depend on the seed only (SplitMix64, Steele, Lea and Flood 2014), and runs of
//! many seeds.

use std::panic::RefUnwindSafe;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

#[derive(Debug, Clone)]
/// A generator of random numbers.
pub struct Random(u64);

impl Random {
    /// Starts a sequence.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03)
    }

    /// Returns a number of 64 bits.
    pub fn draw(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// Returns 0 to `end` - 1.
    pub fn below(&mut self, end: usize) -> usize {
        (self.draw() % end as u64) as usize
    }

    /// Returns true once in `times` calls on average.
    pub fn once_in(&mut self, times: usize) -> bool {
        self.below(times) == 0
    }

    /// Returns a number between `low` and `high`.
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * (self.draw() >> 40) as f32 / (1_u32 << 24) as f32
    }

    /// Returns one of `choices`.
    pub fn pick<'a, T>(&mut self, choices: &'a [T]) -> &'a T {
        &choices[self.below(choices.len())]
    }
}

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
