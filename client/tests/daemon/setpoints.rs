//! Setpoints from the client to the daemon.

use super::fake_daemon::{Running, granted};
use super::{TIMEOUT, connect, directory, until};
use motord_client::{Client, Error, JointLimits, Rejection, Setpoint, State};
use motord_shared::JointSetpoint;
use std::sync::atomic::Ordering;
use std::time::Duration;

#[test]
fn setpoints_arrive_whole_with_rising_sequence() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 7);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    for turn in 0..50_u8 {
        client.wait(TIMEOUT).unwrap();
        claim.send(&[Setpoint::torque(f32::from(turn)), Setpoint::damping(f32::from(turn))]).unwrap();
    }
    until("the last setpoint", || daemon.setpoints().last().filter(|last| last.sequence == 50).copied());
    let seen = daemon.setpoints();
    assert!(seen.windows(2).all(|pair| pair[0].sequence < pair[1].sequence));
    assert!(seen.windows(2).all(|pair| pair[0].time_ns <= pair[1].time_ns));
    for setpoint in &seen {
        assert_eq!((setpoint.lease, setpoint.joint_count), (granted(7, 1), 2));
        assert_eq!(setpoint.joints[0].torque.to_bits(), setpoint.joints[1].kd.to_bits());
        assert!(setpoint.cycle > 0);
    }
}

/// Returns the setpoints of the last message, hip and knee.
fn last_of(daemon: &Running, sequence: u64) -> [JointSetpoint; 2] {
    let last =
        until("the setpoint", || daemon.setpoints().last().filter(|last| last.sequence == sequence).copied());
    [last.joints[0], last.joints[1]]
}

#[test]
fn setpoints_by_name_and_slot_reach_their_joints() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    let [knee, hip] = claim.slots(["knee", "hip"]).unwrap()[..] else { panic!("two slots") };
    claim.set("knee", Setpoint::torque(2.0)).unwrap();
    claim.set(hip, Setpoint::torque(1.0)).unwrap();
    claim.commit().unwrap();
    assert_eq!(last_of(&daemon, 1).map(|joint| joint.torque), [1.0, 2.0]);
    claim.set(knee, Setpoint::torque(3.0)).unwrap();
    claim.commit().unwrap();
    assert_eq!(last_of(&daemon, 2).map(|joint| joint.torque), [1.0, 3.0], "the hip keeps what it was given");
    assert_eq!(claim.setpoint("knee"), Ok(Setpoint::torque(3.0)));
    assert_eq!(claim.limits(knee), Ok(JointLimits::default()));
    let unknown = claim.set("toe", Setpoint::torque(0.0)).unwrap_err();
    assert!(unknown.to_string().contains("hip, knee"), "{unknown}");
}

/// The daemon would reject the whole group, and stop it a setpoint timeout later for a cause that
/// hides the mistake.
#[test]
fn invalid_setpoint_is_reported_immediately_and_changes_nothing() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    claim.set("knee", Setpoint::torque(1.0)).unwrap();
    for (bad, rejection) in [
        (Setpoint::torque(f32::NAN), Rejection::NotFinite),
        (Setpoint::hold(f32::INFINITY, 1.0, 1.0), Rejection::NotFinite),
        (Setpoint::damping(-1.0), Rejection::Negative),
    ] {
        let refused = Err(Error::BadSetpoint { joint: "knee".into(), rejection });
        assert_eq!(claim.set("knee", bad), refused);
        assert_eq!(claim.send(&[Setpoint::torque(2.0), bad]), refused);
    }
    let state = client.wait(TIMEOUT).unwrap();
    assert!(matches!(claim.hold(&state, f32::NAN, 0.5), Err(Error::BadSetpoint { .. })));
    assert!(matches!(claim.hold(&state, 5.0, -0.5), Err(Error::BadSetpoint { .. })));
    assert_eq!(claim.setpoint("knee"), Ok(Setpoint::torque(1.0)));
    assert_eq!(daemon.setpoints(), []);
}

/// A joint without a setpoint would be limp.
#[test]
fn group_is_not_sent_before_all_joints_set() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    claim.set("hip", Setpoint::damping(1.0)).unwrap();
    assert_eq!(claim.commit(), Err(Error::NotSet { joint: "knee".into() }));
    client.wait(TIMEOUT).unwrap();
    assert_eq!(daemon.setpoints(), []);
    claim.set("knee", Setpoint::damping(1.0)).unwrap();
    claim.commit().unwrap();
}

/// After a restart with another configuration it could be another joint.
#[test]
fn a_slot_of_another_claim_is_refused() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let old = client.claim("leg").unwrap().slot("knee").unwrap();
    let mut claim = client.claim("leg").unwrap();
    assert_eq!(claim.set(old, Setpoint::torque(1.0)), Err(Error::OtherClaim));
    assert_eq!(claim.limits(old), Err(Error::OtherClaim));
    let state = client.wait(TIMEOUT).unwrap();
    assert_eq!(state.of(&claim).unwrap().joint(old), Err(Error::OtherClaim));
}

/// Returns the next state whose second joint has replied or not, as `is_heard` requires.
fn state_with(client: &Client, is_heard: bool) -> State {
    until("such a state", || {
        Some(client.wait(TIMEOUT).unwrap())
            .filter(|state| state.joint(1).unwrap().position().is_some() == is_heard)
    })
}

#[test]
fn hold_needs_a_state_of_every_joint() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    daemon.mute.store(true, Ordering::Relaxed);
    let state = state_with(&client, false);
    let silent = Error::NotHeard { joint: "knee".into() };
    assert_eq!(claim.hold(&state, 5.0, 0.5), Err(silent.clone()));
    assert!(matches!(claim.commit(), Err(Error::NotSet { .. })), "nothing was set");
    let leg = state.of(&claim).unwrap();
    assert_eq!((leg.position("hip"), leg.position("knee"), leg.is_heard()), (Ok(0.5), Err(silent), false));
    daemon.mute.store(false, Ordering::Relaxed);
    let state = state_with(&client, true);
    claim.hold(&state, 5.0, 0.5).unwrap();
    claim.commit().unwrap();
    assert_eq!(
        last_of(&daemon, 1).map(|joint| (joint.position, joint.kp, joint.kd)),
        [(0.5, 5.0, 0.5), (1.5, 5.0, 0.5)]
    );
    let leg = state.of(&claim).unwrap();
    assert_eq!(leg.positions(), Ok(vec![0.5, 1.5]));
    assert_eq!(leg.joints().map(|(name, _)| name.to_owned()).collect::<Vec<_>>(), ["hip", "knee"]);
}

#[test]
fn group_holds_without_its_absent_excluded_joint() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    daemon.excluded.store(true, Ordering::Relaxed);
    daemon.mute.store(true, Ordering::Relaxed);
    let state = state_with(&client, false);
    let leg = state.of(&claim).unwrap();
    assert!(leg.is_heard() && leg.joint("knee").unwrap().is_excluded());
    claim.hold(&state, 5.0, 0.5).unwrap();
    claim.commit().unwrap();
    assert_eq!(last_of(&daemon, 1).map(|joint| (joint.position, joint.kp)), [(0.5, 5.0), (0.0, 0.0)]);
}

#[test]
fn horizon_is_sent_or_refused_by_the_client() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    let most = client.description().setpoint_horizon_max;
    claim.set_horizon(most).unwrap();
    let refused = claim.set_horizon(most + Duration::from_nanos(1)).unwrap_err();
    assert!(refused.to_string().contains("setpoint-horizon-max-ms"), "{refused}");
    claim.send(&[Setpoint::torque(1.0); 2]).unwrap();
    let sent = || daemon.setpoints().last().map(|last| last.horizon_ns);
    assert_eq!(until("the setpoint", sent), 40_000_000, "a refusal changes nothing");
    claim.set_horizon(Duration::ZERO).unwrap();
    claim.commit().unwrap();
    until("no horizon", || sent().filter(|horizon| *horizon == 0));
}
