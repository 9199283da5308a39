//! The latency distributions, from records of cycles.

use super::*;
use motord_core::cycle::Polled;
use motord_shared::limits::{GROUPS_MAX, JOINTS_MAX};

const PERIOD: Duration = Duration::from_millis(1);

/// The cycle begins with its tick and publishes 700 µs later; the first group begins to use an answer to `answered`.
fn record(cycle: u64, answered: u64) -> Record {
    let mut answered_cycle = [0; GROUPS_MAX];
    answered_cycle[0] = answered;
    Record {
        cycle,
        scheduled: Instant::ZERO + PERIOD * cycle as u32,
        wake_latency_ns: 0,
        cycle_ns: 700_000,
        setpoint_age_ns: None,
        answered_cycle,
        publication_ns: None,
        polled: Polled::default(),
        missed: 0,
        missed_ticks: 0,
        reply_latency_ns: [0; JOINTS_MAX],
    }
}

#[test]
fn the_control_latency_lasts_from_the_states_to_the_cycle_that_uses_the_answer() {
    let mut distributions = Distributions::new(1, 2, PERIOD);
    // In time, one cycle late, without a new setpoint, after a record was lost, and from another age.
    for (cycle, answered) in [(1, 0), (2, 1), (3, 1), (4, 0), (6, 5), (100, 1)] {
        distributions.record(&record(cycle, answered));
    }
    let telemetry = distributions.telemetry();
    assert_eq!(telemetry.control[0].cycles, [2, 1, 0, 0, 0, 0, 0, 1]);
    assert_eq!(telemetry.control[1], ControlLatency { cycles: vec![0; 8], ..Default::default() });
    let latency = telemetry.control_latency_us;
    assert_eq!(latency, telemetry.control[0].control_latency_us);
    assert_eq!(latency.count, 2, "of those whose states' publication is known");
    assert!((latency.p50 - 300.0).abs() < 1.0 && (latency.max - 1300.0).abs() < 2.0, "{latency:?}");
}
