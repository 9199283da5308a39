//! The rules of commands: a pure function of a message, its group, the clock and the settings.

use crate::config::Commands;
use crate::group::{Group, GroupJoint, JointGains};
use crate::refusal::Refusal;
use crate::trajectory::Trajectory;
use motord_client::Setpoint;
use std::time::{Duration, Instant};

/// Seconds and nanoseconds of the wall clock, as a message has them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Stamp {
    pub(crate) sec: i32,
    pub(crate) nanosec: u32,
}

/// The stamp of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stamped {
    /// The message has a header.
    Header(Stamp),
    /// The form has no header: the time at which its DDS writer sent it counts.
    Writer,
}

/// Stiffness and damping of a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Gains<'a> {
    /// Those of the message, in the order of its names.
    Message { kp: &'a [f64], kd: &'a [f64] },
    /// Those of the configuration: the form has none.
    Configured,
}

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

/// What a command is checked against.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rules<'a> {
    pub(crate) group: &'a Group,
    pub(crate) gains: Option<&'a JointGains>,
    pub(crate) commands: &'a Commands,
    pub(crate) horizon_max: Duration,
    /// ns since 1970.
    pub(crate) now_ns: u64,
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

/// What a command makes the group do.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Target {
    Setpoints(Setpoints),
    Trajectory(Trajectory),
}

/// A command that counts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Command {
    /// The number of the claim under which it counts.
    pub(crate) claim: u64,
    pub(crate) arrived: Instant,
    pub(crate) target: Target,
}

impl Command {
    /// Returns the time after its arrival at which the command is fulfilled.
    pub(crate) fn duration(&self) -> Duration {
        match &self.target {
            Target::Setpoints(setpoints) => setpoints.horizon,
            Target::Trajectory(trajectory) => trajectory.duration(),
        }
    }

    /// Returns `true` until `timeout` after the command is fulfilled.
    pub(crate) fn is_in_force(&self, now: Instant, timeout: Duration) -> bool {
        now.saturating_duration_since(self.arrived) <= self.duration() + timeout
    }
}

/// Checks a command, and returns the setpoints of the group.
pub(crate) fn check(incoming: &Incoming, rules: &Rules) -> Result<Setpoints, Refusal> {
    check_stamp(incoming.stamp, incoming.sent_ns, rules)?;
    let slots = slots(incoming.names, rules.group)?;
    let count = rules.group.joints.len();
    let position = values(incoming.position, count, Refusal::PositionLength)?;
    let velocity = values_or_zeros(incoming.velocity, count, Refusal::VelocityLength)?;
    let effort = values_or_zeros(incoming.effort, count, Refusal::EffortLength)?;
    let (kp, kd) = gains(incoming.gains, &slots, rules)?;
    let horizon = horizon(incoming.horizon, rules.horizon_max)?;
    let mut joints = vec![Setpoint::torque(0.0); count];
    for (index, slot) in slots.iter().enumerate() {
        let gains = (kp[index], kd[index]);
        joints[*slot] =
            Setpoint::impedance(position[index], velocity[index], gains.0, gains.1, effort[index]);
    }
    Ok(Setpoints { joints, horizon })
}

/// Checks that a command is young.
pub(crate) fn check_stamp(stamp: Stamped, sent_ns: Option<u64>, rules: &Rules) -> Result<(), Refusal> {
    let of_writer = || sent_ns.ok_or(Refusal::ZeroStamp);
    let stamp_ns = match stamp {
        Stamped::Writer => of_writer()?,
        Stamped::Header(Stamp { sec: 0, nanosec: 0 }) if rules.commands.allow_zero_stamp => of_writer()?,
        Stamped::Header(Stamp { sec: 0, nanosec: 0 }) => return Err(Refusal::ZeroStamp),
        Stamped::Header(Stamp { sec, nanosec }) => {
            let sec = u64::try_from(sec).map_err(|_| Refusal::InvalidStamp)?;
            if nanosec >= 1_000_000_000 {
                return Err(Refusal::InvalidStamp);
            }
            sec * 1_000_000_000 + u64::from(nanosec)
        }
    };
    let milliseconds = |ns: u64| ns as f64 / 1e6;
    if milliseconds(rules.now_ns.saturating_sub(stamp_ns)) > rules.commands.max_age_ms {
        return Err(Refusal::Old);
    }
    if milliseconds(stamp_ns.saturating_sub(rules.now_ns)) > rules.commands.max_ahead_ms {
        return Err(Refusal::Future);
    }
    Ok(())
}

/// Returns for each name its index in the group. Each joint is named exactly once.
pub(crate) fn slots(names: Option<&[String]>, group: &Group) -> Result<Vec<usize>, Refusal> {
    let count = group.joints.len();
    let Some(names) = names else { return Ok((0..count).collect()) };
    let (mut seen, mut slots) = (vec![false; count], Vec::with_capacity(count));
    for name in names {
        let slot = group.joints.iter().position(|joint| joint.name == *name);
        let slot = slot.ok_or(Refusal::UnknownJoint)?;
        if std::mem::replace(&mut seen[slot], true) {
            return Err(Refusal::RepeatedJoint);
        }
        slots.push(slot);
    }
    if slots.len() == count { Ok(slots) } else { Err(Refusal::MissingJoint) }
}

/// Returns `numbers` as the daemon takes them. There must be `count` finite ones.
pub(crate) fn values(numbers: &[f64], count: usize, length: Refusal) -> Result<Vec<f32>, Refusal> {
    if numbers.len() != count {
        return Err(length);
    }
    let value = |number: &f64| match *number as f32 {
        value if value.is_nan() => Err(Refusal::NotANumber),
        value if value.is_infinite() => Err(Refusal::Infinite),
        value => Ok(value),
    };
    numbers.iter().map(value).collect()
}

/// Works like [`values`]; zeros stand for an empty list.
pub(crate) fn values_or_zeros(numbers: &[f64], count: usize, length: Refusal) -> Result<Vec<f32>, Refusal> {
    if numbers.is_empty() { Ok(vec![0.0; count]) } else { values(numbers, count, length) }
}

/// Returns stiffness and damping in the order of the message.
pub(crate) fn gains(gains: Gains, slots: &[usize], rules: &Rules) -> Result<(Vec<f32>, Vec<f32>), Refusal> {
    let count = slots.len();
    let (kp, kd) = match gains {
        Gains::Message { kp, kd } => {
            (values(kp, count, Refusal::KpLength)?, values(kd, count, Refusal::KdLength)?)
        }
        Gains::Configured => {
            let gains = rules.gains.ok_or(Refusal::NoGains)?;
            let in_order = |numbers: &[f64]| slots.iter().map(|slot| numbers[*slot] as f32).collect();
            (in_order(&gains.kp), in_order(&gains.kd))
        }
    };
    match kp.iter().chain(&kd).any(|gain| *gain < 0.0) {
        true => Err(Refusal::NegativeGain),
        false => Ok((kp, kd)),
    }
}

fn horizon(seconds: f64, most: Duration) -> Result<Duration, Refusal> {
    if seconds.is_nan() {
        return Err(Refusal::NotANumber);
    }
    let horizon = Duration::try_from_secs_f64(seconds).map_err(|_| Refusal::Horizon)?;
    if horizon <= most { Ok(horizon) } else { Err(Refusal::Horizon) }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::config::Numbers;
    use motord_client::JointLimits;
    use std::sync::LazyLock;

    pub(crate) const NOW_NS: u64 = 1_000_000_000_000;
    pub(crate) const NOW: Stamped = Stamped::Header(Stamp { sec: 1000, nanosec: 0 });

    /// A group whose joints may move from -1 to 1 rad at 10 rad/s.
    pub(crate) fn group(names: &[&str]) -> Group {
        let limits = JointLimits { position: [-1.0, 1.0], velocity: 10.0, ..JointLimits::default() };
        let joint = |(index, name): (usize, &&str)| GroupJoint { name: (*name).to_owned(), index, limits };
        Group { name: "legs".to_owned(), index: 0, joints: names.iter().enumerate().map(joint).collect() }
    }

    pub(crate) fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    pub(crate) fn rules<'a>(group: &'a Group, commands: &'a Commands) -> Rules<'a> {
        Rules { group, gains: None, commands, horizon_max: Duration::from_millis(50), now_ns: NOW_NS }
    }

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

    #[test]
    fn command_ends_after_horizon_and_timeout() {
        let (arrived, horizon) = (Instant::now(), Duration::from_millis(50));
        let target = Target::Setpoints(Setpoints { joints: Vec::new(), horizon });
        let command = Command { claim: 1, arrived, target };
        let is_in_force =
            |ms| command.is_in_force(arrived + Duration::from_millis(ms), Duration::from_millis(100));
        assert_eq!([0, 150, 151].map(is_in_force), [true, true, false]);
    }
}
