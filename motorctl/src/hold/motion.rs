//! The setpoints of `motorctl hold` over time.

use crate::hold::failure::HoldFailure;
use motord_client::{JointLimits, Setpoint};
use std::f64::consts::TAU;

/// Time in which gains and amplitude rise to their values, s.
const RAMP: f64 = 1.0;
/// Share of the gains at the beginning. With a stiffness of 0 the daemon would not check the pose.
const FIRST_SHARE: f64 = 0.05;

/// A hold with a sine around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    /// Stiffness, N·m/rad.
    pub(crate) kp: f32,
    /// Damping, N·m·s/rad.
    pub(crate) kd: f32,
    /// Amplitude of the sine, rad; 0 holds still.
    pub(crate) amplitude: f32,
    /// Frequency of the sine, Hz.
    pub(crate) frequency: f32,
}

impl Motion {
    /// Returns the stiffness and the damping after the ramp, within the limits of a joint.
    pub(crate) fn gains(&self, limits: &JointLimits) -> [f32; 2] {
        [self.kp.min(limits.kp), self.kd.min(limits.kd)]
    }

    /// Returns the setpoint of a joint that was at `centre`, rad, at `time`, s, after its motor
    /// follows setpoints.
    pub(crate) fn setpoint(&self, time: f64, centre: f32, limits: &JointLimits) -> Setpoint {
        let [kp, kd] = self.gains(limits);
        let (risen, rise) = ramp(time);
        let share = (FIRST_SHARE + (1.0 - FIRST_SHARE) * risen) as f32;
        let (amplitude, omega) = (f64::from(self.amplitude), TAU * f64::from(self.frequency));
        let (sin, cos) = (omega * time).sin_cos();
        let distance = amplitude * risen * sin;
        let velocity = amplitude * (risen * omega * cos + rise * sin);
        let position = limits.clamp_position(centre + distance as f32);
        Setpoint::impedance(position, velocity as f32, share * kp, share * kd, 0.0)
    }

    /// Returns the setpoint of a joint that the motion does not move: damping alone.
    pub(crate) fn rest(&self, limits: &JointLimits) -> Setpoint {
        let [_, kd] = self.gains(limits);
        Setpoint::damping(kd)
    }

    /// Checks that the sine around `centre`, rad, stays within the limits of a joint.
    ///
    /// # Errors
    ///
    /// With the numbers, when it does not.
    pub(crate) fn check(&self, joint: &str, centre: f32, limits: &JointLimits) -> Result<(), HoldFailure> {
        let Self { amplitude, frequency, .. } = *self;
        if amplitude == 0.0 {
            return Ok(());
        }
        let (joint, [lower, upper]) = (joint.to_owned(), limits.position);
        if !limits.allow(centre - amplitude) || !limits.allow(centre + amplitude) {
            return Err(HoldFailure::OutOfRange { joint, position: centre, amplitude, lower, upper });
        }
        let (peak, limit) = (amplitude * frequency * TAU as f32, limits.velocity);
        if peak > limit { Err(HoldFailure::TooFast { joint, peak, limit }) } else { Ok(()) }
    }
}

/// Returns the share to which the ramp has risen at `time`, s, and its rise, 1/s. Both are
/// continuous.
fn ramp(time: f64) -> (f64, f64) {
    let part = (time / RAMP).clamp(0.0, 1.0);
    (part * part * (3.0 - 2.0 * part), 6.0 * part * (1.0 - part) / RAMP)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOTION: Motion = Motion { kp: 20.0, kd: 1.0, amplitude: 0.2, frequency: 0.5 };

    fn limits() -> JointLimits {
        JointLimits { position: [-1.0, 1.0], velocity: 2.0, torque: 5.0, kp: 10.0, kd: 0.5 }
    }

    #[test]
    fn gains_rise_to_the_configurations_limits() {
        let at = |time| MOTION.setpoint(time, 0.3, &limits());
        let first = at(0.0);
        assert_eq!((first.position, first.velocity, first.torque), (0.3, 0.0, 0.0));
        assert!(first.kp > 0.0 && first.kp < 0.6 && first.kd < 0.03, "{first:?}");
        let mut before = first;
        for step in 1..=100 {
            let now = at(0.01 * f64::from(step));
            assert!(now.kp >= before.kp && now.kp - before.kp < 0.2, "{before:?} {now:?}");
            before = now;
        }
        assert_eq!([at(1.0).kp, at(1.0).kd], [10.0, 0.5]);
    }

    #[test]
    fn velocity_is_slope_of_position() {
        let at = |time| MOTION.setpoint(time, 0.3, &limits());
        for step in 0..400 {
            let time = 0.01 * f64::from(step);
            let slope = (at(time + 5e-4).position - at(time - 5e-4).position) / 1e-3;
            assert!((slope - at(time).velocity).abs() < 5e-3, "{time}: {slope} {}", at(time).velocity);
        }
    }

    #[test]
    fn sine_beyond_limits_is_refused_with_numbers() {
        let refused =
            |motion: Motion, centre| motion.check("knee", centre, &limits()).unwrap_err().to_string();
        assert!(MOTION.check("knee", 0.7, &limits()).is_ok());
        let far = refused(MOTION, 0.9);
        assert!(
            far.starts_with(
                "knee is at 0.90 rad, and with ±0.2 rad it would leave its limits, -1.00 to 1.00"
            ),
            "{far}"
        );
        let fast = refused(Motion { frequency: 2.0, ..MOTION }, 0.0);
        assert!(fast.starts_with("the sine needs 2.51 rad/s, and knee may turn at 2.00 rad/s"), "{fast}");
        let still = Motion { amplitude: 0.0, ..MOTION };
        assert!(still.check("knee", 3.0, &limits()).is_ok(), "the daemon judges the pose");
    }
}
