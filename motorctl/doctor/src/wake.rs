//! The wake-up latency of an idle thread with the scheduling of the cycle.

use crate::finding::Level;
use crate::robot::Robot;
use hdrhistogram::Histogram;
use motord_bus::clock::{monotonic, sleep_until};
use motord_bus::{Duration, Instant};
use motord_realtime::{
    SchedulingRequest, Step, forbid_deep_sleep, lock_memory, prepare_thread, tighten_timers,
};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{Builder, JoinHandle};

/// Largest recorded latency, ns: a minute.
const LATENCY_MAX_NS: u64 = 60_000_000_000;
/// Significant digits of the histogram.
const DIGITS: u8 = 3;

/// Limits of the latency of 99.9 % of the ticks and of every tick, as shares of the period.
///
/// 5 %: the velocity error of a controller that divides by the nominal period. 20 %: a reply may
/// arrive until 80 % of the period after the command (`reply-deadline-percent`), so a later cycle
/// may reach its next tick. 50 %: on a bus that is 75 % full, the last replies arrive after the
/// next tick, which is missed.
pub(crate) const GOOD: Shares = Shares { p99_9: 0.05, max: 0.2 };
pub(crate) const WARN: Shares = Shares { p99_9: 0.2, max: 0.5 };

/// Shares of the period.
pub(crate) struct Shares {
    p99_9: f64,
    max: f64,
}

impl Shares {
    fn allow(&self, p99_9: f64, max: f64) -> bool {
        p99_9 <= self.p99_9 && max <= self.max
    }
}

/// Checks the latencies of 99.9 % of the ticks and of every tick, as shares of the period.
#[must_use]
pub(crate) fn grade(p99_9: f64, max: f64) -> Level {
    match (GOOD.allow(p99_9, max), WARN.allow(p99_9, max)) {
        (true, _) => Level::Good,
        (false, true) => Level::Warn,
        (false, false) => Level::Bad,
    }
}

/// A running measurement.
pub struct Measurement {
    shared: Arc<Shared>,
    thread: JoinHandle<Wake>,
}

#[derive(Default)]
struct Shared {
    ends: AtomicBool,
    max_ns: AtomicU64,
}

/// A finished measurement.
#[derive(Debug)]
pub struct Wake {
    /// The requested scheduling.
    pub request: SchedulingRequest,
    /// The steps of the set-up with their outcomes.
    pub steps: Vec<Step>,
    /// Time between two ticks.
    pub period: Duration,
    /// Ticks that passed without a wake-up.
    pub missed: u64,
    /// Latencies, ns. A wake-up that is late by more than a period also counts for each missed
    /// tick.
    pub latencies: Histogram<u64>,
}

impl Measurement {
    /// Starts a measurement with the rate, scheduling and locked memory of the cycle of `robot`.
    ///
    /// # Errors
    ///
    /// The thread cannot be started.
    pub fn start(robot: &Robot) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let (given, request) = (Arc::clone(&shared), robot.request);
        let period = Duration::from_secs_f64(1.0 / robot.rate_hz);
        let thread =
            Builder::new().name("motord-doctor".into()).spawn(move || measure(request, period, &given))?;
        Ok(Self { shared, thread })
    }

    /// Returns the longest latency so far, µs.
    #[must_use]
    pub fn max_us(&self) -> f64 {
        self.shared.max_ns.load(Ordering::Relaxed) as f64 / 1e3
    }

    /// Ends the measurement.
    ///
    /// # Errors
    ///
    /// The thread panicked.
    pub fn end(self) -> io::Result<Wake> {
        self.shared.ends.store(true, Ordering::Relaxed);
        self.thread.join().map_err(|_| io::Error::other("the thread of the measurement panicked"))
    }
}

/// Sets the thread up as the daemon's cycle, and sleeps from tick to tick until the end. Does not
/// allocate between two sleeps.
fn measure(request: SchedulingRequest, period: Duration, shared: &Shared) -> Wake {
    let mut latencies =
        Histogram::new_with_bounds(1, LATENCY_MAX_NS, DIGITS).expect("these bounds are valid");
    let (awake, _kept_awake) = forbid_deep_sleep();
    let mut steps = prepare_thread(request);
    steps.extend([tighten_timers(), lock_memory(), awake]);
    let period_ns = period.as_nanos() as u64;
    let (mut missed, mut tick) = (0, monotonic() + period);
    while !shared.ends.load(Ordering::Relaxed) {
        let latency = wake_at(tick);
        shared.max_ns.fetch_max(latency, Ordering::Relaxed);
        // The next tick is on the grid, as in the cycle.
        let passed = latency / period_ns;
        (0..=passed).for_each(|tick| latencies.saturating_record(latency - tick * period_ns));
        missed += passed;
        tick = tick + Duration::from_nanos((passed + 1) * period_ns);
    }
    Wake { request, steps, period, missed, latencies }
}

/// Sleeps until `tick`. Returns the latency, ns.
fn wake_at(tick: Instant) -> u64 {
    loop {
        sleep_until(tick);
        let now = monotonic();
        if now >= tick {
            return now.as_nanos() - tick.as_nanos();
        }
    }
}

impl Wake {
    /// Returns the quantile of the latency at `share`, µs.
    #[must_use]
    pub fn quantile_us(&self, share: f64) -> f64 {
        self.latencies.value_at_quantile(share) as f64 / 1e3
    }

    /// Returns the longest latency, µs.
    #[must_use]
    pub fn max_us(&self) -> f64 {
        self.latencies.max() as f64 / 1e3
    }

    /// Returns the refused steps.
    pub fn refused(&self) -> impl Iterator<Item = &Step> {
        self.steps.iter().filter(|step| step.outcome.is_err())
    }

    /// Returns false without `SCHED_FIFO`, which a daemon may have.
    #[must_use]
    pub fn is_that_of_a_daemon(&self) -> bool {
        self.refused().all(|step| step.what != "SCHED_FIFO")
    }

    /// Returns the level; a warning without the scheduling of a daemon.
    #[must_use]
    pub fn level(&self) -> Level {
        if !self.is_that_of_a_daemon() {
            return Level::Warn;
        }
        let period_us = self.period.as_nanos() as f64 / 1e3;
        grade(self.quantile_us(0.999) / period_us, self.max_us() / period_us)
    }
}

/// Upper edges of the bars, µs.
const EDGES_US: [u64; 14] =
    [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, LATENCY_MAX_NS / 1000];

/// Counts `latencies` (ns) up to each edge (µs) and above the one before, without empty bars at
/// both ends.
#[must_use]
pub(crate) fn bars(latencies: &Histogram<u64>) -> Vec<(u64, u64)> {
    let mut counts = [0; EDGES_US.len()];
    for value in latencies.iter_recorded() {
        let least = latencies.lowest_equivalent(value.value_iterated_to());
        let edge = EDGES_US.iter().position(|edge| least <= edge * 1000);
        counts[edge.unwrap_or(EDGES_US.len() - 1)] += value.count_at_value();
    }
    let has_some = |count: &u64| *count > 0;
    let (Some(first), Some(last)) = (counts.iter().position(has_some), counts.iter().rposition(has_some))
    else {
        return Vec::new();
    };
    EDGES_US.into_iter().zip(counts).skip(first).take(last - first + 1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latency_thresholds_are_good_share_and_bad_share() {
        for (p99_9, max, level) in [
            (0.0, 0.0, Level::Good),
            (0.05, 0.2, Level::Good),
            (0.051, 0.2, Level::Warn),
            (0.05, 0.21, Level::Warn),
            (0.2, 0.5, Level::Warn),
            (0.21, 0.3, Level::Bad),
            (0.01, 0.51, Level::Bad),
            (0.01, 3.0, Level::Bad),
        ] {
            assert_eq!(grade(p99_9, max), level, "{p99_9} {max}");
        }
    }

    #[test]
    fn every_latency_falls_into_its_bar() {
        let mut latencies = Histogram::new_with_bounds(1, LATENCY_MAX_NS, DIGITS).unwrap();
        for ns in [3_000, 4_990, 5_000, 40_000, LATENCY_MAX_NS] {
            latencies.saturating_record(ns);
        }
        let bars = bars(&latencies);
        assert_eq!(bars.first(), Some(&(5, 3)));
        assert_eq!(bars[3], (50, 1));
        assert_eq!(bars.iter().map(|(_, count)| count).sum::<u64>(), 5);
        assert_eq!(super::bars(&Histogram::new(3).unwrap()), []);
    }

    #[test]
    fn a_measurement_counts_every_tick_once() {
        let request = SchedulingRequest { cpu: None, priority: None };
        let robot = Robot { rate_hz: 200.0, request, ..Robot::default() };
        let measurement = Measurement::start(&robot).unwrap();
        while measurement.shared.max_ns.load(Ordering::Relaxed) == 0 {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let wake = measurement.end().unwrap();
        assert!(!wake.latencies.is_empty() && wake.latencies.len() >= wake.missed, "{wake:?}");
        assert!(wake.max_us() >= wake.quantile_us(0.5));
    }
}
