//! The robot as its fleet sees it: its summary twice a second, each change of a group at once, and
//! its latencies every ten seconds.

use super::robot::Robot;
use crate::network::{Keys, NetworkError};
use crate::summary::{GroupSummary, Summary};
use motord_ports::{ClientPorts, Question};
use motord_shared::description::RobotDescription;
use motord_shared::{AdminRequest, Operation, StateMessage};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::{Session, Wait};

/// Between two summaries.
const SUMMARY: Duration = Duration::from_millis(500);
/// Between two reports of latencies.
const LATENCY: Duration = Duration::from_secs(10);

/// The publishers of a robot for its fleet.
pub(super) struct Fleet<'a> {
    name: String,
    status: Publisher<'a>,
    events: Publisher<'a>,
    latency: Publisher<'a>,
    /// The robot of the daemon that runs.
    description: Option<RobotDescription>,
    groups: Vec<GroupSummary>,
    summarised: Option<Instant>,
    measured: Instant,
    question: Option<Question>,
}

impl<'a> Fleet<'a> {
    pub(super) fn new(name: &str, session: &Session, keys: &Keys) -> Result<Self, NetworkError> {
        let publisher = |key: String| {
            let publisher = session.declare_publisher(key).congestion_control(CongestionControl::Drop);
            publisher.priority(Priority::DataLow).wait().map_err(NetworkError::of)
        };
        Ok(Self {
            name: name.to_owned(),
            status: publisher(keys.status())?,
            events: publisher(keys.events())?,
            latency: publisher(keys.latency())?,
            description: None,
            groups: Vec::new(),
            summarised: None,
            measured: Instant::now(),
            question: None,
        })
    }

    /// Takes a state of the daemon.
    pub(super) fn take(&mut self, state: &StateMessage, robot: &Robot, ports: &ClientPorts) {
        if self.description.as_ref().is_none_or(|known| known.boot_id != state.boot_id) {
            self.description = describe(robot);
        }
        let Some(description) = &self.description else { return };
        let has_changed = self.groups.len() != state.groups().len()
            || self.groups.iter().zip(state.groups()).any(|(known, group)| !known.is(group));
        if has_changed || self.summarised.is_none_or(|at| at.elapsed() >= SUMMARY) {
            self.summarised = Some(Instant::now());
            let summary = Summary::of(&self.name, description, state);
            self.announce(&summary);
            put(&self.status, &summary);
            self.groups = summary.groups;
        }
        self.measure(ports);
    }

    /// Announces the groups that have changed.
    fn announce(&self, summary: &Summary) {
        for group in summary.groups.iter().filter(|group| !self.groups.contains(group)) {
            let time = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            let event = serde_json::json!({
                "robot": self.name,
                "boot_id": summary.boot_id,
                "cycle": summary.cycle,
                "time_unix_ms": time.as_millis() as u64,
                "group": group,
            });
            put(&self.events, &event);
        }
    }

    /// Asks the daemon for its latencies from time to time, and passes its answer on.
    fn measure(&mut self, ports: &ClientPorts) {
        if let Some(question) = self.question.take() {
            match question.answer() {
                Ok(Some((_, text))) => drop(self.latency.put(text).wait()),
                Ok(None) if self.measured.elapsed() < LATENCY => self.question = Some(question),
                Ok(None) | Err(_) => {}
            }
        } else if self.measured.elapsed() >= LATENCY {
            self.measured = Instant::now();
            let request = AdminRequest { operation: Operation::Telemetry.code(), ..AdminRequest::default() };
            self.question = ports.ask(request).ok();
        }
    }
}

impl GroupSummary {
    /// Returns whether phase, owner and cause are those of `state`.
    fn is(&self, state: &motord_shared::GroupState) -> bool {
        let phase = motord_shared::Phase::try_from(state.phase).map_or("unknown", motord_shared::Phase::name);
        self.phase == phase && self.owned == (state.lease != 0) && self.cause.is_some() == (state.cause != 0)
    }
}

fn describe(robot: &Robot) -> Option<RobotDescription> {
    let request = AdminRequest { operation: Operation::Describe.code(), ..AdminRequest::default() };
    let (_, text) = robot.link.ask(request).ok()?;
    serde_json::from_slice(&text).ok()
}

fn put(publisher: &Publisher<'_>, value: &impl serde::Serialize) {
    if let Ok(json) = serde_json::to_string(value) {
        // A slow link drops it.
        let _dropped = publisher.put(json).wait();
    }
}
