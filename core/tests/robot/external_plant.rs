//! Twelve motors with an external plant, under the real cycle, on virtual time, with the client in
//! process.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_shared::{Cause, JointSetpoint, MotorMode, Operation, Phase};
use motord_simulator::{MotorSettings, Plant, Shaft};
use std::f32::consts::TAU;

const MOTORS: usize = 12;
/// Hip, thigh, knee.
const LEG: usize = 3;
/// Cycles of a trot: two seconds.
const TROT: usize = 2000;

/// Moves each shaft separately, like the built-in mechanics: inertia, dry and viscous friction.
struct Alone;

impl Plant for Alone {
    fn step(&mut self, torques: &[f64], seconds: f64, shafts: &mut [Shaft]) {
        let motor = MotorSettings::default();
        let inertia = motor.load_inertia + motor.rotor_inertia * motor.gear_ratio.powi(2);
        for (shaft, torque) in shafts.iter_mut().zip(torques) {
            let momentum = inertia * shaft.velocity + torque * seconds;
            let kept = (momentum.abs() - motor.coulomb_friction * seconds).max(0.0).copysign(momentum);
            shaft.velocity = kept / (inertia + motor.viscous_friction * seconds);
            shaft.position += shaft.velocity * seconds;
        }
    }
}

/// Four legs that hang from a stand: a hip that rolls, a thigh and a knee that swing in one plane
/// and pull at each other. Zero is straight down. Each link is a point of 0.5 kg, 0.1 m below its
/// joint, on a shaft with the motor's rotor.
struct Legs;

impl Legs {
    const MASS: f64 = 0.5;
    const LENGTH: f64 = 0.1;
    const GRAVITY: f64 = 9.81;
    /// Rotor of a GIM8108-8 behind its gear, kg·m².
    const ROTOR: f64 = 6e-5 * 64.0;
    /// N·m·s/rad.
    const FRICTION: f64 = 0.02;

    /// Angular accelerations of a leg, rad/s².
    fn accelerations(torques: &[f64], [hip, thigh, knee]: [Shaft; LEG]) -> [f64; LEG] {
        let (inertia, weight) =
            (Self::MASS * Self::LENGTH.powi(2), Self::MASS * Self::GRAVITY * Self::LENGTH);
        let [roll, swing, bend] =
            [0, 1, 2].map(|joint| torques[joint] - Self::FRICTION * [hip, thigh, knee][joint].velocity);
        let (sine, cosine) = knee.position.sin_cos();
        let below = weight * (thigh.position + knee.position).sin();
        // Lagrange's equations of a double pendulum of equal points, with the knee's angle relative
        // to the thigh.
        let [m11, m12, m22] =
            [inertia * (3.0 + 2.0 * cosine) + Self::ROTOR, inertia * (1.0 + cosine), inertia + Self::ROTOR];
        let swing = swing - 2.0 * weight * thigh.position.sin() - below
            + inertia * sine * knee.velocity * (2.0 * thigh.velocity + knee.velocity);
        let bend = bend - below - inertia * sine * thigh.velocity.powi(2);
        let determinant = m11 * m22 - m12 * m12;
        [
            (roll - 2.0 * weight * hip.position.sin()) / (4.0 * inertia + Self::ROTOR),
            (m22 * swing - m12 * bend) / determinant,
            (m11 * bend - m12 * swing) / determinant,
        ]
    }
}

impl Plant for Legs {
    fn step(&mut self, torques: &[f64], seconds: f64, shafts: &mut [Shaft]) {
        for (leg, torques) in shafts.chunks_exact_mut(LEG).zip(torques.chunks_exact(LEG)) {
            let accelerations = Self::accelerations(torques, [leg[0], leg[1], leg[2]]);
            for (shaft, acceleration) in leg.iter_mut().zip(accelerations) {
                shaft.velocity += acceleration * seconds;
                shaft.position += shaft.velocity * seconds;
            }
        }
    }
}

/// Returns every joint at `time` of a trot at 2 Hz that begins softly: diagonal legs together, the
/// knee twice as far as the thigh.
fn trot(time: f32) -> Vec<JointSetpoint> {
    let joint = |motor: usize| {
        let phase = TAU * (2.0 * time + if matches!(motor / LEG, 0 | 3) { 0.0 } else { 0.5 });
        let reach = [0.05, 0.2, -0.4][motor % LEG] * (time / 0.5).min(1.0);
        let (position, velocity) = (reach * phase.sin(), reach * 2.0 * TAU * phase.cos());
        JointSetpoint { position, velocity, kp: 60.0, kd: 1.5, ..Default::default() }
    };
    (0..MOTORS).map(joint).collect()
}

/// Claims, enables, and trots. Returns the position of each joint in each cycle, rad.
fn trotted(robot: &mut Robot) -> Vec<[f32; MOTORS]> {
    robot.steps(10);
    robot.claim().unwrap();
    robot.follow(&trot(0.0));
    robot.operate(Operation::Enable).unwrap();
    robot.follow_until(&trot(0.0), 300, |robot| robot.phase() == Phase::Active);
    let cycle = |cycle: usize| {
        robot.follow(&trot(cycle as f32 * 1e-3));
        let state = robot.client.state();
        std::array::from_fn(|motor| state.joints()[motor].position)
    };
    let track = (0..TROT).map(cycle).collect();
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    track
}

/// Returns the root mean square, rad, of `differs` over each cycle and joint.
fn rms(differs: impl Fn(usize, usize) -> f32) -> f32 {
    let squares: f32 = (0..TROT * MOTORS).map(|at| differs(at / MOTORS, at % MOTORS).powi(2)).sum();
    (squares / (TROT * MOTORS) as f32).sqrt()
}

#[test]
fn external_plant_reproduces_the_builtin_trot() {
    let [inside, outside] =
        [Robot::new(robot::quadruped(), 1), Robot::with_plant(robot::quadruped(), 1, Alone)]
            .map(|mut robot| trotted(&mut robot));
    let difference = rms(|cycle, joint| inside[cycle][joint] - outside[cycle][joint]);
    println!("built-in and external mechanics differ by {:.3} mrad RMS", 1e3 * difference);
    assert!(difference < 1e-3, "{difference} rad");
}

#[test]
fn hanging_legs_trot_deterministically() {
    let [track, again] = [1, 1].map(|seed| trotted(&mut Robot::with_plant(robot::quadruped(), seed, Legs)));
    assert_eq!(track, again);
    let setpoints: Vec<_> = (0..TROT).map(|cycle| trot(cycle as f32 * 1e-3)).collect();
    let error = rms(|cycle, joint| track[cycle][joint] - setpoints[cycle][joint].position);
    println!("hanging legs follow within {:.1} mrad RMS", 1e3 * error);
    assert!(error < 0.03, "{error} rad");
    let reached = track.iter().map(|joints| joints[2].abs()).fold(0.0, f32::max);
    assert!(reached > 0.3, "the knee must swing, and swung {reached} rad");
}

#[test]
fn silent_owner_leaves_hanging_legs_at_rest() {
    let mut robot = Robot::with_plant(robot::quadruped(), 1, Legs);
    trotted(&mut robot);
    robot.steps(25);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::SetpointTimeout)));
    robot.take_sent();
    robot.steps(6000);
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()));
    assert_eq!(robot.phase(), Phase::Disarmed);
    for motor in 0..MOTORS {
        assert_eq!(robot.mode(motor), MotorMode::Idle);
        let (position, velocity) = (robot.truth(motor).position(), robot.truth(motor).velocity());
        assert!(position.abs() < 0.02 && velocity.abs() < 0.1, "{motor}: {position} rad, {velocity} rad/s");
    }
}

#[test]
fn emergency_stop_of_hanging_legs_latches_until_reset() {
    let mut robot = Robot::with_plant(robot::quadruped(), 1, Legs);
    trotted(&mut robot);
    robot.operate(Operation::EmergencyStop).unwrap();
    robot.steps(2);
    assert_eq!(robot.cause(), Some(Cause::EmergencyStop));
    robot.take_sent();
    robot.steps(3000);
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()));
    assert!(robot.operate(Operation::Enable).is_err());
    robot.operate(Operation::Reset).unwrap();
    robot.steps(2);
    assert_eq!(robot.cause(), None);
}
