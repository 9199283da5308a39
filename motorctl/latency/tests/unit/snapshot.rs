//! Intervals as differences of totals.

use super::*;

fn total(values: &[u64]) -> Histogram<u64> {
    let mut total = Histogram::new_with_bounds(1, 10_000_000_000, 3).unwrap();
    values.iter().for_each(|value| total.record(*value).unwrap());
    total
}

fn snapshot(boot_id: u64, resets: u64, cycles: u64, wake: Histogram<u64>) -> Snapshot {
    let telemetry = Telemetry { resets, cycles, ..Telemetry::default() };
    let histograms = Quantities::from([("wake_latency".to_owned(), wake)]);
    Snapshot { taken: SystemTime::UNIX_EPOCH, boot_id, telemetry, histograms }
}

#[test]
fn interval_holds_samples_between_two_totals() {
    let before = snapshot(1, 0, 2, total(&[10_000, 900_000]));
    let now = snapshot(1, 0, 5, total(&[10_000, 900_000, 20_000, 20_000, 30_000]));
    let interval = now.since(&before).telemetry(&RobotDescription::default());
    assert_eq!((interval.cycles, interval.wake_latency_us.count), (3, 3));
    assert!((interval.wake_latency_us.p50 - 20.0).abs() < 0.1 && interval.wake_latency_us.max < 30.1);
    let nothing = now.since(&now).telemetry(&RobotDescription::default());
    assert_eq!(nothing.wake_latency_us, Percentiles::default());
}

#[test]
fn totals_that_began_anew_are_all_new() {
    let before = snapshot(1, 0, 4, total(&[10_000, 10_000, 10_000, 10_000]));
    for now in [snapshot(1, 1, 1, total(&[7_000])), snapshot(2, 0, 1, total(&[7_000]))] {
        let interval = now.since(&before).telemetry(&RobotDescription::default());
        assert_eq!((interval.cycles, interval.wake_latency_us.count), (1, 1));
    }
}

#[test]
fn interval_survives_total_with_fewer_digits() {
    let (before, now) = (total(&[10_000, 50_000]), total(&[10_000, 50_000, 70_000]));
    let coarse = difference(&rounded(&now, 2), Some(&before));
    assert_eq!((coarse.len(), coarse.sigfig()), (1, 2));
    assert!(coarse.equivalent(coarse.max(), 70_000));
}

#[test]
fn bytes_that_are_no_histogram_are_refused() {
    for bytes in [&b""[..], b"HDR", &[0x1c, 0x84, 0x93, 0x14, 0, 0, 0, 2, 1, 1], &[0xff; 64]] {
        assert!(histogram(bytes).is_none());
    }
}
