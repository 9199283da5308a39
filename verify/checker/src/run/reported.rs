//! Comparison of a published state with the replies (I6).

use crate::protocol::codec::Reported;
use crate::robot::Motor;
use crate::state::Joint;
use motord_bus::{Frame, Instant};
use std::collections::VecDeque;

/// A frame to the host, as recorded on the wire.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reply {
    /// The end of the frame.
    pub at: Instant,
    /// Index of the bus.
    pub bus: usize,
    /// Id and bytes.
    pub frame: Frame,
}

/// Greatest difference of a state from the reply, rad and rad/s, or as a share of it: single
/// precision.
const TOLERANCE: f64 = 1e-3;
/// Number of different velocities in the memory. A stopped native motor reports its velocity only
/// rarely, and the daemon does not use a late reply.
const REMEMBERED: usize = 64;

/// The velocities that a native motor has reported, rad/s, motor side, the newest last.
#[derive(Debug, Clone, Default)]
pub(super) struct Velocities(VecDeque<f64>);

impl Velocities {
    /// Adds the velocities of `motor` in these replies.
    pub(super) fn receive(&mut self, motor: &Motor, replies: &[Reply]) {
        if !motor.protocol.codec().reports_parts() {
            return;
        }
        for reply in replies {
            if let Some(Reported::State([_, velocity]) | Reported::Speed(velocity)) = reported(reply, motor) {
                self.0.retain(|known| known.to_bits() != velocity.to_bits());
                self.0.push_back(velocity);
            }
        }
        self.0.drain(..self.0.len().saturating_sub(REMEMBERED));
    }

    /// Returns `true` when one of them is `velocity`. Zero stands for the velocity before the
    /// first; it counts until `REMEMBERED` are known.
    fn has(&self, velocity: f64) -> bool {
        let is = |reported: &f64| is_close(*reported, velocity);
        self.0.iter().any(is) || self.0.len() < REMEMBERED && is(&0.0)
    }
}

fn is_close(reported: f64, published: f64) -> bool {
    (reported - published).abs() < TOLERANCE * reported.abs().max(1.0)
}

/// Returns the motion in a reply of this motor, motor side.
fn reported(reply: &Reply, motor: &Motor) -> Option<Reported> {
    if reply.bus != motor.bus || !motor.replies.matches(reply.frame.id()) {
        return None;
    }
    motor.protocol.codec().reported(&reply.frame, motor.id)
}

/// Returns position and velocity in a reply of this motor, joint side.
pub(super) fn state(reply: &Reply, motor: &Motor) -> Option<[f64; 2]> {
    let Some(Reported::State([position, velocity])) = reported(reply, motor) else { return None };
    Some([motor.direction * position + motor.offset, motor.direction * velocity])
}

/// Returns `true` when the reply is the motor's, arrived at the time of `joint` or later, and
/// contains its position and velocity. The velocity of a native motor may be older: that of the
/// state `before`, or one of `velocities`.
pub(super) fn reports(
    reply: &Reply,
    motor: &Motor,
    before: &Joint,
    joint: &Joint,
    velocities: &Velocities,
) -> bool {
    if reply.at.as_nanos() < joint.receive_ns {
        return false;
    }
    let position = (f64::from(joint.position) - motor.offset) * motor.direction;
    let velocity = motor.direction * f64::from(joint.velocity);
    let is = |reported: [f64; 2]| is_close(reported[0], position) && is_close(reported[1], velocity);
    match reported(reply, motor) {
        Some(Reported::State(state)) => is(state),
        Some(Reported::Angle(angle)) => {
            let is_kept = joint.velocity.to_bits() == before.velocity.to_bits();
            (is_kept || velocities.has(velocity)) && is([angle, velocity])
        }
        Some(Reported::Speed(_)) | None => false,
    }
}
