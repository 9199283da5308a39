//! A motor that motord does not bring: one file beside the configuration, and no line of Rust.

#![expect(clippy::disallowed_methods, reason = "the test writes the files of a user")]
#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use core::time::Duration;
use motord_shared::{Cause, Fault, JointSetpoint, Operation, Phase};
use motord_twin::{Options, Twin};
use std::fs;

/// An actuator as its manual describes it, with a code of its fault in the last byte of a reply.
const ACTUATOR: &str = include_str!("../../../motors/protocol/tests/acme.toml");

const ROBOT: &str = r#"[[bus]]
name = "leg"
type = "simulated"

[[motor]]
name = "knee"
bus = "leg"
id = 5
protocol = "mit"
model = "A-10"
direction = -1
offset-rad = 0.3
"#;

fn robot() -> Twin {
    let directory = tempfile::tempdir().unwrap();
    let (file, folder) = (directory.path().join("robot.toml"), directory.path().join("models.d"));
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("acme.toml"), ACTUATOR).unwrap();
    fs::write(&file, ROBOT).unwrap();
    Twin::load(&file, Options { seed: 7, compute: Duration::ZERO }, None, None).unwrap()
}

fn follow(twin: &mut Twin, position: f32) {
    let joint = JointSetpoint { position, kp: 60.0, kd: 1.5, ..Default::default() };
    twin.send(0, &[joint], Duration::ZERO).unwrap();
    twin.step();
}

/// Claims and enables the robot where it is, and returns its position.
fn enabled(twin: &mut Twin) -> f32 {
    (0..20).for_each(|_| twin.step());
    twin.ask(Operation::Claim, 0).unwrap();
    let start = twin.state().joints()[0].position;
    (0..5).for_each(|_| follow(twin, start));
    twin.ask(Operation::Enable, 0).unwrap();
    (0..300).for_each(|_| follow(twin, start));
    assert_eq!(twin.state().groups()[0].phase, Phase::Active.code());
    start
}

#[test]
fn described_motor_moves_and_holds() {
    let mut twin = robot();
    let start = enabled(&mut twin);
    for cycle in 0_u16..1000 {
        follow(&mut twin, start + 0.4 * f32::from(cycle) / 1000.0);
    }
    (0..500).for_each(|_| follow(&mut twin, start + 0.4));
    let joint = twin.state().joints()[0];
    assert!((joint.position - start - 0.4).abs() < 0.02, "{} is not {}", joint.position, start + 0.4);
    assert!(joint.velocity.abs() < 0.1 && joint.temperature > 20.0, "{joint:?}");
    assert_eq!((joint.fault, twin.state().groups()[0].cause), (0, 0));
}

#[test]
fn fault_of_described_motor_stops_it() {
    let mut twin = robot();
    let start = enabled(&mut twin);
    twin.inject_at(twin.time() + Duration::from_millis(5), "knee fault 4".parse().unwrap()).unwrap();
    (0..100).for_each(|_| follow(&mut twin, start));
    assert_eq!(twin.state().groups()[0].cause, Cause::MotorFault.code());
    assert_eq!(twin.state().joints()[0].fault, Fault::Encoder.bit());
}
