//! Stiffness and damping for a wanted bandwidth, and the margins of their loop.
//!
//! ```text
//! L(s) = (kd·s + kp) / (inertia·s² + viscous·s) · exp(-delay·s)
//! ```
//!
//! The magnitude of L falls with the frequency and is 1 at one frequency, the crossover. So the loop
//! is stable exactly where its phase margin is above zero (Åström and Murray, "Feedback Systems",
//! 2nd edition, sections 10.2 and 10.3).

use core::f64::consts::TAU;

/// Least phase margin of a proposal, rad: 45°.
pub const PHASE_MARGIN_MIN: f64 = core::f64::consts::FRAC_PI_4;
/// Least damping ratio of a proposal. Below about 0.42 no delay leaves the phase margin.
pub const DAMPING_RATIO_MIN: f64 = 0.5;
/// Largest torque, as a share of the limit, that one code of the velocity causes over the damping.
const NOISE_SHARE: f64 = 0.02;
/// Factor from one bandwidth that is tried to the next, and how many are.
const STEP: f64 = 0.99;
const STEPS: i32 = 1000;

/// Stiffness and damping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gains {
    /// N·m/rad.
    pub kp: f64,
    /// N·m·s/rad.
    pub kd: f64,
}

/// A joint whose torque answers its position and velocity late.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plant {
    /// kg·m².
    pub inertia: f64,
    /// Viscous friction, N·m·s/rad.
    pub viscous: f64,
    /// From the measurement of the joint until its torque acts, s.
    pub delay: f64,
}

/// The distance of a loop from instability.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins {
    /// Frequency at which the loop gain is 1, rad/s.
    pub crossover: f64,
    /// Phase that is left at the crossover, rad.
    pub phase: f64,
    /// Further delay at which the loop becomes unstable, s.
    pub delay: f64,
}

impl Plant {
    /// Returns the margins with `gains`, whose stiffness is above zero.
    #[must_use]
    pub fn margins(&self, gains: Gains) -> Margins {
        let Gains { kp, kd } = gains;
        let Self { inertia, viscous, delay } = *self;
        // |L| = 1 is a quadratic equation of the square of the frequency, with one positive root.
        let half = (kd * kd - viscous * viscous) / 2.0;
        let square = (half + half.hypot(inertia * kp)) / (inertia * inertia);
        let crossover = square.sqrt();
        let phase = (kd * crossover).atan2(kp) + viscous.atan2(inertia * crossover) - delay * crossover;
        Margins { crossover, phase, delay: phase / crossover }
    }

    /// Returns the gains that give the joint this natural frequency, Hz, and this damping ratio,
    /// rounded to three digits. Where the friction damps more, there is no damping.
    fn gains(&self, bandwidth: f64, damping_ratio: f64) -> Gains {
        let omega = TAU * bandwidth;
        let kd = 2.0 * damping_ratio * self.inertia * omega - self.viscous;
        Gains { kp: rounded(self.inertia * omega * omega), kd: rounded(kd.max(0.0)) }
    }
}

/// Three significant digits, as they are printed.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// The wanted response.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// Natural frequency, Hz.
    pub bandwidth: f64,
    /// 1 is critical damping.
    pub damping_ratio: f64,
}

/// The bounds of the motor and its limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Largest gains.
    pub gains: Gains,
    /// Largest torque, N·m.
    pub torque: f64,
    /// Distance of two codes of the velocity, rad/s.
    pub velocity_code: f64,
}

/// A reason why the bandwidth is lower than wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bound {
    /// The largest stiffness.
    Kp,
    /// The largest damping.
    Kd,
    /// The delay, which would leave less than [`PHASE_MARGIN_MIN`].
    Delay,
    /// A code of the velocity, which the damping would turn into noise.
    Noise,
}

/// Gains with their margins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proposal {
    /// The gains.
    pub gains: Gains,
    /// Natural frequency, Hz: at most the wanted one.
    pub bandwidth: f64,
    /// At least [`PHASE_MARGIN_MIN`].
    pub margins: Margins,
    /// Why the bandwidth is lower than wanted.
    pub bound: Option<Bound>,
}

/// Proposes gains with the highest bandwidth, at most the wanted one, that bounds and delay permit.
///
/// # Errors
///
/// Not even a thousandth of it is possible: the bound that forbids that, if one does.
pub fn propose(plant: &Plant, wanted: Wanted, bounds: &Bounds) -> Result<Proposal, Option<Bound>> {
    let mut bound = None;
    let proposal = (0..STEPS).map(|step| wanted.bandwidth * STEP.powi(step)).find_map(|bandwidth| {
        let gains = plant.gains(bandwidth, wanted.damping_ratio);
        let margins = plant.margins(gains);
        let broken = broken(gains, &margins, bounds);
        bound = broken.or(bound);
        let is_proposed = broken.is_none() && gains.kp > 0.0;
        is_proposed.then_some(Proposal { gains, bandwidth, margins, bound })
    });
    proposal.ok_or(bound)
}

/// The first bound that gains break.
fn broken(gains: Gains, margins: &Margins, bounds: &Bounds) -> Option<Bound> {
    let noise = gains.kd * bounds.velocity_code;
    let broken = [
        // A margin that is not a number is none.
        (Bound::Delay, !(PHASE_MARGIN_MIN..).contains(&margins.phase)),
        (Bound::Kp, gains.kp > bounds.gains.kp),
        (Bound::Kd, gains.kd > bounds.gains.kd),
        (Bound::Noise, noise > NOISE_SHARE * bounds.torque),
    ];
    broken.into_iter().find(|(_, is_broken)| *is_broken).map(|(bound, _)| bound)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLANT: Plant = Plant { inertia: 0.02, viscous: 0.0, delay: 0.0 };
    const FREE: Bounds = Bounds { gains: Gains { kp: 5000.0, kd: 100.0 }, torque: 20.0, velocity_code: 0.0 };

    fn near(value: f64, wanted: f64) -> bool {
        (value - wanted).abs() <= 1e-3 * wanted.abs()
    }

    /// Loops whose margins textbooks have.
    #[test]
    fn margins_are_those_of_known_loops() {
        // kp = J·ω², kd = 2·J·ω: crossover √(2 + √5)·ω, phase margin atan(2·√(2 + √5)).
        let critical = PLANT.margins(Gains { kp: 0.02 * 100.0 * 100.0, kd: 0.04 * 100.0 });
        assert!(near(critical.crossover, 205.817), "{critical:?}");
        assert!(near(critical.phase.to_degrees(), 76.345), "{critical:?}");
        // Without any damping the phase margin is 0, and each delay makes it negative.
        assert!(PLANT.margins(Gains { kp: 50.0, kd: 0.0 }).phase.abs() < 1e-9);
        assert!(Plant { delay: 1e-3, ..PLANT }.margins(Gains { kp: 50.0, kd: 0.0 }).phase < 0.0);
        // Damping by friction alone, damping ratio 0.5: phase margin 51.8°.
        let friction = Plant { viscous: 0.02 * 100.0, ..PLANT };
        let standard = friction.margins(Gains { kp: 0.02 * 100.0 * 100.0, kd: 0.0 });
        assert!(near(standard.phase.to_degrees(), 51.827), "{standard:?}");
    }

    /// Largest distance from rest in the last second after a push, by that in the first half second.
    fn growth(plant: &Plant, gains: Gains) -> f64 {
        const STEP: f64 = 20e-6;
        let mut torques = vec![0.0; (plant.delay / STEP).round() as usize];
        let [mut position, mut velocity] = [0.0, 1.0];
        let [mut first, mut last] = [0.0, 0.0];
        for at in 0..100_000_usize {
            torques.push(-gains.kp * position - gains.kd * velocity);
            velocity += STEP * (torques[at] - plant.viscous * velocity) / plant.inertia;
            position += STEP * velocity;
            match at {
                ..25_000 => first = f64::max(first, position.abs()),
                50_000.. => last = f64::max(last, position.abs()),
                _ => {}
            }
        }
        last / first
    }

    #[test]
    fn loop_is_unstable_beyond_its_delay_margin() {
        let plant = Plant { viscous: 0.05, delay: 1e-3, ..PLANT };
        let gains = Gains { kp: 80.0, kd: 1.5 };
        let margin = plant.margins(gains).delay;
        let grown = |share: f64| growth(&Plant { delay: plant.delay + share * margin, ..plant }, gains);
        assert!(grown(0.9) < 1.0, "{}", grown(0.9));
        assert!(grown(1.1) > 1.0, "{}", grown(1.1));
    }

    #[test]
    fn free_joint_gets_the_gains_of_the_formula() {
        let wanted = Wanted { bandwidth: 10.0, damping_ratio: 1.0 };
        let found = propose(&Plant { viscous: 0.1, ..PLANT }, wanted, &FREE).unwrap();
        let omega = TAU * 10.0;
        assert!((found.gains.kp / (0.02 * omega * omega) - 1.0).abs() < 0.005, "{found:?}");
        assert!((found.gains.kd / (0.04 * omega - 0.1) - 1.0).abs() < 0.005, "{found:?}");
        assert_eq!((found.bandwidth, found.bound), (10.0, None));
        assert_eq!(found.gains.kp.to_string(), "79");
    }

    #[test]
    fn each_bound_lowers_bandwidth_and_is_named() {
        let wanted = Wanted { bandwidth: 50.0, damping_ratio: 1.0 };
        let late = Plant { delay: 7.5e-3, ..PLANT };
        let noisy = Bounds { velocity_code: 0.1, ..FREE };
        let at_most = |kp, kd| Bounds { gains: Gains { kp, kd }, ..FREE };
        for (plant, bounds, named) in [
            (late, FREE, Bound::Delay),
            (PLANT, at_most(100.0, 100.0), Bound::Kp),
            (PLANT, at_most(5000.0, 1.0), Bound::Kd),
            (PLANT, noisy, Bound::Noise),
        ] {
            let found = propose(&plant, wanted, &bounds).unwrap();
            assert_eq!(found.bound, Some(named), "{found:?}");
            assert!(found.bandwidth < 50.0 && broken(found.gains, &found.margins, &bounds).is_none());
        }
    }

    #[test]
    fn absurd_mechanics_get_no_proposal() {
        let wanted = Wanted { bandwidth: 10.0, damping_ratio: 1.0 };
        for absurd in [
            Plant { viscous: 1e200, ..PLANT },
            Plant { inertia: 1e-200, ..PLANT },
            Plant { delay: f64::NAN, ..PLANT },
        ] {
            let found = propose(&absurd, wanted, &FREE);
            assert!(found.is_err(), "{absurd:?}: {found:?}");
        }
    }

    #[test]
    fn bound_without_any_gains_is_named() {
        let wanted = Wanted { bandwidth: 10.0, damping_ratio: 1.0 };
        let undamped = Bounds { gains: Gains { kp: 100.0, kd: 0.0 }, ..FREE };
        assert_eq!(propose(&PLANT, wanted, &undamped), Err(Some(Bound::Kd)));
        let loose = Bounds { gains: Gains { kp: 0.0, kd: 100.0 }, ..FREE };
        assert_eq!(propose(&PLANT, wanted, &loose), Err(Some(Bound::Kp)));
    }

    /// Numbers from 0 to 1 (xorshift).
    fn next(random: &mut u64) -> f64 {
        *random ^= *random << 13;
        *random ^= *random >> 7;
        *random ^= *random << 17;
        (*random >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Phase left where the magnitude of L, computed with complex numbers, falls below 1.
    fn scanned_phase(plant: &Plant, gains: Gains) -> f64 {
        let mut omega = 1e-4;
        loop {
            let [re, im] = [gains.kp, gains.kd * omega];
            let [below_re, below_im] = [-plant.inertia * omega * omega, plant.viscous * omega];
            if re.hypot(im) < below_re.hypot(below_im) {
                let phase = im.atan2(re) - below_im.atan2(below_re) - plant.delay * omega;
                return phase + core::f64::consts::PI;
            }
            omega *= 1.0005;
        }
    }

    #[test]
    fn proposals_have_at_least_promised_phase_margin() {
        let mut random = 0x9E37_79B9_7F4A_7C15;
        let mut between = |low: f64, high: f64| low * (high / low).powf(next(&mut random));
        for _ in 0..500 {
            let plant = Plant {
                inertia: between(1e-4, 1.0),
                viscous: between(1e-4, 1.0),
                delay: between(1e-5, 0.05),
            };
            let ratio = between(DAMPING_RATIO_MIN, 2.0);
            let wanted = Wanted { bandwidth: between(0.5, 100.0), damping_ratio: ratio };
            let found = propose(&plant, wanted, &FREE).unwrap();
            let phase = scanned_phase(&plant, found.gains);
            assert!(phase > PHASE_MARGIN_MIN - 2e-3, "{plant:?} {wanted:?} {found:?}: {phase}");
            assert!(found.bandwidth <= wanted.bandwidth);
        }
    }
}
