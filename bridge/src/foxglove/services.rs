//! The services: the stop, and a summary.

use crate::foxglove::channels::json_schema;
use crate::shared::Shared;
use crate::stop::{NO_RECEIPT, Receipt, StopDesk};
use foxglove::websocket::service::{Service, ServiceSchema};
use motord_client::{Cause, MotorMode, Phase, RobotDescription, State, StateMessage};
use serde_json::{Value, json};
use std::sync::Arc;

/// Returns the services. No other one exists: a viewer cannot move the robot.
pub(crate) fn all(shared: &Arc<Shared>, desk: &Arc<StopDesk>) -> Vec<Service> {
    vec![stop(desk), status(shared)]
}

fn schema(name: &str, response: &Value) -> ServiceSchema {
    ServiceSchema::new(name)
        .with_request("json", json_schema(&format!("{name}Request"), &json!({})))
        .with_response("json", json_schema(&format!("{name}Response"), response))
}

fn stop(desk: &Arc<StopDesk>) -> Service {
    let example = json!({ "message": "", "confirmed": [""] });
    let desk = Arc::clone(desk);
    Service::builder("/motord/stop", schema("motord.Stop", &example)).async_handler_fn(move |request| {
        let source = format!("the Foxglove viewer {}", request.client_id());
        // Before anything else: the request counts also if its caller disconnects now.
        let receipt = desk.request(source);
        async move {
            match receipt.recv().await {
                Ok(receipt) => answer(&receipt),
                Err(_) => Err(NO_RECEIPT.to_owned()),
            }
        }
    })
}

/// Returns the receipt as the answer. One without each motor's confirmation is an error.
fn answer(receipt: &Receipt) -> Result<Vec<u8>, String> {
    let Receipt { is_confirmed, message, confirmed, .. } = receipt;
    match (is_confirmed, confirmed.is_empty()) {
        (true, _) => Ok(json!({ "message": message, "confirmed": confirmed }).to_string().into_bytes()),
        (false, true) => Err(message.clone()),
        (false, false) => Err(format!("{message} Confirmed: {}.", confirmed.join(", "))),
    }
}

fn status(shared: &Arc<Shared>) -> Service {
    let example = summary(&shared.robot, &State::from(&StateMessage::default()));
    let shared = Arc::clone(shared);
    Service::builder("/motord/status", schema("motord.Status", &example)).handler_fn(move |_| {
        let state = shared.latest.newest().ok_or("no state of motord has arrived yet")?;
        Ok::<_, &str>(summary(&shared.robot, &state).to_string().into_bytes())
    })
}

/// Returns phases and causes, and the joints.
fn summary(robot: &RobotDescription, state: &State) -> Value {
    let name_of =
        |joint: Option<usize>| joint.and_then(|joint| robot.joints.get(joint)).map(|joint| &joint.name);
    let groups = robot.groups.iter().zip(state.groups()).map(|(group, now)| {
        json!({
            "name": group.name,
            "phase": now.phase.map(Phase::name),
            "is_latched": now.latched,
            "cause": now.cause.map(Cause::name),
            "sentence": now.cause.map(Cause::sentence),
            "advice": now.cause.map(Cause::advice),
            "joint": name_of(now.cause_joint),
            "pid": now.cause_pid,
            "has_owner": now.owned,
        })
    });
    let joints = robot.joints.iter().zip(state.joints()).map(|(joint, now)| {
        json!({
            "name": joint.name,
            "position_rad": now.position(),
            "velocity_rad_s": now.velocity(),
            "torque_nm": now.torque(),
            "temperature_c": now.temperature,
            "supply_v": now.supply_voltage,
            "mode": now.mode.map(MotorMode::name),
            "faults": now.faults.names().collect::<Vec<_>>(),
        })
    });
    json!({
        "instance": robot.instance,
        "cycle": state.cycle(),
        "age_ms": state.age().as_secs_f64() * 1e3,
        "emergency_stop": state.emergency_stop(),
        "missed_ticks": state.overruns(),
        "groups": groups.collect::<Vec<_>>(),
        "joints": joints.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::{GroupDescription, JointDescription};
    use std::time::Duration;

    fn robot() -> RobotDescription {
        let joint = |name: &str| JointDescription { name: name.to_owned(), ..Default::default() };
        let group = GroupDescription { name: "legs".to_owned(), joints: vec![0, 1] };
        RobotDescription {
            joints: ["hip", "knee"].map(joint).into(),
            groups: vec![group],
            ..Default::default()
        }
    }

    fn receipt(is_confirmed: bool, confirmed: &[&str], unconfirmed: &[&str]) -> Receipt {
        let [confirmed, unconfirmed] =
            [confirmed, unconfirmed].map(|names| names.iter().map(|name| (*name).to_owned()).collect());
        let message = "A sentence.".to_owned();
        Receipt { is_confirmed, message, confirmed, unconfirmed, after: Duration::ZERO }
    }

    #[test]
    fn receipt_names_the_motors_that_confirmed() {
        let all = answer(&receipt(true, &["hip", "knee"], &[])).unwrap();
        assert_eq!(
            String::from_utf8(all).unwrap(),
            r#"{"confirmed":["hip","knee"],"message":"A sentence."}"#
        );
        let part = answer(&receipt(false, &["knee"], &["hip"])).unwrap_err();
        assert_eq!(part, "A sentence. Confirmed: knee.");
        assert_eq!(answer(&receipt(false, &[], &["hip", "knee"])).unwrap_err(), "A sentence.");
    }

    #[test]
    fn summary_names_cause_and_joint() {
        let mut message = StateMessage { joint_count: 2, group_count: 1, ..StateMessage::default() };
        (message.groups[0].cause, message.groups[0].cause_joint) = (Cause::MotorFault.code(), 1);
        let found = summary(&robot(), &State::from(&message));
        let group = &found["groups"][0];
        assert_eq!((&group["cause"], &group["joint"]), (&json!("motor-fault"), &json!("knee")));
        assert_eq!(found["joints"][0]["position_rad"], Value::Null, "the motor has not replied");
    }
}
