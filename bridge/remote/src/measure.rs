//! Counters and latencies of one side of the network.

use crate::admission::Refused;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use hdrhistogram::Histogram;
use hdrhistogram::serialization::{Serializer as _, V2DeflateSerializer};
use motord_shared::description::{EncodedHistogram, Percentiles};
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Largest latency that is recorded as it is, ns.
const LARGEST: u64 = 60_000_000_000;

/// Latencies of one quantity, ns, to 1 %.
#[derive(Debug)]
pub(crate) struct Latencies(Mutex<Histogram<u64>>);

impl Default for Latencies {
    fn default() -> Self {
        Self(Mutex::new(Histogram::new_with_bounds(1, LARGEST, 2).expect("these bounds are valid")))
    }
}

impl Latencies {
    /// Records a latency; one above a minute counts as a minute.
    pub(crate) fn record(&self, latency: Duration) {
        let ns = crate::frame::nanos(latency).clamp(1, LARGEST);
        self.with(|histogram| histogram.saturating_record(ns));
    }

    pub(crate) fn percentiles(&self) -> Percentiles {
        self.with(|histogram| {
            Percentiles::of(histogram.len(), histogram.max(), |share| histogram.value_at_quantile(share))
        })
    }

    /// Returns the histogram under `name`, as the daemon returns its own.
    pub(crate) fn encoded(&self, name: &str) -> Option<EncodedHistogram> {
        let mut bytes = Vec::new();
        self.with(|histogram| V2DeflateSerializer::new().serialize(histogram, &mut bytes)).ok()?;
        Some(EncodedHistogram { name: name.to_owned(), encoded: STANDARD.encode(&bytes) })
    }

    pub(crate) fn reset(&self) {
        self.with(Histogram::reset);
    }

    fn with<T>(&self, read: impl FnOnce(&mut Histogram<u64>) -> T) -> T {
        read(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Counters of the robot's side.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    counts: Mutex<Counts>,
    /// Upper bounds of the times from a controller's `send` to the arrival of its setpoint.
    pub(crate) setpoint_age: Latencies,
}

/// Numbers since the start.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Counts {
    /// Setpoints that were passed to the daemon.
    pub(crate) setpoints: u64,
    /// Samples of external IMUs that were passed to the daemon.
    pub(crate) samples: u64,
    /// Records that were sent to mirrors.
    pub(crate) records: u64,
    /// Requests that were passed to the daemon.
    pub(crate) requests: u64,
    /// Emergency stops.
    pub(crate) stops: u64,
    /// Frames that did not count, by reason.
    pub(crate) refused: BTreeMap<Refused, u64>,
}

impl Default for Counts {
    fn default() -> Self {
        let refused = Refused::ALL.map(|reason| (reason, 0)).into();
        Self { setpoints: 0, samples: 0, records: 0, requests: 0, stops: 0, refused }
    }
}

impl Counters {
    pub(crate) fn refuse(&self, reason: Refused) {
        self.change(|counts| *counts.refused.entry(reason).or_default() += 1);
    }

    pub(crate) fn change(&self, change: impl FnOnce(&mut Counts)) {
        change(&mut self.counts.lock().unwrap_or_else(PoisonError::into_inner));
    }

    pub(crate) fn counts(&self) -> Counts {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the counters and latencies as JSON.
    pub(crate) fn json(&self) -> String {
        #[derive(serde::Serialize)]
        struct Report {
            #[serde(flatten)]
            counts: Counts,
            setpoint_age_us: Percentiles,
        }
        let report = Report { counts: self.counts(), setpoint_age_us: self.setpoint_age.percentiles() };
        serde_json::to_string(&report).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn report_has_every_reason() {
        let counters = Counters::default();
        counters.refuse(Refused::Late);
        let report: serde_json::Value = serde_json::from_str(&counters.json()).unwrap();
        assert_eq!(report["refused"]["late"], 1);
        assert_eq!(report["refused"].as_object().unwrap().len(), Refused::ALL.len());
        assert_eq!((&report["setpoints"], &report["setpoint_age_us"]["count"]), (&0.into(), &0.into()));
    }
}
