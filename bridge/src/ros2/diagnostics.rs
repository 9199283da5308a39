//! `/diagnostics`: the daemon, the groups with their refused commands, the buses and the motors.

use crate::link::GroupLink;
use crate::refusal::Refusal;
use crate::ros2::messages::{DiagnosticArray, DiagnosticStatus, KeyValue};
use crate::ros2::stamp::header;
use crate::shared::{Report, Shared, Snapshot};
use motord_client::{Bus, BusCondition, Cause, Fault, Group, Joint, MotorMode};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Levels of `diagnostic_msgs/DiagnosticStatus`.
const OK: u8 = 0;
const WARN: u8 = 1;
const ERROR: u8 = 2;

/// Returns the status of everything. The stamp is that of the state.
pub(crate) fn array(report: &Report, shared: &Shared) -> DiagnosticArray {
    match report {
        Report::Down(reason) => {
            let status = status(shared, "daemon", ERROR, reason.clone(), Vec::new());
            DiagnosticArray { header: header(Duration::ZERO, ""), status: vec![status] }
        }
        Report::State(snapshot) => {
            let mut all = vec![daemon(snapshot, shared)];
            let groups = shared.groups.iter().zip(snapshot.state.groups());
            all.extend(groups.map(|(link, state)| group(link, &state, shared)));
            let buses = shared.robot.buses.iter().zip(snapshot.state.buses());
            all.extend(buses.map(|(name, state)| bus(name, &state, shared)));
            let joints = shared.robot.joints.iter().zip(snapshot.state.joints());
            all.extend(joints.map(|(description, state)| motor(&description.name, &state, shared)));
            DiagnosticArray { header: header(snapshot.state.age(), ""), status: all }
        }
    }
}

fn status(
    shared: &Shared,
    part: &str,
    level: u8,
    message: String,
    values: Vec<KeyValue>,
) -> DiagnosticStatus {
    let hardware_id = shared.robot.instance.clone();
    DiagnosticStatus { level, name: format!("motord: {part}"), message, hardware_id, values }
}

fn value(key: &str, value: impl ToString) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}

fn known(key: &str, number: Option<impl ToString>) -> KeyValue {
    value(key, number.map_or_else(|| "unknown".to_owned(), |number| number.to_string()))
}

fn daemon(snapshot: &Snapshot, shared: &Shared) -> DiagnosticStatus {
    let state = &snapshot.state;
    let values = vec![
        value("version", &shared.robot.version),
        value("cycle", state.cycle()),
        value("missed ticks", state.overruns()),
        value("real-time", state.realtime()),
        value("emergency stop", state.emergency_stop()),
        value("configuration file changed", state.config_changed()),
        known("lowest supply voltage, V", snapshot.battery()),
    ];
    let (level, message) = match (state.shutting_down(), state.emergency_stop()) {
        (true, _) => (ERROR, "motord is shutting down"),
        (_, true) => (ERROR, "the emergency stop is latched"),
        _ => (OK, "running"),
    };
    status(shared, "daemon", level, message.to_owned(), values)
}

fn group(link: &GroupLink, state: &Group, shared: &Shared) -> DiagnosticStatus {
    let phase = state.phase.map_or("unknown", |phase| phase.name());
    let joint = state.cause_joint.and_then(|joint| shared.robot.joints.get(joint));
    let mut values = vec![
        value("phase", phase),
        value("cause", state.cause.map_or("none", Cause::name)),
        value("advice", state.cause.map_or("none", Cause::advice)),
        value("joint of the cause", joint.map_or("none", |joint| &joint.name)),
        known("process of the cause", state.cause_pid),
        value("owned", state.owned),
        value("claimed by the bridge", link.gate.claim().is_some()),
        value("accepted", link.counters.accepted.load(Ordering::Relaxed)),
        value("clamped", link.counters.clamped.load(Ordering::Relaxed)),
        value("timeouts", link.counters.timeouts.load(Ordering::Relaxed)),
    ];
    let refused =
        |refusal: &Refusal| value(&format!("refused {}", refusal.name()), link.counters.refused(*refusal));
    values.extend(Refusal::ALL.iter().map(refused));
    let (level, message) = match (state.latched, state.cause) {
        (true, Some(cause)) => (ERROR, format!("stopped: {} {}.", cause.sentence(), cause.advice())),
        (true, None) => (ERROR, "stopped for a cause that this version does not know".to_owned()),
        (false, _) => (OK, phase.to_owned()),
    };
    status(shared, &format!("group {}", link.group.name), level, message, values)
}

fn bus(name: &str, state: &Bus, shared: &Shared) -> DiagnosticStatus {
    let level = match state.condition {
        Some(BusCondition::Active) => OK,
        Some(BusCondition::Warning | BusCondition::Passive) => WARN,
        _ => ERROR,
    };
    let message = state.condition.map_or("in an unknown condition", BusCondition::sentence);
    let values = vec![
        value("condition", state.condition.map_or("unknown", |condition| condition.name())),
        value("sent", state.sent),
        value("dropped", state.dropped),
        value("received", state.received),
        value("errors", state.errors),
        value("lost", state.lost),
    ];
    status(shared, &format!("bus {name}"), level, message.to_owned(), values)
}

fn motor(name: &str, joint: &Joint, shared: &Shared) -> DiagnosticStatus {
    let mode = joint.mode;
    let faults: Vec<String> = joint.faults.names().collect();
    let (level, message) = if !joint.faults.is_empty() {
        let sentences = joint.faults.iter().map(Fault::sentence).collect::<Vec<_>>();
        (ERROR, format!("{}: {}", faults.join(", "), sentences.join(" ")))
    } else if joint.mismatch {
        (ERROR, "the motor differs from its configuration: see the log of motord".to_owned())
    } else {
        let level = if matches!(mode, Some(MotorMode::Offline) | None) { WARN } else { OK };
        (level, mode.map_or("in an unknown mode", MotorMode::sentence).to_owned())
    };
    let values = vec![
        value("mode", mode.map_or("unknown", |mode| mode.name())),
        value("faults", joint.faults),
        known("temperature, °C", joint.temperature),
        known("supply voltage, V", joint.supply_voltage),
        known("age of the last reply, ms", joint.age().map(|age| age.as_secs_f64() * 1e3)),
        value("missed replies", joint.missed),
        value("limited cycles", joint.clamped),
    ];
    status(shared, &format!("motor {name}"), level, message, values)
}
