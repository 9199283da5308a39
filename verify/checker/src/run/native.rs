//! Rules for the commands to a native motor (I2). Each contains one value, with the precision of a
//! float.

use crate::protocol::codec::Meaning;
use crate::robot::Limits;
use crate::state::Joint;

/// Single precision, as a share of the largest value.
const PRECISION: f64 = 1e-5;
/// Shortest time in which a speed rises from zero to the joint's limit, s. It begins at the speed
/// of the joint.
const SPEED_RISE: f64 = 0.5;
/// Least slope of a braking speed, as a share of `SPEED_RISE`'s. At over-voltage a quarter of that
/// slope is left. A fault request may replace each second command, and its cycle may be longer than
/// the other.
const LEAST_SLOPE: f64 = 0.05;

/// The last control command to one native motor.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Last {
    /// The command, and its time, s.
    order: Option<(Meaning, f64)>,
    /// Time at which the motor was last neither moved nor damped, s.
    rested: f64,
}

impl Last {
    /// Checks a control command at `time`, s, to a motor that follows setpoints, by the states
    /// before and after its cycle. A speed may begin at one of these `velocities`, rad/s. For a motor that takes turns, `turn` is the length of one, s:
    /// its bus may have refused commands. It may begin to follow within its turn.
    pub(super) fn check(
        &mut self,
        order: Meaning,
        (time, turn): (f64, Option<f64>),
        limits: &Limits,
        [joint, now]: [&Joint; 2],
        velocities: &[f64],
    ) {
        let last = self.order.replace((order, time));
        let begun = turn.map_or(time, |turn| self.rested.min(time - turn));
        let elapsed = time - last.map_or(begun, |(_, before)| before);
        match (order, last.map(|(last, _)| last)) {
            (Meaning::Position(position), Some(Meaning::Position(before))) => {
                check_step("the position", position - before, limits.velocity * elapsed, limits.position[1]);
            }
            (Meaning::Speed(speed), Some(Meaning::Speed(before))) => {
                check_step(
                    "the speed",
                    speed - before,
                    limits.velocity / SPEED_RISE * elapsed,
                    limits.velocity,
                );
            }
            (Meaning::Speed(speed), _) => {
                let step = |begun: f64| if falls(begun, speed) { 0.0 } else { speed - begun };
                let steps = velocities.iter().copied().map(step);
                let step = steps.min_by(|one, other| one.abs().total_cmp(&other.abs())).unwrap_or(f64::NAN);
                check_step("the speed", step, limits.velocity / SPEED_RISE * elapsed, limits.velocity);
            }
            (Meaning::Torque(torque), Some(Meaning::Torque(before))) if is_free(joint) && is_free(now) => {
                // The limits may reduce a torque by any amount in one step.
                let step = if falls(before, torque) { 0.0 } else { torque - before };
                check_step("the torque", step, limits.torque.slew * elapsed, limits.torque.most);
            }
            _ => {}
        }
    }

    /// Checks a control command at `time`, s, to a motor that is damped: a speed falls to zero. A
    /// motor that was lost meanwhile is braked from its speed when it replies again. `applied` is
    /// the previously sent speed, rad/s, which a line may have lost.
    pub(super) fn check_braking(&mut self, order: Meaning, time: f64, limits: &Limits, applied: f64) {
        let last = self.order.replace((order, time)).filter(|(_, then)| *then >= self.rested);
        let (Meaning::Speed(speed), Some((Meaning::Speed(before), then))) = (order, last) else {
            return;
        };
        let fall = LEAST_SLOPE * limits.velocity / SPEED_RISE * (time - then);
        let most = (before.abs().max(applied.abs()) - fall).max(0.0) + PRECISION * limits.velocity;
        assert!(speed.abs() <= most, "I10: a speed that brakes was {before} and became {speed}");
    }

    /// Records that it received another command: the next one starts a new slope.
    pub(super) const fn forget(&mut self) {
        self.order = None;
    }

    /// Records that it is neither moved nor damped at `time`, s, whether or not it receives a
    /// command.
    pub(super) const fn rest(&mut self, time: f64) {
        self.rested = time;
    }
}

/// Returns `true` when the value is nearer to zero than the previous one, and not beyond zero.
fn falls(before: f64, value: f64) -> bool {
    value * before >= 0.0 && value.abs() < before.abs()
}

/// Returns `true` when neither stiffness nor damping is part of the torque.
fn is_free(joint: &Joint) -> bool {
    joint.applied_kp == 0.0 && joint.applied_kd == 0.0
}

fn check_step(name: &str, step: f64, reach: f64, largest: f64) {
    let most = reach + PRECISION * largest.abs().max(1.0);
    assert!(step.abs() <= most, "I2: {name} stepped by {step}, expected at most {most}");
}

/// Checks the value of a command by the limits of its joint. `active`: the position is the
/// controller's, and not slewed.
pub(super) fn check_value(order: Meaning, limits: &Limits, active: bool) {
    let within = |value: f64, most: f64| value.is_finite() && value.abs() <= most * (1.0 + PRECISION);
    match order {
        Meaning::Torque(torque) => assert!(within(torque, limits.torque.most), "I2: torque {torque}"),
        Meaning::Speed(speed) => assert!(within(speed, limits.velocity), "I2: velocity {speed}"),
        Meaning::Position(position) => {
            let [low, high] = limits.position;
            let noise = PRECISION * low.abs().max(high.abs());
            let inside = (low - noise..=high + noise).contains(&position);
            assert!(position.is_finite() && (inside || !active), "I2: position {position}");
        }
        _ => {}
    }
}
