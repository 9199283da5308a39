//! The metrics of the robot in the text format of Prometheus.

use crate::distributions::Distributions;
use crate::names::Names;
use hdrhistogram::Histogram as Distribution;
use motord_core::control::Event;
use motord_shared::message::{GroupState, IMU_LOST};
use motord_shared::{BusCondition, Cause, ImuState, JointState, Phase, Rejection, StateMessage};
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

/// Counters that exist only in the metrics, and the names of the robot's parts.
#[derive(Debug)]
pub struct Metrics {
    names: Names,
    /// Stops of groups, by cause. Every cause has an entry.
    stops: Vec<(Cause, u64)>,
}

impl Metrics {
    /// Creates the metrics of a robot with these names.
    #[must_use]
    pub fn new(names: Names) -> Self {
        Self { names, stops: Cause::ALL.iter().map(|cause| (*cause, 0)).collect() }
    }

    /// The names of the robot.
    #[must_use]
    pub const fn names(&self) -> &Names {
        &self.names
    }

    /// Records an event of the cycle.
    pub fn record(&mut self, event: Event) {
        if let Event::Stopped { cause, .. } = event {
            self.stops.iter_mut().filter(|(known, _)| *known == cause).for_each(|(_, stops)| *stops += 1);
        }
    }

    /// Returns all metrics as text. `state` is a recent one; `dropped` samples were lost since the
    /// start.
    #[must_use]
    pub fn text(&self, distributions: &Distributions, state: &StateMessage, dropped: u64) -> String {
        let mut families = self.latencies(distributions);
        families.extend(self.counters(state));
        families.push(self.states(state));
        families.push(self.conditions(state));
        families.extend(self.supplies(state));
        families.extend(self.imus(state));
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
        let help = |quantity: &'static str| match quantity {
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
            unknown => (unknown, ""),
        };
        let robot = distributions.robot().map(|(quantity, values)| (help(quantity), values));
        let mut families: Vec<_> =
            robot.map(|((name, help), values)| histograms(name, help, [(vec![], values)])).into();
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
        let ages = self.names.imus.iter().zip(distributions.by_imu());
        families.push(histograms(
            "motord_imu_age_seconds",
            "From the receipt of the newest sample to the publication of states with it.",
            ages.map(|(name, values)| (vec![("imu", name.as_str())], values)),
        ));
        families
    }

    /// Counters of the state count modulo 2³²; a counter of Prometheus may restart at zero.
    fn counters(&self, state: &StateMessage) -> Vec<MetricFamily> {
        let Names { joints, groups, buses, .. } = &self.names;
        let motors = joints.iter().zip(state.joints());
        let missed = motors.clone().map(|(name, joint)| (labels([("motor", name)]), u64::from(joint.missed)));
        let foreign =
            motors.map(|(name, joint)| (labels([("motor", name)]), u64::from(joint.foreign_commands)));
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
            counter(
                "motord_motor_foreign_commands_total",
                "Frames with a command to a motor that motord did not send.",
                foreign,
            ),
            counter("motord_bus_tx_dropped_total", "Frames that a bus did not accept.", dropped),
            counter(
                "motord_setpoint_rejected_total",
                "Setpoint messages that were rejected, whole.",
                rejected,
            ),
            counter("motord_safe_stop_total", "Stops of groups for a cause.", stops),
        ]
    }

    fn supplies(&self, state: &StateMessage) -> [MetricFamily; 2] {
        let known = |quantity: fn(&JointState) -> f32| {
            let motors = self.names.joints.iter().zip(state.joints());
            let values = motors.map(move |(name, joint)| (labels([("motor", name)]), quantity(joint)));
            values.filter(|(_, value)| value.is_finite()).map(|(labels, value)| gauge(labels, value.into()))
        };
        [
            family(
                "motord_supply_volts",
                "Voltage of the supply, as a motor reported it last.",
                MetricType::GAUGE,
                known(|joint| joint.supply_voltage),
            ),
            family(
                "motord_supply_amperes",
                "Current from the supply, as a motor reported it last.",
                MetricType::GAUGE,
                known(|joint| joint.supply_current),
            ),
        ]
    }

    fn imus(&self, state: &StateMessage) -> [MetricFamily; 4] {
        let imus = || self.names.imus.iter().zip(state.imus());
        let lost = imus().map(|(name, imu)| flag(labels([("imu", name)]), imu.flags & IMU_LOST != 0));
        let counted = |name, help, count: fn(&ImuState) -> u64| {
            counter(name, help, imus().map(|(name, imu)| (labels([("imu", name)]), count(imu))))
        };
        [
            family(
                "motord_imu_lost",
                "1 for an IMU that is lost, 0 for the others.",
                MetricType::GAUGE,
                lost,
            ),
            counted("motord_imu_samples_total", "Samples received.", |imu| imu.sequence),
            counted(
                "motord_imu_missing_samples_total",
                "Samples that the device took and motord did not receive.",
                |imu| imu.missing.into(),
            ),
            counted("motord_imu_rejected_samples_total", "Samples that are damaged or not sound.", |imu| {
                imu.rejected.into()
            }),
        ]
    }

    fn states(&self, state: &StateMessage) -> MetricFamily {
        let groups = self.names.groups.iter().zip(state.groups());
        let samples = groups.flat_map(|(name, group): (_, &GroupState)| {
            Phase::ALL.iter().map(move |phase| {
                flag(labels([("group", name), ("phase", phase.name())]), group.phase == phase.code())
            })
        });
        family(
            "motord_state",
            "1 for the phase that a group is in, 0 for the others.",
            MetricType::GAUGE,
            samples,
        )
    }

    fn conditions(&self, state: &StateMessage) -> MetricFamily {
        let buses = self.names.buses.iter().zip(state.buses());
        let samples = buses.flat_map(|(name, bus)| {
            BusCondition::ALL.iter().map(move |condition| {
                let labels = labels([("bus", name), ("condition", condition.name())]);
                flag(labels, bus.condition == condition.code())
            })
        });
        family(
            "motord_bus_condition",
            "1 for the condition of a bus, 0 for the others.",
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

/// Returns a gauge of 1 where `is_set`, else of 0.
fn flag(labels: Labels<'_>, is_set: bool) -> Metric {
    gauge(labels, u8::from(is_set).into())
}

fn gauge(labels: Labels<'_>, value: f64) -> Metric {
    let mut gauge = Gauge::default();
    gauge.set_value(value);
    let mut metric = Metric::from_label(pairs(labels));
    metric.set_gauge(gauge);
    metric
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

/// Returns the values in buckets, s. A value within 0.1 % of a bound may count on its other side,
/// because a histogram has three significant digits; within 1 % where it has two.
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
mod tests {
    use super::*;
    use motord_bus::Duration;

    fn metrics() -> Metrics {
        let names = |names: &[&str]| names.iter().map(ToString::to_string).collect();
        Metrics::new(Names {
            joints: names(&["hip", "knee"]),
            groups: names(&["leg"]),
            buses: names(&["front"]),
            imus: names(&["base"]),
        })
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
        state.joints[0].foreign_commands = 3;
        (state.buses[0].dropped, state.buses[0].condition) = (5, BusCondition::Held.code());
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
        assert!(text.contains("motord_motor_foreign_commands_total{motor=\"hip\"} 3\n"));
        assert!(text.contains("motord_motor_foreign_commands_total{motor=\"knee\"} 0\n"));
        assert!(text.contains("motord_bus_tx_dropped_total{bus=\"front\",reason=\"not-accepted\"} 5\n"));
        assert!(text.contains("motord_bus_condition{bus=\"front\",condition=\"held\"} 1\n"));
        assert!(text.contains("motord_bus_condition{bus=\"front\",condition=\"active\"} 0\n"));
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
    fn metrics_of_an_imu_bear_its_name() {
        let mut state = StateMessage { imu_count: 1, ..Default::default() };
        state.imus[0] = ImuState { sequence: 7, missing: 2, rejected: 3, ..ImuState::UNKNOWN };
        let distributions = Distributions::new(2, 1, Duration::from_millis(1)).with_imus(1);
        let text = metrics().text(&distributions, &state, 0);
        for line in [
            "motord_imu_lost{imu=\"base\"} 1",
            "motord_imu_samples_total{imu=\"base\"} 7",
            "motord_imu_missing_samples_total{imu=\"base\"} 2",
            "motord_imu_rejected_samples_total{imu=\"base\"} 3",
            "motord_imu_age_seconds_count{imu=\"base\"} 0",
        ] {
            assert!(text.contains(&format!("{line}\n")), "{line} in {text}");
        }
    }

    #[test]
    fn robot_without_state_has_complete_metrics_text() {
        let distributions = Distributions::new(2, 1, Duration::from_millis(1));
        let text = metrics().text(&distributions, &StateMessage::default(), 0);
        assert!(!text.contains("motord_state"), "nothing is made up: {text}");
        assert_eq!(
            lines(&text, "motord_tick_lateness_seconds_count"),
            ["motord_tick_lateness_seconds_count 0"]
        );
    }
}
