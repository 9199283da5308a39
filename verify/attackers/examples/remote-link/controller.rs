//! A controller on the other computer, and a watcher on the robot that knows when each of its
//! setpoints was sent.

use crate::network::{Network, UNPOISONED};
use motord_client::{Client, Error, Phase, State};
use motord_ports::clock;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// When the network is cut, from the beginning.
const CUT_AFTER: Duration = Duration::from_secs(1);
/// Longest time for something that takes milliseconds on an idle machine.
const LONGEST: Duration = Duration::from_secs(20);

/// A robot, its mirror, and how often the controller sends.
pub(crate) struct Drive {
    robot: (String, String),
    other: (String, String),
    hz: f64,
    seconds: f64,
}

/// Of one drive.
#[derive(Default)]
struct Seen {
    /// By number of a setpoint, when it was sent, ns of `CLOCK_MONOTONIC`.
    sent: Mutex<Vec<u64>>,
    ended: AtomicBool,
}

/// The setpoints that the robot used, and its end.
#[derive(Default)]
struct Used {
    /// Ages of setpoints in the first cycle that used them, µs, as the controller's clock has them.
    ages: Vec<u64>,
    /// Largest difference from the age that the robot reports, µs.
    error_us: u64,
    /// A setpoint was used after a newer one.
    backwards: u64,
    /// From the sending of the last used setpoint to the first state that was not active, µs.
    damped_after_us: Option<u64>,
    cause: Option<String>,
    /// Beginnings of activity.
    starts: u64,
}

impl Drive {
    pub(crate) fn new(robot: &str, other: &str, hz: f64, seconds: f64) -> Self {
        let split = |text: &str| {
            let (runtime, instance) = text.rsplit_once('/').expect("RUNTIME/INSTANCE");
            (runtime.to_owned(), instance.to_owned())
        };
        Self { robot: split(robot), other: split(other), hz, seconds }
    }

    /// Drives for some seconds; with `cut`, the network is cut for so long after a second. Returns
    /// JSON.
    pub(crate) fn drive(&self, cut: Option<Duration>, network: &Arc<Network>) -> String {
        let seen = Arc::new(Seen::default());
        let robot = Client::connect_in(Path::new(&self.robot.0), &self.robot.1).expect("a robot");
        let of_watcher = Arc::clone(&seen);
        let watcher = std::thread::spawn(move || watch(&robot, &of_watcher));
        let outcome = self.control(cut, network, &seen);
        // The robot may stop after the controller's end.
        std::thread::sleep(Duration::from_millis(500));
        seen.ended.store(true, Ordering::Relaxed);
        let used = watcher.join().expect("a watcher");
        let sent = seen.sent.lock().expect(UNPOISONED).len();
        report(&used, sent, &outcome)
    }

    /// Returns how the controller ended.
    fn control(&self, cut: Option<Duration>, network: &Network, seen: &Seen) -> String {
        match self.try_control(cut, network, seen) {
            Ok(()) => "done".to_owned(),
            Err(error) => error.to_string(),
        }
    }

    fn try_control(&self, cut: Option<Duration>, network: &Network, seen: &Seen) -> Result<(), Error> {
        let client = self.connect()?;
        // It goes on where others would give up: the robot must stop by itself.
        client.set_silence(LONGEST);
        let group = client.description().groups[0].name.clone();
        client.reset(&group)?;
        let mut claim = client.claim(&group)?;
        let period = Duration::from_secs_f64(1.0 / self.hz);
        claim.set_horizon(period.mul_f64(1.25))?;
        claim.hold(&client.wait(LONGEST)?, 20.0, 1.0)?;
        commit(&mut claim, seen)?;
        start(&client, &mut claim, seen, period)?;
        let begun = Instant::now();
        let (mut next, mut is_cut) = (begun, false);
        while begun.elapsed().as_secs_f64() < self.seconds {
            if let Some(cut) = cut.filter(|_| !is_cut && begun.elapsed() >= CUT_AFTER) {
                network.cut(cut);
                is_cut = true;
            }
            commit(&mut claim, seen)?;
            next += period;
            std::thread::sleep(next.saturating_duration_since(Instant::now()));
        }
        claim.disable()
    }

    fn connect(&self) -> Result<Client, Error> {
        let begun = Instant::now();
        loop {
            match Client::connect_in(Path::new(&self.other.0), &self.other.1) {
                Err(error) if error.is_transient() && begun.elapsed() < LONGEST => {
                    std::thread::sleep(Duration::from_millis(50));
                }
                other => return other,
            }
        }
    }
}

/// Sends the setpoints, and notes when.
fn commit(claim: &mut motord_client::Claim, seen: &Seen) -> Result<(), Error> {
    seen.sent.lock().expect(UNPOISONED).push(clock::now_ns());
    claim.commit()
}

/// Enables the group while setpoints go on.
fn start(
    client: &Client,
    claim: &mut motord_client::Claim,
    seen: &Seen,
    period: Duration,
) -> Result<(), Error> {
    let begun = Instant::now();
    let mut is_requested = false;
    loop {
        commit(claim, seen)?;
        std::thread::sleep(period);
        let group = client.newest()?.and_then(|state| state.group(claim.index()));
        if group.is_some_and(|group| group.phase == Some(Phase::Active)) {
            return Ok(());
        }
        if !is_requested && begun.elapsed() > 4 * period {
            client.enable(claim.group())?;
            is_requested = true;
        }
        if begun.elapsed() > LONGEST {
            return Err(Error::Timeout { waited: LONGEST });
        }
    }
}

fn watch(robot: &Client, seen: &Seen) -> Used {
    let mut used = Used::default();
    let (mut sequence, mut was_active, mut last_sent) = (0, false, None);
    let mut lease = None;
    while !seen.ended.load(Ordering::Relaxed) {
        let Ok(state) = robot.wait(Duration::from_millis(100)) else { continue };
        let Some(group) = state.group(0) else { continue };
        if group.lease.is_some() && group.lease != lease {
            (lease, sequence) = (group.lease, 0);
        }
        let is_active = group.phase == Some(Phase::Active);
        used.starts += u64::from(is_active && !was_active);
        if was_active && !is_active {
            used.damped_after_us = last_sent.map(|sent| since(sent, &state));
            used.cause = group.cause.map(|cause| cause.to_string());
        }
        was_active = is_active;
        if group.sequence != 0 && group.sequence != sequence {
            used.backwards += u64::from(group.sequence < sequence);
            sequence = group.sequence;
            // The first message of a claim has the number 1.
            let sent = seen.sent.lock().expect(UNPOISONED).get(sequence as usize - 1).copied();
            if let Some(sent) = sent {
                last_sent = Some(sent);
                let age = since(sent, &state);
                used.ages.push(age);
                let reported = group.setpoint_age.map_or(0, |age| age.as_micros() as u64);
                used.error_us = used.error_us.max(age.abs_diff(reported));
            }
        }
    }
    used
}

/// Returns the time from `sent_ns` to the beginning of the state's cycle, µs.
fn since(sent_ns: u64, state: &State) -> u64 {
    let began = state.tick_ns() + state.wake_latency().as_nanos() as u64;
    began.saturating_sub(sent_ns) / 1000
}

fn report(used: &Used, sent: usize, outcome: &str) -> String {
    let mut ages = used.ages.clone();
    ages.sort_unstable();
    let at =
        |share: f64| ages.get(((ages.len() as f64 * share) as usize).min(ages.len().max(1) - 1)).copied();
    let number = |value: Option<u64>| value.map_or_else(|| "null".to_owned(), |value| value.to_string());
    let cause = used.cause.as_ref().map_or_else(|| "null".to_owned(), |cause| format!("{cause:?}"));
    format!(
        "{{\"sent\":{sent},\"used\":{},\"age_us\":{{\"p50\":{},\"p99\":{},\"max\":{}}},\"error_us\":{},\
         \"backwards\":{},\"starts\":{},\"damped_after_us\":{},\"cause\":{cause},\"outcome\":{outcome:?}}}",
        used.ages.len(),
        number(at(0.5)),
        number(at(0.99)),
        number(ages.last().copied()),
        used.error_us,
        used.backwards,
        used.starts,
        number(used.damped_after_us),
    )
}
