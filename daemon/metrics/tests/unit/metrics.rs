//! The text of the metrics.

use super::*;
use motord_bus::Duration;

fn metrics() -> Metrics {
    let names = |names: &[&str]| names.iter().map(ToString::to_string).collect();
    Metrics::new(Names { joints: names(&["hip", "knee"]), groups: names(&["leg"]), buses: names(&["front"]) })
}

fn lines(text: &str, name: &str) -> Vec<String> {
    let lines = text.lines().filter(|line| line.starts_with(name));
    lines.map(str::to_owned).collect()
}

#[test]
fn bucket_counts_values_up_to_its_bound() {
    let mut values = crate::histogram::histogram();
    for value in [900, 1_900, 2_100, 4_000, 700_000, 2_000_000_000] {
        values.record(value).unwrap();
    }
    let histogram = buckets(&values);
    let counts: Vec<u64> = histogram.get_bucket().iter().map(Bucket::cumulative_count).collect();
    assert_eq!(counts[..10], [1, 2, 4, 4, 4, 4, 4, 4, 4, 5]);
    assert_eq!(
        (counts[18], histogram.get_sample_count()),
        (5, 6),
        "the last is above every bound but infinity"
    );
    assert!((histogram.get_sample_sum() / 2.000_708_9 - 1.0).abs() < 0.001);
}

#[test]
fn the_metrics_of_a_robot_bear_its_names() {
    let mut metrics = metrics();
    let mut state = StateMessage { joint_count: 2, group_count: 1, bus_count: 1, ..Default::default() };
    state.overruns = 12;
    state.joints[1].missed = 4;
    state.buses[0].dropped = 5;
    state.groups[0].phase = Phase::Active.code();
    state.groups[0].rejected[Rejection::Stale.code() as usize] = 6;
    metrics.record(Event::Stopped { group: 0, cause: Cause::Overspeed, motor: None, pid: None });
    let mut distributions = Distributions::new(2, 1, Duration::from_millis(1));
    distributions.record_delivery(3_000);
    let text = metrics.text(&distributions, &state, 9);
    let samples = |name: &str| lines(&text, name);
    assert_eq!(samples("motord_tick_missed_total"), ["motord_tick_missed_total 12"]);
    assert_eq!(samples("motord_telemetry_dropped_total"), ["motord_telemetry_dropped_total 9"]);
    assert_eq!(
        samples("motord_motor_missed_replies_total{"),
        [
            "motord_motor_missed_replies_total{motor=\"hip\"} 0",
            "motord_motor_missed_replies_total{motor=\"knee\"} 4"
        ]
    );
    assert!(text.contains("motord_bus_tx_dropped_total{bus=\"front\",reason=\"not-accepted\"} 5\n"));
    assert!(text.contains("motord_setpoint_rejected_total{group=\"leg\",reason=\"stale\"} 6\n"));
    assert!(text.contains("motord_safe_stop_total{cause=\"overspeed\"} 1\n"));
    assert!(text.contains("motord_state{group=\"leg\",phase=\"active\"} 1\n"));
    assert!(text.contains("motord_state{group=\"leg\",phase=\"disarmed\"} 0\n"));
    assert!(text.contains("motord_delivery_seconds_bucket{le=\"0.000005\"} 1\n"), "{text}");
    assert_eq!(samples("motord_motor_reply_latency_seconds_count").len(), 2);
    assert_eq!(
        samples("# TYPE motord_tick_lateness_seconds"),
        ["# TYPE motord_tick_lateness_seconds histogram"]
    );
}

#[test]
fn robot_without_state_has_complete_metrics_text() {
    let distributions = Distributions::new(2, 1, Duration::from_millis(1));
    let text = metrics().text(&distributions, &StateMessage::default(), 0);
    assert!(!text.contains("motord_state"), "nothing is made up: {text}");
    assert_eq!(lines(&text, "motord_tick_lateness_seconds_count"), ["motord_tick_lateness_seconds_count 0"]);
}
