//! The joints of the robot, between the cycle and the thread of the plant.

use motord_bus::{Duration, Instant, clock};
use motord_twin::Mechanics;
use triple_buffer::{Input, Output};

/// Steps after the last answer of the plant in which the joints turn on: 10 ms. A cycle that is
/// slow or late computes more of them in a row.
const STEPS_MAX: u32 = 40;
/// The velocity of the joints is zero after this time without an answer.
const STILL: Duration = Duration::from_millis(10);

/// Torques since the beginning.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Push {
    /// Of each joint, N·m·s.
    pub impulses: Vec<f64>,
    /// Time in which they acted, s.
    pub seconds: f64,
}

impl Push {
    pub(super) fn new(joints: usize) -> Self {
        Self { impulses: vec![0.0; joints], seconds: 0.0 }
    }

    /// Writes the mean torques since `before` into `torques`, and this into `before`. Changes
    /// nothing when no time has passed.
    pub(super) fn mean_since(&self, before: &mut Self, torques: &mut [f64]) {
        let seconds = self.seconds - before.seconds;
        if seconds <= 0.0 {
            return;
        }
        for ((torque, now), before) in torques.iter_mut().zip(&self.impulses).zip(&mut before.impulses) {
            *torque = (now - *before) / seconds;
            *before = *now;
        }
        before.seconds = self.seconds;
    }
}

/// A state of all joints.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    /// rad.
    pub positions: Vec<f64>,
    /// rad/s.
    pub velocities: Vec<f64>,
}

impl Motion {
    pub(super) fn new(joints: usize) -> Self {
        Self { positions: vec![0.0; joints], velocities: vec![0.0; joints] }
    }
}

/// The mechanics as the simulated motors see them. Between two answers of the plant a joint turns
/// with its last velocity.
pub(super) struct Joints {
    sum: Push,
    pushes: Input<Push>,
    motion: Output<Motion>,
    begin: Option<Vec<f64>>,
    /// Steps since the last answer.
    steps: u32,
    answered: Instant,
}

impl Joints {
    pub(super) fn new(pushes: Input<Push>, motion: Output<Motion>, begin: Option<Vec<f64>>) -> Self {
        let sum = pushes_of(&motion);
        Self { sum, pushes, motion, begin, steps: 0, answered: clock::monotonic() }
    }
}

fn pushes_of(motion: &Output<Motion>) -> Push {
    Push::new(motion.output_buffer().positions.len())
}

impl Mechanics for Joints {
    fn begin(&mut self, positions: &mut [f64]) {
        if let Some(begin) = &self.begin {
            positions.copy_from_slice(begin);
        }
    }

    /// Wait-free; does not allocate.
    fn step(&mut self, torques: &[f64], seconds: f64, positions: &mut [f64], velocities: &mut [f64]) {
        self.sum.seconds += seconds;
        self.sum.impulses.iter_mut().zip(torques).for_each(|(sum, torque)| *sum += torque * seconds);
        self.pushes.input_buffer_mut().clone_from(&self.sum);
        self.pushes.publish();
        if self.motion.update() {
            let motion = self.motion.output_buffer();
            positions.copy_from_slice(&motion.positions);
            velocities.copy_from_slice(&motion.velocities);
            (self.steps, self.answered) = (0, clock::monotonic());
            return;
        }
        self.steps = self.steps.saturating_add(1);
        if self.steps <= STEPS_MAX {
            let turn = positions.iter_mut().zip(velocities);
            turn.for_each(|(position, velocity)| *position += *velocity * seconds);
        } else if clock::monotonic().since(self.answered) > STILL {
            velocities.fill(0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use triple_buffer::TripleBuffer;

    const STEP: f64 = 250e-6;

    fn joints() -> (Joints, Output<Push>, Input<Motion>) {
        let (push, pushes) = TripleBuffer::new(&Push::new(1)).split();
        let (motion, moved) = TripleBuffer::new(&Motion::new(1)).split();
        (Joints::new(push, moved, None), pushes, motion)
    }

    /// The cycle computes several steps at once; the plant gets the mean of all of them, and none
    /// twice.
    #[test]
    fn plant_gets_mean_torque_of_skipped_steps() {
        let (mut joints, mut pushes, _motion) = joints();
        let (mut before, mut torques) = (Push::new(1), [7.0]);
        pushes.read().mean_since(&mut before, &mut torques);
        assert_eq!(torques, [7.0]);
        for torque in [1.0, 2.0, 6.0] {
            joints.step(&[torque], STEP, &mut [0.0], &mut [0.0]);
        }
        pushes.read().mean_since(&mut before, &mut torques);
        assert!((torques[0] - 3.0).abs() < 1e-9);
        joints.step(&[-1.0], STEP, &mut [0.0], &mut [0.0]);
        pushes.read().mean_since(&mut before, &mut torques);
        assert!((torques[0] + 1.0).abs() < 1e-9);
    }

    #[test]
    fn joint_of_a_silent_plant_stands_still() {
        let (mut joints, _pushes, mut motion) = joints();
        motion.write(Motion { positions: vec![0.5], velocities: vec![2.0] });
        let (mut positions, mut velocities) = ([0.0], [0.0]);
        joints.step(&[0.0], STEP, &mut positions, &mut velocities);
        assert_eq!((positions, velocities), ([0.5], [2.0]));
        joints.step(&[0.0], STEP, &mut positions, &mut velocities);
        assert!((positions[0] - 0.5005).abs() < 1e-12);
        for _ in 0..1000 {
            joints.step(&[0.0], STEP, &mut positions, &mut velocities);
        }
        assert!((positions[0] - 0.52).abs() < 1e-9, "{positions:?}");
        std::thread::sleep(2 * STILL);
        joints.step(&[0.0], STEP, &mut positions, &mut velocities);
        assert_eq!(velocities, [0.0]);
    }

    /// A cycle of 20 ms computes 80 steps in a row: the plant is not silent in them.
    #[test]
    fn slow_cycle_keeps_velocity_of_last_answer() {
        let (mut joints, _pushes, mut motion) = joints();
        motion.write(Motion { positions: vec![0.5], velocities: vec![2.0] });
        let (mut positions, mut velocities) = ([0.0], [0.0]);
        for _ in 0..80 {
            joints.step(&[0.0], STEP, &mut positions, &mut velocities);
        }
        assert_eq!(velocities, [2.0]);
    }
}
