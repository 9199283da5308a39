//! A robot of the shipped configuration on virtual time, with a body that the test moves.

#![expect(clippy::disallowed_types, reason = "the test shares its body with the twin")]
#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use core::time::Duration;
use motord_shared::{Cause, ImuContradiction, JointSetpoint, Operation, Phase, Refusal, StateMessage};
use motord_twin::{Body, ImuValues, JointPhysics, Mechanics, Options, Twin, TwinError};
use std::f32::consts::TAU;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

fn configuration(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config").join(name)
}

fn twin(options: Options) -> Twin {
    Twin::load(&configuration("quadruped-simulated.toml"), options, None, None).unwrap()
}

const fn compute(compute: Duration) -> Options {
    Options { seed: 7, compute }
}

/// Setpoints that hold every joint where it is.
fn hold(twin: &mut Twin) -> Vec<JointSetpoint> {
    let joint = |joint: &motord_shared::JointState| JointSetpoint {
        position: joint.position,
        kp: 40.0,
        kd: 1.0,
        ..Default::default()
    };
    twin.state().joints().iter().map(joint).collect()
}

fn follow(twin: &mut Twin, joints: &[JointSetpoint]) {
    twin.send(0, joints, Duration::ZERO).unwrap();
    twin.step();
}

/// Claims and enables the robot, and returns what holds it.
fn enabled(twin: &mut Twin) -> Vec<JointSetpoint> {
    (0..20).for_each(|_| twin.step());
    twin.ask(Operation::Claim, 0).unwrap();
    let joints = hold(twin);
    (0..5).for_each(|_| follow(twin, &joints));
    twin.ask(Operation::Enable, 0).unwrap();
    for _ in 0..300 {
        follow(twin, &joints);
    }
    assert_eq!(twin.state().groups()[0].phase, Phase::Active.code());
    joints
}

/// Every state of a second of a trot.
fn trotted(options: Options) -> Vec<StateMessage> {
    let mut twin = twin(options);
    let held = enabled(&mut twin);
    let step = |cycle: u16| {
        let swing = (TAU * 2.0 * f32::from(cycle) * 1e-3).sin();
        let joints: Vec<_> = held
            .iter()
            .map(|joint| JointSetpoint { position: joint.position + 0.1 * swing, ..*joint })
            .collect();
        follow(&mut twin, &joints);
        *twin.state()
    };
    (0..1000).map(step).collect()
}

#[test]
fn same_seed_gives_the_same_states() {
    let [first, again] = [(); 2].map(|()| trotted(compute(Duration::ZERO)));
    // As text: a value that is not known is NaN, which equals nothing.
    assert!(format!("{first:?}") == format!("{again:?}"));
    assert!(first.windows(2).all(|pair| pair[0].cycle < pair[1].cycle));
}

#[test]
fn computing_time_decides_which_cycle_uses_setpoints() {
    for (micros, cycles) in [(0, 1), (200, 1), (900, 2), (1200, 2), (2200, 3)] {
        let mut twin = twin(compute(Duration::from_micros(micros)));
        let joints = enabled(&mut twin);
        let seen = (0..20).map(|_| {
            follow(&mut twin, &joints);
            let group = twin.state().groups()[0];
            group.used_cycle - group.answered_cycle
        });
        let seen: Vec<_> = seen.collect();
        assert!(seen[5..].iter().all(|seen| *seen == cycles), "{micros} µs: {seen:?}");
    }
}

#[test]
fn fault_at_a_time_stops_its_group() {
    let mut twin = twin(compute(Duration::ZERO));
    let joints = enabled(&mut twin);
    let soon = twin.time() + Duration::from_millis(50);
    let name = twin.settings().motors[2].name.clone();
    twin.inject_at(soon, format!("{name} off").parse().unwrap()).unwrap();
    while twin.time() < soon {
        assert_eq!(twin.state().groups()[0].cause, 0);
        follow(&mut twin, &joints);
    }
    (0..100).for_each(|_| follow(&mut twin, &joints));
    let group = twin.state().groups()[0];
    assert_eq!((group.cause, group.cause_joint), (Cause::MotorLost.code(), 2));
    assert!(twin.inject_at(soon, "nobody off".parse().unwrap()).is_err());
}

#[test]
fn silent_controller_is_stopped_and_nothing_restarts() {
    let mut twin = twin(compute(Duration::ZERO));
    enabled(&mut twin);
    (0..400).for_each(|_| twin.step());
    assert_eq!(twin.state().groups()[0].cause, Cause::SetpointTimeout.code());
    assert_eq!(twin.ask(Operation::Enable, 0), Err(Refusal::Latched));
}

/// Joints on a table that turns: the body of the IMU.
#[derive(Clone, Default)]
struct Table(Arc<Mutex<f64>>);

impl Mechanics for Table {
    fn begin(&mut self, positions: &mut [f64]) {
        positions[2] = -1.5;
    }

    fn step(&mut self, torques: &[f64], seconds: f64, positions: &mut [f64], velocities: &mut [f64]) {
        *self.0.lock().unwrap() += seconds;
        for ((position, velocity), torque) in positions.iter_mut().zip(velocities).zip(torques) {
            *velocity += (torque - 0.1 * *velocity) / 0.01 * seconds;
            *position += *velocity * seconds;
        }
    }
}

impl Body for Table {
    fn measure(&mut self) -> ImuValues {
        let angle = *self.0.lock().unwrap();
        ImuValues {
            orientation: [(angle / 2.0).cos(), 0.0, 0.0, (angle / 2.0).sin()],
            angular_velocity: [0.0, 0.0, 1.0],
            acceleration: [0.0, 0.0, 9.81],
            temperature: 30.0,
        }
    }
}

/// A plant whose IMU has another convention, on a body that rests with roll 0.4, pitch 0.3, yaw 0.5
/// rad.
struct Tilted([f64; 4], [f64; 3]);

impl Body for Tilted {
    fn measure(&mut self) -> ImuValues {
        let Self(orientation, acceleration) = *self;
        ImuValues { orientation, angular_velocity: [0.0; 3], acceleration, temperature: 30.0 }
    }
}

/// The first cycle, and 2 s at 1 kHz.
#[test]
fn each_convention_of_a_plant_is_named() {
    let [w, x, y, z] = [0.946_281, 0.154_097, 0.190_506, 0.210_984];
    let force @ [fx, fy, fz] = [-2.899, 3.650, 8.632];
    let right = [w, x, y, z];
    for (expected, orientation, acceleration) in [
        (None, right, force),
        (Some(ImuContradiction::QuaternionXyzw), [x, y, z, w], force),
        (Some(ImuContradiction::QuaternionInverse), [w, -x, -y, -z], force),
        (Some(ImuContradiction::QuaternionNed), [w, x, -y, -z], force),
        (Some(ImuContradiction::ZDown), right, force.map(|part| -part)),
        (Some(ImuContradiction::AccelerationAxes), right, [fy, -fx, fz]),
        (Some(ImuContradiction::AccelerationInG), right, force.map(|part| part / 9.81)),
        (Some(ImuContradiction::WithoutGravity), right, [0.0; 3]),
    ] {
        let body: Box<dyn Body> = Box::new(Tilted(orientation, acceleration));
        let file = configuration("quadruped-simulated.toml");
        let mut twin = Twin::load(&file, compute(Duration::ZERO), None, Some(body)).unwrap();
        let named = |twin: &mut Twin| {
            twin.step();
            twin.state().imus()[0].contradictions() != 0
        };
        let cycles = (0..2001).find(|_| named(&mut twin));
        println!("{expected:?}: {cycles:?} ms");
        let expected = expected.map_or(0, ImuContradiction::bit);
        assert_eq!((twin.state().imus()[0].contradictions(), cycles.is_some()), (expected, expected != 0));
    }
}

#[test]
fn plant_beyond_any_machine_is_refused() {
    struct Far(f64);
    impl Mechanics for Far {
        fn begin(&mut self, positions: &mut [f64]) {
            positions[2] = self.0;
        }

        fn step(&mut self, _: &[f64], _: f64, _: &mut [f64], _: &mut [f64]) {}
    }
    for far in [1e308, f64::NAN, f64::NEG_INFINITY] {
        let path = configuration("quadruped-simulated.toml");
        let refused =
            Twin::load(&path, compute(Duration::ZERO), Some(Box::new(Far(far))), None).err().unwrap();
        assert!(matches!(&refused, TwinError::Begin { joint, .. } if joint == "fl-knee"), "{refused}");
    }
}

#[test]
fn imu_measures_body_of_plant_at_tick() {
    let table = Table::default();
    let (plant, body): (Box<dyn Mechanics>, Box<dyn Body>) = (Box::new(table.clone()), Box::new(table));
    let mut twin = Twin::load(
        &configuration("quadruped-simulated.toml"),
        compute(Duration::ZERO),
        Some(plant),
        Some(body),
    )
    .unwrap();
    (0..500).for_each(|_| twin.step());
    let imu = twin.state().imus()[0];
    assert!(imu.sequence > 100, "{imu:?}");
    assert!(
        (twin.state().joints()[2].position + 1.5).abs() < 1e-3,
        "the joints begin where the mechanics have them"
    );
    let [w, _, _, z] = imu.orientation;
    let angle = 2.0 * z.atan2(w);
    // The last tick was at 499 ms, and the last sample at most a period before.
    assert!((0.48..=0.4995).contains(&angle), "{angle}");
    assert!((imu.angular_velocity[2] - 1.0).abs() < 0.1 && (imu.acceleration[2] - 9.81).abs() < 1.0);
}

#[test]
fn serial_line_is_refused_by_name() {
    let refused = Twin::load(&configuration("arm-native.toml"), Options::default(), None, None)
        .map(|_| ())
        .unwrap_err();
    assert!(matches!(&refused, TwinError::SerialBus { bus } if !bus.is_empty()), "{refused}");
}

/// A GIM8108-8: 6e-5 kg·m² behind a gear of 8.
#[test]
fn joint_physics_are_those_of_the_motors() {
    let physics = JointPhysics::of(twin(Options::default()).settings());
    assert_eq!(physics.len(), 12);
    assert!((physics[0].armature - 3.84e-3).abs() < 1e-6, "{:?}", physics[0]);
}

/// The vendor's table of the series: 1.8e-5, 1.95e-4 and 2.0e-5 kg·m² of the rotors, behind gears
/// of 10, 9 and 40.
#[test]
fn rotors_have_the_inertia_of_the_vendor() {
    for (model, armature) in [("DM-J4310-2EC", 0.0018), ("DM-J8009-2EC", 0.015795), ("DM-J4340-2EC", 0.032)] {
        let found = motord_twin::armature(model).unwrap();
        assert!((found / armature - 1.0).abs() < 1e-3, "{model}: {found}");
    }
}

#[test]
fn configured_mechanics_replace_those_of_the_model() {
    let path = configuration("quadruped-simulated.toml");
    let text = include_str!("../../../config/quadruped-simulated.toml");
    let keys = "simulation = { armature-kg-m2 = 0.005, viscous-friction-nm-s-per-rad = 0.07, coulomb-friction-nm = 0, initial-";
    let text = text.replacen("simulation = { initial-", keys, 1);
    let loaded = motord_configuration::parse(&path, text.as_bytes(), &motord_configuration::Machine::here());
    let physics = JointPhysics::of(&loaded.unwrap().settings);
    assert_eq!((physics[0].damping, physics[0].friction), (0.07, 0.0));
    assert!((physics[0].armature - 0.005).abs() < 1e-9, "{}", physics[0].armature);
    assert_eq!((physics[1].damping, physics[1].friction), (0.02, 0.15), "those of the model");
    assert!((motord_twin::armature("GIM8108-8").unwrap() - physics[1].armature).abs() < 1e-12);
    assert_eq!(motord_twin::armature("GIM0"), None);
}
