//! A smooth motion to a pose, checked against the limits of the joints before it begins.

use crate::arrays::{duration, pose};
use motord_client::{Claim, Client, Error, JointLimits, Setpoint, State};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::time::Duration;

/// The highest speed of the motion, as a multiple of distance divided by time.
const PEAK: f32 = 1.875;
/// Longest time without a check for Ctrl-C, cycles.
const CYCLES: u32 = 50;
const TIMEOUT: Duration = Duration::from_secs(1);

/// The motion of a joint.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Path {
    pub(crate) start: f32,
    pub(crate) goal: f32,
}

/// A smooth motion. joints are names, lowest and highest position, rad, and largest speed, rad/s.
///
/// ValueError with the joint whose goal is outside its limits, or that would be too fast.
#[pyclass(frozen, module = "motord._motord")]
#[derive(Debug)]
pub(crate) struct Motion {
    paths: Vec<Path>,
    seconds: f64,
}

/// Share of the distance after the share `at` of the time, and its derivative: the minimum-jerk polynomial.
fn share(at: f64) -> (f32, f32) {
    let at = at.clamp(0.0, 1.0);
    let distance = at * at * at * (10.0 + at * (6.0 * at - 15.0));
    let speed = 30.0 * at * at * (1.0 + at * (at - 2.0));
    (distance as f32, speed as f32)
}

/// Returns the sentence about a joint whose goal is outside its limits.
fn outside(name: &str, goal: f32, limits: &JointLimits) -> Option<String> {
    let [lower, upper] = limits.position;
    (!limits.allow(goal)).then(|| format!("{name}: {goal} rad is outside its limits, {lower} to {upper} rad"))
}

/// The joint that needs most of the time.
#[derive(Debug, Default)]
struct Slowest {
    least: f64,
    text: String,
}

impl Slowest {
    fn note(&mut self, name: &str, path: &Path, limits: &JointLimits) {
        let distance = (path.goal - path.start).abs();
        let least = f64::from(PEAK * distance / limits.velocity);
        if least > self.least {
            let text = format!("{name} has {distance:.2} rad to move, at most {} rad/s", limits.velocity);
            // Rounded up, so that the time that is asked for is enough.
            *self = Self {
                least,
                text: format!("{text}: give at least {:.2} s", (least * 100.0).ceil() / 100.0),
            };
        }
    }
}

impl Motion {
    /// Plans the motion of joints of these names and limits.
    ///
    /// # Errors
    /// A sentence about the joint that may not move so.
    pub(crate) fn new<'a>(
        joints: impl Iterator<Item = (&'a str, JointLimits, Path)>,
        seconds: f64,
    ) -> Result<Self, String> {
        let (mut paths, mut slowest) = (Vec::new(), Slowest::default());
        for (name, limits, path) in joints {
            if let Some(objection) = outside(name, path.goal, &limits) {
                return Err(objection);
            }
            slowest.note(name, &path, &limits);
            paths.push(path);
        }
        if slowest.least > seconds { Err(slowest.text) } else { Ok(Self { paths, seconds }) }
    }
}

#[pymethods]
impl Motion {
    /// Plans the motion of joints of these names, with lowest and highest position, rad, and largest speed, rad/s, to a
    /// pose as that of `Claim.move_to`.
    #[new]
    fn of_joints(
        joints: Vec<(String, [f32; 2], f32)>,
        starts: Vec<f32>,
        goals: &Bound<'_, PyAny>,
        seconds: f64,
    ) -> PyResult<Self> {
        let names: Vec<_> = joints.iter().map(|(name, ..)| name.clone()).collect();
        let goals = pose(goals, &names)?;
        let paths = starts.into_iter().zip(goals).map(|(start, goal)| Path { start, goal });
        let limits = |position, velocity| JointLimits { position, velocity, ..JointLimits::default() };
        let joints = joints.iter().zip(paths);
        let joints =
            joints.map(|((name, position, velocity), path)| (&**name, limits(*position, *velocity), path));
        Self::new(joints, duration("seconds", seconds)?.as_secs_f64()).map_err(PyValueError::new_err)
    }

    /// The position, rad, and velocity, rad/s, of each joint, and whether it is at its goal, after this time, s.
    fn at(&self, time: f64) -> (Vec<f32>, Vec<f32>, bool) {
        let at = if self.seconds > 0.0 { time / self.seconds } else { 1.0 };
        let (distance, speed) = share(at);
        let per_second = if self.seconds > 0.0 { speed / self.seconds as f32 } else { 0.0 };
        let span = |path: &Path| path.goal - path.start;
        let positions = self.paths.iter().map(|path| path.start + span(path) * distance);
        let velocities = self.paths.iter().map(|path| span(path) * per_second);
        (positions.collect(), velocities.collect(), at >= 1.0)
    }
}

/// A motion of a claim that has begun.
#[derive(Debug)]
pub(crate) struct Begun {
    motion: Motion,
    /// Stiffness and damping of each joint.
    gains: Vec<[f32; 2]>,
    begun: Duration,
}

impl Begun {
    /// Plans the motion of the joints of `claim`, in its order, from their present commands, or positions where they
    /// have no stiffness. `goals` are position, stiffness and damping.
    ///
    /// # Errors
    /// A sentence about the joint that may not move so. An error of the group is that of the outer result.
    pub(crate) fn plan(
        claim: &Claim,
        state: &State,
        goals: impl Fn(usize) -> [f32; 3],
        seconds: f64,
    ) -> Result<Result<Self, String>, Error> {
        let group = state.of(claim)?;
        group.must_be_active()?;
        let (mut joints, mut gains) = (Vec::new(), Vec::new());
        for (index, name) in claim.names().enumerate() {
            let joint = group.joint(name)?;
            let measured = group.position(name)?;
            let start = if joint.applied.kp > 0.0 { joint.applied.position } else { measured };
            let [goal, kp, kd] = goals(index);
            joints.push((name, claim.limits(name)?, Path { start, goal }));
            gains.push([kp, kd]);
        }
        let motion = Motion::new(joints.into_iter(), seconds);
        Ok(motion.map(|motion| Self { motion, gains, begun: state.time() }))
    }

    /// Moves for some cycles. Returns `true` once the goal is sent.
    ///
    /// # Errors
    /// Those of waiting and sending; [`Error::Stopped`] when the group is stopped.
    pub(crate) fn advance(&self, client: &Client, claim: &mut Claim) -> Result<bool, Error> {
        for _ in 0..CYCLES {
            let state = client.wait(TIMEOUT)?;
            state.of(claim)?.must_be_active()?;
            let (positions, velocities, is_at_goal) =
                self.motion.at(state.time().saturating_sub(self.begun).as_secs_f64());
            let setpoints = positions.iter().zip(&velocities).zip(&self.gains);
            let setpoints = setpoints.map(|((q, dq), [kp, kd])| Setpoint::impedance(*q, *dq, *kp, *kd, 0.0));
            claim.send(&setpoints.collect::<Vec<_>>())?;
            if is_at_goal {
                // The caller may begin a slow loop.
                claim.keep_for(Duration::MAX)?;
                return Ok(true);
            }
        }
        Ok(false)
    }
}
