//! Rules for the commands to a native motor (I2): each names one value, as exact as a float.

use super::heard::Order;
use crate::robot::Limits;
use crate::state::Joint;

/// Single precision, as a share of the largest value.
const PRECISION: f64 = 1e-5;
/// A speed rises from zero to the joint's limit in this time at least, s. It begins at the speed of the joint.
const SPEED_RISE: f64 = 0.5;
/// A braking speed falls with at least this share of the slope of `SPEED_RISE`. At over-voltage a quarter of that slope is
/// left. A question for faults may replace each second command, and the cycle of that question may be longer than the other.
const LEAST_SLOPE: f64 = 0.05;

/// The last control command to one native motor.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Last {
    /// The command, and when it was heard, s.
    order: Option<(Order, f64)>,
    /// When the motor was last neither moved nor damped, s.
    rested: f64,
}

impl Last {
    /// Judges a control command at `time`, s, to a motor that follows setpoints, by the states before and after its cycle. For a
    /// motor that takes turns, `turn` is the length of one, s: its bus may have refused commands, and it may begin to follow within
    /// its turn.
    pub(super) fn judge(
        &mut self,
        order: Order,
        (time, turn): (f64, Option<f64>),
        limits: &Limits,
        [joint, now]: [&Joint; 2],
    ) {
        let last = self.order.replace((order, time));
        let begun = turn.map_or(time, |turn| self.rested.min(time - turn));
        let elapsed = time - last.map_or(begun, |(_, before)| before);
        match (order, last.map(|(last, _)| last)) {
            (Order::Position(position), Some(Order::Position(before))) => {
                judge_step("the position", position - before, limits.velocity * elapsed, limits.position[1]);
            }
            (Order::Speed(speed), Some(Order::Speed(before))) => {
                judge_step(
                    "the speed",
                    speed - before,
                    limits.velocity / SPEED_RISE * elapsed,
                    limits.velocity,
                );
            }
            (Order::Speed(speed), _) => {
                let begun = f64::from(joint.velocity);
                let step = if falls(begun, speed) { 0.0 } else { speed - begun };
                judge_step("the speed", step, limits.velocity / SPEED_RISE * elapsed, limits.velocity);
            }
            (Order::Torque(torque), Some(Order::Torque(before))) if is_free(joint) && is_free(now) => {
                // The limits may reduce a torque by any amount at once.
                let step = if falls(before, torque) { 0.0 } else { torque - before };
                judge_step("the torque", step, limits.torque_slew * elapsed, limits.torque);
            }
            _ => {}
        }
    }

    /// Judges a control command at `time`, s, to a motor that is damped: a speed falls to zero. A motor that was lost
    /// in between is braked from the speed that it has when it comes back. `applied` is the speed that was sent before, rad/s, which a
    /// line may have lost.
    pub(super) fn judge_braking(&mut self, order: Order, time: f64, limits: &Limits, applied: f64) {
        let last = self.order.replace((order, time)).filter(|(_, then)| *then >= self.rested);
        let (Order::Speed(speed), Some((Order::Speed(before), then))) = (order, last) else { return };
        let fall = LEAST_SLOPE * limits.velocity / SPEED_RISE * (time - then);
        let most = (before.abs().max(applied.abs()) - fall).max(0.0) + PRECISION * limits.velocity;
        assert!(speed.abs() <= most, "I10: a speed that brakes was {before} and became {speed}");
    }

    /// It heard something else: the next command begins anew.
    pub(super) const fn forget(&mut self) {
        self.order = None;
    }

    /// At `time`, s, it is neither moved nor damped, whether or not it hears that.
    pub(super) const fn rest(&mut self, time: f64) {
        self.rested = time;
    }
}

/// The value is nearer to zero than the one before, and not beyond it.
fn falls(before: f64, value: f64) -> bool {
    value * before >= 0.0 && value.abs() < before.abs()
}

/// Neither stiffness nor damping is a part of the torque.
fn is_free(joint: &Joint) -> bool {
    joint.applied_kp == 0.0 && joint.applied_kd == 0.0
}

fn judge_step(name: &str, step: f64, reach: f64, largest: f64) {
    let most = reach + PRECISION * largest.abs().max(1.0);
    assert!(step.abs() <= most, "I2: {name} stepped by {step}, expected at most {most}");
}

/// Judges the value of a command by the limits of its joint; `active`: the position is the controller's, and not slewed.
pub(super) fn judge_value(order: Order, limits: &Limits, active: bool) {
    let within = |value: f64, most: f64| value.is_finite() && value.abs() <= most * (1.0 + PRECISION);
    match order {
        Order::Torque(torque) => assert!(within(torque, limits.torque), "I2: torque {torque}"),
        Order::Speed(speed) => assert!(within(speed, limits.velocity), "I2: velocity {speed}"),
        Order::Position(position) => {
            let [low, high] = limits.position;
            let noise = PRECISION * low.abs().max(high.abs());
            let inside = (low - noise..=high + noise).contains(&position);
            assert!(position.is_finite() && (inside || !active), "I2: position {position}");
        }
        _ => {}
    }
}
