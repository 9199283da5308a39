//! A trajectory: its rules, and its setpoints at a time.

use crate::group::Group;
use crate::refusal::Refusal;
use crate::rules::{self, Gains, Rules, Stamped};
use motord_client::Setpoint;
use std::time::Duration;

/// Longest time between setpoints that a joint needs at its velocity limit, of which a step may use
/// this share: the points of planners lie on the limit.
const VELOCITY_MARGIN: f64 = 1.05;

/// A trajectory as it arrived.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct IncomingTrajectory<'a> {
    pub(crate) stamp: Stamped,
    /// Time at which the DDS writer sent the message, ns since 1970, if it reported that.
    pub(crate) sent_ns: Option<u64>,
    pub(crate) names: &'a [String],
    pub(crate) points: &'a [IncomingPoint<'a>],
}

/// A point of a trajectory as it arrived.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct IncomingPoint<'a> {
    /// rad.
    pub(crate) position: &'a [f64],
    /// rad/s; empty for straight lines between the positions.
    pub(crate) velocity: &'a [f64],
    /// N·m; empty for zeros.
    pub(crate) effort: &'a [f64],
    /// Seconds and nanoseconds from the start.
    pub(crate) time: (i32, u32),
}

/// A point, in the group's order.
#[derive(Debug, Clone, PartialEq)]
struct Point {
    time: Duration,
    position: Vec<f32>,
    /// `None` for a straight line.
    velocity: Option<Vec<f32>>,
    effort: Vec<f32>,
}

/// A trajectory from the present positions to its last point, in the group's order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Trajectory {
    /// The first point is the present position, at time zero.
    points: Vec<Point>,
    gains: Vec<(f32, f32)>,
}

impl Trajectory {
    /// Checks a trajectory that begins at the positions `present`, in the group's order.
    pub(crate) fn check(
        incoming: &IncomingTrajectory,
        present: &[Option<f32>],
        rules: &Rules,
    ) -> Result<Self, Refusal> {
        rules::check_stamp(incoming.stamp, incoming.sent_ns, rules)?;
        let slots = rules::slots(Some(incoming.names), rules.group)?;
        let (kp, kd) = rules::gains(Gains::Configured, &slots, rules)?;
        if incoming.points.is_empty() {
            return Err(Refusal::NoPoints);
        }
        let position: Option<Vec<f32>> = present.iter().copied().collect();
        let position = position.filter(|position| position.len() == slots.len());
        let position = position.ok_or(Refusal::PositionUnknown)?;
        let count = slots.len();
        let start = Point {
            time: Duration::ZERO,
            position,
            velocity: Some(vec![0.0; count]),
            effort: vec![0.0; count],
        };
        let mut points = vec![start];
        for (index, incoming) in incoming.points.iter().enumerate() {
            let point = Point::check(incoming, &slots)?;
            let last = &points[points.len() - 1];
            let rises = if index == 0 { point.time >= last.time } else { point.time > last.time };
            if !rises || point.time.as_secs_f64() > rules.commands.trajectory_max_s {
                return Err(Refusal::Times);
            }
            check_step(last, &point, rules)?;
            points.push(point);
        }
        Ok(Self { points, gains: in_group_order(&slots, &kp.into_iter().zip(kd).collect::<Vec<_>>()) })
    }

    /// Returns the time of the last point.
    pub(crate) fn duration(&self) -> Duration {
        self.points.last().map_or(Duration::ZERO, |point| point.time)
    }

    /// Returns `true` if a position is outside the limits of its joint. The daemon clamps it.
    pub(crate) fn exceeds_limits(&self, group: &Group) -> bool {
        let is_outside = |point: &Point| {
            point.position.iter().zip(&group.joints).any(|(position, joint)| !joint.limits.allow(*position))
        };
        self.points.iter().skip(1).any(is_outside)
    }

    /// Returns the setpoints at `time` after the start. The last point holds after its time.
    pub(crate) fn at(&self, time: Duration) -> Vec<Setpoint> {
        let next = self.points.partition_point(|point| point.time <= time);
        let from = &self.points[next.saturating_sub(1)];
        let setpoint = |(joint, (kp, kd)): (usize, &(f32, f32))| {
            let (position, velocity, effort) = match self.points.get(next) {
                Some(to) => between(from, to, joint, time),
                None => (from.position[joint], 0.0, from.effort[joint]),
            };
            Setpoint::impedance(position, velocity, *kp, *kd, effort)
        };
        self.gains.iter().enumerate().map(setpoint).collect()
    }
}

impl Point {
    fn check(incoming: &IncomingPoint, slots: &[usize]) -> Result<Self, Refusal> {
        let count = slots.len();
        let position = rules::values(incoming.position, count, Refusal::PositionLength)?;
        let velocity = match incoming.velocity.is_empty() {
            true => None,
            false => Some(rules::values(incoming.velocity, count, Refusal::VelocityLength)?),
        };
        let effort = rules::values_or_zeros(incoming.effort, count, Refusal::EffortLength)?;
        let (sec, nanosec) = incoming.time;
        let sec = u64::try_from(sec).map_err(|_| Refusal::Times)?;
        if nanosec >= 1_000_000_000 {
            return Err(Refusal::Times);
        }
        Ok(Self {
            time: Duration::new(sec, nanosec),
            position: in_group_order(slots, &position),
            velocity: velocity.map(|velocity| in_group_order(slots, &velocity)),
            effort: in_group_order(slots, &effort),
        })
    }
}

/// Checks that each joint may move from one point to the next in the time between them.
fn check_step(from: &Point, to: &Point, rules: &Rules) -> Result<(), Refusal> {
    let seconds = to.time.saturating_sub(from.time).as_secs_f64();
    for (index, joint) in rules.group.joints.iter().enumerate() {
        let step = f64::from((to.position[index] - from.position[index]).abs());
        let free = rules.commands.trajectory_step_rad;
        if step > free + seconds * f64::from(joint.limits.velocity) * VELOCITY_MARGIN {
            return Err(Refusal::Jump);
        }
    }
    Ok(())
}

fn in_group_order<T: Copy>(slots: &[usize], values: &[T]) -> Vec<T> {
    let mut ordered = values.to_vec();
    for (value, slot) in values.iter().zip(slots) {
        ordered[*slot] = *value;
    }
    ordered
}

/// Returns position, velocity and torque of a joint between two points: cubic where the second one
/// has a velocity, otherwise on a straight line.
fn between(from: &Point, to: &Point, joint: usize, time: Duration) -> (f32, f32, f32) {
    let length = to.time.saturating_sub(from.time).as_secs_f32().max(1e-6);
    let share = (time.saturating_sub(from.time).as_secs_f32() / length).clamp(0.0, 1.0);
    let (p0, p1) = (from.position[joint], to.position[joint]);
    let effort = from.effort[joint] + share * (to.effort[joint] - from.effort[joint]);
    let line = (p1 - p0) / length;
    let Some(end) = &to.velocity else { return (p0 + share * (p1 - p0), line, effort) };
    let begin = from.velocity.as_ref().map_or(line, |velocity| velocity[joint]);
    let (v0, v1) = (begin * length, end[joint] * length);
    let (square, cube) = (share * share, share * share * share);
    let position = (2.0 * cube - 3.0 * square + 1.0) * p0
        + (cube - 2.0 * square + share) * v0
        + (3.0 * square - 2.0 * cube) * p1
        + (cube - square) * v1;
    let slope = (6.0 * square - 6.0 * share) * (p0 - p1)
        + (3.0 * square - 4.0 * share + 1.0) * v0
        + (3.0 * square - 2.0 * share) * v1;
    (position, slope / length, effort)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Commands;
    use crate::fixtures::{NOW, NOW_NS, group, names, rules};
    use crate::group::JointGains;

    const fn point<'a>(position: &'a [f64], velocity: &'a [f64], time: (i32, u32)) -> IncomingPoint<'a> {
        IncomingPoint { position, velocity, effort: &[], time }
    }

    /// The outcome for points of the joints `b` and `a`, which are at 0 rad.
    fn outcome(points: &[IncomingPoint]) -> Result<Trajectory, Refusal> {
        outcome_from(points, &[Some(0.0), Some(0.0)])
    }

    fn outcome_from(points: &[IncomingPoint], present: &[Option<f32>]) -> Result<Trajectory, Refusal> {
        let (group, commands, names) = (group(&["a", "b"]), Commands::default(), names(&["b", "a"]));
        let gains = JointGains { kp: vec![40.0, 50.0], kd: vec![1.0, 2.0] };
        let rules = Rules { gains: Some(&gains), ..rules(&group, &commands) };
        let incoming = IncomingTrajectory { stamp: NOW, sent_ns: Some(NOW_NS), names: &names, points };
        Trajectory::check(&incoming, present, &rules)
    }

    #[test]
    fn straight_lines_lead_from_present_position() {
        let trajectory = outcome(&[point(&[0.4, 0.2], &[], (1, 0))]).unwrap();
        assert_eq!(trajectory.duration(), Duration::from_secs(1));
        let halfway = trajectory.at(Duration::from_millis(500));
        assert_eq!(halfway[0], Setpoint::impedance(0.1, 0.2, 40.0, 1.0, 0.0));
        assert_eq!(halfway[1], Setpoint::impedance(0.2, 0.4, 50.0, 2.0, 0.0));
        let end = trajectory.at(Duration::from_secs(5));
        assert_eq!(end[0], Setpoint::impedance(0.2, 0.0, 40.0, 1.0, 0.0));
    }

    #[test]
    fn point_with_velocity_is_reached_smoothly() {
        let trajectory = outcome(&[point(&[0.0, 0.4], &[0.0, 0.0], (1, 0))]).unwrap();
        let positions = |ms| trajectory.at(Duration::from_millis(ms))[0].position;
        assert!((positions(500) - 0.2).abs() < 1e-6);
        assert!(positions(100) < 0.02 && positions(900) > 0.38);
        let velocity = |ms| trajectory.at(Duration::from_millis(ms))[0].velocity;
        assert!(velocity(1).abs() < 0.01 && (velocity(500) - 0.6).abs() < 1e-5);
    }

    #[test]
    fn times_of_points_rise() {
        let at = |time| point(&[0.0, 0.0], &[], time);
        assert_eq!(outcome(&[at((1, 0)), at((1, 0))]), Err(Refusal::Times));
        assert_eq!(outcome(&[at((1, 0)), at((0, 5))]), Err(Refusal::Times));
        assert_eq!(outcome(&[at((-1, 0))]), Err(Refusal::Times));
        assert_eq!(outcome(&[at((0, u32::MAX))]), Err(Refusal::Times));
        assert_eq!(outcome(&[at((10, 1))]), Err(Refusal::Times));
        assert!(outcome(&[at((0, 0)), at((10, 0))]).is_ok());
        assert_eq!(outcome(&[]), Err(Refusal::NoPoints));
    }

    #[test]
    fn step_beyond_velocity_limit_is_refused() {
        assert_eq!(outcome(&[point(&[0.0, 0.06], &[], (0, 0))]), Err(Refusal::Jump));
        assert!(outcome(&[point(&[0.0, 0.04], &[], (0, 0))]).is_ok());
        assert_eq!(outcome(&[point(&[0.0, 0.9], &[], (0, 50_000_000))]), Err(Refusal::Jump));
        assert!(outcome(&[point(&[0.0, 0.9], &[], (0, 100_000_000))]).is_ok());
    }

    #[test]
    fn points_obey_the_rules_of_commands() {
        assert_eq!(outcome(&[point(&[0.0], &[], (1, 0))]), Err(Refusal::PositionLength));
        assert_eq!(outcome(&[point(&[0.0, f64::NAN], &[], (1, 0))]), Err(Refusal::NotANumber));
        assert_eq!(outcome(&[point(&[0.0, 0.0], &[f64::INFINITY, 0.0], (1, 0))]), Err(Refusal::Infinite));
    }

    #[test]
    fn trajectory_needs_the_position_it_begins_at() {
        let points = [point(&[0.0, 0.0], &[], (1, 0))];
        assert_eq!(outcome_from(&points, &[Some(0.0), None]), Err(Refusal::PositionUnknown));
        assert_eq!(outcome_from(&points, &[]), Err(Refusal::PositionUnknown));
    }
}
