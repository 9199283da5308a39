//! The metrics of the robot in the text format of Prometheus.

use crate::distributions::Distributions;
use hdrhistogram::Histogram as Distribution;
use motord_core::control::Event;
use motord_core::settings::Settings;
use motord_shared::message::GroupState;
use motord_shared::{Cause, Phase, Rejection, StateMessage};
use prometheus::TextEncoder;
use prometheus::proto::{Bucket, Counter, Gauge, Histogram, LabelPair, Metric, MetricFamily, MetricType};

/// Upper bounds of the buckets of every histogram, ns: 1 µs to 1 s, three in a decade.
const BOUNDS_NS: [u64; 19] = [
    1_000,
    2_000,
    5_000,
    10_000,
    20_000,
    50_000,
    100_000,
    200_000,
    500_000,
    1_000_000,
    2_000_000,
    5_000_000,
    10_000_000,
    20_000_000,
    50_000_000,
    100_000_000,
    200_000_000,
    500_000_000,
    1_000_000_000,
];

/// Names of the parts of the robot, in the order of the configuration.
#[derive(Debug, Clone, Default)]
pub struct Names {
    /// Of joints and their motors.
    pub joints: Vec<String>,
    /// Of groups.
    pub groups: Vec<String>,
    /// Of buses.
    pub buses: Vec<String>,
}

impl Names {
    /// Those of a configuration.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        Self {
            joints: settings.motors.iter().map(|motor| motor.name.clone()).collect(),
            groups: settings.groups.iter().map(|group| group.name.clone()).collect(),
            buses: settings.buses.iter().map(|bus| bus.name.clone()).collect(),
        }
    }
}

/// The counters that only the metrics have, and the names of all.
#[derive(Debug)]
pub struct Metrics {
    names: Names,
    /// Stops of groups, by the code of their cause; each cause has its place.
    stops: Vec<(Cause, u64)>,
}

impl Metrics {
    /// Of a robot with these names.
    #[must_use]
    pub fn new(names: Names) -> Self {
        Self { names, stops: Cause::ALL.iter().map(|cause| (*cause, 0)).collect() }
    }

    /// The names of the robot.
    #[must_use]
    pub const fn names(&self) -> &Names {
        &self.names
    }

    /// Takes in an event of the cycle.
    pub fn record(&mut self, event: Event) {
        if let Event::Stopped { cause, .. } = event {
            self.stops.iter_mut().filter(|(known, _)| *known == cause).for_each(|(_, stops)| *stops += 1);
        }
    }

    /// Everything that is known, as text. `state` is a recent one; `dropped` samples were lost since the start.
    #[must_use]
    pub fn text(&self, distributions: &Distributions, state: &StateMessage, dropped: u64) -> String {
        let mut families = self.latencies(distributions);
        families.extend(self.counters(state));
        families.push(self.states(state));
        families.extend([
            counter(
                "motord_tick_missed_total",
                "Ticks that passed without a cycle.",
                [(vec![], state.overruns)],
            ),
            counter(
                "motord_telemetry_dropped_total",
                "Samples and events that telemetry was too slow for.",
                [(vec![], dropped)],
            ),
            counter(
                "motord_cycles_total",
                "Cycles that were run, since the start or the last reset of the latencies.",
                [(vec![], distributions.cycles())],
            ),
        ]);
        // The encoder refuses a family without a sample.
        families.retain(|family| !family.get_metric().is_empty());
        TextEncoder::new().encode_to_string(&families).expect("every family has a name and samples")
    }

    fn latencies(&self, distributions: &Distributions) -> Vec<MetricFamily> {
        let help = |quantity: &str| match quantity {
            "wake_latency" => ("motord_tick_lateness_seconds", "From a tick to the beginning of its cycle."),
            "transmit" => {
                ("motord_transmit_seconds", "From the beginning of a cycle until its frames are handed over.")
            }
            "setpoint_age" => {
                ("motord_setpoint_age_seconds", "From the sending of a setpoint to the cycle that used it.")
            }
            "cycle" => {
                ("motord_cycle_seconds", "From the beginning of a cycle to the publication of its states.")
            }
            "publication" => (
                "motord_publication_seconds",
                "From the last reply of a cycle to the publication of its states.",
            ),
            "delivery" => (
                "motord_delivery_seconds",
                "From the publication of states until all waiting clients are woken.",
            ),
            "polled" => ("motord_polled_seconds", "How long cycles polled for their last replies."),
            // The reply and control latencies of the whole robot are left out: they are the sums of the families below.
            _ => ("", ""),
        };
        let robot = distributions.robot();
        let named = robot.iter().map(|(quantity, values)| (help(quantity), values));
        let known = named.filter(|((name, _), _)| !name.is_empty());
        let mut families: Vec<_> =
            known.map(|((name, help), values)| histograms(name, help, [(vec![], &**values)])).collect();
        let replies = self.names.joints.iter().zip(distributions.by_joint());
        families.push(histograms(
            "motord_motor_reply_latency_seconds",
            "From a command to its reply.",
            replies.map(|(name, values)| (vec![("motor", name.as_str())], values)),
        ));
        let control = self.names.groups.iter().zip(distributions.by_group());
        families.push(histograms(
            "motord_control_latency_seconds",
            "From the publication of states to the cycle that first used the setpoint that answers them.",
            control.map(|(name, values)| (vec![("group", name.as_str())], values)),
        ));
        families
    }

    /// The counters that count modulo 2³² begin anew then, as a counter of Prometheus may.
    fn counters(&self, state: &StateMessage) -> Vec<MetricFamily> {
        let Names { joints, groups, buses } = &self.names;
        let motors = joints.iter().zip(state.joints());
        let missed = motors.map(|(name, joint)| (labels([("motor", name)]), u64::from(joint.missed)));
        let buses = buses.iter().zip(state.buses());
        let dropped = buses
            .map(|(name, bus)| (labels([("bus", name), ("reason", "not-accepted")]), u64::from(bus.dropped)));
        let rejected = groups.iter().zip(state.groups()).flat_map(|(name, group)| {
            let counts = Rejection::ALL.iter().zip(group.rejected);
            counts.map(move |(reason, count)| {
                (labels([("group", name), ("reason", reason.name())]), u64::from(count))
            })
        });
        let stops = self.stops.iter().map(|(cause, count)| (labels([("cause", cause.name())]), *count));
        vec![
            counter("motord_motor_missed_replies_total", "Turns of a motor without a reply.", missed),
            counter("motord_bus_tx_dropped_total", "Frames that a bus did not accept.", dropped),
            counter(
                "motord_setpoint_rejected_total",
                "Setpoint messages that were rejected, whole.",
                rejected,
            ),
            counter("motord_safe_stop_total", "Stops of groups for a cause.", stops),
        ]
    }

    fn states(&self, state: &StateMessage) -> MetricFamily {
        let groups = self.names.groups.iter().zip(state.groups());
        let samples = groups.flat_map(|(name, group): (_, &GroupState)| {
            Phase::ALL.iter().map(move |phase| {
                let mut gauge = Gauge::default();
                gauge.set_value(f64::from(u8::from(group.phase == phase.code())));
                let mut metric =
                    Metric::from_label(pairs(labels([("group", name), ("phase", phase.name())])));
                metric.set_gauge(gauge);
                metric
            })
        });
        family(
            "motord_state",
            "1 for the phase that a group is in, 0 for the others.",
            MetricType::GAUGE,
            samples,
        )
    }
}

type Labels<'a> = Vec<(&'static str, &'a str)>;

fn labels<'a, const N: usize>(labels: [(&'static str, &'a str); N]) -> Labels<'a> {
    labels.to_vec()
}

fn pairs(labels: Labels<'_>) -> Vec<LabelPair> {
    let pair = |(name, value): (&str, &str)| {
        let mut pair = LabelPair::default();
        pair.set_name(name.to_owned());
        pair.set_value(value.to_owned());
        pair
    };
    labels.into_iter().map(pair).collect()
}

fn family(name: &str, help: &str, kind: MetricType, samples: impl Iterator<Item = Metric>) -> MetricFamily {
    let mut family = MetricFamily::default();
    family.set_name(name.to_owned());
    family.set_help(help.to_owned());
    family.set_field_type(kind);
    family.set_metric(samples.collect());
    family
}

fn counter<'a>(name: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'a>, u64)>) -> MetricFamily {
    let metric = |(labels, count): (Labels<'a>, u64)| {
        let mut counter = Counter::default();
        counter.set_value(count as f64);
        let mut metric = Metric::from_label(pairs(labels));
        metric.set_counter(counter);
        metric
    };
    family(name, help, MetricType::COUNTER, samples.into_iter().map(metric))
}

fn histograms<'a>(
    name: &str,
    help: &str,
    samples: impl IntoIterator<Item = (Labels<'a>, &'a Distribution<u64>)>,
) -> MetricFamily {
    let metric = |(labels, values): (Labels<'a>, &Distribution<u64>)| {
        let mut metric = Metric::from_label(pairs(labels));
        metric.set_histogram(buckets(values));
        metric
    };
    family(name, help, MetricType::HISTOGRAM, samples.into_iter().map(metric))
}

/// The values in the buckets, s. A value within 0.1 % of a bound may count on its other side: the histogram knows no more.
fn buckets(values: &Distribution<u64>) -> Histogram {
    let mut buckets = Vec::with_capacity(BOUNDS_NS.len());
    let mut recorded = values.iter_recorded().peekable();
    let mut count = 0;
    for bound in BOUNDS_NS {
        while let Some(value) = recorded.next_if(|value| value.value_iterated_to() <= bound) {
            count += value.count_at_value();
        }
        let mut bucket = Bucket::default();
        bucket.set_upper_bound(bound as f64 / 1e9);
        bucket.set_cumulative_count(count);
        buckets.push(bucket);
    }
    let mut histogram = Histogram::default();
    histogram.set_bucket(buckets);
    histogram.set_sample_count(values.len());
    histogram.set_sample_sum(values.mean() * values.len() as f64 / 1e9);
    histogram
}

#[cfg(test)]
#[path = "../tests/unit/metrics.rs"]
mod tests;
