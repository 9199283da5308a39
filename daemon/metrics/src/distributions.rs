//! Histograms of all latencies, since the start or the last reset.
//!
//! All of them have the same fixed range, 1 ns to 10 s, and three significant digits: they are allocated once, and a value
//! costs the same whatever came before.
//!
//! A late wake-up is one event for the cycle thread, but it delays every tick that passes meanwhile (coordinated omission).
//! So each missed tick leaves a sample of its own for each quantity that had a real value at that tick:
//!
//! | quantity | sample of a missed tick |
//! |---|---|
//! | wake latency | from that tick to the beginning of the cycle after it |
//! | setpoint age | the age, at that tick, of the setpoint that the cycle before it used: the motors still followed it |
//! | the others | none. Nothing was sent, answered or published for that tick; it is counted as missed |

use crate::encoded;
use crate::histogram::{LATENCY_MAX_NS, histogram};
use hdrhistogram::Histogram;
use motord_bus::time::nanos;
use motord_bus::{Duration, Instant};
use motord_core::cycle::Record;
use motord_shared::description::{ControlLatency, Histograms, Percentiles, Telemetry};
use std::borrow::Cow;

/// Control latencies are counted up to so many cycles; longer ones as this many.
const CONTROL_CYCLES: usize = 8;

/// The histograms behind [`Telemetry`].
pub struct Distributions {
    totals: Telemetry,
    first: Option<Instant>,
    last: Instant,
    wake: Histogram<u64>,
    transmit: Histogram<u64>,
    reply: Histogram<u64>,
    setpoint_age: Histogram<u64>,
    cycle: Histogram<u64>,
    publication: Histogram<u64>,
    delivery: Histogram<u64>,
    polled: Histogram<u64>,
    joints: Vec<Histogram<u64>>,
    control: Vec<Control>,
    publications: Publications,
    /// The age of the setpoints in use at the beginning of the last cycle.
    aged: Option<(Instant, u64)>,
    /// Replies that were missed before the last reset, and those up to now.
    missed_replies: (u64, u64),
    /// Samples that were lost before the last reset.
    dropped_before: u64,
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
    /// Of a robot with so many joints and groups, whose ticks come every `period`. Allocates everything.
    #[must_use]
    pub fn new(joints: usize, groups: usize, period: Duration) -> Self {
        let control = || Control { latency: histogram(), cycles: [0; CONTROL_CYCLES] };
        Self {
            totals: Telemetry::default(),
            first: None,
            last: Instant::ZERO,
            wake: histogram(),
            transmit: histogram(),
            reply: histogram(),
            setpoint_age: histogram(),
            cycle: histogram(),
            publication: histogram(),
            delivery: histogram(),
            polled: histogram(),
            control: (0..groups).map(|_| control()).collect(),
            publications: Publications([(0, Instant::ZERO); Publications::KEPT]),
            joints: (0..joints).map(|_| histogram()).collect(),
            aged: None,
            missed_replies: (0, 0),
            dropped_before: 0,
            period,
        }
    }

    /// Begins everything anew. `dropped` samples were lost since the daemon started.
    pub fn reset(&mut self, dropped: u64) {
        let fresh = Self::new(self.joints.len(), self.control.len(), self.period);
        let last = std::mem::replace(self, fresh);
        self.totals.resets = last.totals.resets + 1;
        (self.publications, self.aged) = (last.publications, last.aged);
        self.missed_replies = (last.missed_replies.1, last.missed_replies.1);
        self.dropped_before = dropped;
    }

    /// Takes in the measurements of a cycle. Does not allocate; bounded by joints and groups, and after a stall by the ticks of
    /// 10 s.
    pub fn record(&mut self, record: &Record) {
        self.totals.cycles += 1;
        self.totals.overruns += record.missed_ticks;
        self.missed_replies.1 = record.missed;
        self.first.get_or_insert(record.scheduled);
        self.last = record.scheduled;
        self.record_wake(record);
        self.record_setpoint_age(record);
        self.transmit.saturating_record(record.transmit_ns);
        self.cycle.saturating_record(record.cycle_ns);
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

    /// Takes in how long the states of a cycle took from their publication to the clients, ns.
    pub fn record_delivery(&mut self, delivery_ns: u64) {
        self.delivery.saturating_record(delivery_ns);
    }

    /// The cycle belongs to the last tick that has passed. The ticks before it, from the one that it slept for, were missed.
    fn record_wake(&mut self, record: &Record) {
        let period = nanos(self.period);
        let late_by = |ticks: u64| record.wake_latency_ns.saturating_sub(ticks.saturating_mul(period));
        // The first `beyond` of these ticks are late by more than the range: one call records them all.
        let beyond = record.wake_latency_ns.saturating_sub(LATENCY_MAX_NS) / period.max(1);
        let beyond = beyond.min(record.missed_ticks);
        record_beyond(&mut self.wake, beyond);
        (beyond..=record.missed_ticks).for_each(|ticks| self.wake.saturating_record(late_by(ticks)));
    }

    fn record_setpoint_age(&mut self, record: &Record) {
        if let Some((begun, age)) = self.aged {
            let period = nanos(self.period).max(1);
            let first = age + nanos(record.scheduled.since(begun));
            let within = record.missed_ticks.min(LATENCY_MAX_NS / period);
            (0..within).for_each(|tick| self.setpoint_age.saturating_record(first + tick * period));
            // All of these are older than the range.
            record_beyond(&mut self.setpoint_age, record.missed_ticks - within);
        }
        if let Some(age) = record.setpoint_age_ns {
            self.setpoint_age.saturating_record(age);
        }
        self.aged = record.setpoint_age_ns.map(|age| (begun(record), age));
    }

    /// A group's setpoint answers a cycle before this one, so that its publication was taken in.
    fn record_control(&mut self, record: &Record) {
        for (control, &answered) in self.control.iter_mut().zip(&record.answered_cycle) {
            let Some(cycles) = record.cycle.checked_sub(answered).filter(|_| answered > 0) else { continue };
            control.cycles[(cycles.max(1) - 1).min(CONTROL_CYCLES as u64 - 1) as usize] += 1;
            let is_recent = cycles <= Publications::KEPT as u64;
            if let Some(published) = self.publications.of(answered).filter(|_| is_recent) {
                control.latency.saturating_record(nanos(begun(record).since(published)));
            }
        }
        self.publications.take(record.cycle, begun(record) + Duration::from_nanos(record.cycle_ns));
    }

    fn all_control(&self) -> Histogram<u64> {
        let mut all = histogram();
        for control in &self.control {
            all.add(&control.latency).expect("their bounds are the same");
        }
        all
    }

    /// Counters and percentiles; nothing of the groups' history. `dropped` samples were lost since the daemon started.
    #[must_use]
    pub fn telemetry(&self, dropped: u64) -> Telemetry {
        let ran = self.first.map_or(Duration::ZERO, |first| self.last.since(first) + self.period);
        Telemetry {
            seconds: ran.as_secs_f64(),
            missed_replies: self.missed_replies.1.saturating_sub(self.missed_replies.0),
            dropped_records: dropped.saturating_sub(self.dropped_before),
            wake_latency_us: percentiles(&self.wake),
            transmit_us: percentiles(&self.transmit),
            reply_latency_us: percentiles(&self.reply),
            setpoint_age_us: percentiles(&self.setpoint_age),
            cycle_us: percentiles(&self.cycle),
            publication_us: percentiles(&self.publication),
            delivery_us: percentiles(&self.delivery),
            polled_us: percentiles(&self.polled),
            control_latency_us: percentiles(&self.all_control()),
            control: self.control.iter().map(Control::latency).collect(),
            joints: self.joints.iter().map(percentiles).collect(),
            ..self.totals.clone()
        }
    }

    /// As many histograms as fit into one answer, from the one with number `from` on. The joints and groups have these names.
    #[must_use]
    pub fn histograms(&self, from: usize, joints: &[String], groups: &[String]) -> Histograms {
        let robot = self.robot().into_iter().map(|(name, histogram)| (name.to_owned(), histogram));
        let named = |quantity, name: &String| format!("{quantity}/{name}");
        let groups = self.by_group().zip(groups);
        let groups =
            groups.map(|(histogram, name)| (named("control_latency", name), Cow::Borrowed(histogram)));
        let joints = self.by_joint().zip(joints);
        let joints = joints.map(|(histogram, name)| (named("reply_latency", name), Cow::Borrowed(histogram)));
        encoded::page(from, self.totals.resets, robot.chain(groups).chain(joints))
    }

    /// The histograms of the whole robot, by the members of [`Telemetry`] without their unit.
    pub(crate) fn robot(&self) -> [(&'static str, Cow<'_, Histogram<u64>>); 9] {
        [
            ("wake_latency", Cow::Borrowed(&self.wake)),
            ("transmit", Cow::Borrowed(&self.transmit)),
            ("reply_latency", Cow::Borrowed(&self.reply)),
            ("setpoint_age", Cow::Borrowed(&self.setpoint_age)),
            ("cycle", Cow::Borrowed(&self.cycle)),
            ("publication", Cow::Borrowed(&self.publication)),
            ("delivery", Cow::Borrowed(&self.delivery)),
            ("polled", Cow::Borrowed(&self.polled)),
            ("control_latency", Cow::Owned(self.all_control())),
        ]
    }

    /// The control latencies, in the order of the groups.
    pub(crate) fn by_group(&self) -> impl Iterator<Item = &Histogram<u64>> {
        self.control.iter().map(|control| &control.latency)
    }

    /// The reply latencies, in the order of the joints.
    pub(crate) fn by_joint(&self) -> impl Iterator<Item = &Histogram<u64>> {
        self.joints.iter()
    }

    /// Cycles that were run.
    pub(crate) const fn cycles(&self) -> u64 {
        self.totals.cycles
    }
}

/// When the cycle of `record` began.
fn begun(record: &Record) -> Instant {
    record.scheduled + Duration::from_nanos(record.wake_latency_ns)
}

/// Records `count` values beyond the range; none for zero, with which the library would still raise its largest value.
fn record_beyond(values: &mut Histogram<u64>, count: u64) {
    if count > 0 {
        values.saturating_record_n(LATENCY_MAX_NS, count);
    }
}

impl Control {
    fn latency(&self) -> ControlLatency {
        ControlLatency { control_latency_us: percentiles(&self.latency), cycles: self.cycles.to_vec() }
    }
}

fn percentiles(histogram: &Histogram<u64>) -> Percentiles {
    Percentiles::of(histogram.len(), histogram.max(), |quantile| histogram.value_at_quantile(quantile))
}

#[cfg(test)]
#[path = "../tests/unit/distributions.rs"]
mod tests;
