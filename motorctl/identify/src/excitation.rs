//! The motion that makes inertia and friction visible, within the limits of the joint.
//!
//! ```text
//! rise -> multisine -> slow sweeps, with reversals from rest -> return
//! ```

use core::f64::consts::TAU;
use core::fmt;

/// Frequencies of the multisine, Hz. Their common period is 100 s.
const FREQUENCIES: [f64; 7] = [0.37, 0.61, 0.97, 1.59, 2.53, 4.09, 6.61];
/// Sets of phases that are tried for a low crest factor.
const PHASE_SETS: u32 = 64;
/// Steps per second at which the peak of a set of phases is computed.
const PEAK_HZ: f64 = 100.0;
/// Time in which gains and amplitude rise and fall, s.
const RAMP: f64 = 1.0;
/// Share of the gains at the beginning. With a stiffness of 0 the daemon would not check the pose.
const FIRST_SHARE: f64 = 0.05;
/// Shares of the limits that commands keep.
const VELOCITY_SHARE: f64 = 0.6;
const TORQUE_SHARE: f64 = 0.7;
/// Share of the range of positions that stays free at each end, and the least that does, rad.
const POSITION_MARGIN: f64 = 0.03;
const POSITION_MARGIN_MIN: f64 = 0.02;
/// Smallest amplitude that shows anything, rad.
const AMPLITUDE_MIN: f64 = 0.05;
/// Amplitude where the limits permit it, rad.
const AMPLITUDE_DEFAULT: f64 = 0.3;
/// Steps of the gains of MIT motors: 500 N·m/rad and 5 N·m·s/rad in 12 bits. Other gains would be
/// rounded by the drive.
const KP_STEP: f64 = 500.0 / 4095.0;
const KD_STEP: f64 = 5.0 / 4095.0;
/// Several codes of velocity, rad/s.
const DITHER: f64 = 0.1;
/// Share of the time for the multisine; the sweeps have the rest.
const MULTISINE_SHARE: f64 = 0.5;
/// Sweeps: share of their time, amplitude as a share, and cycles. The first is for the stiction.
const SWEEPS: [(f64, f64, f64); 3] = [(0.5, 1.0 / 6.0, 2.0), (0.25, 1.0, 1.0), (0.25, 1.0, 3.0)];

/// The limits of a joint, joint side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Lowest and highest position, rad.
    pub position: [f64; 2],
    /// Largest speed, rad/s.
    pub velocity: f64,
    /// Largest torque, N·m.
    pub torque: f64,
    /// Largest stiffness, N·m/rad.
    pub kp: f64,
    /// Largest damping, N·m·s/rad.
    pub kd: f64,
}

impl Limits {
    /// Free range at each end of the positions, rad.
    fn margin(&self) -> f64 {
        let [lower, upper] = self.position;
        (POSITION_MARGIN * (upper - lower)).clamp(POSITION_MARGIN_MIN, 0.1)
    }
}

/// The choices for an excitation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Largest distance from the centre, rad; `None`: 0.3, or what the limits leave.
    pub amplitude: Option<f64>,
    /// Duration of multisine and sweeps, s.
    pub seconds: f64,
    /// Stiffness, N·m/rad. Low, so that the torque shows the joint and not the reference.
    pub kp: f64,
    /// Damping, N·m·s/rad.
    pub kd: f64,
}

/// A setpoint: position, velocity, stiffness and damping, joint side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// rad.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
    /// N·m/rad.
    pub kp: f64,
    /// N·m·s/rad.
    pub kd: f64,
}

/// A part of the excitation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// The gains rise.
    Rise,
    /// Sines of several frequencies.
    Multisine,
    /// Constant velocities in both directions.
    Sweeps,
    /// The joint returns to the centre.
    Return,
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Rise => "gains rise",
            Self::Multisine => "multisine",
            Self::Sweeps => "slow sweeps",
            Self::Return => "returns",
        })
    }
}

/// The reason why a joint cannot be moved, or why its motion ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlanError {
    /// The limits leave less than the amplitude.
    Narrow {
        /// Position of the joint, rad.
        position: f64,
        /// Largest amplitude that fits there, rad.
        most: f64,
        /// Lowest and highest position, rad.
        limits: [f64; 2],
    },
    /// The joint left its limits although its setpoints did not.
    Left {
        /// Position of the joint, rad.
        position: f64,
        /// Lowest and highest position, rad.
        limits: [f64; 2],
    },
    /// The joint became faster than its limit although its setpoints did not.
    Fast {
        /// Velocity of the joint, rad/s.
        velocity: f64,
        /// The limit, rad/s.
        limit: f64,
    },
}

impl fmt::Display for PlanError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Narrow { position, most, limits: [lower, upper] } => write!(
                f,
                "it is at {:.2} rad, where its limits, {lower:.2} to {upper:.2}, leave an amplitude of {:.2} rad: \
                 choose a smaller --amplitude-rad (at least {AMPLITUDE_MIN}), or move it by hand",
                hundredths(*position),
                most.max(0.0)
            ),
            Self::Left { position, limits: [lower, upper] } => write!(
                f,
                "it reached {position:.2} rad, at the end of its limits, {lower:.2} to {upper:.2}: \
                 choose a smaller --amplitude-rad or a larger --kd"
            ),
            Self::Fast { velocity, limit } => write!(
                f,
                "it reached {velocity:.2} rad/s, and its limit is {limit:.2}: choose a smaller --amplitude-rad or a larger --kd"
            ),
        }
    }
}

impl core::error::Error for PlanError {}

/// Avoids a negative zero.
fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0 + 0.0
}

/// An excitation of one joint. Values of every time are within its limits, less a margin.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    limits: Limits,
    centre: f64,
    amplitude: f64,
    shape: Shape,
    phases: Phases,
    /// Amplitude and phase of each frequency.
    sines: Sines,
}

impl Plan {
    /// Plans the excitation of a joint that is at `centre`, rad. Takes milliseconds: it tries sets
    /// of phases.
    ///
    /// # Errors
    ///
    /// [`PlanError::Narrow`].
    pub fn new(limits: Limits, centre: f64, shape: Shape) -> Result<Self, PlanError> {
        let amplitude = amplitude(&limits, centre, shape)?;
        let stepped = |gain: f64, most: f64, step: f64| ((gain.min(most) / step).floor() * step).max(0.0);
        let kp = stepped(shape.kp + KP_STEP / 2.0, limits.kp, KP_STEP);
        let kd = stepped(shape.kd + KD_STEP / 2.0, limits.kd, KD_STEP);
        let shape = Shape { kp, kd, ..shape };
        let phases = Phases::of_low_crest(MULTISINE_SHARE * shape.seconds);
        let sines = phases.scaled(amplitude, VELOCITY_SHARE * limits.velocity);
        Ok(Self { limits, centre, amplitude, shape, phases, sines })
    }

    /// Plans the same excitation around another position, rad, with at most the amplitude of this
    /// one. Takes microseconds: a cycle of the daemon may wait for it.
    ///
    /// # Errors
    ///
    /// [`PlanError::Narrow`].
    pub fn around(&self, centre: f64) -> Result<Self, PlanError> {
        let amplitude = amplitude(&self.limits, centre, self.shape)?.min(self.amplitude);
        let sines = self.phases.scaled(amplitude, VELOCITY_SHARE * self.limits.velocity);
        Ok(Self { centre, amplitude, sines, ..self.clone() })
    }

    /// Largest distance of the reference from the centre, rad.
    #[must_use]
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// Stiffness and damping within the limits.
    #[must_use]
    pub fn gains(&self) -> [f64; 2] {
        [self.shape.kp, self.shape.kd]
    }

    /// Duration of everything, s.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.shape.seconds + 2.0 * RAMP
    }

    /// The part at a time since the motor follows, s; `None` after the last.
    #[must_use]
    pub fn stage(&self, time: f64) -> Option<Stage> {
        let [begin, middle, end] = self.times();
        match time {
            _ if time < begin => Some(Stage::Rise),
            _ if time < middle => Some(Stage::Multisine),
            _ if time < end => Some(Stage::Sweeps),
            _ if time < self.seconds() => Some(Stage::Return),
            _ => None,
        }
    }

    /// Begin of the multisine, of the sweeps, and of the return, s.
    fn times(&self) -> [f64; 3] {
        [RAMP, RAMP + MULTISINE_SHARE * self.shape.seconds, RAMP + self.shape.seconds]
    }

    /// Returns the setpoint at `time`, s, of a joint that is at `position`, rad, with `velocity`,
    /// rad/s. `None`: the end.
    #[must_use]
    pub fn command(&self, time: f64, position: f64, velocity: f64) -> Option<Command> {
        let [begin, middle, end] = self.times();
        let [distance, speed] = match self.stage(time)? {
            Stage::Rise | Stage::Return => [0.0, 0.0],
            Stage::Multisine => self.multisine(time - begin, middle - begin),
            Stage::Sweeps => self.sweep(time - middle, end - middle),
        };
        let speed = speed + dither(time);
        let share = FIRST_SHARE + (1.0 - FIRST_SHARE) * smooth(time / RAMP)[0];
        let (kp, kd) = (share * self.shape.kp, share * self.shape.kd);
        let wanted = Command { position: self.centre + distance, velocity: speed, kp, kd };
        Some(self.bounded(wanted, position, velocity))
    }

    /// Bounds the torque that the command asks for where the joint is, then the position.
    fn bounded(&self, wanted: Command, position: f64, velocity: f64) -> Command {
        let Command { kp, kd, .. } = wanted;
        let damping = kd * (wanted.velocity - velocity);
        let torque = kp * (wanted.position - position) + damping;
        let most = TORQUE_SHARE * self.limits.torque;
        let bounded = torque.clamp(-most, most);
        let reference = if bounded == torque || kp <= 0.0 {
            wanted.position
        } else {
            position + (bounded - damping) / kp
        };
        let ([lower, upper], margin) = (self.limits.position, self.limits.margin());
        Command { position: reference.clamp(lower + margin, upper - margin), ..wanted }
    }

    /// Checks where the joint is, rad, and its velocity, rad/s.
    ///
    /// # Errors
    ///
    /// [`PlanError::Left`] or [`PlanError::Fast`]: the caller stops the joint.
    pub fn check(&self, position: f64, velocity: f64) -> Result<(), PlanError> {
        let ([lower, upper], margin) = (self.limits.position, 0.5 * self.limits.margin());
        if !(lower + margin..=upper - margin).contains(&position) {
            return Err(PlanError::Left { position, limits: self.limits.position });
        }
        if velocity.abs() > self.limits.velocity {
            return Err(PlanError::Fast { velocity, limit: self.limits.velocity });
        }
        Ok(())
    }

    /// Distance from the centre and velocity of the sines, which fade in and out.
    fn multisine(&self, time: f64, seconds: f64) -> [f64; 2] {
        let fade = if time < seconds / 2.0 { time } else { seconds - time };
        let [share, rate] = smooth(fade / RAMP);
        let rate = if time < seconds / 2.0 { rate / RAMP } else { -rate / RAMP };
        let [distance, velocity] = sum(&self.sines, time);
        [share * distance, share * velocity + rate * distance]
    }

    /// Distance and velocity of the sweeps: triangles, each from the centre and back to it.
    fn sweep(&self, time: f64, seconds: f64) -> [f64; 2] {
        let mut from = 0.0;
        for (share, height, cycles) in SWEEPS {
            let length = share * seconds;
            if time < from + length {
                let height = height * self.amplitude;
                let cycles =
                    cycles.min((length * VELOCITY_SHARE * self.limits.velocity / (4.0 * height)).max(0.25));
                let speed = 4.0 * height * cycles / length;
                return triangle((time - from) / length * cycles, height, speed);
            }
            from += length;
        }
        [0.0, 0.0]
    }
}

/// Largest distance from `centre` that is asked for, or that the limits leave, rad.
fn amplitude(limits: &Limits, centre: f64, shape: Shape) -> Result<f64, PlanError> {
    let [lower, upper] = limits.position;
    let most = (centre - lower).min(upper - centre) - 2.0 * limits.margin();
    let amplitude = shape.amplitude.unwrap_or_else(|| most.min(AMPLITUDE_DEFAULT));
    let is_possible = amplitude >= AMPLITUDE_MIN && amplitude <= most;
    is_possible.then_some(amplitude).ok_or(PlanError::Narrow {
        position: centre,
        most,
        limits: limits.position,
    })
}

/// A velocity around 0, rad/s, that differs from cycle to cycle: the drive rounds a constant one
/// always to the same side.
fn dither(time: f64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    DITHER * ((time * 1e3).round() * GOLDEN).fract() - DITHER / 2.0
}

/// Distance and velocity of a triangle wave after `turns` cycles.
fn triangle(turns: f64, height: f64, speed: f64) -> [f64; 2] {
    let phase = turns.fract();
    match phase {
        _ if phase < 0.25 => [4.0 * height * phase, speed],
        _ if phase < 0.75 => [height * (2.0 - 4.0 * phase), -speed],
        _ => [height * (4.0 * phase - 4.0), speed],
    }
}

/// Rises from 0 to 1, with its slope; both are continuous.
pub(crate) fn smooth(part: f64) -> [f64; 2] {
    let part = part.clamp(0.0, 1.0);
    [part * part * (3.0 - 2.0 * part), 6.0 * part * (1.0 - part)]
}

/// Amplitude, rad, and phase of each frequency.
type Sines = [(f64, f64); FREQUENCIES.len()];

/// Sines of the same velocity whose phases keep their sum low.
#[derive(Debug, Clone, PartialEq)]
struct Phases {
    sines: Sines,
    /// Largest distance and velocity of the sum.
    peaks: [f64; 2],
}

impl Phases {
    /// The set of phases with the lowest sum over `seconds`.
    fn of_low_crest(seconds: f64) -> Self {
        let of_set = |set: u32| {
            let mut random = u64::from(set) + 1;
            let sines = FREQUENCIES.map(|frequency| (1.0 / (TAU * frequency), TAU * next(&mut random)));
            Self { sines, peaks: peaks(&sines, seconds) }
        };
        let first = of_set(0);
        let lower = |best: Self, set| {
            let next = of_set(set);
            if next.peaks[0] < best.peaks[0] { next } else { best }
        };
        (1..PHASE_SETS).fold(first, lower)
    }

    /// The sines with this peak, rad, or a lower one where they would be faster than `velocity`,
    /// rad/s.
    fn scaled(&self, peak: f64, velocity: f64) -> Sines {
        let [distance, speed] = self.peaks;
        // A fade adds at most 1.5 times the distance in a second.
        let scale = (peak / distance).min(velocity / (speed + 1.5 * distance / RAMP));
        self.sines.map(|(amplitude, phase)| (scale * amplitude, phase))
    }
}

/// A number from 0 to 1 (xorshift).
fn next(random: &mut u64) -> f64 {
    for _ in 0..8 {
        *random ^= *random << 13;
        *random ^= *random >> 7;
        *random ^= *random << 17;
    }
    (*random >> 11) as f64 / (1_u64 << 53) as f64
}

/// Largest distance and velocity over a time.
fn peaks(sines: &[(f64, f64)], seconds: f64) -> [f64; 2] {
    let steps = (seconds.min(100.0) * PEAK_HZ) as u32;
    (0..=steps)
        .map(|step| sum(sines, f64::from(step) / PEAK_HZ))
        .fold([0.0, 0.0], |peak, now| [f64::max(peak[0], now[0].abs()), f64::max(peak[1], now[1].abs())])
}

fn sum(sines: &[(f64, f64)], time: f64) -> [f64; 2] {
    sines.iter().zip(FREQUENCIES).fold([0.0, 0.0], |[distance, velocity], ((amplitude, phase), frequency)| {
        let omega = TAU * frequency;
        let (sin, cos) = (omega * time + phase).sin_cos();
        [distance + amplitude * sin, velocity + amplitude * omega * cos]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    const LIMITS: Limits = Limits { position: [-1.0, 1.0], velocity: 6.0, torque: 5.0, kp: 50.0, kd: 2.0 };
    const SHAPE: Shape = Shape { amplitude: None, seconds: 40.0, kp: 20.0, kd: 1.0 };

    #[test]
    fn commands_stay_within_limits_wherever_the_joint_is() {
        for velocity in [6.0, 1.0, 0.3] {
            let plan = Plan::new(Limits { velocity, ..LIMITS }, 0.4, SHAPE).unwrap();
            for step in 0..42_000 {
                let time = f64::from(step) * 1e-3;
                for (position, speed) in [(0.4, 0.0), (-0.9, -3.0), (0.9, 3.0)] {
                    let command = plan.command(time, position, speed).unwrap();
                    let Command { position: reference, velocity: rate, kp, kd } = command;
                    assert!((-0.94..=0.94).contains(&reference), "{time}: {command:?}");
                    assert!(rate.abs() <= 0.601 * velocity + DITHER / 2.0, "{time}: {command:?}");
                    // Where the position is bounded, too, the torque is less.
                    let torque = kp * (reference - position) + kd * (rate - speed);
                    assert!(torque.abs() <= 3.5 + 1e-9 || reference.abs() > 0.93, "{time}: {torque}");
                }
            }
            assert_eq!(plan.command(42.0, 0.4, 0.0), None);
        }
    }

    #[test]
    fn velocity_is_slope_of_position() {
        let plan = Plan::new(Limits { torque: 20.0, ..LIMITS }, 0.0, SHAPE).unwrap();
        let mut off = 0;
        for step in 1..41_999 {
            let at = |time: f64| plan.command(time, 0.0, 0.0).unwrap();
            let time = f64::from(step) * 1e-3;
            let [before, now, after] = [-5e-4, 0.0, 5e-4].map(|shift| at(time + shift));
            let slope = (after.position - before.position) / 1e-3;
            off += u32::from((slope - now.velocity).abs() > 0.02 + DITHER / 2.0);
        }
        // A triangle has corners.
        assert!(off < 40, "{off}");
    }

    #[test]
    fn crest_factor_is_low() {
        let sines = Phases::of_low_crest(20.0).scaled(0.3, 100.0);
        let count = 20_000;
        let square: f64 = (0..count).map(|step| sum(&sines, f64::from(step) * 1e-3)[0].powi(2)).sum();
        let crest = 0.3 / (square / f64::from(count)).sqrt();
        assert!(crest < 2.2, "{crest}");
    }

    /// No setpoint is sent while the joint that begins to follow is planned for, and the daemon
    /// stops a silent group.
    #[test]
    fn moved_joint_needs_no_second_search() {
        let begun = Instant::now();
        let plan = Plan::new(LIMITS, 0.4, SHAPE).unwrap();
        let (search, begun) = (begun.elapsed(), Instant::now());
        let moved: Vec<_> = (0..100).map(|_| plan.around(-0.7).unwrap()).collect();
        assert!(begun.elapsed() < search, "100 times in {:?}, and {search:?} for the first", begun.elapsed());
        assert_eq!(moved[0], Plan::new(LIMITS, -0.7, SHAPE).unwrap());
        assert!(matches!(plan.around(0.95), Err(PlanError::Narrow { .. })));
    }

    /// A person has agreed to the amplitude.
    #[test]
    fn moved_joint_gets_no_larger_amplitude() {
        let near = Plan::new(LIMITS, 0.8, SHAPE).unwrap();
        assert!((near.amplitude() - 0.08).abs() < 1e-9, "{}", near.amplitude());
        assert_eq!(near.around(0.0).unwrap().amplitude(), near.amplitude());
    }

    #[test]
    fn joint_at_its_limit_is_refused_with_numbers() {
        let refused = Plan::new(LIMITS, 0.95, SHAPE).unwrap_err().to_string();
        assert!(refused.starts_with("it is at 0.95 rad, where its limits, -1.00 to 1.00"), "{refused}");
        let wide = Plan::new(LIMITS, 0.0, Shape { amplitude: Some(1.2), ..SHAPE }).unwrap_err();
        assert!(matches!(wide, PlanError::Narrow { most, .. } if (most - 0.88).abs() < 1e-9), "{wide}");
        let plan = Plan::new(LIMITS, 0.0, SHAPE).unwrap();
        assert!(plan.check(0.9, 1.0).is_ok());
        assert!(matches!(plan.check(0.98, 0.0), Err(PlanError::Left { .. })));
        assert!(matches!(plan.check(0.0, -6.1), Err(PlanError::Fast { .. })));
        assert!(plan.check(f64::NAN, 0.0).is_err());
    }
}
