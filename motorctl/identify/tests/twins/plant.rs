//! Joints with hidden mechanics, which only the tests know.

use motord_configuration::Machine;
use motord_identify::BusTiming;
use motord_twin::{Mechanics, Options, Twin};
use std::path::Path;
use std::time::Duration;

/// Mechanics of one joint.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hidden {
    pub(crate) inertia: f64,
    pub(crate) viscous: f64,
    /// At high speed.
    pub(crate) coulomb: f64,
    /// At rest.
    pub(crate) stiction: f64,
    pub(crate) sine: f64,
    pub(crate) cosine: f64,
    /// Of the answers, µs.
    pub(crate) latency: u64,
    pub(crate) model: &'static str,
    /// Other motors on the bus.
    pub(crate) others: usize,
    pub(crate) extra: Extra,
}

/// Mechanics beyond the equation of motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Extra {
    Nothing,
    /// Torque that changes with the position: amplitude, N·m, and angular frequency, 1/rad.
    Cogging(f64, f64),
    /// Friction above Coulomb's at rest, N·m, and the speed, rad/s, at which 1/e of it is left.
    Stribeck(f64, f64),
    /// Free angle between motor and load, rad, and the share of the inertia at the motor.
    Backlash(f64, f64),
    /// Torque of the motor that changes with its position: share, and angular frequency, 1/rad.
    Ripple(f64, f64),
    /// Time constant with which the torque follows its command, s.
    Lag(f64),
    /// Time constant of a filter of the measured position, s.
    Filter(f64),
    /// Stiffness, N·m/rad.
    Spring(f64),
}

pub(crate) const NOMINAL: Hidden = Hidden {
    inertia: 0.02,
    viscous: 0.05,
    coulomb: 0.3,
    stiction: 0.3,
    sine: 0.0,
    cosine: 0.0,
    latency: 70,
    model: "GIM8108-8",
    others: 0,
    extra: Extra::Nothing,
};

/// Steps of the integration in one step of the plant.
const STEPS: u32 = 25;
/// Stiffness, N·m/rad, and damping, N·m·s/rad, of two flanks that touch.
const CONTACT: [f64; 2] = [2000.0, 1.0];

/// The joint while it moves.
struct Joint {
    hidden: Hidden,
    /// Position and velocity of the motor, and of the load behind a play.
    motor: [f64; 2],
    load: [f64; 2],
    /// Torque that acts, N·m.
    torque: f64,
}

impl Hidden {
    /// Friction of the moving joint without the viscous part, N·m.
    fn dry(&self, speed: f64) -> f64 {
        match self.extra {
            Extra::Stribeck(excess, at) => self.coulomb + excess * (-(speed / at).powi(2)).exp(),
            _ => self.coulomb,
        }
    }

    /// Torque that the position takes, N·m.
    fn pull(&self, position: f64) -> f64 {
        let (sin, cos) = position.sin_cos();
        let other = match self.extra {
            Extra::Cogging(amplitude, frequency) => amplitude * (frequency * position).sin(),
            Extra::Spring(stiffness) => stiffness * position,
            _ => 0.0,
        };
        self.sine * sin + self.cosine * cos + other
    }

    /// Moves a mass with friction under a torque.
    fn move_body(&self, [position, velocity]: &mut [f64; 2], inertia: f64, pull: f64, step: f64) {
        if *velocity == 0.0 && pull.abs() <= self.stiction {
            return;
        }
        let momentum = inertia * *velocity + step * pull;
        let kept = (momentum.abs() - step * self.dry(velocity.abs())).max(0.0);
        *velocity = kept.copysign(momentum) / (inertia + step * self.viscous);
        *position += step * *velocity;
    }
}

impl Joint {
    fn advance(&mut self, torque: f64, step: f64) {
        let hidden = self.hidden;
        let applied = match hidden.extra {
            Extra::Lag(constant) => self.torque + (torque - self.torque) * step / constant,
            Extra::Ripple(share, frequency) => torque * (1.0 + share * (frequency * self.motor[0]).sin()),
            _ => torque,
        };
        self.torque = applied;
        let Extra::Backlash(play, share) = hidden.extra else {
            let pull = applied - hidden.pull(self.motor[0]);
            hidden.move_body(&mut self.motor, hidden.inertia, pull, step);
            return;
        };
        let apart = self.motor[0] - self.load[0];
        let depth = apart - apart.clamp(-play / 2.0, play / 2.0);
        let [stiffness, damping] = CONTACT;
        let force =
            if depth == 0.0 { 0.0 } else { stiffness * depth + damping * (self.motor[1] - self.load[1]) };
        hidden.move_body(&mut self.motor, share * hidden.inertia, applied - force, step);
        self.load[1] += step * (force - hidden.pull(self.load[0])) / ((1.0 - share) * hidden.inertia);
        self.load[0] += step * self.load[1];
    }
}

impl Mechanics for Joint {
    fn step(&mut self, torques: &[f64], seconds: f64, positions: &mut [f64], velocities: &mut [f64]) {
        let step = seconds / f64::from(STEPS);
        (0..STEPS).for_each(|_| self.advance(torques[0], step));
        let shown = match self.hidden.extra {
            Extra::Filter(constant) => {
                // The filtered position of the step before is that which the motor showed.
                let share = 1.0 - (-seconds / constant).exp();
                let next = positions[0] + share * (self.motor[0] - positions[0]);
                [next, (next - positions[0]) / seconds]
            }
            _ => self.motor,
        };
        [positions[0], velocities[0]] = shown;
    }
}

/// Numbers from 0 to 1 (xorshift).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    /// The first numbers of similar seeds are similar, and are left out.
    fn seeded(seed: u64) -> Self {
        let mut random = Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        (0..20).for_each(|_| {
            random.next();
        });
        random
    }

    pub(crate) fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// From `low` to `high`, each order of magnitude alike.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.next())
    }
}

pub(crate) fn draw(seed: u64) -> Hidden {
    let mut random = Random::seeded(seed);
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
        extra: Extra::Nothing,
    }
}

/// A joint of the kind number `seed` modulo 8: plain, gravity, cogging, Stribeck, backlash, ripple,
/// lag, filter.
pub(crate) fn draw_kind(seed: u64) -> Hidden {
    let mut hidden = draw(seed);
    let mut random = Random::seeded(seed ^ 0xA5A5);
    hidden.extra = match seed % 8 {
        2 => Extra::Cogging(random.between(0.02, 0.2), random.between(10.0, 170.0)),
        3 => Extra::Stribeck(hidden.coulomb * random.between(0.2, 1.0), random.between(0.05, 0.5)),
        4 => Extra::Backlash(random.between(0.005, 0.08), random.between(0.1, 0.6)),
        5 => Extra::Ripple(random.between(0.02, 0.1), random.between(40.0, 170.0)),
        6 => Extra::Lag(random.between(0.5e-3, 4e-3)),
        7 => Extra::Filter(random.between(0.5e-3, 4e-3)),
        _ => Extra::Nothing,
    };
    if seed % 8 == 1 {
        (hidden.sine, hidden.cosine) = (random.between(0.5, 4.0), random.next() - 0.5);
    }
    if let Extra::Stribeck(excess, _) = hidden.extra {
        hidden.stiction = hidden.coulomb + excess;
    }
    hidden
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
    pub(crate) fn twin(&self, seed: u64) -> Twin {
        let loaded = motord_configuration::parse(
            Path::new("hidden.toml"),
            self.configuration().as_bytes(),
            &Machine::here(),
        )
        .unwrap();
        let joint = Joint { hidden: *self, motor: [0.0; 2], load: [0.0; 2], torque: 0.0 };
        let options = Options { seed, compute: Duration::from_micros(100) };
        Twin::new(loaded.settings, options, Some(Box::new(joint)), None).unwrap()
    }

    pub(crate) fn wire(&self, twin: &Twin) -> BusTiming {
        let frame = motord_configuration::describe(twin.settings(), 0).frame_times[0];
        BusTiming { frame, others: self.others, is_can: true }
    }
}
