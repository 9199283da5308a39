//! The robot's side: a client of the daemon, which passes on what counts.
//!
//! ```text
//!  zenoh ── setpoint ─▶ Admission ─▶ shared memory ─▶ motord
//!        ── imu ──────▶ Admission ─▶ shared memory ─▶ motord
//!        ── request ──▶ Admission ─▶ thread `request` ─▶ motord
//!        ── ask ──────▶ thread `ask` ─▶ motord
//!        ── stop ─────▶ thread `stop` ─▶ motord's stop socket
//!        ◀── state ──── main thread ◀── motord
//!        ◀── record ─── thread `record` ◀── motord
//! ```
//!
//! The daemon damps the robot whenever setpoints stay away: after a partition, after the death of a
//! mirror or its controller, and after the death of this process.

mod fleet;
mod imus;
mod link;
mod readers;
mod records;
mod requests;
mod robot;
mod stops;

use crate::config::{Network, Serve};
use crate::frame::{Down, Head, nanos};
use crate::measure::Counts;
use crate::network::{self, Keys, NetworkError, Served};
use crate::random::random;
use fleet::Fleet;
use motord_ports::clock;
use motord_shared::StateMessage;
use robot::Robot;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use zenoh::pubsub::{Publisher, Subscriber};
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

/// Serves the robot until `ends`.
pub(crate) fn run(serve: &Serve, network: &Network, ends: &Arc<AtomicBool>) -> Result<(), NetworkError> {
    let keys = Keys::of(&serve.robot);
    let served = Served { keys: &keys, may_claim: &serve.may_claim };
    let is_over = || ends.load(Ordering::Relaxed);
    let Some(session) = network::open(network, Some(&served), is_over)? else { return Ok(()) };
    let run = random().map_err(NetworkError::of)?;
    let robot = Arc::new(Robot::new(serve, run));
    let _frames = [
        subscribe(&session, keys.setpoint(), &robot, Robot::take_setpoint)?,
        subscribe(&session, keys.imu(), &robot, Robot::take_samples)?,
        subscribe(&session, keys.beat(), &robot, Robot::take_beat)?,
        subscribe(&session, keys.want(), &robot, Robot::take_want)?,
    ];
    let _requests = requests::serve(&session, &keys, &robot)?;
    let _stops = stops::serve(&session, &keys, &robot, &serve.instance)?;
    let of_counters = Arc::clone(&robot);
    let key = keys.link();
    let _counters = session
        .declare_queryable(keys.link())
        .callback(move |query| {
            // A peer that has gone needs no answer.
            let _disconnected = query.reply(&key, of_counters.counters.json()).wait();
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
    let records = records::start(&session, &keys, &robot, run, ends);
    while !ends.load(Ordering::Relaxed) {
        sender.serve_daemon(&serve.instance, &session, &keys, ends);
    }
    let _panicked = records.join();
    Ok(())
}

/// Calls `take` with the bytes of each frame of `key`.
fn subscribe(
    session: &Session,
    key: String,
    robot: &Arc<Robot>,
    take: fn(&Robot, &[u8]),
) -> Result<Subscriber<()>, NetworkError> {
    let robot = Arc::clone(robot);
    let subscriber = session.declare_subscriber(key);
    let subscriber = subscriber.callback(move |sample| take(&robot, &sample.payload().to_bytes()));
    subscriber.wait().map_err(NetworkError::of)
}

/// Sends the states of the daemon.
struct Sender<'a> {
    robot: &'a Arc<Robot>,
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

    /// Sends a state if it is due. Never waits for the network.
    fn send(&mut self, state: &StateMessage) {
        let now_ns = clock::now_ns();
        let mut admission = self.robot.admission();
        admission.keep(|lease| state.groups().iter().any(|group| group.lease == lease), now_ns);
        admission.abandoned(now_ns).into_iter().for_each(|lease| requests::release(self.robot, lease));
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
fn report(before: &Counts, now: Counts) -> Counts {
    for (reason, count) in &now.refused {
        let new = count - before.refused[reason];
        if new > 0 {
            tracing::warn!(?reason, frames = new, "frames of a mirror did not count");
        }
    }
    now
}
