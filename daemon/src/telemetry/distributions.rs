//! Latency distributions since the start.

use hdrhistogram::Histogram;
use motord_bus::{Duration, Instant};
use motord_core::cycle::Record;
use motord_shared::description::{Percentiles, Telemetry};

/// Latencies beyond it are recorded as it: 10 s.
const LATENCY_MAX_NS: u64 = 10_000_000_000;

/// The histograms behind [`Telemetry`].
pub(super) struct Distributions {
    totals: Telemetry,
    first: Option<Instant>,
    last: Instant,
    wake: Histogram<u64>,
    reply: Histogram<u64>,
    setpoint_age: Histogram<u64>,
    cycle: Histogram<u64>,
    joints: Vec<Histogram<u64>>,
    period: Duration,
}

impl Distributions {
    pub(super) fn new(joints: usize, period: Duration) -> Self {
        let histogram = || {
            Histogram::new_with_bounds(1, LATENCY_MAX_NS, 3).expect("1 and 10 s are bounds of a histogram")
        };
        Self {
            totals: Telemetry::default(),
            first: None,
            last: Instant::ZERO,
            wake: histogram(),
            reply: histogram(),
            setpoint_age: histogram(),
            cycle: histogram(),
            joints: (0..joints).map(|_| histogram()).collect(),
            period,
        }
    }

    pub(super) fn record(&mut self, record: &Record) {
        self.totals.cycles += 1;
        self.totals.overruns += record.missed_ticks;
        self.totals.missed_replies = record.missed;
        self.first.get_or_insert(record.scheduled);
        self.last = record.scheduled;
        self.wake.saturating_record(record.wake_latency_ns);
        self.cycle.saturating_record(record.cycle_ns);
        if let Some(age) = record.setpoint_age_ns {
            self.setpoint_age.saturating_record(age);
        }
        for (joint, &latency) in self.joints.iter_mut().zip(&record.reply_latency_ns) {
            if latency > 0 {
                joint.saturating_record(u64::from(latency));
                self.reply.saturating_record(u64::from(latency));
            }
        }
    }

    pub(super) fn telemetry(&self) -> Telemetry {
        let ran = self.first.map_or(Duration::ZERO, |first| self.last.since(first) + self.period);
        Telemetry {
            seconds: ran.as_secs_f64(),
            wake_latency_us: percentiles(&self.wake),
            reply_latency_us: percentiles(&self.reply),
            setpoint_age_us: percentiles(&self.setpoint_age),
            cycle_us: percentiles(&self.cycle),
            joints: self.joints.iter().map(percentiles).collect(),
            ..self.totals.clone()
        }
    }
}

fn percentiles(histogram: &Histogram<u64>) -> Percentiles {
    let microseconds = |nanos: u64| nanos as f64 / 1000.0;
    Percentiles {
        count: histogram.len(),
        p50: microseconds(histogram.value_at_quantile(0.5)),
        p99: microseconds(histogram.value_at_quantile(0.99)),
        p99_9: microseconds(histogram.value_at_quantile(0.999)),
        max: microseconds(histogram.max()),
    }
}
