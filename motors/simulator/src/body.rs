//! Mechanics and heat of one motor: a rotor behind a gear, friction, a torque limit, a winding that
//! heats up.

use crate::settings::MotorSettings;

/// The state of an output shaft, on the scale of
/// [`MotorSettings::initial_position`](crate::MotorSettings::initial_position). A set-zero command
/// changes the motor's own zero, and not this scale.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shaft {
    /// rad, unlimited.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
}

/// Length of one step, ns. Steps end on multiples of it, or when the drive receives a frame, so a
/// run does not depend on the times of the calls.
pub(crate) const STEP_NS: u64 = 50_000;
const STEP_SECONDS: f64 = STEP_NS as f64 / 1e9;
/// Heat in W per Ω from line to line and A² of q current: 3/2 of a phase's resistance. That is half
/// of the resistance from line to line.
pub(crate) const COPPER_LOSS: f64 = 0.75;

/// The torque that a drive commands:
/// `torque + kp·(reference - position) + kd·(velocity - shaft velocity)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Law {
    /// rad; moves towards `target`.
    pub(crate) reference: f64,
    /// rad.
    pub(crate) target: f64,
    /// Speed of the reference, rad/s.
    pub(crate) rate: f64,
    /// rad/s.
    pub(crate) velocity: f64,
    /// N·m/rad.
    pub(crate) kp: f64,
    /// N·m·s/rad.
    pub(crate) kd: f64,
    /// N·m.
    pub(crate) torque: f64,
}

impl Law {
    /// No torque.
    pub(crate) const LIMP: Self =
        Self { reference: 0.0, target: 0.0, rate: 0.0, velocity: 0.0, kp: 0.0, kd: 0.0, torque: 0.0 };

    fn follow(&mut self, seconds: f64) {
        let reach = self.rate * seconds;
        self.reference += (self.target - self.reference).clamp(-reach, reach);
    }
}

/// All quantities are at the output shaft. The law's and the body's positions have the same zero.
#[derive(Debug, Clone)]
pub(crate) struct Body {
    /// rad.
    pub(crate) position: f64,
    /// rad/s.
    pub(crate) velocity: f64,
    /// Torque of the drive, N·m.
    pub(crate) torque: f64,
    /// Torque of the load, N·m.
    pub(crate) load: f64,
    /// °C.
    pub(crate) winding: f64,
    inertia: f64,
    viscous: f64,
    coulomb: f64,
    torque_peak: f64,
    velocity_max: f64,
    ambient: f64,
    /// Final temperature rise of the winding, K per (N·m)².
    heating: f64,
    thermal_time: f64,
    /// A plant outside moves the shaft.
    is_coupled: bool,
    /// Torque of drive and load times time, since the last call of `take_impulse`, N·m·s. Counted
    /// only for the plant.
    impulse: f64,
}

impl Body {
    pub(crate) fn new(settings: &MotorSettings) -> Self {
        let MotorSettings { gear_ratio, torque_constant, .. } = *settings;
        let ampere_per_newton_metre = 1.0 / (torque_constant * gear_ratio);
        let loss = COPPER_LOSS * settings.winding_resistance * ampere_per_newton_metre.powi(2);
        Self {
            position: settings.initial_position,
            velocity: 0.0,
            torque: 0.0,
            load: settings.load_torque,
            winding: settings.ambient_celsius,
            inertia: settings.rotor_inertia * gear_ratio * gear_ratio + settings.load_inertia,
            viscous: settings.viscous_friction,
            coulomb: settings.coulomb_friction,
            torque_peak: settings.torque_peak,
            velocity_max: settings.velocity_max,
            ambient: settings.ambient_celsius,
            heating: loss * settings.thermal_resistance,
            thermal_time: settings.thermal_time,
            is_coupled: false,
            impulse: 0.0,
        }
    }

    /// Returns the inertia at the output, kg·m².
    pub(crate) fn inertia(&self) -> f64 {
        self.inertia
    }

    /// Lets a plant outside move the shaft from now on. Returns its position and velocity.
    pub(crate) fn couple(&mut self) -> Shaft {
        self.is_coupled = true;
        Shaft { position: self.position, velocity: self.velocity }
    }

    /// Sets the shaft to the state that the plant computed.
    pub(crate) fn set_shaft(&mut self, shaft: Shaft) {
        (self.position, self.velocity) = (shaft.position, shaft.velocity);
    }

    /// Returns torque of drive and load times time since the last call, N·m·s.
    pub(crate) fn take_impulse(&mut self) -> f64 {
        core::mem::take(&mut self.impulse)
    }

    /// Computes one step under `law`.
    pub(crate) fn step(&mut self, law: &mut Law, seconds: f64) {
        law.follow(seconds);
        if self.is_coupled {
            self.coast(law, seconds);
        } else {
            self.integrate(law, seconds);
        }
        self.warm(seconds);
    }

    /// Turns the shaft at its velocity until the plant sets it.
    fn coast(&mut self, law: &Law, seconds: f64) {
        self.apply(law);
        self.impulse += (self.torque + self.load) * seconds;
        self.position += self.velocity * seconds;
    }

    /// Integrates by the implicit midpoint rule, which neither removes energy from a spring nor
    /// adds any. Where that rule is not safe, uses backward Euler, which damps at any gain. These
    /// are steps longer than the grid's, and steps in which dry friction may hold the shaft.
    fn integrate(&mut self, law: &Law, seconds: f64) {
        if (self.velocity != 0.0 || self.coulomb == 0.0) && seconds <= STEP_SECONDS {
            let middle = self.velocity_under(law, seconds / 2.0);
            let end = 2.0 * middle - self.velocity;
            let turns = end * self.velocity < 0.0 || middle * self.velocity <= 0.0;
            if !turns || self.coulomb == 0.0 {
                self.velocity = end;
                self.position += middle * seconds;
                return;
            }
        }
        self.velocity = self.velocity_under(law, seconds);
        self.position += self.velocity * seconds;
    }

    /// Returns the velocity after `seconds` of `law`, implicit in position, velocity and friction.
    /// Sets the torque.
    fn velocity_under(&mut self, law: &Law, seconds: f64) -> f64 {
        let (kp, kd) = (law.kp, law.kd);
        let pull = law.torque + kp * (law.reference - self.position) + kd * law.velocity;
        let velocity = self.velocity_after(seconds, pull, self.viscous + kd + kp * seconds);
        let wanted = pull - (kp * seconds + kd) * velocity;
        let (lowest, highest) = self.torque_range();
        self.torque = wanted.clamp(lowest, highest);
        if self.torque == wanted { velocity } else { self.velocity_after(seconds, self.torque, self.viscous) }
    }

    /// Applies the torque of a new `law` immediately, for an answer that is sent before the next
    /// step.
    pub(crate) fn apply(&mut self, law: &Law) {
        let (lowest, highest) = self.torque_range();
        self.torque = self.commanded(law).clamp(lowest, highest);
    }

    /// Returns the torque that `law` commands now, beyond any limit of torque, N·m.
    pub(crate) fn commanded(&self, law: &Law) -> f64 {
        law.torque + law.kp * (law.reference - self.position) + law.kd * (law.velocity - self.velocity)
    }

    /// Computes backward Euler. Dry friction reduces the momentum to at least zero, and never
    /// reverses it.
    fn velocity_after(&self, seconds: f64, torque: f64, resistance: f64) -> f64 {
        let momentum = self.inertia * self.velocity + seconds * (torque + self.load);
        let kept = (momentum.abs() - seconds * self.coulomb).max(0.0);
        kept.copysign(momentum) / (self.inertia + seconds * resistance)
    }

    /// Returns the range of torque. Braking has the full peak torque. Driving torque decreases with
    /// speed, because the back EMF reduces the voltage.
    fn torque_range(&self) -> (f64, f64) {
        let peak = |speed: f64| self.torque_peak * (1.0 - speed.max(0.0) / self.velocity_max).max(0.0);
        (-peak(-self.velocity), peak(self.velocity))
    }

    fn warm(&mut self, seconds: f64) {
        let end = self.ambient + self.heating * self.torque * self.torque;
        self.winding += (end - self.winding) * seconds / (self.thermal_time + seconds);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = STEP_NS as f64 / 1e9;

    fn body(settings: MotorSettings) -> Body {
        Body::new(&settings)
    }

    fn run(body: &mut Body, mut law: Law, seconds: f64) {
        for _ in 0..(seconds / STEP).round() as u32 {
            body.step(&mut law, STEP);
        }
    }

    #[test]
    fn falling_load_reaches_friction_limited_speed() {
        let mut body = body(MotorSettings { load_torque: 0.55, ..MotorSettings::default() });
        run(&mut body, Law::LIMP, 10.0);
        assert!((body.velocity - (0.55 - 0.15) / 0.02).abs() < 1e-3, "{}", body.velocity);
        assert_eq!(body.torque, 0.0);
    }

    #[test]
    fn dry_friction_holds_what_it_can_hold() {
        let mut body = body(MotorSettings { load_torque: 0.149, ..MotorSettings::default() });
        run(&mut body, Law::LIMP, 1.0);
        assert_eq!((body.position, body.velocity), (0.0, 0.0));
    }

    #[test]
    fn a_spring_without_friction_keeps_its_energy() {
        let free = MotorSettings { viscous_friction: 0.0, coulomb_friction: 0.0, ..MotorSettings::default() };
        let mut body = body(MotorSettings { initial_position: 0.1, ..free });
        let mut law = Law { kp: 20.0, ..Law::LIMP };
        let energy = |body: &Body| {
            0.5 * body.inertia * body.velocity * body.velocity + 10.0 * body.position * body.position
        };
        let start = energy(&body);
        let mut last = start;
        for _ in 0..2_000 {
            body.step(&mut law, STEP);
            assert!(energy(&body) <= last * (1.0 + 1e-9));
            last = energy(&body);
        }
        assert!(last > 0.999_999 * start, "0.1 s cost {}", 1.0 - last / start);
    }

    #[test]
    fn spring_and_damper_settle_on_target() {
        let mut body = body(MotorSettings { coulomb_friction: 0.0, ..MotorSettings::default() });
        run(&mut body, Law { reference: 0.5, target: 0.5, kp: 50.0, kd: 1.5, ..Law::LIMP }, 1.0);
        assert!((body.position - 0.5).abs() < 1e-6 && body.velocity.abs() < 1e-6);
    }

    #[test]
    fn torque_saturates_at_peak_and_fades() {
        let mut body = body(MotorSettings::default());
        let full = Law { torque: 225.0, ..Law::LIMP };
        run(&mut body, full, STEP);
        assert_eq!(body.torque, 22.0);
        run(&mut body, full, 5.0);
        assert!(body.velocity < 33.5, "{}", body.velocity);
        run(&mut body, Law { torque: -225.0, ..Law::LIMP }, STEP);
        assert_eq!(body.torque, -22.0, "braking has the full peak");
    }

    #[test]
    fn the_stiffest_law_is_stable_at_any_step() {
        for step in [STEP, 1e-3, 0.1, 2.0] {
            let mut body = body(MotorSettings::default());
            let mut law = Law { reference: 0.02, target: 0.02, kp: 500.0, kd: 5.0, ..Law::LIMP };
            for _ in 0..4_000 {
                body.step(&mut law, step);
                assert!(body.velocity.abs() <= 33.5 + 22.0 * step / body.inertia, "{step}");
            }
            let error = (body.position - 0.02).abs();
            assert!(error <= 0.15 / 500.0 + 1e-6 || step > 0.05, "{step}: {error}");
        }
    }

    #[test]
    fn winding_warms_with_its_time_constant() {
        let settings = MotorSettings::default();
        let mut body = body(MotorSettings { viscous_friction: 1e6, ..settings.clone() });
        run(&mut body, Law { torque: 7.0, ..Law::LIMP }, settings.thermal_time);
        // 7 N·m are 7 A here: 0.75 · 0.67 · 49 W through 2 K/W.
        let end = 0.75 * 0.67 * 49.0 * 2.0;
        assert!((body.winding - 25.0 - end * (1.0 - (-1.0_f64).exp())).abs() < 0.01, "{}", body.winding);
    }
}
