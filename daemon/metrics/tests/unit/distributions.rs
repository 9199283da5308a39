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
        transmit_ns: 90_000,
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
fn control_latency_spans_states_to_answering_cycle() {
    let mut distributions = Distributions::new(1, 2, PERIOD);
    // In time, one cycle late, without a new setpoint, after a record was lost, and from another age.
    for (cycle, answered) in [(1, 0), (2, 1), (3, 1), (4, 0), (6, 5), (100, 1)] {
        distributions.record(&record(cycle, answered));
    }
    let telemetry = distributions.telemetry(0);
    assert_eq!(telemetry.control[0].cycles, [2, 1, 0, 0, 0, 0, 0, 1]);
    assert_eq!(telemetry.control[1], ControlLatency { cycles: vec![0; 8], ..Default::default() });
    let latency = telemetry.control_latency_us;
    assert_eq!(latency, telemetry.control[0].control_latency_us);
    assert_eq!(latency.count, 2, "of those whose states' publication is known");
    assert!((latency.p50 - 300.0).abs() < 1.0 && (latency.max - 1300.0).abs() < 2.0, "{latency:?}");
}

#[test]
fn missed_ticks_count_as_late_until_next_cycle() {
    let mut distributions = Distributions::new(1, 1, PERIOD);
    distributions.record(&Record { wake_latency_ns: 40_000, ..record(1, 0) });
    // The thread sleeps for tick 2 and begins 3.25 ms after it: ticks 2, 3 and 4 are missed, and the cycle is that of tick 5.
    let stalled = Record { cycle: 5, wake_latency_ns: 3_250_000, missed_ticks: 3, ..record(2, 0) };
    distributions.record(&stalled);
    let samples: Vec<u64> =
        distributions.wake.iter_recorded().map(|value| value.value_iterated_to()).collect();
    let expected = [40_000, 250_000, 1_250_000, 2_250_000, 3_250_000];
    assert_eq!(samples, expected.map(|late| distributions.wake.highest_equivalent(late)));
    assert_eq!(distributions.wake.len(), 5, "one for each tick from 1 to 5");
    assert_eq!(distributions.cycle.len(), 2, "a missed tick publishes nothing");
}

#[test]
fn the_largest_value_is_one_that_was_measured() {
    let mut distributions = Distributions::new(1, 1, PERIOD);
    for cycle in 1..4 {
        distributions.record(&Record {
            wake_latency_ns: 40_000,
            setpoint_age_ns: Some(300_000),
            ..record(cycle, 0)
        });
    }
    let telemetry = distributions.telemetry(0);
    assert!(telemetry.wake_latency_us.max < 41.0, "{:?}", telemetry.wake_latency_us);
    assert!(telemetry.setpoint_age_us.max < 301.0, "{:?}", telemetry.setpoint_age_us);
}

#[test]
fn missed_tick_ages_setpoint_in_use() {
    let mut distributions = Distributions::new(1, 1, PERIOD);
    let aged = |number, age| Record { setpoint_age_ns: age, ..record(number, 0) };
    distributions.record(&Record { wake_latency_ns: 100_000, ..aged(1, Some(300_000)) });
    // Ticks 2 and 3 are missed, 0.9 and 1.9 ms after cycle 1 began with a setpoint of 0.3 ms.
    let stalled = aged(2, Some(500_000));
    distributions.record(&Record { cycle: 4, wake_latency_ns: 2_100_000, missed_ticks: 2, ..stalled });
    let ages: Vec<u64> =
        distributions.setpoint_age.iter_recorded().map(|value| value.value_iterated_to()).collect();
    let expected = [300_000, 500_000, 1_200_000, 2_200_000];
    assert_eq!(ages, expected.map(|age| distributions.setpoint_age.highest_equivalent(age)));
    // No group is active: nobody follows a setpoint at the ticks that are missed then.
    distributions.record(&aged(5, None));
    distributions.record(&Record { cycle: 9, wake_latency_ns: 3_000_000, missed_ticks: 3, ..aged(6, None) });
    assert_eq!(distributions.setpoint_age.len(), 4);
}

#[test]
fn stall_of_a_day_counts_every_tick() {
    let mut distributions = Distributions::new(1, 1, PERIOD);
    distributions.record(&Record { setpoint_age_ns: Some(0), ..record(1, 0) });
    let (day, ticks) = (86_400_000_000_000, 86_400_000);
    distributions.record(&Record {
        cycle: 2 + ticks,
        wake_latency_ns: day,
        missed_ticks: ticks,
        ..record(2, 0)
    });
    assert_eq!(distributions.wake.len(), 2 + ticks);
    assert_eq!(distributions.setpoint_age.len(), 1 + ticks);
    assert!(
        distributions.wake.equivalent(distributions.wake.value_at_quantile(0.5), LATENCY_MAX_NS),
        "the end of the range"
    );
}

#[test]
fn reset_clears_all_but_next_cycle_data() {
    let mut distributions = Distributions::new(1, 1, PERIOD);
    let replied = |cycle, answered, missed| {
        let mut record = Record { missed, missed_ticks: 0, ..record(cycle, answered) };
        record.reply_latency_ns[0] = 200_000;
        record
    };
    distributions.record(&replied(1, 0, 7));
    distributions.record_delivery(5_000);
    distributions.reset(3);
    let empty = distributions.telemetry(3);
    assert_eq!((empty.resets, empty.cycles, empty.missed_replies, empty.dropped_records), (1, 0, 0, 0));
    assert_eq!((empty.reply_latency_us.count, empty.delivery_us.count), (0, 0));
    distributions.record(&replied(2, 1, 9));
    let after = distributions.telemetry(4);
    assert_eq!((after.cycles, after.missed_replies, after.dropped_records), (1, 2, 1));
    assert_eq!(after.joints[0].count, 1);
    assert_eq!(after.control_latency_us.count, 1, "it answers the states before the reset");
}
