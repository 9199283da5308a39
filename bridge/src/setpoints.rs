//! A command of setpoints: its rules.

use crate::group::{Group, GroupJoint};
use crate::refusal::Refusal;
use crate::rules::{self, Gains, Rules, Stamped};
use motord_client::Setpoint;
use std::time::Duration;

/// A command as it arrived, whatever its form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Incoming<'a> {
    pub(crate) stamp: Stamped,
    /// Time at which the DDS writer sent the message, ns since 1970, if it reported that.
    pub(crate) sent_ns: Option<u64>,
    /// `None`: the joints have the group's order.
    pub(crate) names: Option<&'a [String]>,
    /// rad.
    pub(crate) position: &'a [f64],
    /// rad/s; empty for zeros.
    pub(crate) velocity: &'a [f64],
    /// N·m; empty for zeros.
    pub(crate) effort: &'a [f64],
    pub(crate) gains: Gains<'a>,
    /// s.
    pub(crate) horizon: f64,
}

/// Setpoints in the group's order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Setpoints {
    pub(crate) joints: Vec<Setpoint>,
    pub(crate) horizon: Duration,
}

impl Setpoints {
    /// Returns `true` if a position is outside the limits of its joint. The daemon clamps it.
    pub(crate) fn exceed_limits(&self, group: &Group) -> bool {
        let is_outside = |(setpoint, joint): (&Setpoint, &GroupJoint)| {
            setpoint.kp > 0.0 && !joint.limits.allow(setpoint.position)
        };
        self.joints.iter().zip(&group.joints).any(is_outside)
    }
}

/// Checks a command, and returns the setpoints of the group.
pub(crate) fn check(incoming: &Incoming, rules: &Rules) -> Result<Setpoints, Refusal> {
    rules::check_stamp(incoming.stamp, incoming.sent_ns, rules)?;
    let slots = rules::slots(incoming.names, rules.group)?;
    let count = rules.group.joints.len();
    let position = rules::values(incoming.position, count, Refusal::PositionLength)?;
    let velocity = rules::values_or_zeros(incoming.velocity, count, Refusal::VelocityLength)?;
    let effort = rules::values_or_zeros(incoming.effort, count, Refusal::EffortLength)?;
    let (kp, kd) = rules::gains(incoming.gains, &slots, rules)?;
    let horizon = horizon(incoming.horizon, rules.horizon_max)?;
    let mut joints = vec![Setpoint::torque(0.0); count];
    for (index, slot) in slots.iter().enumerate() {
        let gains = (kp[index], kd[index]);
        joints[*slot] =
            Setpoint::impedance(position[index], velocity[index], gains.0, gains.1, effort[index]);
    }
    Ok(Setpoints { joints, horizon })
}

fn horizon(seconds: f64, most: Duration) -> Result<Duration, Refusal> {
    if seconds.is_nan() {
        return Err(Refusal::NotANumber);
    }
    let horizon = Duration::try_from_secs_f64(seconds).map_err(|_| Refusal::Horizon)?;
    if horizon <= most { Ok(horizon) } else { Err(Refusal::Horizon) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Commands, Numbers};
    use crate::fixtures::{NOW, NOW_NS, group, names, rules};
    use crate::group::JointGains;
    use crate::rules::{Stamp, Stamped, check_stamp};
    use std::sync::LazyLock;

    /// The outcome for a valid command of the joints `b` and `a`, changed by `change`.
    fn outcome<'a>(change: impl FnOnce(&mut Incoming<'a>)) -> Result<Setpoints, Refusal> {
        static NAMES: LazyLock<Vec<String>> = LazyLock::new(|| names(&["b", "a"]));
        let (group, commands) = (group(&["a", "b"]), Commands::default());
        let gains = Gains::Message { kp: &[20.0, 10.0], kd: &[2.0, 1.0] };
        let mut incoming = Incoming {
            stamp: NOW,
            sent_ns: Some(NOW_NS),
            names: Some(&NAMES),
            position: &[0.2, 0.1],
            velocity: &[],
            effort: &[0.4, 0.3],
            gains,
            horizon: 0.02,
        };
        change(&mut incoming);
        check(&incoming, &rules(&group, &commands))
    }

    fn refusal<'a>(change: impl FnOnce(&mut Incoming<'a>)) -> Refusal {
        outcome(change).unwrap_err()
    }

    #[test]
    fn valid_command_is_sorted_into_group_order() {
        let expected =
            [Setpoint::impedance(0.1, 0.0, 10.0, 1.0, 0.3), Setpoint::impedance(0.2, 0.0, 20.0, 2.0, 0.4)];
        let setpoints = outcome(|_| ()).unwrap();
        assert_eq!((setpoints.joints, setpoints.horizon), (expected.to_vec(), Duration::from_millis(20)));
    }

    #[test]
    fn each_joint_is_named_exactly_once() {
        let [missing, unknown, repeated] = [["a"].as_slice(), &["a", "c"], &["a", "a"]].map(names);
        assert_eq!(refusal(|command| command.names = Some(&missing)), Refusal::MissingJoint);
        assert_eq!(refusal(|command| command.names = Some(&unknown)), Refusal::UnknownJoint);
        assert_eq!(refusal(|command| command.names = Some(&repeated)), Refusal::RepeatedJoint);
        assert_eq!(refusal(|command| command.names = Some(&[])), Refusal::MissingJoint);
    }

    #[test]
    fn every_list_has_one_number_per_joint() {
        assert_eq!(refusal(|command| command.position = &[0.0]), Refusal::PositionLength);
        assert_eq!(refusal(|command| command.position = &[]), Refusal::PositionLength);
        assert_eq!(refusal(|command| command.velocity = &[0.0; 3]), Refusal::VelocityLength);
        assert_eq!(refusal(|command| command.effort = &[0.0]), Refusal::EffortLength);
        let gains = |kp, kd| move |command: &mut Incoming| command.gains = Gains::Message { kp, kd };
        assert_eq!(refusal(gains(&[1.0], &[1.0, 1.0])), Refusal::KpLength);
        assert_eq!(refusal(gains(&[1.0, 1.0], &[])), Refusal::KdLength);
    }

    #[test]
    fn every_number_is_a_finite_float() {
        for (number, expected) in [
            (f64::NAN, Refusal::NotANumber),
            (f64::INFINITY, Refusal::Infinite),
            (f64::NEG_INFINITY, Refusal::Infinite),
            (1e300, Refusal::Infinite),
        ] {
            let numbers = [0.0, number];
            assert_eq!(refusal(|command| command.position = &numbers), expected);
            assert_eq!(refusal(|command| command.velocity = &numbers), expected);
            assert_eq!(refusal(|command| command.effort = &numbers), expected);
            let gains = Gains::Message { kp: &[1.0, 1.0], kd: &numbers };
            assert_eq!(refusal(|command| command.gains = gains), expected);
        }
    }

    #[test]
    fn gains_are_not_negative() {
        let negative = Gains::Message { kp: &[1.0, -0.1], kd: &[1.0, 1.0] };
        assert_eq!(refusal(|command| command.gains = negative), Refusal::NegativeGain);
    }

    #[test]
    fn form_without_gains_needs_configured_ones() {
        assert_eq!(refusal(|command| command.gains = Gains::Configured), Refusal::NoGains);
        let (group, commands) = (group(&["a", "b"]), Commands::default());
        let [kp, kd] = [vec![40.0, 50.0], Numbers::All(1.0).of(2).unwrap()];
        let gains = JointGains { kp, kd };
        let rules = Rules { gains: Some(&gains), ..rules(&group, &commands) };
        let incoming = Incoming {
            stamp: Stamped::Writer,
            sent_ns: Some(NOW_NS),
            names: None,
            position: &[0.1, 0.2],
            velocity: &[],
            effort: &[],
            gains: Gains::Configured,
            horizon: 0.0,
        };
        let setpoints = check(&incoming, &rules).unwrap();
        assert_eq!(setpoints.joints[1], Setpoint::hold(0.2, 50.0, 1.0));
    }

    #[test]
    fn stamp_is_neither_old_nor_ahead() {
        let header = |sec, nanosec| Stamped::Header(Stamp { sec, nanosec });
        assert_eq!(refusal(|command| command.stamp = header(999, 899_000_000)), Refusal::Old);
        assert!(outcome(|command| command.stamp = header(999, 901_000_000)).is_ok());
        assert_eq!(refusal(|command| command.stamp = header(1000, 11_000_000)), Refusal::Future);
        assert!(outcome(|command| command.stamp = header(1000, 9_000_000)).is_ok());
        assert_eq!(refusal(|command| command.stamp = header(0, 1)), Refusal::Old);
        assert_eq!(refusal(|command| command.stamp = header(i32::MAX, 0)), Refusal::Future);
    }

    #[test]
    fn impossible_stamps_are_refused() {
        let header = |sec, nanosec| Stamped::Header(Stamp { sec, nanosec });
        assert_eq!(refusal(|command| command.stamp = header(-1, 0)), Refusal::InvalidStamp);
        assert_eq!(refusal(|command| command.stamp = header(999, u32::MAX)), Refusal::InvalidStamp);
    }

    #[test]
    fn zero_stamp_needs_permission_and_young_writer() {
        let (group, mut commands) = (group(&["a"]), Commands::default());
        let zero = Stamped::Header(Stamp { sec: 0, nanosec: 0 });
        assert_eq!(check_stamp(zero, Some(NOW_NS), &rules(&group, &commands)), Err(Refusal::ZeroStamp));
        commands.allow_zero_stamp = true;
        let rules = rules(&group, &commands);
        assert_eq!(check_stamp(zero, Some(NOW_NS), &rules), Ok(()));
        assert_eq!(check_stamp(zero, Some(NOW_NS - 200_000_000), &rules), Err(Refusal::Old));
        assert_eq!(check_stamp(zero, None, &rules), Err(Refusal::ZeroStamp));
    }

    #[test]
    fn form_without_stamp_needs_young_writer() {
        assert_eq!(
            refusal(|command| (command.stamp, command.sent_ns) = (Stamped::Writer, None)),
            Refusal::ZeroStamp
        );
        assert_eq!(
            refusal(|command| (command.stamp, command.sent_ns) = (Stamped::Writer, Some(1))),
            Refusal::Old
        );
    }

    #[test]
    fn horizon_is_within_limit_of_motord() {
        assert_eq!(refusal(|command| command.horizon = -0.001), Refusal::Horizon);
        assert_eq!(refusal(|command| command.horizon = 0.051), Refusal::Horizon);
        assert_eq!(refusal(|command| command.horizon = f64::INFINITY), Refusal::Horizon);
        assert_eq!(refusal(|command| command.horizon = f64::NAN), Refusal::NotANumber);
    }

    #[test]
    fn position_outside_limits_is_left_to_daemon() {
        let group = group(&["a", "b"]);
        assert!(!outcome(|_| ()).unwrap().exceed_limits(&group));
        assert!(outcome(|command| command.position = &[0.0, 1.5]).unwrap().exceed_limits(&group));
    }
}
