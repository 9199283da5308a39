//! Latency distributions since the start.

use hdrhistogram::Histogram;
use motord_bus::time::nanos;
use motord_bus::{Duration, Instant};
use motord_core::cycle::Record;
use motord_shared::description::{ControlLatency, Percentiles, Telemetry};

/// Latencies beyond it are recorded as it: 10 s.
const LATENCY_MAX_NS: u64 = 10_000_000_000;

/// Control latencies are counted up to so many cycles; longer ones as this many.
const CONTROL_CYCLES: usize = 8;

/// The histograms behind [`Telemetry`].
pub(super) struct Distributions {
    totals: Telemetry,
    first: Option<Instant>,
    last: Instant,
    wake: Histogram<u64>,
    reply: Histogram<u64>,
    setpoint_age: Histogram<u64>,
    cycle: Histogram<u64>,
    publication: Histogram<u64>,
    polled: Histogram<u64>,
    joints: Vec<Histogram<u64>>,
    control: Vec<Control>,
    publications: Publications,
    period: Duration,
}

/// The control latencies of a group.
struct Control {
    latency: Histogram<u64>,
    /// By cycles, as in [`ControlLatency::cycles`].
    cycles: [u64; CONTROL_CYCLES],
}

/// When the states of the last cycles were published, by their number modulo [`Self::KEPT`].
struct Publications([(u64, Instant); Self::KEPT]);

impl Publications {
    const KEPT: usize = 64;

    fn take(&mut self, cycle: u64, published: Instant) {
        self.0[cycle as usize % Self::KEPT] = (cycle, published);
    }

    /// `None` when it was too long ago, or its record was lost.
    fn of(&self, cycle: u64) -> Option<Instant> {
        let (kept, published) = self.0[cycle as usize % Self::KEPT];
        (kept == cycle).then_some(published)
    }
}

impl Distributions {
    pub(super) fn new(joints: usize, groups: usize, period: Duration) -> Self {
        let control = || Control { latency: histogram(), cycles: [0; CONTROL_CYCLES] };
        Self {
            totals: Telemetry::default(),
            first: None,
            last: Instant::ZERO,
            wake: histogram(),
            reply: histogram(),
            setpoint_age: histogram(),
            cycle: histogram(),
            publication: histogram(),
            polled: histogram(),
            control: (0..groups).map(|_| control()).collect(),
            publications: Publications([(0, Instant::ZERO); Publications::KEPT]),
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
        if let Some(publication) = record.publication_ns {
            self.publication.saturating_record(publication);
        }
        if record.polled.reads > 0 {
            self.polled.saturating_record(nanos(record.polled.time));
            self.totals.polled_reads += u64::from(record.polled.reads);
            self.totals.polled_in_vain += u64::from(record.polled.in_vain);
        }
        self.record_control(record);
        for (joint, &latency) in self.joints.iter_mut().zip(&record.reply_latency_ns) {
            if latency > 0 {
                joint.saturating_record(u64::from(latency));
                self.reply.saturating_record(u64::from(latency));
            }
        }
    }

    /// A group's setpoint answers a cycle before this one, so that its publication was taken in.
    fn record_control(&mut self, record: &Record) {
        let begun = record.scheduled + Duration::from_nanos(record.wake_latency_ns);
        for (control, &answered) in self.control.iter_mut().zip(&record.answered_cycle) {
            let Some(cycles) = record.cycle.checked_sub(answered).filter(|_| answered > 0) else { continue };
            control.cycles[(cycles.max(1) - 1).min(CONTROL_CYCLES as u64 - 1) as usize] += 1;
            let is_recent = cycles <= Publications::KEPT as u64;
            if let Some(published) = self.publications.of(answered).filter(|_| is_recent) {
                control.latency.saturating_record(nanos(begun.since(published)));
            }
        }
        self.publications.take(record.cycle, begun + Duration::from_nanos(record.cycle_ns));
    }

    fn all_control(&self) -> Histogram<u64> {
        let mut all = histogram();
        for control in &self.control {
            all.add(&control.latency).expect("their bounds are the same");
        }
        all
    }

    pub(super) fn telemetry(&self) -> Telemetry {
        let ran = self.first.map_or(Duration::ZERO, |first| self.last.since(first) + self.period);
        Telemetry {
            seconds: ran.as_secs_f64(),
            wake_latency_us: percentiles(&self.wake),
            reply_latency_us: percentiles(&self.reply),
            setpoint_age_us: percentiles(&self.setpoint_age),
            cycle_us: percentiles(&self.cycle),
            publication_us: percentiles(&self.publication),
            polled_us: percentiles(&self.polled),
            control_latency_us: percentiles(&self.all_control()),
            control: self.control.iter().map(Control::latency).collect(),
            joints: self.joints.iter().map(percentiles).collect(),
            ..self.totals.clone()
        }
    }
}

fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, LATENCY_MAX_NS, 3).expect("1 and 10 s are bounds of a histogram")
}

impl Control {
    fn latency(&self) -> ControlLatency {
        ControlLatency { control_latency_us: percentiles(&self.latency), cycles: self.cycles.to_vec() }
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

#[cfg(test)]
#[path = "../../tests/unit/distributions.rs"]
mod tests;
