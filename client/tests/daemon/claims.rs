//! Claims from creation to release.

use super::fake_daemon::Running;
use super::{TIMEOUT, connect, directory, until};
use motord_client::{Cause, Claim, Client, Error, Lateness, Phase, Refusal, Setpoint, Stop};
use std::sync::atomic::Ordering;
use std::time::Duration;

#[test]
fn states_report_a_claim_taken_away() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let (client, other) = (connect(&directory), connect(&directory));
    let claim = client.claim("leg").unwrap();
    for _ in 0..20 {
        client.wait(TIMEOUT).unwrap().of(&claim).unwrap();
    }
    other.force_release("leg").unwrap();
    let lost = until("the loss", || client.wait(TIMEOUT).unwrap().of(&claim).err());
    assert_eq!(lost, Error::ClaimLost { group: "leg".into() });
    assert!(lost.is_transient());
}

#[test]
fn setpoints_continue_while_waiting_for_the_group() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let (client, operator) = (connect(&directory), connect(&directory));
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    claim.enable().unwrap();
    let before = daemon.setpoints().len();
    claim.wait_for(Phase::Active, TIMEOUT).unwrap();
    operator.wait_for("leg", Phase::Starting, TIMEOUT).unwrap();
    assert!(client.wait(TIMEOUT).unwrap().of(&claim).unwrap().must_be_active().is_ok());
    assert!(daemon.setpoints().len() > before, "the daemon received setpoints of the waiting owner");
    let expected = Error::NotReached {
        group: "leg".into(),
        phase: Some(Phase::Active),
        expected: Phase::Disarmed,
        waited: Duration::from_millis(20),
    };
    assert_eq!(operator.wait_for("leg", Phase::Disarmed, Duration::from_millis(20)), Err(expected));
    claim.disable().unwrap();
    claim.wait_for(Phase::Disarmed, TIMEOUT).unwrap();
}

#[test]
fn starting_group_asks_to_wait_not_enable() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    let error = until("a start", || {
        claim.enable().unwrap();
        let state = client.wait(TIMEOUT).unwrap();
        let group = state.of(&claim).unwrap();
        group.must_be_active().err().filter(|_| group.phase() == Some(Phase::Starting))
    });
    assert_eq!(error.to_string(), "group leg does not follow setpoints yet: it is starting");
    assert!(error.is_transient());
}

#[test]
fn stop_during_start_reports_cause_and_joint() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    claim.enable().unwrap();
    daemon.cause.store(Cause::MotorLost.code(), Ordering::Relaxed);
    let stop = Stop::Cause { cause: Cause::MotorLost, joint: Some("knee".into()), pid: None, lateness: None };
    let stopped = Error::Stopped { group: "leg".into(), stop: stop.clone() };
    client.wait(TIMEOUT).unwrap();
    assert_eq!(claim.wait_for(Phase::Active, 4 * TIMEOUT), Err(stopped.clone()));
    assert_eq!(client.wait(TIMEOUT).unwrap().of(&claim).unwrap().must_be_active(), Err(stopped.clone()));
    assert_eq!(client.wait(TIMEOUT).unwrap().of(&claim).unwrap().stop(), Some(stop));
    assert_eq!(
        stopped.to_string(),
        "group leg was stopped: A motor stopped answering (joint knee). Check the motor's power, its CAN cable and its id, \
         then reset the group"
    );
    claim.wait_for(Phase::Disarmed, TIMEOUT).unwrap();
}

/// Claims the group, and starts it.
fn active(client: &Client) -> Claim {
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    claim.enable().unwrap();
    claim.wait_for(Phase::Active, TIMEOUT).unwrap();
    claim
}

/// The loop of a slow controller has its first state a period later.
#[test]
fn last_setpoints_of_start_get_longest_horizon() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = active(&client);
    let horizons = || daemon.setpoints().iter().map(|message| message.horizon_ns).collect::<Vec<_>>();
    let sent = until("the last setpoint", || Some(horizons()).filter(|all| all.last() == Some(&40_000_000)));
    assert!(sent[..sent.len() - 1].iter().all(|horizon| *horizon == 0));
    claim.commit().unwrap();
    until("the own horizon", || horizons().last().filter(|horizon| **horizon == 0).copied());
    let before = daemon.setpoints().len();
    claim.keep_for(Duration::from_millis(1)).unwrap();
    client.wait(TIMEOUT).unwrap();
    client.wait(TIMEOUT).unwrap();
    assert_eq!(daemon.setpoints().len(), before, "the last one is young enough");
    claim.keep_for(Duration::from_millis(45)).unwrap();
    until("what 45 ms need", || horizons().last().filter(|horizon| **horizon == 25_000_000).copied());
}

/// Goal: a repetition is no late answer to the state of the setpoint before.
#[test]
fn repeated_setpoints_answer_no_state() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = active(&client);
    let answered = || daemon.setpoints().last().map(|message| message.cycle);
    client.wait(TIMEOUT).unwrap();
    claim.commit().unwrap();
    until("an answer", || answered().filter(|cycle| *cycle > 0));
    claim.repeat().unwrap();
    until("a repetition", || answered().filter(|cycle| *cycle == 0));
}

/// Goal: a claim measures its own stop, after it has seen that of its predecessor.
#[test]
fn stop_of_predecessor_hides_no_later_gap() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    daemon.cause.store(Cause::SetpointTimeout.code(), Ordering::Relaxed);
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    let error = claim.wait_for(Phase::Active, TIMEOUT).unwrap_err();
    let of_predecessor = matches!(
        &error,
        Error::Stopped { stop: Stop::Cause { cause: Cause::SetpointTimeout, lateness: None, .. }, .. }
    );
    assert!(of_predecessor, "{error:?}");
    daemon.cause.store(0, Ordering::Relaxed);
    claim.enable().unwrap();
    claim.wait_for(Phase::Active, TIMEOUT).unwrap();
    std::thread::sleep(Duration::from_millis(80));
    daemon.cause.store(Cause::SetpointTimeout.code(), Ordering::Relaxed);
    let error = until("the stop", || client.wait(TIMEOUT).unwrap().of(&claim).err());
    let is_measured = matches!(&error, Error::Stopped { stop: Stop::Cause { lateness: Some(_), .. }, .. });
    assert!(is_measured, "{error:?}");
}

#[test]
fn late_owner_gets_stop_with_measured_gap() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = active(&client);
    std::thread::sleep(Duration::from_millis(80));
    daemon.cause.store(Cause::SetpointTimeout.code(), Ordering::Relaxed);
    let error = until("the stop", || client.wait(TIMEOUT).unwrap().of(&claim).err());
    let Error::Stopped { stop: Stop::Cause { cause, lateness: Some(late), .. }, .. } = error.clone() else {
        panic!("{error}")
    };
    let [horizon, timeout] = [40, 20].map(Duration::from_millis);
    assert_eq!((cause, late), (Cause::SetpointTimeout, Lateness { gap: late.gap, horizon, timeout }));
    assert!(late.gap >= Duration::from_millis(80) && late.gap < TIMEOUT, "{late:?}");
    let text = error.to_string();
    let gap = late.gap.as_nanos() as f64 / 1e6;
    for part in
        [&*format!("sent none for {gap:.1} ms"), "setpoint-timeout-ms is 20", "claim and enable it again"]
    {
        assert!(text.contains(part), "{text}");
    }
    assert!(!error.is_transient());
    for _ in 0..3 {
        assert_eq!(claim.send(&[Setpoint::damping(1.0); 2]), Err(error.clone()), "and from then on");
    }
}

#[test]
fn setpoints_after_a_stop_fail_until_reset() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = active(&client);
    daemon.cause.store(Cause::EmergencyStop.code(), Ordering::Relaxed);
    let error = until("the stop", || claim.commit().err());
    assert!(matches!(error, Error::Stopped { stop: Stop::Cause { cause: Cause::EmergencyStop, .. }, .. }));
    assert_eq!(claim.send(&[Setpoint::damping(1.0); 2]), Err(error));
    let before = daemon.setpoints().len();
    until("setpoints that keep the claim", || {
        client.wait(TIMEOUT).unwrap();
        assert!(claim.commit().is_err());
        (daemon.setpoints().len() > before).then_some(())
    });
    daemon.cause.store(0, Ordering::Relaxed);
    until("the reset", || claim.commit().ok());
    drop(claim);
    // A new claim sends before a person has reset the group.
    daemon.cause.store(Cause::EmergencyStop.code(), Ordering::Relaxed);
    let mut claim = client.claim("leg").unwrap();
    for _ in 0..5 {
        client.wait(TIMEOUT).unwrap();
        claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    }
}

#[test]
fn setpoints_of_a_removed_owner_fail() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let (client, other) = (connect(&directory), connect(&directory));
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    other.force_release("leg").unwrap();
    let lost = until("the loss", || claim.commit().err());
    assert_eq!(lost, Error::ClaimLost { group: "leg".into() });
}

#[test]
fn release_of_lost_claim_succeeds_and_takes_nothing() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let (first, second) = (connect(&directory), connect(&directory));
    let claim = first.claim("leg").unwrap();
    second.force_release("leg").unwrap();
    let _owner = second.claim("leg").unwrap();
    claim.release().unwrap();
    let refused = first.claim("leg").unwrap_err();
    assert!(matches!(refused, Error::Refused { refusal: Refusal::Owned, .. }), "{refused}");
}

#[test]
fn setpoint_with_wrong_joint_count_is_not_sent() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    assert_eq!(claim.send(&[Setpoint::damping(1.0)]), Err(Error::SetpointCount { expected: 2, received: 1 }));
    client.wait(TIMEOUT).unwrap();
    assert_eq!(daemon.setpoints(), []);
}

#[test]
fn one_setpoint_is_enough_to_enable() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
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
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let (first, second) = (connect(&directory), connect(&directory));
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
