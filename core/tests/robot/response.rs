//! Drives that answer and give no torque, and healthy ones that give little, on virtual time.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_bus::Duration;
use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_harness::robot::random::Random;
use motord_shared::{Cause, JointSetpoint, MotorMode, Operation, Phase, SetpointMode};
use motord_simulator::{ReplyTiming, RobStrideFirmware};

/// Number of seeds of healthy robots in a plain `cargo test`.
const SEEDS: u64 = 60;

/// Returns a robot on one bus, whose motors get a command in one of `every` cycles. The thigh is
/// reversed.
fn leg(rate_hz: u32, every: u32) -> String {
    let mut text = format!(
        "[cycle]\nrate-hz = {rate_hz}\nmax-lateness-ms = 100.0\n[safety]\nsetpoint-timeout-ms = 200\n\
         [[bus]]\nname = \"can\"\ntype = \"simulated\"\nevery = {every}\n"
    );
    for (id, name, more) in
        [(1, "hip", ""), (2, "thigh", "direction = -1\noffset-rad = 0.3"), (3, "knee", "")]
    {
        text += &robot::motor(id, name, "can", more);
    }
    text
}

/// Activates the robot, also one with native motors, which report their first state later.
fn activate(robot: &mut Robot) -> Vec<JointSetpoint> {
    robot.steps(400);
    robot.claim().unwrap();
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    robot.operate(Operation::Enable).unwrap_or_else(|refusal| panic!("{refusal}"));
    robot.follow_until(&joints, 400, |robot| robot.phase() == Phase::Active);
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    joints
}

/// Goal: a drive that restarts without a silence stops its group, although its states have no
/// status. Method: a load on each joint in turn, reversed or not; each cycle and every fourth; at 1
/// kHz and 50 Hz.
#[test]
fn restarted_drive_under_load_is_motor_off() {
    for (rate, every, joint, states_ms) in [(1000, 1, 0, 1), (1000, 1, 1, 1), (1000, 4, 2, 4), (50, 1, 0, 20)]
    {
        let mut robot = Robot::built(robot::settings(&leg(rate, every)), 1, |_, motors| {
            motors.iter_mut().for_each(|motor| motor.load_inertia = 0.5);
        });
        let joints = activate(&mut robot);
        let name = robot.settings.motors[joint].name.clone();
        robot.disturb(&format!("{name} load 4"));
        (0..rate).for_each(|_| robot.follow(&joints));
        assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
        robot.disturb(&format!("{name} restart"));
        let begun = robot.now();
        robot.follow_until(&joints, 1000, |robot| robot.cause().is_some());
        let stop = (robot.cause(), robot.group().cause_joint);
        assert_eq!(stop, (Some(Cause::MotorOff), joint as u32), "{rate} Hz, every {every}");
        let most = Duration::from_millis(50 + 4 + 6 * states_ms);
        assert!(robot.now().since(begun) <= most, "{rate} Hz, every {every}: {:?}", robot.now().since(begun));
    }
}

#[test]
fn restarted_older_robstride_drive_is_motor_off() {
    let text = include_str!("../../../config/mixed-simulated.toml");
    let mut robot = Robot::built(robot::settings(text), 3, |_, motors| {
        motors.iter_mut().for_each(|motor| motor.behaviour.firmware = RobStrideFirmware::Manual2025);
    });
    let joints = robot.activate();
    let joint = robot.settings.motors.iter().position(|motor| motor.profile.name == "robstride").unwrap();
    let name = robot.settings.motors[joint].name.clone();
    robot.disturb(&format!("{name} load 2"));
    (0..500).for_each(|_| robot.follow(&joints));
    robot.disturb(&format!("{name} restart"));
    (0..80).for_each(|_| robot.follow(&joints));
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorOff), joint as u32));
}

#[test]
fn response_of_zero_percent_checks_nothing() {
    let mut settings = robot::three_motors();
    settings.motors.iter_mut().for_each(|motor| motor.limits.torque_response = 0.0);
    let mut robot = Robot::built(settings, 1, |_, motors| motors[0].coulomb_friction = 100.0);
    let mut joints = robot.activate();
    joints[0].torque = 5.0;
    (0..300).for_each(|_| robot.follow(&joints));
    robot.disturb("hip restart");
    (0..300).for_each(|_| robot.follow(&joints));
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
}

/// The motion of one joint's setpoints.
struct Motion {
    kp: f32,
    kd: f32,
    mode: SetpointMode,
    /// rad or N·m, by `by_torque`.
    amplitude: f32,
    hz: f32,
    is_square: bool,
    by_torque: bool,
    is_noise: bool,
}

impl Motion {
    fn new(random: &mut Random, is_native: bool) -> Self {
        use SetpointMode::{Impedance, Position, Speed, Torque};
        let by_torque = random.once_in(2);
        Self {
            kp: *random.pick(&[0.0, 0.06, 2.0, 20.0, 100.0]),
            kd: *random.pick(&[0.0, 0.05, 1.0, 5.0]),
            mode: if is_native { *random.pick(&[Impedance, Torque, Speed, Position]) } else { Impedance },
            amplitude: random.between(0.0, if by_torque { 18.0 } else { 1.0 }),
            hz: random.between(0.1, 20.0),
            is_square: random.once_in(2),
            by_torque,
            is_noise: random.once_in(6),
        }
    }

    fn at(&self, seconds: f32, still: f32, random: &mut Random) -> JointSetpoint {
        let phase = core::f32::consts::TAU * self.hz * seconds;
        let wave = if self.is_square { phase.sin().signum() } else { phase.sin() };
        let wave = if self.is_noise { random.between(-1.0, 1.0) } else { wave };
        let value = self.amplitude * wave;
        let (position, torque) = if self.by_torque { (still, value) } else { (still + value, 0.0) };
        let velocity = if self.mode == SetpointMode::Speed { 5.0 * wave } else { 0.0 };
        JointSetpoint { position, velocity, kp: self.kp, kd: self.kd, torque, mode: self.mode.code() }
    }
}

/// Returns a healthy robot: of its drives some give less torque than configured, or have less
/// supply, or are blocked.
fn healthy(random: &mut Random, seed: u64, torque: f32) -> Robot {
    let every = *random.pick(&[1, 1, 4]);
    let mut text = leg(1000, every);
    if seed % 3 == 1 {
        let knee = text.rfind("\"mit\"").unwrap();
        text.replace_range(knee..knee + 5, "\"gim\"");
    }
    let mut settings = robot::settings(&text);
    settings.motors.iter_mut().for_each(|motor| motor.limits.torque = torque);
    Robot::built(settings, seed, |_, motors| {
        for motor in motors {
            motor.coulomb_friction = *random.pick(&[0.05, 0.15, 1.0, 100.0]);
            motor.load_inertia = *random.pick(&[0.0, 0.01, 0.2, 1.0]);
            match random.below(4) {
                0 => motor.torque_peak = 4.0,
                1 => motor.velocity_max = 8.0,
                _ => {}
            }
            motor.behaviour.truncates = random.once_in(2);
            motor.behaviour.reply_timing =
                *random.pick(&[ReplyTiming::BeforeCommand, ReplyTiming::AfterCommand]);
        }
    })
}

/// Goal: no healthy motor is taken for one that is off, and no contact for a joint that does not
/// follow. Method: random gains from zero on, loads, blocked joints, weak drives, low supplies,
/// torque limits, square waves, noise, lost replies and late cycles, of MIT and native motors, each
/// cycle or every fourth. `MOTORD_SEEDS` sets the number of seeds.
#[test]
fn healthy_motors_are_never_off() {
    robot::for_each_seed("robot healthy_motors", SEEDS, |seed| {
        let mut random = Random::new(seed);
        let torque = *random.pick(&[20.0, 20.0, 2.0]);
        let mut robot = healthy(&mut random, seed, torque);
        let still = activate(&mut robot);
        let motions: Vec<_> = (0..still.len())
            .map(|joint| Motion::new(&mut random, robot.settings.motors[joint].protocol.name() == "gim"))
            .collect();
        for cycle in 0..2000_u16 {
            if random.once_in(300) {
                let joint = random.pick(&["hip", "thigh", "knee"]);
                let fault = match random.below(3) {
                    // Less than the weakest drive gives.
                    0 => format!("load {}", 0.8 * torque.min(4.0) * random.between(-1.0, 1.0)),
                    1 => "intermittent 20%".to_owned(),
                    _ => "delayed 300us".to_owned(),
                };
                robot.disturb(&format!("{joint} {fault}"));
            }
            if random.once_in(300) {
                robot.oversleep(Duration::from_secs_f32(random.between(0.1e-3, 3e-3)));
            }
            let seconds = f32::from(cycle) / 1000.0;
            let joints: Vec<_> = motions
                .iter()
                .zip(&still)
                .map(|(motion, still)| motion.at(seconds, still.position, &mut random))
                .collect();
            robot.follow(&joints);
            if let Some(cause) = robot.cause() {
                let joint = robot.group().cause_joint;
                assert!(
                    ![Cause::MotorOff, Cause::FollowingError].contains(&cause),
                    "{cause} of {joint} after {cycle} cycles"
                );
                break;
            }
        }
    });
}

/// A stopped native motor refuses control commands, and reports no state.
#[test]
fn restarted_native_drive_is_found_by_its_refusals() {
    let text = leg(1000, 1).replace("\"mit\"", "\"gim\"");
    let mut robot = Robot::new(robot::settings(&text), 1);
    let joints = activate(&mut robot);
    robot.disturb("knee restart");
    (0..40).for_each(|_| robot.follow(&joints));
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorLost), 2));
    assert_ne!(robot.mode(2), MotorMode::Active);
}
