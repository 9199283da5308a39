//! A trot on the spot: diagonal legs swing together, the two pairs in antiphase. Pure: time is an
//! argument.

use std::f64::consts::{PI, TAU};

/// The group that trots.
pub(crate) const GROUP: &str = "legs";
/// Strides per second, Hz.
const STRIDE_HZ: f64 = 1.5;
/// Amplitude of a thigh, rad.
const THIGH_SWING: f64 = 0.2;
/// Amplitude of a knee, rad.
const KNEE_SWING: f64 = 0.25;
/// The knee leads its thigh by a quarter of a stride: the foot is up while the leg swings forward.
const KNEE_LEAD: f64 = PI / 2.0;
/// The swing grows from nothing over this time, s, so that no joint jumps.
pub(crate) const BLEND: f64 = 1.0;

/// The motion of a joint about its start position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Swing {
    /// rad.
    amplitude: f64,
    /// rad.
    phase: f64,
}

impl Swing {
    /// Returns the motion of the joint `name`: `fl-thigh` is the thigh of the front left leg. Hips
    /// and joints of no leg do not move.
    pub(crate) fn of(name: &str) -> Self {
        let (leg, part) = name.split_once('-').unwrap_or((name, ""));
        let pair = match leg {
            "fl" | "rr" => 0.0,
            _ => PI,
        };
        match part {
            "thigh" => Self { amplitude: THIGH_SWING, phase: pair },
            "knee" => Self { amplitude: KNEE_SWING, phase: pair + KNEE_LEAD },
            _ => Self { amplitude: 0.0, phase: 0.0 },
        }
    }

    /// Returns distance from the start position, rad, and velocity, rad/s, at `time` seconds after
    /// the start.
    pub(crate) fn at(self, time: f64) -> (f64, f64) {
        let (blend, blend_rate) = blend(time);
        let (sine, cosine) = (TAU * STRIDE_HZ * time + self.phase).sin_cos();
        let distance = self.amplitude * blend * sine;
        let velocity = self.amplitude * (blend * TAU * STRIDE_HZ * cosine + blend_rate * sine);
        (distance, velocity)
    }
}

/// Returns a blend that rises from 0 to 1 over [`BLEND`] without a step in its rate, and the rate,
/// 1/s.
fn blend(time: f64) -> (f64, f64) {
    let x = (time / BLEND).clamp(0.0, 1.0);
    (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / BLEND)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 1e-3;

    #[test]
    fn trot_begins_at_current_pose_at_rest() {
        for joint in ["fl-hip", "fl-thigh", "fr-knee", "rr-knee", "gripper"] {
            assert_eq!(Swing::of(joint).at(0.0), (0.0, 0.0), "{joint}");
        }
    }

    #[test]
    fn the_velocity_is_the_rate_of_the_position() {
        for joint in ["fl-thigh", "fr-knee"] {
            let swing = Swing::of(joint);
            for step in 0..3000 {
                let time = f64::from(step) * STEP;
                let slope = (swing.at(time + STEP / 2.0).0 - swing.at(time - STEP / 2.0).0) / STEP;
                // The blend has a kink in its second derivative at its ends, hence the coarse bound
                // there.
                assert!((slope - swing.at(time).1).abs() < 2e-3, "{joint} at {time} s");
            }
        }
    }

    #[test]
    fn diagonal_legs_move_together_in_antiphase() {
        for part in ["thigh", "knee"] {
            let distance = |leg: &str| Swing::of(&format!("{leg}-{part}")).at(2.345).0;
            assert!((distance("fl") - distance("rr")).abs() < 1e-12);
            assert!((distance("fr") - distance("rl")).abs() < 1e-12);
            assert!((distance("fl") + distance("fr")).abs() < 1e-12);
        }
    }

    #[test]
    fn hips_stand_still() {
        assert_eq!(Swing::of("rl-hip").at(2.345), (0.0, 0.0));
    }
}
