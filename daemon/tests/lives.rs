//! Goal: whatever a controller does, the invariants of `robot/witness.rs` hold on the bytes that reach the motors.
//! Method: seeded lives of a rough controller on virtual time: absurd values, NaN, stutter, silence, old and foreign
//! messages, requests at the wrong time, and death. A seed that fails is printed; `MOTORD_SEED=n` runs it alone, and
//! `MOTORD_SEEDS=n` runs more than the thousand.

mod robot;

use motord_bus::{Duration, Instant};
use motord_shared::{AdminRequest, JointSetpoint, Operation, Phase, SetpointMessage};
use robot::Robot;
use robot::random::Random;
use robot::witness::{FOREIGN_KP, Witness};

const ABSURD: [f32; 12] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    f32::MIN_POSITIVE / 2.0,
    -0.0,
    1e9,
    -1e9,
    500.0,
    -12.5,
    12.5,
];

#[test]
fn whatever_a_controller_does_no_motor_hears_what_it_must_not() {
    let seeds = std::env::var("MOTORD_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(1000);
    let only: Option<u64> = std::env::var("MOTORD_SEED").ok().and_then(|text| text.parse().ok());
    for seed in only.map_or(0..seeds, |seed| seed..seed + 1) {
        let life = std::panic::catch_unwind(|| live(seed));
        assert!(life.is_ok(), "run it alone with MOTORD_SEED={seed} cargo test -p motord --test lives");
    }
}

/// One controller, from its claim to well after its death.
fn live(seed: u64) {
    let mut random = Random::new(seed);
    let mut robot = Robot::new(robot::three_motors(), seed);
    let mut witness = Witness::new(&robot);
    for _ in 0..10 {
        robot.step();
        witness.judge(&mut robot);
    }
    robot.post_claim();
    robot.step();
    witness.judge(&mut robot);
    robot.take_lease();
    let mut wishes = robot.hold(30.0, 1.0);
    let death = 100 + random.below(400);
    for cycle in 0..death + 60 {
        if cycle < death {
            act(&mut random, &mut robot, &mut witness, &mut wishes);
        }
        robot.step();
        witness.judge(&mut robot);
    }
    for _ in 0..2500 {
        robot.step();
        witness.judge(&mut robot);
    }
    assert_eq!(robot.phase(), Phase::Disarmed, "a dead controller's group is stopped");
}

/// What the controller does between two cycles.
fn act(random: &mut Random, robot: &mut Robot, witness: &mut Witness, wishes: &mut [JointSetpoint]) {
    if random.once_in(50) {
        request(random, robot, witness);
    }
    match random.below(40) {
        0..=2 => {}
        3 => wishes.iter_mut().for_each(|wish| wish.position += random.between(-3.0, 3.0)),
        4 => wishes.iter_mut().for_each(|wish| wish.torque = random.between(-50.0, 50.0)),
        5 => wishes.iter_mut().for_each(|wish| wish.kp = random.between(0.0, 120.0)),
        6 => wishes.iter_mut().for_each(|wish| wish.velocity = random.between(-60.0, 60.0)),
        7..=9 => {
            let mut message = robot.message(wishes);
            spoil(random, &mut message, robot.now());
            robot.deliver(&message);
        }
        _ => {
            let message = robot.message(wishes);
            witness.good_setpoint = Some(robot.now());
            robot.deliver(&message);
        }
    }
}

/// Makes a message one that must be rejected, or whose values must be limited.
fn spoil(random: &mut Random, message: &mut SetpointMessage, now: Instant) {
    let joint = random.below(3);
    match random.below(9) {
        0 => message.joints[joint].position = *random.pick(&ABSURD),
        1 => message.joints[joint].velocity = *random.pick(&ABSURD),
        2 => message.joints[joint].kp = *random.pick(&ABSURD),
        3 => message.joints[joint].kd = *random.pick(&ABSURD),
        4 => message.joints[joint].torque = *random.pick(&ABSURD),
        5 => message.joints[joint].mode = random.next() as u32,
        6 => message.joint_count = random.next() as u32,
        7 => message.time_ns = *random.pick(&[0, u64::MAX, (now - Duration::from_millis(21)).as_nanos()]),
        _ => {
            message.lease ^= 1 << (8 + random.below(56));
            message.joints.iter_mut().for_each(|joint| joint.kp = FOREIGN_KP);
        }
    }
}

/// Asks for something, at the right time or not.
fn request(random: &mut Random, robot: &mut Robot, witness: &mut Witness) {
    let operation = *random.pick(&[
        Operation::Enable,
        Operation::Enable,
        Operation::Disable,
        Operation::Reset,
        Operation::EmergencyStop,
        Operation::SetZero,
        Operation::ClearFault,
    ]);
    witness.reset |= operation == Operation::Reset;
    witness.enabled |= operation == Operation::Enable;
    witness.errand |= matches!(operation, Operation::SetZero | Operation::ClearFault);
    let joint = random.below(3) as u32;
    robot.post(AdminRequest { operation: operation.code(), joint, lease: robot.lease, ..Default::default() });
}
