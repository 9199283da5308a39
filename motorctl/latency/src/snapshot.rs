//! The daemon's totals at one moment, and the difference of two of them.

use crate::failure::LatencyFailure;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hdrhistogram::Histogram;
use hdrhistogram::serialization::Deserializer;
use motord_client::{Client, ControlLatency, NetworkLatency, Percentiles, RobotDescription, Telemetry};
use std::collections::BTreeMap;
use std::time::{Duration, SystemTime};

/// Histograms of values in ns, by the name of their quantity.
pub(crate) type Histograms = BTreeMap<String, Histogram<u64>>;

/// The totals of a daemon.
pub(crate) struct Snapshot {
    taken: SystemTime,
    /// Changes with every start of the daemon.
    boot_id: u64,
    telemetry: Telemetry,
    pub(crate) histograms: Histograms,
}

/// The samples between two snapshots.
pub(crate) struct Interval {
    pub(crate) begun: SystemTime,
    pub(crate) length: Duration,
    counters: Telemetry,
    pub(crate) histograms: Histograms,
}

impl Snapshot {
    /// Requests the present totals.
    pub(crate) fn take(client: &Client) -> Result<Self, LatencyFailure> {
        let (telemetry, answer) = (client.telemetry()?, client.histograms()?);
        let decode = |encoded: &str| histogram(&STANDARD.decode(encoded).ok()?);
        let decoded = answer.histograms.into_iter().map(|quantity| {
            let histogram = decode(&quantity.encoded);
            let histogram = histogram.ok_or_else(|| LatencyFailure::NotUnderstood(quantity.name.clone()))?;
            Ok::<_, LatencyFailure>((quantity.name, histogram))
        });
        let (boot_id, taken) = (client.description().boot_id, SystemTime::now());
        Ok(Self { taken, boot_id, telemetry, histograms: decoded.collect::<Result<_, _>>()? })
    }

    /// Returns the samples after `before`. If the totals were reset since then, all samples count.
    pub(crate) fn since(&self, before: &Self) -> Interval {
        let is_same = (self.boot_id, self.telemetry.resets) == (before.boot_id, before.telemetry.resets);
        let earlier = |name| before.histograms.get(name).filter(|_| is_same);
        let new = self.histograms.iter().map(|(name, now)| (name.clone(), difference(now, earlier(name))));
        Interval {
            begun: before.taken,
            length: self.taken.duration_since(before.taken).unwrap_or_default(),
            counters: if is_same {
                counted(&self.telemetry, &before.telemetry)
            } else {
                self.telemetry.clone()
            },
            histograms: new.collect(),
        }
    }
}

impl Interval {
    /// Creates an interval without counters.
    #[cfg(test)]
    pub(crate) fn new(begun: SystemTime, length: Duration, histograms: Histograms) -> Self {
        Self { begun, length, counters: Telemetry::default(), histograms }
    }

    /// Returns counters and percentiles, in the order of `robot`.
    pub(crate) fn telemetry(&self, robot: &RobotDescription) -> Telemetry {
        let of = |name: &str| self.histograms.get(name).map_or_else(Percentiles::default, percentiles);
        let control = robot.groups.iter().zip(&self.counters.control);
        let control = control.map(|(group, counted)| ControlLatency {
            control_latency_us: of(&format!("control_latency/{}", group.name)),
            cycles: counted.cycles.clone(),
        });
        let joints = robot.joints.iter().map(|joint| of(&format!("reply_latency/{}", joint.name)));
        let imus = robot.imus.iter().map(|imu| of(&format!("imu_age/{}", imu.name)));
        Telemetry {
            wake_latency_us: of("wake_latency"),
            transmit_us: of("transmit"),
            reply_latency_us: of("reply_latency"),
            setpoint_age_us: of("setpoint_age"),
            cycle_us: of("cycle"),
            publication_us: of("publication"),
            delivery_us: of("delivery"),
            polled_us: of("polled"),
            control_latency_us: of("control_latency"),
            control: control.collect(),
            joints: joints.collect(),
            imus: imus.collect(),
            network: self.counters.network.as_ref().map(|counted| NetworkLatency {
                round_trip_us: of("network_round_trip"),
                state_age_us: of("network_state_age"),
                state_interval_us: of("network_state_interval"),
                ..counted.clone()
            }),
            ..self.counters.clone()
        }
    }
}

/// Returns the percentiles for tables.
pub(crate) fn percentiles(values: &Histogram<u64>) -> Percentiles {
    Percentiles::of(values.len(), values.max(), |quantile| values.value_at_quantile(quantile))
}

/// Decodes a histogram in the formats of HdrHistogram.
pub(crate) fn histogram(bytes: &[u8]) -> Option<Histogram<u64>> {
    Deserializer::new().deserialize(&mut &bytes[..]).ok()
}

/// Returns the values of `now` without those of `before`. The daemon sends large histograms with
/// fewer digits.
fn difference(now: &Histogram<u64>, before: Option<&Histogram<u64>>) -> Histogram<u64> {
    let Some(before) = before else { return now.clone() };
    let digits = now.sigfig().min(before.sigfig());
    let (mut difference, before) = (rounded(now, digits), rounded(before, digits));
    match difference.subtract(&before) {
        Ok(()) => difference,
        // The daemon reset them between the two requests.
        Err(_) => now.clone(),
    }
}

/// Returns the values with `digits` significant digits.
fn rounded(values: &Histogram<u64>, digits: u8) -> Histogram<u64> {
    if values.sigfig() == digits {
        return values.clone();
    }
    let mut rounded = Histogram::new_with_bounds(values.low(), values.high(), digits)
        .expect("they are bounds of a histogram, and the digits those of another");
    rounded.add(values).expect("their bounds are the same");
    rounded
}

/// Returns the counters of `now` minus those of `before`, apart from `resets`. The percentiles of
/// the result are unset.
fn counted(now: &Telemetry, before: &Telemetry) -> Telemetry {
    let control = now.control.iter().zip(&before.control).map(|(now, before)| ControlLatency {
        cycles: now
            .cycles
            .iter()
            .zip(&before.cycles)
            .map(|(now, before)| now.saturating_sub(*before))
            .collect(),
        ..ControlLatency::default()
    });
    let network = now.network.as_ref().map(|now| {
        let before = before.network.clone().unwrap_or_default();
        let lost = now.lost.saturating_sub(before.lost);
        let refused = now.refused.saturating_sub(before.refused);
        NetworkLatency { lost, refused, ..NetworkLatency::default() }
    });
    Telemetry {
        network,
        resets: now.resets,
        cycles: now.cycles.saturating_sub(before.cycles),
        overruns: now.overruns.saturating_sub(before.overruns),
        seconds: (now.seconds - before.seconds).max(0.0),
        missed_replies: now.missed_replies.saturating_sub(before.missed_replies),
        polled_in_vain: now.polled_in_vain.saturating_sub(before.polled_in_vain),
        polled_reads: now.polled_reads.saturating_sub(before.polled_reads),
        plant_lost_us: now.plant_lost_us.saturating_sub(before.plant_lost_us),
        dropped_records: now.dropped_records.saturating_sub(before.dropped_records),
        control: control.collect(),
        ..Telemetry::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn total(values: &[u64]) -> Histogram<u64> {
        let mut total = Histogram::new_with_bounds(1, 10_000_000_000, 3).unwrap();
        values.iter().for_each(|value| total.record(*value).unwrap());
        total
    }

    fn snapshot(boot_id: u64, resets: u64, cycles: u64, wake: Histogram<u64>) -> Snapshot {
        let telemetry = Telemetry { resets, cycles, ..Telemetry::default() };
        let histograms = Histograms::from([("wake_latency".to_owned(), wake)]);
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
    fn reset_totals_count_completely() {
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
    fn malformed_histograms_are_rejected() {
        for bytes in [&b""[..], b"HDR", &[0x1c, 0x84, 0x93, 0x14, 0, 0, 0, 2, 1, 1], &[0xff; 64]] {
            assert!(histogram(bytes).is_none());
        }
    }
}
