//! A watcher on the robot, which knows when the setpoints of a controller were sent.

use crate::network::UNPOISONED;
use motord_client::{Client, Group, Phase, State};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// Setpoints of a controller of this program.
#[derive(Default)]
pub(crate) struct Seen {
    /// By number of a setpoint, when it was sent, ns of `CLOCK_MONOTONIC`.
    pub(crate) sent: Mutex<Vec<u64>>,
    ended: AtomicBool,
}

/// A thread that reads the robot's states.
pub(crate) struct Watcher {
    pub(crate) seen: Arc<Seen>,
    thread: JoinHandle<Used>,
}

impl Watcher {
    pub(crate) fn start(robot: Client) -> Self {
        let seen = Arc::new(Seen::default());
        let of_thread = Arc::clone(&seen);
        Self { seen, thread: std::thread::spawn(move || watch(&robot, &of_thread)) }
    }

    /// Returns what the robot did since the start, as JSON.
    pub(crate) fn end(self, outcome: &str) -> String {
        self.seen.ended.store(true, Ordering::Relaxed);
        let used = self.thread.join().expect("a watcher");
        let sent = self.seen.sent.lock().expect(UNPOISONED).len();
        used.report(sent, outcome)
    }
}

/// The setpoints that the robot used, and its end.
#[derive(Default)]
struct Used {
    lease: Option<motord_client::Lease>,
    /// Number of the newest setpoint.
    sequence: u64,
    was_active: bool,
    /// When the newest setpoint was sent, where that is known.
    last_sent: Option<u64>,
    /// Setpoints that were used.
    count: u64,
    /// Ages of setpoints in the first cycle that used them, µs, as the controller's clock has them.
    ages: Vec<u64>,
    /// Largest difference from the age that the robot reports, µs.
    error_us: u64,
    /// Oldest setpoint that an active group used, µs, as the robot reports it.
    oldest_us: u64,
    /// A setpoint was used after a newer one.
    backwards: u64,
    /// Largest angle of an active robot's IMU from level, rad.
    tilt: f32,
    /// From the sending of the last used setpoint to the first state that was not active, µs.
    damped_after_us: Option<u64>,
    cause: Option<String>,
    /// Beginnings of activity.
    starts: u64,
}

fn watch(robot: &Client, seen: &Seen) -> Used {
    let mut used = Used::default();
    while !seen.ended.load(Ordering::Relaxed) {
        let Ok(state) = robot.wait(Duration::from_millis(100)) else { continue };
        if let Some(group) = state.group(0) {
            used.take(&state, &group, seen);
        }
    }
    used
}

impl Used {
    fn take(&mut self, state: &State, group: &Group, seen: &Seen) {
        if group.lease.is_some() && group.lease != self.lease {
            (self.lease, self.sequence) = (group.lease, 0);
        }
        let is_active = group.phase == Some(Phase::Active);
        self.starts += u64::from(is_active && !self.was_active);
        if self.was_active && !is_active {
            self.damped_after_us = self.last_sent.map(|sent| since(sent, state));
            self.cause = group.cause.map(|cause| cause.to_string());
        }
        self.was_active = is_active;
        let age_us = group.setpoint_age.map_or(0, |age| age.as_micros() as u64);
        if is_active {
            self.oldest_us = self.oldest_us.max(age_us);
            self.tilt = self.tilt.max(tilt(state));
        }
        if group.sequence != 0 && group.sequence != self.sequence {
            self.take_setpoint(state, group.sequence, age_us, seen);
        }
    }

    /// Takes the first state with a setpoint.
    fn take_setpoint(&mut self, state: &State, sequence: u64, age_us: u64, seen: &Seen) {
        self.count += 1;
        self.backwards += u64::from(sequence < self.sequence);
        self.sequence = sequence;
        // The first message of a claim has the number 1.
        let sent = seen.sent.lock().expect(UNPOISONED).get(sequence as usize - 1).copied();
        if let Some(sent) = sent {
            self.last_sent = Some(sent);
            let age = since(sent, state);
            self.ages.push(age);
            self.error_us = self.error_us.max(age.abs_diff(age_us));
        }
    }

    fn report(&self, sent: usize, outcome: &str) -> String {
        let mut ages = self.ages.clone();
        ages.sort_unstable();
        let at =
            |share: f64| ages.get(((ages.len() as f64 * share) as usize).min(ages.len().max(1) - 1)).copied();
        let number = |value: Option<u64>| value.map_or_else(|| "null".to_owned(), |value| value.to_string());
        let cause = self.cause.as_ref().map_or_else(|| "null".to_owned(), |cause| format!("{cause:?}"));
        format!(
            "{{\"sent\":{sent},\"used\":{},\"age_us\":{{\"p50\":{},\"p99\":{},\"max\":{}}},\"error_us\":{},\
             \"oldest_us\":{},\"backwards\":{},\"tilt\":{:.3},\"starts\":{},\"damped_after_us\":{},\
             \"cause\":{cause},\"outcome\":{outcome:?}}}",
            self.count,
            number(at(0.5)),
            number(at(0.99)),
            number(ages.last().copied()),
            self.error_us,
            self.oldest_us,
            self.backwards,
            self.tilt,
            self.starts,
            number(self.damped_after_us),
        )
    }
}

/// Returns the time from `sent_ns` to the beginning of the state's cycle, µs.
fn since(sent_ns: u64, state: &State) -> u64 {
    let began = state.tick_ns() + state.wake_latency().as_nanos() as u64;
    began.saturating_sub(sent_ns) / 1000
}

/// Returns the angle of the first IMU from level, rad; 0 without one.
fn tilt(state: &State) -> f32 {
    let orientation = state.imu(0).and_then(|imu| imu.orientation());
    // The z of the body in the z of the world.
    orientation.map_or(0.0, |[_, x, y, _]| (1.0 - 2.0 * (x * x + y * y)).clamp(-1.0, 1.0).acos())
}
