//! A smooth motion to a pose, checked against the limits of the joints before it begins.

use motord_client::{Claim, Client, Error, JointLimits, Setpoint, State};
use std::time::Duration;

/// The highest speed of the motion, as a multiple of distance divided by time.
const PEAK: f32 = 1.875;
/// Longest time without a check for Ctrl-C, cycles.
const CYCLES: u32 = 50;
const PATIENCE: Duration = Duration::from_secs(1);

/// The motion of a joint.
#[derive(Debug, Clone, Copy)]
struct Path {
    start: f32,
    goal: f32,
    kp: f32,
    kd: f32,
}

/// A motion that has begun.
#[derive(Debug)]
pub(crate) struct Motion {
    paths: Vec<Path>,
    begun: Duration,
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
    /// Plans the motion of the joints of `claim`, in its order, from their present commands, or positions where they
    /// have no stiffness.
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
        let (mut paths, mut slowest) = (Vec::new(), Slowest::default());
        for (place, name) in claim.names().enumerate() {
            let joint = group.joint(name)?;
            let measured = group.position(name)?;
            let start = if joint.applied.kp > 0.0 { joint.applied.position } else { measured };
            let [goal, kp, kd] = goals(place);
            let (path, limits) = (Path { start, goal, kp, kd }, claim.limits(name)?);
            if let Some(objection) = outside(name, goal, &limits) {
                return Ok(Err(objection));
            }
            slowest.note(name, &path, &limits);
            paths.push(path);
        }
        if slowest.least > seconds {
            return Ok(Err(slowest.text));
        }
        Ok(Ok(Self { paths, begun: state.time(), seconds }))
    }

    /// Moves for some cycles. Returns `true` once the goal is sent.
    ///
    /// # Errors
    /// Those of waiting and sending; [`Error::Stopped`] when the group is stopped.
    pub(crate) fn advance(&self, client: &Client, claim: &mut Claim) -> Result<bool, Error> {
        for _ in 0..CYCLES {
            let state = client.wait(PATIENCE)?;
            state.of(claim)?.must_be_active()?;
            let time = state.time().saturating_sub(self.begun).as_secs_f64();
            let at = if self.seconds > 0.0 { time / self.seconds } else { 1.0 };
            claim.send(&self.setpoints(at))?;
            if at >= 1.0 {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn setpoints(&self, at: f64) -> Vec<Setpoint> {
        let (distance, speed) = share(at);
        let per_second = if self.seconds > 0.0 { speed / self.seconds as f32 } else { 0.0 };
        let setpoint = |path: &Path| {
            let way = path.goal - path.start;
            Setpoint::impedance(path.start + way * distance, way * per_second, path.kp, path.kd, 0.0)
        };
        self.paths.iter().map(setpoint).collect()
    }
}
