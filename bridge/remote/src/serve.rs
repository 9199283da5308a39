//! The robot's side: a client of the daemon, which passes on what counts.
//!
//! ```text
//!  zenoh ── setpoint ─▶ Admission ─▶ shared memory ─▶ motord
//!        ── request ──▶ Admission ─▶ thread `request` ─▶ motord
//!        ── ask ──────▶ thread `ask` ─▶ motord
//!        ── stop ─────▶ thread `stop` ─▶ motord's stop socket
//!        ◀── state ──── main thread ◀── motord
//! ```
//!
//! The daemon damps the robot whenever setpoints stay away: after a partition, after the death of a
//! mirror or its controller, and after the death of this process.

mod fleet;
mod link;
mod requests;
mod stops;

use crate::admission::{Admission, Refused};
use crate::config::{Network, Serve};
use crate::frame::{Down, Head, Up, nanos};
use crate::measure::Counters;
use crate::network::{self, Keys, NetworkError, Served};
use crate::random;
use fleet::Fleet;
use link::Link;
use motord_ports::clock;
use motord_shared::StateMessage;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::{Session, Wait};

/// Longest sleep until the next state.
const SLEEP: Duration = Duration::from_millis(10);
/// Interval of attempts to connect.
const RETRY: Duration = Duration::from_millis(500);
/// After this long without a state the robot counts as absent.
const SILENCE: Duration = Duration::from_secs(1);
/// Between two lines about refused frames.
const REPORT: Duration = Duration::from_secs(10);

/// What the threads of this side share.
#[derive(Debug)]
pub(crate) struct Robot {
    admission: Mutex<Admission>,
    link: Link,
    counters: Counters,
    age_max: Duration,
}

impl Robot {
    fn new(serve: &Serve, run: u64) -> Self {
        Self {
            admission: Mutex::new(Admission::new(run, serve.age_max())),
            link: Link::default(),
            counters: Counters::default(),
            age_max: serve.age_max(),
        }
    }

    fn admission(&self) -> MutexGuard<'_, Admission> {
        self.admission.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the bytes of a mirror: passes a setpoint that counts to the daemon, and counts others.
    fn take_setpoint(&self, bytes: &[u8]) {
        if let Err(reason) = self.pass_setpoint(bytes, clock::now_ns()) {
            self.counters.refuse(reason);
        }
    }

    fn pass_setpoint(&self, bytes: &[u8], now_ns: u64) -> Result<(), Refused> {
        let (up, setpoint) = Up::read_setpoint(bytes)?;
        let mut admission = self.admission();
        let on_the_way = admission.admit(&up, now_ns)?;
        let Some((mut setpoint, waited)) = setpoint else { return Ok(()) };
        let lease = admission.check_lease(up.head.from, setpoint.lease)?;
        drop(admission);
        let age = on_the_way.saturating_add(waited);
        if age > self.age_max {
            return Err(Refused::Late);
        }
        setpoint.time_ns = sent_ns(now_ns, on_the_way, waited);
        self.counters.setpoint_age.record(age);
        self.counters.change(|counts| counts.setpoints += 1);
        self.link.send(lease, &setpoint);
        Ok(())
    }
}

/// Returns the time of a setpoint's sending by the own clock, ns. A bound of the time on the way
/// contains the way of the state before it: half of it is the best estimate.
fn sent_ns(now_ns: u64, on_the_way: Duration, waited: Duration) -> u64 {
    now_ns.saturating_sub(nanos((on_the_way / 2).saturating_add(waited)))
}

/// Serves the robot until `ends`.
pub(crate) fn run(serve: &Serve, network: &Network, ends: &Arc<AtomicBool>) -> Result<(), NetworkError> {
    let keys = Keys::of(&serve.robot);
    let served = Served { keys: &keys, may_claim: &serve.may_claim };
    let session = network::open(network, Some(&served))?;
    let run = random()?;
    let robot = Arc::new(Robot::new(serve, run));
    let of_setpoints = Arc::clone(&robot);
    let _setpoints = session
        .declare_subscriber(keys.setpoint())
        .callback(move |sample| of_setpoints.take_setpoint(&sample.payload().to_bytes()))
        .wait()
        .map_err(NetworkError::of)?;
    let _requests = requests::serve(&session, &keys, &robot)?;
    let _stops = stops::serve(&session, &keys, &robot, &serve.instance)?;
    let of_counters = Arc::clone(&robot);
    let key = keys.link();
    let _counters = session
        .declare_queryable(keys.link())
        .callback(move |query| {
            // A peer that has gone needs no answer.
            let _gone = query.reply(&key, of_counters.counters.json()).wait();
        })
        .wait()
        .map_err(NetworkError::of)?;
    let states = session
        .declare_publisher(keys.state())
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::InteractiveHigh)
        .reliability(Reliability::BestEffort)
        .express(true)
        .wait()
        .map_err(NetworkError::of)?;
    tracing::info!(robot = serve.robot, instance = serve.instance, "serves");
    let period = Duration::from_secs_f64(1.0 / serve.states_hz);
    let fleet = Fleet::new(&serve.robot, &session, &keys)?;
    let mut sender =
        Sender { robot: &robot, states, run, sequence: 0, period, due_ns: 0, has_reported: false, fleet };
    while !ends.load(Ordering::Relaxed) {
        sender.serve_daemon(&serve.instance, &session, &keys, ends);
    }
    Ok(())
}

/// Sends the states of the daemon.
struct Sender<'a> {
    robot: &'a Robot,
    states: Publisher<'a>,
    run: u64,
    sequence: u64,
    period: Duration,
    /// The tick of the next state that is sent, ns.
    due_ns: u64,
    /// The log says already that no daemon runs.
    has_reported: bool,
    fleet: Fleet<'a>,
}

impl Sender<'_> {
    /// Connects to the daemon, and sends its states until it falls silent.
    fn serve_daemon(&mut self, instance: &str, session: &Session, keys: &Keys, ends: &AtomicBool) {
        let ports = match self.robot.link.open(instance) {
            Ok(ports) => ports,
            Err(error) => {
                if !std::mem::replace(&mut self.has_reported, true) {
                    tracing::warn!(instance, "waits for motord: {error}");
                }
                return std::thread::sleep(RETRY);
            }
        };
        self.has_reported = false;
        tracing::info!(instance, "connected to motord");
        let mut alive = None;
        let (mut newest, mut reported) = (Instant::now(), Instant::now());
        let mut counts = self.robot.counters.counts();
        while !ends.load(Ordering::Relaxed) && newest.elapsed() < SILENCE {
            let seen = ports.published();
            match ports.newest_state() {
                Ok(Some(state)) => {
                    newest = Instant::now();
                    self.send(&state);
                    self.fleet.take(&state, self.robot, &ports);
                    if alive.is_none() {
                        alive = session.liveliness().declare_token(keys.alive()).wait().ok();
                    }
                }
                // Waits at least a little after each error.
                Ok(None) if ports.sleep(seen, SLEEP).is_ok() => {}
                Ok(None) | Err(_) => std::thread::sleep(SLEEP),
            }
            if reported.elapsed() > REPORT {
                reported = Instant::now();
                counts = report(&counts, self.robot.counters.counts());
            }
        }
        self.robot.link.close();
        tracing::warn!(instance, "motord is silent");
    }

    /// Sends a state if its turn has come. Never waits for the network.
    fn send(&mut self, state: &StateMessage) {
        let now_ns = clock::now_ns();
        let mut admission = self.robot.admission();
        admission.keep(|lease| state.groups().iter().any(|group| group.lease == lease), now_ns);
        if state.tick_ns < self.due_ns {
            return;
        }
        let echoes = admission.echoes(now_ns);
        drop(admission);
        let period = nanos(self.period);
        self.due_ns = (self.due_ns + period).max(state.tick_ns.saturating_sub(period / 2));
        self.sequence += 1;
        let head = Head { from: self.run, sequence: self.sequence, sent_ns: now_ns };
        // A slow link drops the state.
        let _dropped = self.states.put(Down::bytes(&head, &echoes, state)).wait();
    }
}

/// Logs the frames that were refused since `before`.
fn report(before: &crate::measure::Counts, now: crate::measure::Counts) -> crate::measure::Counts {
    for (reason, count) in &now.refused {
        let new = count - before.refused.get(reason).copied().unwrap_or(0);
        if new > 0 {
            tracing::warn!(?reason, frames = new, "frames of a mirror did not count");
        }
    }
    now
}

/// For the tests of this side.
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn setpoint_is_as_old_as_it_waited() {
        let [now, way, waited] = [1_000_000, 4_000, 300];
        assert_eq!(
            sent_ns(now, Duration::from_nanos(way), Duration::from_nanos(waited)),
            now - way / 2 - waited
        );
        assert_eq!(sent_ns(5, Duration::MAX, Duration::MAX), 0);
    }
}
