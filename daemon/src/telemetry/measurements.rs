//! The measurements of the cycle: histograms and metrics, and the answers and texts that come from
//! them.

use super::questions::Answers;
use motord_core::control::Event;
use motord_core::cycle::{Counters, Record};
use motord_metrics::{Distributions, Metrics, Names, Outputs};
use motord_settings::settings::Settings;
use motord_shared::StateMessage;
use motord_shared::description::GroupHistory;
use rtrb::Consumer;
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// All measurements since the start or the last reset.
pub(super) struct Measurements {
    records: Consumer<Record>,
    counters: Arc<Counters>,
    distributions: Distributions,
    metrics: Metrics,
    /// Takes the metrics as text; `None` where no output is configured.
    outputs: Option<Outputs>,
}

impl Measurements {
    /// Of a robot with these settings.
    pub(super) fn new(
        settings: &Settings,
        records: Consumer<Record>,
        counters: Arc<Counters>,
        outputs: Option<Outputs>,
    ) -> Self {
        let (motors, groups) = (settings.motors.len(), settings.groups.len());
        Self {
            records,
            counters,
            distributions: Distributions::new(motors, groups, settings.cycle.period)
                .with_imus(settings.sensors.imus.len()),
            metrics: Metrics::new(Names::of(settings)),
            outputs,
        }
    }

    /// Takes in every measurement that waits.
    pub(super) fn take(&mut self, answers: &mut Answers) {
        while let Ok(record) = self.records.pop() {
            self.distributions.record(&record);
        }
        while let Ok(delivery) = answers.deliveries.pop() {
            self.distributions.record_delivery(delivery);
        }
    }

    /// Takes in an event of the cycle.
    pub(super) fn record(&mut self, event: Event) {
        self.metrics.record(event);
    }

    /// The answer to a question for the histograms, from the one with number `from` on.
    pub(super) fn histograms(&self, from: usize) -> String {
        json(&self.distributions.histograms(from, self.metrics.names()))
    }

    /// The answer to a question for telemetry.
    pub(super) fn telemetry(&self, groups: Vec<GroupHistory>) -> String {
        let mut telemetry = self.distributions.telemetry(self.dropped());
        telemetry.groups = groups;
        telemetry.plant_lost_us = self.counters.plant_lost_us.load(Ordering::Relaxed);
        json(&telemetry)
    }

    /// Begins everything anew.
    pub(super) fn reset(&mut self) {
        self.distributions.reset(self.dropped());
    }

    /// Hands the metrics to the outputs, where there are some. `state` is a recent one.
    pub(super) fn expose(&self, state: &StateMessage) {
        if let Some(outputs) = &self.outputs {
            outputs.publish(self.metrics.text(&self.distributions, state, self.dropped()));
        }
    }

    fn dropped(&self) -> u64 {
        self.counters.dropped.load(Ordering::Relaxed)
    }
}

fn json(answer: &impl Serialize) -> String {
    serde_json::to_string(answer).expect("numbers, texts and lists of them are JSON")
}
