//! Claims from creation to release.

use super::fake_daemon::Running;
use super::{PATIENCE, connect, place, until};
use motord_client::{Cause, Error, Phase, Refusal, Setpoint, Stop};
use std::sync::atomic::Ordering;
use std::time::Duration;

#[test]
fn states_report_a_claim_taken_away() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let (client, other) = (connect(&place), connect(&place));
    let claim = client.claim("leg").unwrap();
    for _ in 0..20 {
        client.wait(PATIENCE).unwrap().of(&claim).unwrap();
    }
    other.force_release("leg").unwrap();
    let lost = until("the loss", || client.wait(PATIENCE).unwrap().of(&claim).err());
    assert_eq!(lost, Error::ClaimLost { group: "leg".into() });
    assert!(lost.is_transient());
}

#[test]
fn setpoints_continue_while_waiting_for_the_group() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let (client, operator) = (connect(&place), connect(&place));
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    claim.enable().unwrap();
    let before = daemon.setpoints().len();
    claim.wait_for(Phase::Active, PATIENCE).unwrap();
    operator.wait_for("leg", Phase::Starting, PATIENCE).unwrap();
    assert!(client.wait(PATIENCE).unwrap().of(&claim).unwrap().must_be_active().is_ok());
    assert!(daemon.setpoints().len() > before, "the daemon received setpoints of the waiting owner");
    let expected = Error::NotReached {
        group: "leg".into(),
        phase: Some(Phase::Active),
        expected: Phase::Disarmed,
        waited: Duration::from_millis(20),
    };
    assert_eq!(operator.wait_for("leg", Phase::Disarmed, Duration::from_millis(20)), Err(expected));
    claim.disable().unwrap();
    claim.wait_for(Phase::Disarmed, PATIENCE).unwrap();
}

#[test]
fn starting_group_asks_for_patience_not_enable() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    let error = until("a start", || {
        claim.enable().unwrap();
        let state = client.wait(PATIENCE).unwrap();
        let group = state.of(&claim).unwrap();
        group.must_be_active().err().filter(|_| group.phase() == Some(Phase::Starting))
    });
    assert_eq!(error.to_string(), "group leg does not follow setpoints yet: it is starting");
    assert!(error.is_transient());
}

#[test]
fn stop_during_start_reports_cause_and_joint() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    claim.enable().unwrap();
    daemon.cause.store(Cause::MotorLost.code(), Ordering::Relaxed);
    let stop = Stop::Cause { cause: Cause::MotorLost, joint: Some("knee".into()), pid: None };
    let stopped = Error::Stopped { group: "leg".into(), stop: stop.clone() };
    client.wait(PATIENCE).unwrap();
    assert_eq!(claim.wait_for(Phase::Active, 4 * PATIENCE), Err(stopped.clone()));
    assert_eq!(client.wait(PATIENCE).unwrap().of(&claim).unwrap().must_be_active(), Err(stopped.clone()));
    assert_eq!(client.wait(PATIENCE).unwrap().of(&claim).unwrap().stop(), Some(stop));
    assert_eq!(
        stopped.to_string(),
        "group leg was stopped: A motor stopped answering (joint knee). Check the motor's power, its CAN cable and its id, \
         then reset the group"
    );
    claim.wait_for(Phase::Disarmed, PATIENCE).unwrap();
}

#[test]
fn setpoint_with_wrong_joint_count_is_not_sent() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    assert_eq!(claim.send(&[Setpoint::damping(1.0)]), Err(Error::SetpointCount { expected: 2, received: 1 }));
    client.wait(PATIENCE).unwrap();
    assert_eq!(daemon.setpoints(), []);
}

#[test]
fn one_setpoint_is_enough_to_enable() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    for _ in 0..20 {
        let mut claim = client.claim("leg").unwrap();
        let early = claim.enable().unwrap_err();
        assert!(matches!(early, Error::Refused { refusal: Refusal::NoSetpoint, .. }), "{early}");
        claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
        claim.enable().unwrap();
    }
}

#[test]
fn a_dropped_claim_leaves_the_group_to_others() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let (first, second) = (connect(&place), connect(&place));
    let claim = first.claim("leg").unwrap();
    let refused = second.claim("leg").unwrap_err();
    assert!(matches!(refused, Error::Refused { refusal: Refusal::Owned, .. }), "{refused}");
    assert!(refused.to_string().contains("process 4321"), "{refused}");
    drop(claim);
    second.claim("leg").unwrap().release().unwrap();
    first.claim("leg").unwrap();
    let unknown = first.claim("arm").unwrap_err();
    assert!(unknown.to_string().contains("leg"), "{unknown}");
}
