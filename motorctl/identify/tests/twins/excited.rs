//! The excitation of a joint through the twin.

use crate::plant::Hidden;
use motord_identify::{Applied, Limits, Plan, Sample, Shape, Stage};
use motord_shared::{JointSetpoint, Limit, Operation, Phase};
use motord_twin::Twin;
use std::time::Duration;

pub(crate) const SHAPE: Shape = Shape { amplitude: None, seconds: 40.0, kp: 20.0, kd: 0.3 };

fn follow(twin: &mut Twin, joints: &[JointSetpoint]) {
    twin.send(0, joints, Duration::ZERO).unwrap();
    twin.step();
}

/// An enabled twin, and the limits of its joint. The other joints are damped.
fn enabled(hidden: &Hidden, seed: u64) -> (Twin, Vec<JointSetpoint>, Limits) {
    let mut twin = hidden.twin(seed);
    let rest = JointSetpoint { kd: 0.5, ..Default::default() };
    let mut joints = vec![rest; hidden.others + 1];
    (0..20).for_each(|_| twin.step());
    twin.ask(Operation::Claim, 0).unwrap();
    joints[0] = JointSetpoint { position: twin.state().joints()[0].position, kp: 1.0, kd: 0.05, ..rest };
    // The registers of Damiao motors are read first.
    let mut refused = None;
    let is_enabled = (0..500).any(|_| {
        follow(&mut twin, &joints);
        refused = twin.ask(Operation::Enable, 0).err();
        refused.is_none()
    });
    assert!(is_enabled, "no motor is enabled: {refused:?}; {hidden:?}");
    while twin.state().groups()[0].phase != Phase::Active.code() {
        follow(&mut twin, &joints);
    }
    let settings = &twin.settings().motors[0].limits;
    let limits = Limits {
        position: settings.position.map(f64::from),
        velocity: settings.velocity.into(),
        torque: settings.torque.into(),
        kp: settings.kp.into(),
        kd: settings.kd.into(),
    };
    (twin, joints, limits)
}

/// The excitation through the twin, up to `until`, s.
pub(crate) fn excited(hidden: &Hidden, seed: u64, shape: Shape, until: f64) -> (Vec<Sample>, Twin) {
    let (mut twin, mut joints, limits) = enabled(hidden, seed);
    let begin = twin.state().tick_ns;
    let centre = twin.state().joints()[0].position;
    let plan = Plan::new(limits, centre.into(), shape).unwrap();
    let mut samples = Vec::new();
    loop {
        let (time, state) = (twin.state().tick_ns - begin, twin.state().joints()[0]);
        let time = time as f64 / 1e9;
        plan.check(state.position.into(), state.velocity.into()).unwrap();
        let (position, velocity) = (state.position.into(), state.velocity.into());
        let Some(command) = plan.command(time, position, velocity).filter(|_| time < until) else { break };
        assert!(f64::abs(command.position) < 1.5 && f64::abs(command.velocity) < 10.0);
        // The gains rise for the time of `start-ramp-ms`. The setpoint of a locked joint follows
        // the bound of its torque.
        let allowed = if hidden.stiction > 1e6 { Limit::PositionSlew.bit() } else { 0 };
        let acting = state.limits & !allowed;
        assert!(acting == 0 || time < 0.5, "a limit of the daemon acts at {time} s: {acting:#b}");
        joints[0] = JointSetpoint {
            position: command.position as f32,
            velocity: command.velocity as f32,
            kp: command.kp as f32,
            kd: command.kd as f32,
            ..Default::default()
        };
        follow(&mut twin, &joints);
        let state = twin.state().joints()[0];
        if plan.stage(time) != Some(Stage::Rise) && state.flags & motord_shared::message::JOINT_FRESH != 0 {
            samples.push(sample(&state));
        }
    }
    assert_eq!(twin.state().groups()[0].cause, 0);
    (samples, twin)
}

fn sample(state: &motord_shared::JointState) -> Sample {
    let latency = f64::from(state.reply_latency_ns) / 1e9;
    let applied = state.applied;
    Sample {
        time: state.receive_ns as f64 / 1e9 - latency,
        latency,
        position: state.position.into(),
        torque: state.torque.into(),
        applied: Applied {
            position: applied.position.into(),
            velocity: applied.velocity.into(),
            kp: applied.kp.into(),
            kd: applied.kd.into(),
            torque: applied.torque.into(),
        },
    }
}
