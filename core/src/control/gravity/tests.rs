use super::*;
use core::f64::consts::TAU;
use proptest::prelude::*;

const RATE_HZ: f64 = 200.0;
/// The names of the conventions, and their contradictions.
const KINDS: [(&str, u32); 10] = [
    ("right", 0),
    ("xyzw", QuaternionXyzw.bit()),
    ("conjugate", QuaternionInverse.bit()),
    ("xyzw, conjugate", QuaternionXyzw.bit() | QuaternionInverse.bit()),
    ("ned", QuaternionNed.bit()),
    ("ned, all", ZDown.bit()),
    ("down", ZDown.bit()),
    ("axes", AccelerationAxes.bit()),
    ("g", AccelerationInG.bit()),
    ("linear", WithoutGravity.bit()),
];

/// Converts a right sample into another convention.
fn sent(kind: &str, right: &ImuSample) -> ImuSample {
    let [w, x, y, z] = right.orientation;
    let force @ [fx, fy, fz] = right.acceleration;
    let gravity = up(right.orientation).map(|part| GRAVITY * part);
    let with = |orientation, acceleration| ImuSample { orientation, acceleration, ..*right };
    match kind {
        "right" => *right,
        "xyzw" => with([x, y, z, w], force),
        "conjugate" => with([w, -x, -y, -z], force),
        "xyzw, conjugate" => with([-x, -y, -z, w], force),
        "ned" => with([w, x, -y, -z], force),
        "ned, all" => with([w, x, -y, -z], [fx, -fy, -fz]),
        "down" => with(right.orientation, force.map(|part| -part)),
        "axes" => with(right.orientation, [fy, -fx, fz]),
        "g" => with(right.orientation, force.map(|part| part / GRAVITY)),
        "linear" => with(right.orientation, difference(force, gravity)),
        _ => panic!("no convention {kind}"),
    }
}

/// A generator of Marsaglia's xorshift.
struct Random(u64);

impl Random {
    fn new(seed: u64) -> Self {
        Self(0x9E37_79B9_7F4A_7C15 ^ (seed + 1).wrapping_mul(0xD134_2543_DE82_EF95))
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        low + (high - low) * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Normal, as the sum of twelve uniform numbers.
    fn normal(&mut self, deviation: f64) -> f64 {
        deviation * ((0..12).map(|_| self.within(0.0, 1.0)).sum::<f64>() - 6.0)
    }
}

/// amplitude · sin(2π · frequency · time + phase).
#[derive(Clone, Copy, Default)]
struct Wave {
    amplitude: f64,
    frequency: f64,
    phase: f64,
}

impl Wave {
    /// Value, first and second derivative.
    fn at(&self, time: f64) -> [f64; 3] {
        let turn = TAU * self.frequency;
        let (sine, cosine) = (turn * time + self.phase).sin_cos();
        [sine, turn * cosine, -turn * turn * sine].map(|part| self.amplitude * part)
    }
}

/// The motion of a body: roll, pitch, yaw and x, y, z of the world, each a sum of waves, its turn
/// to the left, rad/s, and a constant acceleration, m/s².
struct Motion {
    angles: [Vec<Wave>; 3],
    positions: [Vec<Wave>; 3],
    turn: f64,
    push: [f64; 3],
}

impl Motion {
    fn still(angles: [f64; 3]) -> Self {
        let constant = |amplitude| vec![Wave { amplitude, frequency: 0.0, phase: TAU / 4.0 }];
        Self { angles: angles.map(constant), positions: Default::default(), turn: 0.0, push: [0.0; 3] }
    }

    /// A trot: the trunk nods and sways with the steps, rises with each of them, and its speed
    /// changes by 0.1 m/s.
    fn walk(random: &mut Random) -> Self {
        let step = random.within(2.0, 3.0);
        let mut wave = |low, high, frequency| Wave {
            amplitude: random.within(low, high),
            frequency,
            phase: random.within(0.0, TAU),
        };
        let angles = [
            vec![wave(0.01, 0.05, step), wave(0.0, 0.02, 0.4)],
            vec![wave(0.01, 0.05, step), wave(0.0, 0.03, 2.0 * step)],
            vec![wave(0.0, 0.05, step)],
        ];
        let positions = [
            vec![wave(0.001, 0.006, 2.0 * step), wave(0.0, 0.1, 0.15)],
            vec![wave(0.001, 0.006, step)],
            vec![wave(0.002, 0.01, 2.0 * step)],
        ];
        Self { angles, positions, turn: random.within(-0.5, 0.5), push: [0.0; 3] }
    }

    /// Any motion of a body that a robot carries.
    fn random(random: &mut Random) -> Self {
        let mut waves = |most: f64| {
            (0..3)
                .map(|_| {
                    let frequency = random.within(0.05, 3.0);
                    // At most 3 m/s and 3 rad/s.
                    let amplitude = random.within(0.0, most).min(3.0 / (TAU * frequency));
                    Wave { amplitude, frequency, phase: random.within(0.0, TAU) }
                })
                .collect::<Vec<_>>()
        };
        Self {
            angles: [(); 3].map(|()| waves(0.5)),
            positions: [(); 3].map(|()| waves(0.3)),
            turn: 0.0,
            push: [0.0; 3],
        }
    }

    /// A motion that resembles a rest, and its length, s.
    fn like_rest(kind: &str, random: &mut Random) -> (Self, f64) {
        let pose = [random.within(-3.1, 3.1), random.within(-1.5, 1.5), random.within(-3.1, 3.1)];
        let still = Self::still(pose);
        let heading = random.within(0.0, TAU);
        let push = |push| Self { push, ..Self::still(pose) };
        match kind {
            "rest in any pose" => (still, 6.0),
            "on its side" => (Self::still([1.57, pose[1] * 0.1, pose[2]]), 6.0),
            "upside down" => (Self::still([3.1, pose[1] * 0.1, pose[2]]), 6.0),
            // At most 0.09 rad/s.
            "slow tilt" => {
                let wave = Wave { amplitude: 1.4, frequency: 0.0102, phase: heading };
                (Self { angles: [vec![wave], vec![], vec![]], ..still }, 20.0)
            }
            "slow turn" => (Self { turn: 0.09, ..still }, 10.0),
            "braking vehicle" => (push([0.98 * heading.cos(), 0.98 * heading.sin(), 0.0]), 3.0),
            "elevator that starts up" => (push([0.0, 0.0, 0.98]), 3.0),
            "elevator that starts down" => (push([0.0, 0.0, -0.98]), 3.0),
            "free fall" => (push([0.0, 0.0, -f64::from(GRAVITY)]), 1.0),
            "vibration" => {
                let mut wave = || {
                    let frequency = random.within(15.0, 85.0);
                    let amplitude = random.within(0.0, 12.0) / (TAU * frequency).powi(2);
                    vec![Wave { amplitude, frequency, phase: random.within(0.0, TAU) }]
                };
                (Self { positions: [(); 3].map(|()| wave()), ..still }, 6.0)
            }
            _ => panic!("no motion {kind}"),
        }
    }

    /// The sample of a sensor with noise.
    fn sample(&self, time: f64, random: &mut Random) -> ImuSample {
        let sum = |waves: &Vec<Wave>| {
            waves
                .iter()
                .map(|wave| wave.at(time))
                .fold([0.0; 3], |sum, wave| [0, 1, 2].map(|n| sum[n] + wave[n]))
        };
        let [roll, pitch, mut yaw] = [0, 1, 2].map(|axis| sum(&self.angles[axis]));
        (yaw[0], yaw[1]) = (yaw[0] + self.turn * time, yaw[1] + self.turn);
        let orientation = quaternion([roll[0], pitch[0], yaw[0]]);
        let ((sr, cr), (sp, cp)) = (roll[0].sin_cos(), pitch[0].sin_cos());
        let rates =
            [roll[1] - sp * yaw[1], cr * pitch[1] + sr * cp * yaw[1], -sr * pitch[1] + cr * cp * yaw[1]];
        let [x, y, z] = [0, 1, 2].map(|axis| sum(&self.positions[axis])[2]);
        let [px, py, pz] = self.push;
        let force = to_body(orientation, [x + px, y + py, z + pz + f64::from(GRAVITY)]);
        ImuSample {
            orientation: orientation.map(|part| part as f32),
            angular_velocity: rates.map(|rate| (rate + random.normal(0.004)) as f32),
            acceleration: force.map(|part| (part + random.normal(0.05)) as f32),
            temperature: None,
        }
    }
}

/// Roll, pitch and yaw about x, y and z of the world, in this order.
fn quaternion(angles: [f64; 3]) -> [f64; 4] {
    let [(sr, cr), (sp, cp), (sy, cy)] = angles.map(|angle| (angle / 2.0).sin_cos());
    let [roll, pitch, yaw] = [[cr, sr, 0.0, 0.0], [cp, 0.0, sp, 0.0], [cy, 0.0, 0.0, sy]];
    product(yaw, product(pitch, roll))
}

/// The rotation of the second quaternion, followed by that of the first.
fn product([a, b, c, d]: [f64; 4], [w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]
}

/// A vector of the world in the frame of the body.
fn to_body(orientation @ [w, x, y, z]: [f64; 4], [a, b, c]: [f64; 3]) -> [f64; 3] {
    let [_, vector @ ..] = product([w, -x, -y, -z], product([0.0, a, b, c], orientation));
    vector
}

/// Turns the quaternion by roll and pitch about the axes of the body.
fn tilted(orientation: [f32; 4], [roll, pitch]: [f64; 2]) -> [f32; 4] {
    product(orientation.map(f64::from), quaternion([roll, pitch, 0.0])).map(|part| part as f32)
}

/// The constant errors of a sensor: angular velocity, rad/s, acceleration, m/s², roll and pitch,
/// rad.
#[derive(Default)]
struct Errors {
    turn: [f32; 3],
    force: [f32; 3],
    tilt: [f64; 2],
}

impl Errors {
    /// 0.05 rad/s, 0.3 m/s² and 0.017 rad, each in any direction.
    fn random(random: &mut Random) -> Self {
        let mut vector = |size: f32| {
            let axes = [(); 3].map(|()| random.normal(1.0) as f32);
            axes.map(|axis| size * axis / norm(axes))
        };
        let (turn, force) = (vector(0.05), vector(0.3));
        let (sine, cosine) = random.within(0.0, TAU).sin_cos();
        Self { turn, force, tilt: [0.017 * sine, 0.017 * cosine] }
    }

    fn add_to(&self, right: &ImuSample) -> ImuSample {
        let sum = |one: [f32; 3], other: [f32; 3]| [0, 1, 2].map(|axis| one[axis] + other[axis]);
        ImuSample {
            orientation: tilted(right.orientation, self.tilt),
            angular_velocity: sum(right.angular_velocity, self.turn),
            acceleration: sum(right.acceleration, self.force),
            ..*right
        }
    }
}

/// A sensor that sends in a convention, and its check.
struct Sensor {
    kind: &'static str,
    mount: Mount,
    errors: Errors,
    check: GravityCheck,
    time: f64,
    random: Random,
}

impl Sensor {
    fn new(kind: &'static str, mount: Mount, seed: u64) -> Self {
        let (check, random) = (GravityCheck::new(mount), Random::new(seed));
        Self { kind, mount, errors: Errors::default(), check, time: 0.0, random }
    }

    /// Measures a motion of the sensor for this time. Returns the findings, with the seconds from
    /// the begin.
    fn measure(&mut self, motion: &Motion, seconds: f64) -> Vec<(f64, Finding)> {
        let begin = self.time;
        let mut findings = Vec::new();
        while self.time < begin + seconds {
            self.time += 1.0 / RATE_HZ;
            let right = self.errors.add_to(&motion.sample(self.time, &mut self.random));
            let sample = sent(self.kind, &right);
            let at = Instant::from_nanos((self.time * 1e9) as u64);
            let found = self.check.receive(&self.mount.to_body(&sample), at);
            findings.extend(found.map(|finding| (self.time - begin, finding)));
        }
        findings
    }

    fn names(&self) -> Vec<&'static str> {
        ImuContradiction::of_bits(self.check.contradictions()).map(ImuContradiction::name).collect()
    }
}

fn mounts() -> [Mount; 3] {
    [[0.0; 3], [0.0, 0.0, 1.6], [3.1, 0.2, -0.8]].map(Mount::from_roll_pitch_yaw)
}

/// Roll 0.4, pitch 0.3, yaw 0.5 rad.
#[test]
fn each_convention_is_named_within_two_seconds() {
    for mount in mounts() {
        for (kind, expected) in KINDS {
            let mut sensor = Sensor::new(kind, mount, 1);
            let found = sensor.measure(&Motion::still([0.4, 0.3, 0.5]), 2.0);
            assert_eq!(sensor.check.contradictions(), expected, "{kind}: {:?}", sensor.names());
            assert_eq!(found.len(), usize::from(expected != 0), "{kind}");
            found.iter().for_each(|(seconds, _)| println!("{kind}: {seconds:.2} s"));
        }
    }
}

/// In one pose the errors may let another convention agree better.
#[test]
fn each_convention_of_imperfect_sensor_is_noticed() {
    for seed in 0..30 {
        for (kind, expected) in KINDS {
            let mut sensor = Sensor::new(kind, mounts()[(seed % 3) as usize], seed);
            sensor.errors = Errors::random(&mut Random::new(seed));
            sensor.measure(&Motion::still([0.4, 0.3, 0.5]), 2.0);
            assert_eq!(sensor.names().is_empty(), expected == 0, "{kind} {seed}: {:?}", sensor.names());
        }
    }
}

/// A body that moves before, and in a pose that it did not choose.
#[test]
fn rest_after_motion_takes_two_seconds() {
    for seed in 0..20 {
        let mut random = Random::new(seed);
        let (before, pose) = (Motion::random(&mut random), Motion::still([0.4, 0.3, 0.5]));
        for (kind, expected) in KINDS.into_iter().skip(1) {
            let mut sensor = Sensor::new(kind, Mount::ALIGNED, seed);
            sensor.measure(&before, 3.0);
            sensor.measure(&pose, 2.0);
            assert_ne!(sensor.check.contradictions(), 0, "{kind} {seed}");
            assert!(seed > 0 || sensor.check.contradictions() == expected, "{kind}: {:?}", sensor.names());
        }
    }
}

/// One pose may agree in several conventions; poses exclude all but the right one.
#[test]
fn poses_leave_the_convention_that_was_sent() {
    for (kind, expected) in KINDS {
        for seed in 0..30 {
            let mut random = Random::new(seed);
            let mut sensor = Sensor::new(kind, mounts()[(seed % 3) as usize], seed);
            for _ in 0..6 {
                let pose = [random.within(-1.4, 1.4), random.within(-1.2, 1.2), random.within(-3.0, 3.0)];
                sensor.measure(&Motion::still(pose), 2.0);
            }
            // A pose in which nothing contradicts may be the last one.
            let last = sensor.check.contradictions();
            assert!(last == expected || last == 0, "{kind} {seed}: {:?}", sensor.names());
        }
    }
}

#[test]
fn right_convention_is_never_named_while_walking() {
    for seed in 0..6 {
        let mut random = Random::new(seed);
        let mut sensor = Sensor::new("right", mounts()[(seed % 3) as usize], seed);
        // 10 minutes: stands, walks and turns.
        for _ in 0..20 {
            let found = sensor.measure(&Motion::still([0.02, -0.05, 0.3]), 5.0);
            assert_eq!(found, [], "{seed}");
            let walk = Motion::walk(&mut random);
            assert_eq!(sensor.measure(&walk, 25.0), [], "{seed}");
        }
    }
}

#[test]
fn right_convention_is_never_named_in_random_motion() {
    for seed in 100..106 {
        let mut random = Random::new(seed);
        let mut sensor = Sensor::new("right", mounts()[(seed % 3) as usize], seed);
        // 10 minutes.
        for _ in 0..60 {
            let motion = Motion::random(&mut random);
            assert_eq!(sensor.measure(&motion, 10.0), [], "{seed}");
        }
    }
}

#[test]
fn right_convention_is_never_named_in_near_rest() {
    let kinds = [
        "rest in any pose",
        "on its side",
        "upside down",
        "slow tilt",
        "slow turn",
        "braking vehicle",
        "elevator that starts up",
        "elevator that starts down",
        "free fall",
        "vibration",
    ];
    for seed in 200..206 {
        let mut random = Random::new(seed);
        let mut sensor = Sensor::new("right", mounts()[(seed % 3) as usize], seed);
        sensor.errors = Errors::random(&mut random);
        assert_eq!(sensor.measure(&Motion::still([0.02, -0.05, 0.3]), 3.0), []);
        while sensor.time < 600.0 {
            let kind = kinds[random.within(0.0, kinds.len() as f64) as usize];
            let (motion, seconds) = Motion::like_rest(kind, &mut random);
            assert_eq!(sensor.measure(&motion, seconds), [], "{seed} {kind}");
        }
    }
}

/// A scale that changed is no acceleration of some seconds: three rests. A sensor that never agreed
/// needs one.
#[test]
fn unknown_contradiction_of_agreeing_sensor_takes_longer() {
    let pose = Motion::still([0.4, 0.3, 0.5]);
    for (agrees, limits) in [(false, 0.0..2.0), (true, 5.0..5.6)] {
        let mut sensor = Sensor::new("right", Mount::ALIGNED, 1);
        if agrees {
            sensor.measure(&pose, 2.0);
        }
        sensor.errors.force = up(pose.sample(0.0, &mut Random::new(1)).orientation).map(|part| 1.5 * part);
        let found = sensor.measure(&pose, 6.0);
        assert_eq!(sensor.names(), ["size"]);
        assert!(limits.contains(&found[0].0), "{} s", found[0].0);
    }
}

/// Motion has no directions of gravity to compare: what was found stands, and a rest in which both
/// agree ends it.
#[test]
fn finding_stands_until_a_rest_agrees() {
    let pose = Motion::still([0.4, 0.3, 0.5]);
    let mut sensor = Sensor::new("xyzw", Mount::ALIGNED, 3);
    sensor.measure(&pose, 2.0);
    sensor.kind = "right";
    let walk = Motion::walk(&mut Random::new(5));
    assert_eq!(sensor.measure(&walk, 1.5), []);
    assert_eq!(sensor.names(), ["quaternion-xyzw"]);
    let found = sensor.measure(&pose, 2.0);
    assert_eq!(found.iter().map(|(_, finding)| finding.contradictions).collect::<Vec<_>>(), [0]);
}

/// The limits are 10° and 10 %; what exceeded them agrees again below 8° and 8 %. Each value lasts
/// for four rests: the first may contain the value before.
#[test]
fn limits_are_ten_degrees_and_ten_percent() {
    let mut check = GravityCheck::new(Mount::ALIGNED);
    let mut now = 0_u64;
    let mut named = |degrees: f32, size: f32| {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        let acceleration = [0.0, GRAVITY * size * sine, GRAVITY * size * cosine];
        for _ in 0..1400 {
            now += 5_000_000;
            check.receive(&ImuSample { acceleration, ..ImuSample::LEVEL }, Instant::from_nanos(now));
        }
        check.contradictions()
    };
    assert_eq!([named(9.5, 1.0), named(0.0, 1.09), named(0.0, 0.91)], [0; 3]);
    assert_eq!([named(10.5, 1.0), named(9.0, 1.0), named(7.5, 1.0)], [Direction.bit(), Direction.bit(), 0]);
    let size = Size.bit();
    assert_eq!(
        [named(0.0, 1.11), named(0.0, 1.09), named(0.0, 1.07), named(0.0, 0.89)],
        [size, size, 0, size]
    );
}

#[test]
fn gap_between_samples_ends_a_rest() {
    let mut check = GravityCheck::new(Mount::ALIGNED);
    let upside_down = ImuSample { acceleration: [0.0, 0.0, -GRAVITY], ..ImuSample::LEVEL };
    for second in 0..20 {
        assert_eq!(check.receive(&upside_down, Instant::from_nanos(second * 1_000_000_000)), None);
    }
}

#[test]
fn every_turn_of_axes_is_one_rotation() {
    let found: std::collections::BTreeSet<String> =
        (0..AXES).map(|turn| format!("{:?}", turned(turn, [1.0, 2.0, 3.0]))).collect();
    assert_eq!((found.len(), turned(0, [1.0, 2.0, 3.0])), (AXES, [1.0, 2.0, 3.0]));
    for turn in 0..AXES {
        let [x, y, z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| turned(turn, axis));
        let triple = x[0] * (y[1] * z[2] - y[2] * z[1]) - x[1] * (y[0] * z[2] - y[2] * z[0])
            + x[2] * (y[0] * z[1] - y[1] * z[0]);
        assert!((triple - 1.0).abs() < 1e-6, "{turn} is a mirror");
    }
}

proptest! {
    /// Any finite samples at any times: no panic, known bits, and a right sensor at rest afterwards
    /// is right.
    #[test]
    fn hostile_samples_leave_the_check_usable(
        samples in proptest::collection::vec(
            (any::<[f32; 4]>(), any::<[f32; 3]>(), any::<[f32; 3]>(), any::<u64>()), 1..200
        )
    ) {
        let mut check = GravityCheck::new(Mount::ALIGNED);
        let known = ImuContradiction::ALL.iter().fold(0, |bits, convention| bits | convention.bit());
        let mut last = 0;
        for (orientation, angular_velocity, acceleration, step) in samples {
            let sample = ImuSample { orientation, angular_velocity, acceleration, temperature: None };
            let Some(sound) = sample.checked() else { continue };
            last = if step % 3 == 0 { step >> 1 } else { last + step % 400_000_000 };
            check.receive(&sound, Instant::from_nanos(last));
            prop_assert_eq!(check.contradictions() & !known, 0);
        }
        for turn in 0..600_u64 {
            check.receive(&ImuSample::LEVEL, Instant::from_nanos((1 << 63) + turn * 5_000_000));
        }
        prop_assert_eq!(check.contradictions(), 0);
    }
}
