//! `motord run --plant`: another process moves the joints of the simulated robot, in real time.
//!
//! ```text
//!   cycle ──torques──▶ triple buffer ──▶ thread `motord-plant` ──socket──▶ plant: a physics engine
//!         ◀─positions─ triple buffer ◀──                       ◀─socket───
//!   IMUs  ◀──body───── triple buffer ◀──
//! ```
//!
//! The cycle never waits for the plant. The thread asks for a step every 250 µs; a plant that is
//! slower than real time loses time, which is logged. A plant that ends or is silent for a second
//! ends the daemon: the motors are damped and stopped first.

mod joints;
mod link;

pub use link::{PlantError, PlantLink};

use crate::imus::LineLimit;
use joints::{Motion, Push};
use link::{LEVEL, STEP, imu_values};
use motord_bus::{Clock as _, Duration, Instant, Monotonic};
use motord_simulator::ImuValues;
use motord_twin::Mechanics;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use triple_buffer::{Input, Output, TripleBuffer};

/// A plant that is later than this loses the time.
const LATE: Duration = Duration::from_millis(20);
/// Time over which lost time is added up for a line of the log.
const WINDOW: Duration = Duration::from_secs(10);
/// A larger part of the time is worth a line of the log.
const LOST_SHARE: f64 = 0.01;
/// So much lost time is worth a line immediately: the stop that it may cause names a motor, not the
/// plant.
const LOST_MAX: Duration = Duration::from_millis(200);

/// The thread that asks the plant for its steps.
pub struct Plant {
    link: PlantLink,
    pushes: Output<Push>,
    motion: Input<Motion>,
    body: Option<Input<ImuValues>>,
    /// The push until the last step.
    pushed: Push,
    torques: Vec<f64>,
    ended: Arc<OnceLock<PlantError>>,
}

/// The ends of a plant that others use.
pub struct PlantEnds {
    /// Moves the joints of the simulated motors.
    pub mechanics: Box<dyn Mechanics>,
    /// The body that the IMUs measure, if the plant has one.
    pub body: Option<Output<ImuValues>>,
}

impl Plant {
    /// Returns the plant behind `link`, and its other ends. Allocates.
    #[must_use]
    pub fn new(link: PlantLink) -> (Self, PlantEnds) {
        let joints = link.joints();
        let (push, pushes) = TripleBuffer::new(&Push::new(joints)).split();
        let (motion, moved) = TripleBuffer::new(&Motion::new(joints)).split();
        let (body, measured) = if link.has_imu() {
            let (input, output) = TripleBuffer::new(&imu_values(LEVEL)).split();
            (Some(input), Some(output))
        } else {
            (None, None)
        };
        let mechanics = Box::new(joints::Joints::new(push, moved, link.begin()));
        let (pushed, torques) = (Push::new(joints), vec![0.0; joints]);
        let plant = Self { link, pushes, motion, body, pushed, torques, ended: Arc::default() };
        (plant, PlantEnds { mechanics, body: measured })
    }

    /// Returns the slot of the reason for which the plant ends.
    #[must_use]
    pub fn ended(&self) -> Arc<OnceLock<PlantError>> {
        Arc::clone(&self.ended)
    }

    /// Asks for a step every 250 µs until `stop` returns true, or until the plant ends. Blocks in
    /// each step, at most 2 s. Adds the time that the plant loses to `lost_us`, µs.
    pub fn run(mut self, lost_us: &AtomicU64, stop: impl Fn() -> bool) {
        let mut clock = Monotonic;
        let mut pace = Pace::new(clock.now());
        while !stop() {
            if let Err(error) = self.step() {
                let _the_first = self.ended.set(error);
                return;
            }
            let next = pace.next(clock.now());
            lost_us.store(pace.total.as_micros().try_into().unwrap_or(u64::MAX), Ordering::Relaxed);
            clock.sleep_until(next);
        }
    }

    fn step(&mut self) -> Result<(), PlantError> {
        self.pushes.read().mean_since(&mut self.pushed, &mut self.torques);
        let motion = self.motion.input_buffer_mut();
        let body = self.link.step(&self.torques, &mut motion.positions, &mut motion.velocities)?;
        self.motion.publish();
        if let (Some(input), Some(values)) = (&mut self.body, body) {
            input.write(values);
        }
        Ok(())
    }
}

/// The times of the steps.
struct Pace {
    due: Instant,
    /// Since the last line of the log, and since the begin.
    lost: Duration,
    total: Duration,
    begun: Instant,
    log_limit: LineLimit,
}

impl Pace {
    fn new(now: Instant) -> Self {
        Self {
            due: now,
            lost: Duration::ZERO,
            total: Duration::ZERO,
            begun: now,
            log_limit: LineLimit::new(now),
        }
    }

    /// Returns the time of the next step.
    fn next(&mut self, now: Instant) -> Instant {
        self.due = self.due + STEP;
        let late = now.since(self.due);
        if late > LATE {
            self.lost += late;
            self.total += late;
            self.due = now;
        }
        if let Some((share, seconds)) = self.lost_share(now)
            && self.log_limit.permits(now)
        {
            tracing::warn!(
                "the plant is slower than real time: it lost {:.0} % of the last {seconds:.1} s, and its joints jump. Simplify the model, or reduce the other load of the computer",
                100.0 * share
            );
        }
        self.due
    }

    /// Returns the part of the time that was lost, and that time, s, when it is worth a line.
    fn lost_share(&mut self, now: Instant) -> Option<(f64, f64)> {
        let passed = now.since(self.begun);
        if passed < WINDOW && self.lost < LOST_MAX {
            return None;
        }
        let share = self.lost.as_secs_f64() / passed.as_secs_f64();
        (self.begun, self.lost) = (now, Duration::ZERO);
        (share > LOST_SHARE).then_some((share, passed.as_secs_f64()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stall is not made up for: the steps after it would all come at once.
    #[test]
    fn time_of_a_stall_is_lost() {
        let at = |us: u64| Instant::from_nanos(us * 1000);
        let mut pace = Pace::new(at(0));
        assert_eq!(pace.next(at(100)), at(250));
        assert_eq!(pace.next(at(5_000)), at(500));
        assert_eq!(pace.next(at(100_000)), at(100_000));
        assert_eq!([pace.lost, pace.total], [Duration::from_micros(100_000 - 750); 2]);
    }

    #[test]
    fn much_lost_time_is_reported_immediately() {
        let at = |ms: u64| Instant::from_nanos(ms * 1_000_000);
        let mut pace = Pace::new(at(0));
        pace.next(at(100));
        assert_eq!(pace.lost_share(at(100)), None);
        pace.due = at(100);
        pace.lost += Duration::from_millis(150);
        let (share, seconds) = pace.lost_share(at(500)).unwrap();
        assert!((share - 0.5).abs() < 0.01 && (seconds - 0.5).abs() < 1e-9, "{share} {seconds}");
        assert_eq!(pace.lost_share(at(10_000)), None);
    }
}
