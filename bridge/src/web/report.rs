//! The state as JSON, for the page and for programs.

use crate::shared::{Report, Shared, Snapshot};
use crate::stop::{LastStop, Receipt};
use motord_client::{Bus, BusCondition, Cause, Fault, Group, Joint, MotorMode, Phase, State};
use serde::Serialize;

/// Everything that the page shows.
#[derive(Debug, Serialize)]
struct PageState<'a> {
    instance: &'a str,
    version: &'a str,
    /// Process of the bridge, which the daemon names as the cause of its stops.
    bridge_pid: u32,
    /// The reason why no newer state arrives.
    down: Option<&'a str>,
    last_stop: Option<StopState>,
    #[serde(flatten)]
    robot: Option<RobotState<'a>>,
}

/// A state of the daemon.
#[derive(Debug, Serialize)]
struct RobotState<'a> {
    /// Time since the daemon published it.
    age_ms: f64,
    cycle: u64,
    emergency_stop: bool,
    shutting_down: bool,
    /// Lowest supply voltage that a motor reports, V.
    battery_v: Option<f32>,
    groups: Vec<GroupState<'a>>,
    joints: Vec<JointState<'a>>,
    buses: Vec<BusState<'a>>,
}

#[derive(Debug, Serialize)]
struct GroupState<'a> {
    name: &'a str,
    phase: &'static str,
    owned: bool,
    latched: bool,
    cause: Option<&'static str>,
    sentence: Option<&'static str>,
    advice: Option<&'static str>,
    joint: Option<&'a str>,
    /// The process that requested the stop.
    pid: Option<u32>,
}

#[derive(Debug, Serialize)]
struct JointState<'a> {
    name: &'a str,
    mode: &'static str,
    /// rad.
    position: Option<f32>,
    /// °C.
    temperature: Option<f32>,
    faults: Vec<&'static str>,
    mismatch: bool,
}

#[derive(Debug, Serialize)]
struct BusState<'a> {
    name: &'a str,
    condition: &'static str,
    sentence: &'static str,
    is_healthy: bool,
}

#[derive(Debug, Serialize)]
struct StopState {
    source: String,
    others: usize,
    ago_ms: f64,
    #[serde(flatten)]
    receipt: ReceiptState,
}

/// A receipt as JSON.
#[derive(Debug, Serialize)]
struct ReceiptState {
    confirmed: bool,
    message: String,
    joints_confirmed: Vec<String>,
    joints_unconfirmed: Vec<String>,
    after_ms: f64,
}

impl From<Receipt> for ReceiptState {
    fn from(receipt: Receipt) -> Self {
        Self {
            confirmed: receipt.is_confirmed,
            message: receipt.message,
            joints_confirmed: receipt.confirmed,
            joints_unconfirmed: receipt.unconfirmed,
            after_ms: receipt.after.as_secs_f64() * 1e3,
        }
    }
}

/// The newest state, and why none follows.
#[derive(Debug, Default)]
pub(crate) struct Newest {
    snapshot: Option<Snapshot>,
    down: Option<String>,
}

impl Newest {
    pub(crate) fn update(&mut self, report: Report) {
        match report {
            Report::State(snapshot) => *self = Self { snapshot: Some(snapshot), down: None },
            Report::Down(reason) => self.down = Some(reason),
        }
    }

    /// Returns one line of JSON.
    pub(crate) fn json(&self, shared: &Shared, last: Option<LastStop>) -> String {
        let robot = self.snapshot.as_ref().map_or(&shared.robot, |snapshot| &snapshot.robot);
        let last_stop = last.map(|last| StopState {
            source: last.source,
            others: last.others,
            ago_ms: last.at.elapsed().as_secs_f64() * 1e3,
            receipt: last.receipt.into(),
        });
        let state = PageState {
            instance: &robot.instance,
            version: &robot.version,
            bridge_pid: std::process::id(),
            down: self.down.as_deref(),
            last_stop,
            robot: self.snapshot.as_ref().map(robot_state),
        };
        text(&state)
    }
}

/// Returns the receipt as JSON.
pub(crate) fn receipt(receipt: Receipt) -> String {
    text(&ReceiptState::from(receipt))
}

/// These types have no map and no fallible field: they always have a text.
fn text(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_else(|error| format!("{{\"down\":\"no JSON: {error}\"}}"))
}

fn robot_state(snapshot: &Snapshot) -> RobotState<'_> {
    let (state, robot): (&State, _) = (&snapshot.state, &snapshot.robot);
    let name_of = |index: usize| robot.joints.get(index).map(|joint| joint.name.as_str());
    RobotState {
        age_ms: state.age().as_secs_f64() * 1e3,
        cycle: state.cycle(),
        emergency_stop: state.emergency_stop(),
        shutting_down: state.shutting_down(),
        battery_v: snapshot.battery(),
        groups: robot
            .groups
            .iter()
            .zip(state.groups())
            .map(|(group, state)| group_state(&group.name, &state, state.cause_joint.and_then(name_of)))
            .collect(),
        joints: robot
            .joints
            .iter()
            .zip(state.joints())
            .map(|(joint, state)| joint_state(&joint.name, &state))
            .collect(),
        buses: robot.buses.iter().zip(state.buses()).map(|(name, bus)| bus_state(name, &bus)).collect(),
    }
}

fn group_state<'a>(name: &'a str, group: &Group, joint: Option<&'a str>) -> GroupState<'a> {
    let unknown = group.latched && group.cause.is_none();
    GroupState {
        name,
        phase: group.phase.map_or("unknown", Phase::name),
        owned: group.owned,
        latched: group.latched,
        cause: group.cause.map(Cause::name).or(unknown.then_some("unknown")),
        sentence: group.cause.map(Cause::sentence),
        advice: group.cause.map(Cause::advice),
        joint,
        pid: group.cause_pid,
    }
}

fn joint_state<'a>(name: &'a str, joint: &Joint) -> JointState<'a> {
    JointState {
        name,
        mode: joint.mode.map_or("unknown", MotorMode::name),
        position: joint.position(),
        temperature: joint.temperature,
        faults: joint.faults.iter().map(Fault::name).collect(),
        mismatch: joint.mismatch,
    }
}

fn bus_state<'a>(name: &'a str, bus: &Bus) -> BusState<'a> {
    BusState {
        name,
        condition: bus.condition.map_or("unknown", BusCondition::name),
        sentence: bus.condition.map_or("in an unknown condition", BusCondition::sentence),
        is_healthy: bus.condition == Some(BusCondition::Active),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::shared;
    use serde_json::Value;
    use std::time::{Duration, Instant};

    fn parsed(newest: &Newest, last: Option<LastStop>) -> Value {
        serde_json::from_str(&newest.json(&shared(), last)).unwrap()
    }

    #[test]
    fn page_without_state_has_no_age() {
        let state = parsed(&Newest::default(), None);
        assert_eq!((&state["instance"], &state["age_ms"]), (&Value::from("dog"), &Value::Null));
    }

    #[test]
    fn reason_without_states_is_reported() {
        let mut newest = Newest::default();
        newest.update(Report::Down("motord is \"gone\"".to_owned()));
        assert_eq!(parsed(&newest, None)["down"], "motord is \"gone\"");
    }

    #[test]
    fn last_stop_has_source_and_motors() {
        let receipt = Receipt {
            is_confirmed: false,
            message: "cut the power".to_owned(),
            confirmed: vec!["a".to_owned()],
            unconfirmed: vec!["b".to_owned()],
            after: Duration::from_millis(12),
        };
        let last = LastStop { source: "the page, anna".to_owned(), others: 2, receipt, at: Instant::now() };
        let stop = &parsed(&Newest::default(), Some(last))["last_stop"];
        assert_eq!((&stop["source"], &stop["others"]), (&"the page, anna".into(), &2.into()));
        assert_eq!((&stop["confirmed"], &stop["after_ms"]), (&false.into(), &12.0.into()));
        assert_eq!(stop["joints_unconfirmed"][0], "b");
    }
}
