//! The newest reading of the robot, and values computed from several readings: loads and recent
//! latencies.

use super::trends::Trends;
use crate::report::{BusReport, RobotReport};
use motord_client::{GroupHistory, RobotDescription, State, Telemetry};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// Readings that the sparklines remember.
const SAMPLES_MAX: usize = 120;
/// Smallest number of cycles for the load of a bus. Over fewer, a single frame would change the
/// load too much.
const LOAD_CYCLES_MIN: u64 = 20;

/// The robot after one cycle, with names.
#[derive(Debug, Clone, Default)]
pub(super) struct Reading {
    /// Names and limits.
    pub(super) robot: Arc<RobotDescription>,
    /// The state of the cycle.
    pub(super) report: RobotReport,
    /// Counters, latencies and owners, up to a second old.
    pub(super) telemetry: Telemetry,
    /// Latencies of this cycle.
    pub(super) sample: Sample,
    /// The state as the client reads it; `None` in tests that draw no curves.
    pub(super) state: Option<State>,
}

impl Reading {
    /// Combines `state` with the names of `robot`.
    pub(super) fn new(robot: &Arc<RobotDescription>, state: &State, telemetry: &Telemetry) -> Self {
        let mut report = RobotReport::new(robot, state);
        report.add_history(robot, telemetry);
        Self {
            report,
            robot: Arc::clone(robot),
            telemetry: telemetry.clone(),
            sample: Sample::of(state),
            state: Some(state.clone()),
        }
    }

    /// Returns the history of the group `index`; empty before the first telemetry.
    pub(super) fn history(&self, index: usize) -> GroupHistory {
        self.telemetry.groups.get(index).cloned().unwrap_or_default()
    }

    /// Returns the time since the cycle `cycle`.
    pub(super) fn since(&self, cycle: u64) -> Duration {
        let cycles = self.report.cycle.saturating_sub(cycle) as f64;
        Duration::try_from_secs_f64(cycles / self.report.rate_hz).unwrap_or_default()
    }
}

/// Latencies of one cycle, µs.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Sample {
    /// From the tick to the beginning of the cycle.
    pub(super) wake: f64,
    /// From the beginning of the cycle to the publication of its states.
    pub(super) cycle: f64,
    /// From the command to the reply, of the slowest joint that answered in the cycle.
    pub(super) reply: f64,
    /// Age of the oldest setpoint in use.
    pub(super) age: f64,
}

impl Sample {
    fn of(state: &State) -> Self {
        let micros = |time: Duration| time.as_secs_f64() * 1e6;
        let since_tick = Duration::from_nanos(state.publish_ns().saturating_sub(state.tick_ns()));
        let replies = state.joints().filter(|joint| joint.fresh).map(|joint| micros(joint.reply_latency));
        let ages = state.groups().filter_map(|group| group.setpoint_age).map(micros);
        Self {
            wake: micros(state.wake_latency()),
            cycle: micros(since_tick.saturating_sub(state.wake_latency())),
            reply: replies.fold(0.0, f64::max),
            age: ages.fold(0.0, f64::max),
        }
    }
}

/// A daemon that does not answer.
#[derive(Debug, Clone, Default)]
pub(super) struct Loss {
    /// Time without an answer.
    pub(super) lasting: Duration,
    /// The error of the client.
    pub(super) reason: String,
}

/// Everything that is drawn.
#[derive(Debug, Default)]
pub(super) struct Picture {
    /// The newest reading, of any age; `None` before the first.
    pub(super) reading: Option<Reading>,
    /// The shown recording and its position; `None` for a daemon.
    pub(super) replay: Option<String>,
    /// Set while the daemon does not answer.
    pub(super) loss: Option<Loss>,
    /// Latencies of the last readings, the newest last.
    pub(super) samples: VecDeque<Sample>,
    /// Largest share of time that each bus was busy; `None` if unknown.
    pub(super) loads: Vec<Option<f64>>,
    /// Positions, velocities and torques of the last minute.
    pub(super) trends: Trends,
    /// Cycle number and frames by bus that the loads are counted from.
    counted: (u64, Vec<u32>),
}

impl Picture {
    /// Adds a reading.
    pub(super) fn take(&mut self, reading: Reading) {
        if self.reading.is_none() || self.is_restart(&reading) {
            self.samples.clear();
            self.trends = Trends::default();
            self.counted = (reading.report.cycle, frames(&reading.report));
            self.loads = vec![None; reading.report.buses.len()];
        }
        self.count_loads(&reading);
        if let Some(state) = &reading.state {
            self.trends.take(state, &reading.robot);
        }
        self.samples.push_back(reading.sample);
        if self.samples.len() > SAMPLES_MAX {
            self.samples.pop_front();
        }
        self.loss = None;
        self.reading = Some(reading);
    }

    /// Returns whether `reading` is of another daemon than the reading before.
    pub(super) fn is_restart(&self, reading: &Reading) -> bool {
        self.reading.as_ref().is_some_and(|before| before.robot.boot_id != reading.robot.boot_id)
    }

    fn count_loads(&mut self, reading: &Reading) {
        let cycles = reading.report.cycle.saturating_sub(self.counted.0);
        if cycles < LOAD_CYCLES_MIN {
            return;
        }
        let seconds = cycles as f64 / reading.report.rate_hz;
        let frames = frames(&reading.report);
        let load = |((now, before), time): ((&u32, &u32), &f64)| {
            let load = f64::from(now.wrapping_sub(*before)) * time / seconds;
            Some(load).filter(|load| load.is_finite() && *time > 0.0)
        };
        let times = &reading.robot.frame_times;
        self.loads = frames.iter().zip(&self.counted.1).zip(times).map(load).collect();
        self.counted = (reading.report.cycle, frames);
    }
}

/// Returns the frames of each bus since the daemon started, modulo 2³².
fn frames(report: &RobotReport) -> Vec<u32> {
    report.buses.iter().map(|BusReport { sent, received, .. }| sent.wrapping_add(*received)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(cycle: u64, frames: u32) -> Reading {
        let robot = RobotDescription { frame_times: vec![100e-6], ..RobotDescription::default() };
        let buses = vec![BusReport { sent: frames, received: frames, ..BusReport::default() }];
        let report = RobotReport { cycle, rate_hz: 1000.0, buses, ..RobotReport::default() };
        Reading { robot: Arc::new(robot), report, ..Reading::default() }
    }

    #[test]
    fn bus_load_is_wire_time_between_readings() {
        let mut picture = Picture::default();
        picture.take(reading(1000, u32::MAX - 99));
        assert_eq!(picture.loads, [None]);
        // 100 cycles of 3 motors on: the counters have passed their end.
        picture.take(reading(1100, 200));
        let load = picture.loads[0].unwrap();
        assert!((load - 0.6).abs() < 1e-9, "{load}");
    }

    #[test]
    fn the_sparklines_remember_a_bounded_number_of_readings() {
        let mut picture = Picture::default();
        (0..2 * SAMPLES_MAX as u64).for_each(|cycle| picture.take(reading(cycle, 0)));
        assert_eq!(picture.samples.len(), SAMPLES_MAX);
    }
}
