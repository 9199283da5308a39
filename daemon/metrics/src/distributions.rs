//! Histograms of all latencies, since the start or the last reset.
//!
//! All have the same range, 1 ns to 10 s, and three significant digits; those of joints and IMUs have
//! two. Their memory grows when a value is longer than all before it.
//!
//! A late wake-up is one event for the cycle thread, but it delays every tick that passes before it
//! (coordinated omission). So each missed tick adds one sample to each quantity that had a real
//! value at that tick:
//!
//! | quantity | sample of a missed tick |
//! |---|---|
//! | wake latency | from that tick to the beginning of the cycle after it |
//! | setpoint age | the age, at that tick, of the setpoint that the cycle before it used: the motors still followed it |
//! | the others | none: for that tick nothing was sent, answered or published. It is counted as missed |

use crate::encoded;
use crate::histogram::{LATENCY_MAX_NS, add, add_n, growing_histogram, histogram};
use crate::names::Names;
use hdrhistogram::Histogram;
use motord_bus::time::nanos;
use motord_bus::{Duration, Instant};
use motord_core::cycle::Record;
use motord_shared::description::{ControlLatency, Histograms, Percentiles, Telemetry};
use std::borrow::Cow;
use std::iter::once_with;

/// Longest control latency that is counted, in cycles. Longer ones count as this.
const CONTROL_CYCLES: usize = 8;

/// The histograms behind [`Telemetry`].
pub struct Distributions {
    totals: Telemetry,
    first: Option<Instant>,
    last: Instant,
    wake: Histogram<u64>,
    transmit: Histogram<u64>,
    setpoint_age: Histogram<u64>,
    cycle: Histogram<u64>,
    publication: Histogram<u64>,
    delivery: Histogram<u64>,
    polled: Histogram<u64>,
    /// Two significant digits, because there may be 64 joints.
    joints: Vec<Histogram<u64>>,
    /// Two significant digits: the age spreads over a period.
    imus: Vec<Histogram<u64>>,
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
    /// Creates the histograms of a robot with these numbers of joints and groups, and a tick every
    /// `period`.
    #[must_use]
    pub fn new(joints: usize, groups: usize, period: Duration) -> Self {
        let control = || Control { latency: growing_histogram(3), cycles: [0; CONTROL_CYCLES] };
        Self {
            totals: Telemetry::default(),
            first: None,
            last: Instant::ZERO,
            wake: growing_histogram(3),
            transmit: growing_histogram(3),
            setpoint_age: growing_histogram(3),
            cycle: growing_histogram(3),
            publication: growing_histogram(3),
            delivery: growing_histogram(3),
            polled: growing_histogram(3),
            control: (0..groups).map(|_| control()).collect(),
            publications: Publications([(0, Instant::ZERO); Publications::KEPT]),
            joints: (0..joints).map(|_| growing_histogram(2)).collect(),
            imus: Vec::new(),
            aged: None,
            missed_replies: (0, 0),
            dropped_before: 0,
            period,
        }
    }

    /// Adds the histograms of this number of IMUs.
    #[must_use]
    pub fn with_imus(self, imus: usize) -> Self {
        Self { imus: (0..imus).map(|_| growing_histogram(2)).collect(), ..self }
    }

    /// Clears all histograms. `dropped` samples were lost since the daemon started.
    pub fn reset(&mut self, dropped: u64) {
        let fresh = Self::new(self.joints.len(), self.control.len(), self.period).with_imus(self.imus.len());
        let last = std::mem::replace(self, fresh);
        self.totals.resets = last.totals.resets + 1;
        (self.publications, self.aged) = (last.publications, last.aged);
        self.missed_replies = (last.missed_replies.1, last.missed_replies.1);
        self.dropped_before = dropped;
    }

    /// Records the measurements of a cycle. Bounded by joints, groups and IMUs, and after a stall by
    /// the ticks of 10 s.
    pub fn record(&mut self, record: &Record) {
        self.totals.cycles += 1;
        self.totals.overruns += record.missed_ticks;
        self.missed_replies.1 = record.missed;
        self.first.get_or_insert(record.scheduled);
        self.last = record.scheduled;
        self.record_wake(record);
        self.record_setpoint_age(record);
        add(&mut self.transmit, record.transmit_ns);
        add(&mut self.cycle, record.cycle_ns);
        if let Some(publication) = record.publication_ns {
            add(&mut self.publication, publication);
        }
        if record.polled.reads > 0 {
            add(&mut self.polled, nanos(record.polled.time));
            self.totals.polled_reads += u64::from(record.polled.reads);
            self.totals.polled_in_vain += u64::from(record.polled.is_incomplete);
        }
        self.record_control(record);
        for (joint, &latency) in self.joints.iter_mut().zip(&record.reply_latency_ns) {
            if latency > 0 {
                add(joint, u64::from(latency));
            }
        }
        let ages = self.imus.iter_mut().zip(&record.imu_age_ns).filter(|(_, age)| **age > 0);
        ages.for_each(|(imu, &age)| add(imu, u64::from(age)));
    }

    /// Records the time from the publication of a cycle's states to the clients, ns.
    pub fn record_delivery(&mut self, delivery_ns: u64) {
        add(&mut self.delivery, delivery_ns);
    }

    /// The cycle belongs to the last tick that passed. The ticks before it, from the one that it
    /// slept for, were missed.
    fn record_wake(&mut self, record: &Record) {
        let period = nanos(self.period);
        let late_by = |ticks: u64| record.wake_latency_ns.saturating_sub(ticks.saturating_mul(period));
        // The first `beyond` of these ticks are late by more than the range: one call records them
        // all.
        let beyond = record.wake_latency_ns.saturating_sub(LATENCY_MAX_NS) / period.max(1);
        let beyond = beyond.min(record.missed_ticks);
        record_beyond(&mut self.wake, beyond);
        (beyond..=record.missed_ticks).for_each(|ticks| add(&mut self.wake, late_by(ticks)));
    }

    fn record_setpoint_age(&mut self, record: &Record) {
        if let Some((begun, age)) = self.aged {
            let period = nanos(self.period).max(1);
            let first = age + nanos(record.scheduled.since(begun));
            let within = record.missed_ticks.min(LATENCY_MAX_NS / period);
            (0..within).for_each(|tick| add(&mut self.setpoint_age, first + tick * period));
            // All of these are older than the range.
            record_beyond(&mut self.setpoint_age, record.missed_ticks - within);
        }
        if let Some(age) = record.setpoint_age_ns {
            add(&mut self.setpoint_age, age);
        }
        self.aged = record.setpoint_age_ns.map(|age| (begun(record), age));
    }

    /// A group's setpoint answers an earlier cycle, whose publication is recorded already.
    fn record_control(&mut self, record: &Record) {
        for (control, &answered) in self.control.iter_mut().zip(&record.answered_cycle) {
            let Some(cycles) = record.cycle.checked_sub(answered).filter(|_| answered > 0) else { continue };
            control.cycles[(cycles.max(1) - 1).min(CONTROL_CYCLES as u64 - 1) as usize] += 1;
            let is_recent = cycles <= Publications::KEPT as u64;
            if let Some(published) = self.publications.of(answered).filter(|_| is_recent) {
                add(&mut control.latency, nanos(begun(record).since(published)));
            }
        }
        self.publications.take(record.cycle, begun(record) + Duration::from_nanos(record.cycle_ns));
    }

    /// Returns counters and percentiles, without the groups' history. `dropped` samples were lost
    /// since the daemon started.
    #[must_use]
    pub fn telemetry(&self, dropped: u64) -> Telemetry {
        let ran = self.first.map_or(Duration::ZERO, |first| self.last.since(first) + self.period);
        Telemetry {
            seconds: ran.as_secs_f64(),
            missed_replies: self.missed_replies.1.saturating_sub(self.missed_replies.0),
            dropped_records: dropped.saturating_sub(self.dropped_before),
            wake_latency_us: percentiles(&self.wake),
            transmit_us: percentiles(&self.transmit),
            reply_latency_us: percentiles(&sum(self.by_joint())),
            setpoint_age_us: percentiles(&self.setpoint_age),
            cycle_us: percentiles(&self.cycle),
            publication_us: percentiles(&self.publication),
            delivery_us: percentiles(&self.delivery),
            polled_us: percentiles(&self.polled),
            control_latency_us: percentiles(&sum(self.by_group())),
            control: self.control.iter().map(Control::latency).collect(),
            joints: self.joints.iter().map(percentiles).collect(),
            imus: self.imus.iter().map(percentiles).collect(),
            ..self.totals.clone()
        }
    }

    /// Returns as many histograms as fit into one answer, from number `from` on.
    #[must_use]
    pub fn histograms(&self, from: usize, names: &Names) -> Histograms {
        let Names { joints, groups, imus, .. } = names;
        let robot =
            self.robot().into_iter().map(|(name, histogram)| (name.to_owned(), Cow::Borrowed(histogram)));
        let replies = once_with(|| ("reply_latency".to_owned(), Cow::Owned(sum(self.by_joint()))));
        let control = once_with(|| ("control_latency".to_owned(), Cow::Owned(sum(self.by_group()))));
        let robot = robot.chain(replies).chain(control);
        let named = |quantity, name: &String| format!("{quantity}/{name}");
        let groups = self.by_group().zip(groups);
        let groups =
            groups.map(|(histogram, name)| (named("control_latency", name), Cow::Borrowed(histogram)));
        let joints = self.by_joint().zip(joints);
        let joints = joints.map(|(histogram, name)| (named("reply_latency", name), Cow::Borrowed(histogram)));
        let imus = self.by_imu().zip(imus);
        let imus = imus.map(|(histogram, name)| (named("imu_age", name), Cow::Borrowed(histogram)));
        encoded::page(from, self.totals.resets, robot.chain(groups).chain(imus).chain(joints))
    }

    /// The histograms of the whole robot, by the members of [`Telemetry`] without their unit. Reply
    /// and control latencies are the sums of those of joints and groups.
    pub(crate) const fn robot(&self) -> [(&'static str, &Histogram<u64>); 7] {
        [
            ("wake_latency", &self.wake),
            ("transmit", &self.transmit),
            ("setpoint_age", &self.setpoint_age),
            ("cycle", &self.cycle),
            ("publication", &self.publication),
            ("delivery", &self.delivery),
            ("polled", &self.polled),
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

    /// The ages of samples, in the order of the IMUs.
    pub(crate) fn by_imu(&self) -> impl Iterator<Item = &Histogram<u64>> {
        self.imus.iter()
    }

    /// Cycles since the start or the last reset.
    pub(crate) const fn cycles(&self) -> u64 {
        self.totals.cycles
    }
}

/// Returns the sum of histograms. Allocates one.
fn sum<'a>(parts: impl Iterator<Item = &'a Histogram<u64>>) -> Histogram<u64> {
    let mut all = histogram();
    for part in parts {
        all.add(part).expect("their bounds are the same");
    }
    all
}

/// When the cycle of `record` began.
fn begun(record: &Record) -> Instant {
    record.scheduled + Duration::from_nanos(record.wake_latency_ns)
}

/// Records `count` values beyond the range. For a count of zero the library would still raise its
/// largest value.
fn record_beyond(values: &mut Histogram<u64>, count: u64) {
    if count > 0 {
        add_n(values, LATENCY_MAX_NS, count);
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
mod tests {
    use super::*;
    use motord_core::cycle::Polled;
    use motord_shared::limits::{GROUPS_MAX, IMUS_MAX, JOINTS_MAX};

    const PERIOD: Duration = Duration::from_millis(1);

    /// The cycle begins with its tick and publishes 700 µs later; the first group begins to use an
    /// answer to `answered`.
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
            imu_age_ns: [0; IMUS_MAX],
        }
    }

    #[test]
    fn imu_age_counts_while_samples_arrive() {
        let mut distributions = Distributions::new(1, 1, PERIOD).with_imus(2);
        for age in [500_000, 1_500_000, 0] {
            let mut record = record(1, 0);
            record.imu_age_ns[1] = age;
            distributions.record(&record);
        }
        let [lost, base] = distributions.telemetry(0).imus.try_into().unwrap();
        assert_eq!((lost.count, base.count), (0, 2));
        assert!((base.p50 - 500.0).abs() < 10.0 && (base.max - 1500.0).abs() < 20.0, "{base:?}");
        distributions.reset(0);
        assert_eq!(distributions.telemetry(0).imus, [Percentiles::default(); 2]);
    }

    #[test]
    fn control_latency_spans_states_to_answering_cycle() {
        let mut distributions = Distributions::new(1, 2, PERIOD);
        // In time, one cycle late, without a new setpoint, after a record was lost, and from
        // another age.
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
        // The thread sleeps for tick 2 and begins 3.25 ms after it: ticks 2, 3 and 4 are missed,
        // and the cycle is that of tick 5.
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
        // No group is active, so no motor follows a setpoint at the missed ticks.
        distributions.record(&aged(5, None));
        distributions.record(&Record {
            cycle: 9,
            wake_latency_ns: 3_000_000,
            missed_ticks: 3,
            ..aged(6, None)
        });
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
}
