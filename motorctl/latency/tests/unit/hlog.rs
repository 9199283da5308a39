//! Interval logs, written and read back.

use super::*;
use crate::snapshot::percentiles;
use motord_client::Percentiles;
use std::time::Duration;

fn interval(begun: SystemTime, values: &[u64]) -> Interval {
    let mut wake = hdrhistogram::Histogram::new_with_bounds(1, 10_000_000_000, 3).unwrap();
    let empty = wake.clone();
    values.iter().for_each(|value| wake.record(*value).unwrap());
    let names = ["wake_latency", "reply_latency/fl-hip", "polled"].map(str::to_owned);
    let histograms = names.into_iter().zip([wake.clone(), wake, empty]).collect();
    Interval::new(begun, Duration::from_secs(1), histograms)
}

#[test]
fn log_is_complete_after_each_interval() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("run.hlog");
    let mut log = Hlog::create(&path, &RobotDescription::default()).unwrap();
    for (second, values) in [(0, &[11_000, 12_000][..]), (1, &[13_000, 2_000_000])] {
        log.append(&interval(log.begun + Duration::from_secs(second), values)).unwrap();
        let written = read(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(written["wake_latency"].len(), 2 * (second + 1));
    }
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains("#[Histogram log format version 1.3]\n#[StartTime: "), "{text}");
    assert!(text.contains("\nTag=wake_latency,0.000,1.000,12007.000,HIST"), "{text}");
    assert!(text.contains("\nTag=reply_latency/fl-hip,1.000,1.000,2000"), "{text}");
    assert!(!text.contains("polled"), "a quantity without a sample has no line: {text}");
    let read = read(text.as_bytes()).unwrap();
    let Percentiles { count, p50, max, .. } = percentiles(&read["reply_latency/fl-hip"]);
    assert!(count == 4 && (p50 - 12.0).abs() < 0.02 && (max - 2000.0).abs() < 2.0, "{count} {p50} {max}");
}

#[test]
fn invalid_line_is_refused_and_empty_log_accepted() {
    for wrong in [
        "Tag=a,0.0,1.0,2.0,!!!!\n",
        "Tag=a,0.0,1.0,2.0,SERSAAAA\n",
        "0.0;1.0\n",
        "Tag=a,0,1,2,\n",
        "\0\u{ff}\n",
    ] {
        assert!(read(wrong.as_bytes()).is_err(), "{wrong:?}");
    }
    assert!(read(b"").unwrap().is_empty());
    assert!(read(b"#[StartTime: 1.000 (seconds since epoch)]\n").unwrap().is_empty());
}
