//! Twins with hidden mechanics: what is identified contains what was hidden, or is said to be not identifiable.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_configuration::Machine;
use motord_identify::{Applied, Identified, Limits, Plan, Sample, Shape, Stage, Value, Wire, identify};
use motord_shared::{JointSetpoint, Limit, Operation, Phase};
use motord_twin::{Mechanics, Options, Twin};
use std::path::Path;
use std::time::Duration;

/// Mechanics of one joint, which only the test knows.
#[derive(Debug, Clone, Copy)]
struct Hidden {
    inertia: f64,
    viscous: f64,
    coulomb: f64,
    /// At rest.
    stiction: f64,
    sine: f64,
    cosine: f64,
    /// Of the answers, µs.
    latency: u64,
    model: &'static str,
    /// Other motors on the bus.
    others: usize,
}

const NOMINAL: Hidden = Hidden {
    inertia: 0.02,
    viscous: 0.05,
    coulomb: 0.3,
    stiction: 0.3,
    sine: 0.0,
    cosine: 0.0,
    latency: 70,
    model: "GIM8108-8",
    others: 0,
};

/// Steps of the integration in one step of the plant.
const STEPS: u32 = 25;

impl Mechanics for Hidden {
    fn step(&mut self, torques: &[f64], seconds: f64, positions: &mut [f64], velocities: &mut [f64]) {
        let Self { inertia, viscous, coulomb, stiction, sine, cosine, .. } = *self;
        let step = seconds / f64::from(STEPS);
        for _ in 0..STEPS {
            let (sin, cos) = positions[0].sin_cos();
            let pull = torques[0] - sine * sin - cosine * cos;
            if velocities[0] == 0.0 && pull.abs() <= stiction {
                continue;
            }
            let momentum = inertia * velocities[0] + step * pull;
            let kept = (momentum.abs() - step * coulomb).max(0.0);
            velocities[0] = kept.copysign(momentum) / (inertia + step * viscous);
            positions[0] += step * velocities[0];
        }
    }
}

/// Numbers from 0 to 1 (xorshift).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// From `low` to `high`, each order of magnitude alike.
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.next())
    }
}

fn draw(seed: u64) -> Hidden {
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    (0..20).for_each(|_| {
        random.next();
    });
    let coulomb = random.between(0.05, 0.6);
    let hangs = random.next() < 0.5;
    let weight = if hangs { random.between(0.3, 3.0) } else { 0.0 };
    let lean = random.next() - 0.5;
    Hidden {
        inertia: random.between(0.005, 0.1),
        viscous: random.between(0.01, 0.2),
        coulomb,
        stiction: coulomb * (1.0 + 0.3 * random.next()),
        sine: weight * lean.cos(),
        cosine: weight * lean.sin(),
        latency: random.between(30.0, 300.0) as u64,
        model: if seed.is_multiple_of(4) { "DM-J8009-2EC" } else { "GIM8108-8" },
        others: usize::from(seed.is_multiple_of(5)) * 2,
    }
}

impl Hidden {
    fn configuration(&self) -> String {
        let motor = |index: usize| {
            format!(
                "[[motor]]\nname = \"j{index}\"\nbus = \"b\"\nid = {}\nprotocol = \"mit\"\nmodel = \"{}\"\n\
                 limits = {{ position-rad = [-1.5, 1.5], velocity-rad-s = 10.0 }}\n\
                 simulation = {{ reply-latency-us = {} }}\n",
                index + 1,
                self.model,
                self.latency
            )
        };
        let motors: String = (0..=self.others).map(motor).collect();
        let joints: Vec<_> = (0..=self.others).map(|index| format!("\"j{index}\"")).collect();
        format!(
            "[[bus]]\nname = \"b\"\ntype = \"simulated\"\n{motors}[[group]]\nname = \"g\"\njoints = [{}]\n",
            joints.join(", ")
        )
    }

    /// One joint moves; the others have no mechanics.
    fn twin(&self, seed: u64) -> Twin {
        let loaded = motord_configuration::parse(
            Path::new("hidden.toml"),
            self.configuration().as_bytes(),
            &Machine::here(),
        )
        .unwrap();
        let options = Options { seed, compute: Duration::from_micros(100) };
        Twin::new(loaded.settings, options, Some(Box::new(*self)), None).unwrap()
    }

    fn wire(&self, twin: &Twin) -> Wire {
        let frame = motord_configuration::describe(twin.settings(), 0).frame_times[0];
        Wire { frame, others: self.others, is_can: true }
    }
}

const SHAPE: Shape = Shape { amplitude: None, seconds: 40.0, kp: 20.0, kd: 0.3 };

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
    (0..5).for_each(|_| follow(&mut twin, &joints));
    twin.ask(Operation::Enable, 0).unwrap();
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
fn excited(hidden: &Hidden, seed: u64, shape: Shape, until: f64) -> (Vec<Sample>, Twin) {
    let (mut twin, mut joints, limits) = enabled(hidden, seed);
    let begin = twin.state().tick_ns;
    let centre = twin.state().joints()[0].position;
    let plan = Plan::new(limits, centre.into(), shape).unwrap();
    let mut samples = Vec::new();
    loop {
        let (time, state) = (twin.state().tick_ns - begin, twin.state().joints()[0]);
        let time = time as f64 / 1e9;
        plan.judge(state.position.into(), state.velocity.into()).unwrap();
        let (position, velocity) = (state.position.into(), state.velocity.into());
        let Some(command) = plan.command(time, position, velocity).filter(|_| time < until) else { break };
        assert!(f64::abs(command.position) < 1.5 && f64::abs(command.velocity) < 10.0);
        // The gains rise for the time of `start-ramp-ms`. The setpoint of a locked joint follows the bound of its torque.
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

fn identified(hidden: &Hidden, seed: u64) -> Identified {
    let (samples, twin) = excited(hidden, seed, SHAPE, f64::INFINITY);
    identify(&samples, hidden.wire(&twin))
}

/// A parameter: its name, the truth, what was identified, and the largest error that counts as right.
type Judged = (&'static str, f64, Value, f64);

fn judged(hidden: &Hidden, found: &Identified) -> [Judged; 7] {
    let delay = found.delay.unwrap().motor;
    [
        ("inertia", hidden.inertia, found.inertia, 0.02 * hidden.inertia),
        ("viscous", hidden.viscous, found.viscous, 0.10 * hidden.viscous),
        ("Coulomb", hidden.coulomb, found.coulomb, 0.05 * hidden.coulomb),
        ("stiction", hidden.stiction, found.stiction, 0.5 * hidden.stiction),
        ("sine", hidden.sine, found.gravity_sine, f64::INFINITY),
        ("cosine", hidden.cosine, found.gravity_cosine, f64::INFINITY),
        ("latency", hidden.latency as f64 * 1e-6, delay, 50e-6),
    ]
}

#[test]
fn hidden_parameters_are_found_or_not_identifiable() {
    let (mut covered, mut intervals, mut wrong) = (0, 0, Vec::new());
    let mut counts: [[u32; 2]; 7] = [[0; 2]; 7];
    for seed in 1..=20 {
        let hidden = draw(seed);
        let found = identified(&hidden, seed);
        println!(
            "draw {seed}: {}, {} others, {} windows, range {:.2} rad, {:?}",
            hidden.model, hidden.others, found.windows, found.range, found.notes
        );
        for (index, (name, truth, value, most)) in judged(&hidden, &found).into_iter().enumerate() {
            let is_covered = value.lower <= truth && truth <= value.upper;
            let error = 100.0 * (value.value - truth) / truth;
            let Value { value: estimate, lower, upper, why } = value;
            let verdict = why.map_or_else(
                || if is_covered { "".to_owned() } else { "OUTSIDE".to_owned() },
                |why| why.to_string(),
            );
            println!(
                "  {name:9} {truth:9.6} {estimate:9.6} [{lower:9.6}, {upper:9.6}] {error:7.2} % {verdict}"
            );
            if why.is_some() {
                continue;
            }
            counts[index][0] += 1;
            counts[index][1] += u32::from(is_covered);
            intervals += 1;
            covered += u32::from(is_covered);
            if (estimate - truth).abs() > most {
                wrong.push(format!("draw {seed}: {name} {truth} is not {estimate}"));
            }
        }
    }
    println!("identified and covered, by parameter: {counts:?}; all: {covered} of {intervals}");
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(f64::from(covered) >= 0.9 * f64::from(intervals), "{covered} of {intervals}");
    assert!(counts[0][0] >= 18 && counts[2][0] >= 16, "{counts:?}");
}

#[test]
fn locked_joint_is_not_identifiable() {
    let found = identified(&Hidden { stiction: 1e9, ..NOMINAL }, 1);
    for value in
        [found.inertia, found.viscous, found.coulomb, found.stiction, found.gravity_sine, found.offset]
    {
        assert_eq!(value.identified(), None, "{found:?}");
    }
    assert_eq!(found.inertia.why.map(|why| why.to_string()), Some("the joint moved too little".to_owned()));
    assert!(found.delay.is_some_and(|delay| delay.motor.why.is_none()), "its answers have stamps: {found:?}");
}

#[test]
fn heavy_pendulum_shows_its_gravity() {
    let found = identified(&Hidden { sine: 4.0, inertia: 0.08, ..NOMINAL }, 2);
    let value = found.gravity_sine;
    assert!(
        value.why.is_none() && value.lower <= 4.0 && 4.0 <= value.upper && value.half() < 0.1,
        "{value:?}"
    );
    assert_eq!(found.gravity_cosine.identified(), None, "there is none: {:?}", found.gravity_cosine);
}

#[test]
fn interrupted_motion_gives_no_wrong_value() {
    for until in [2.0, 4.0, 8.0, 25.0] {
        let (samples, twin) = excited(&NOMINAL, 3, SHAPE, until);
        let found = identify(&samples, NOMINAL.wire(&twin));
        for (truth, value) in [(NOMINAL.inertia, found.inertia), (NOMINAL.coulomb, found.coulomb)] {
            let is_right = value.lower <= truth && truth <= value.upper;
            assert!(is_right || value.why.is_some(), "{until} s: {value:?} is not {truth}");
        }
    }
}

#[test]
fn reports_that_contradict_the_law_are_believed() {
    let (mut samples, twin) = excited(&NOMINAL, 4, SHAPE, f64::INFINITY);
    samples.iter_mut().for_each(|sample| sample.torque *= 0.7);
    let found = identify(&samples, NOMINAL.wire(&twin));
    assert_eq!(found.notes.len(), 1, "{found:?}");
    let share = found.inertia.value / NOMINAL.inertia;
    assert!((0.66..0.74).contains(&share), "{share}");
}

#[test]
fn lost_samples_leave_gaps_and_no_errors() {
    let (samples, twin) = excited(&NOMINAL, 5, SHAPE, f64::INFINITY);
    let mut random = Random(99);
    let kept: Vec<_> = samples.into_iter().filter(|_| random.next() > 0.02).collect();
    let found = identify(&kept, NOMINAL.wire(&twin));
    for (truth, value) in [(NOMINAL.inertia, found.inertia), (NOMINAL.coulomb, found.coulomb)] {
        assert!(
            value.why.is_none() && value.lower <= truth && truth <= value.upper,
            "{value:?} is not {truth}"
        );
    }
}
