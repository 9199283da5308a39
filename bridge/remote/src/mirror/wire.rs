//! The network's end of a mirror: what arrived last, and what is sent.

use crate::clocks::{Clocks, Offset, RoundTrip};
use crate::frame::{Down, Echo, Head, Up};
use crate::measure::Latencies;
use crate::network::{Keys, NetworkError};
use crate::random::random;
use motord_ports::clock;
use motord_shared::StateMessage;
use motord_shared::description::NetworkLatency;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Thread;
use std::time::Duration;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// Greatest age of the first frame of a run that counts.
const NEW_RUN_AGE_MAX: Duration = Duration::from_secs(1);
/// Longest time between two frames to the robot.
pub(super) const BEAT: Duration = Duration::from_millis(5);

/// The network's end of a mirror.
#[derive(Debug)]
pub(super) struct Wire {
    /// `None` before the first.
    link: Mutex<Option<Link>>,
    pub(super) keys: Keys,
    /// The thread that waits for states.
    main: Thread,
    /// Where records go. `None` while no instance is served.
    records: Mutex<Option<SyncSender<ZBytes>>>,
    /// A random number of this process.
    id: u64,
    sequence: AtomicU64,
    /// Number of the last request.
    requests: AtomicU64,
    received: Mutex<Received>,
    pub(super) latencies: Measured,
}

/// A session, and what it receives.
#[derive(Debug)]
struct Link {
    session: Session,
    _received: [Subscriber<()>; 2],
}

impl Link {
    /// Receives states and records for `wire`.
    fn new(session: Session, wire: &Arc<Wire>) -> Result<Self, NetworkError> {
        let received = [
            subscribe(&session, wire.keys.state(), wire, |wire, state| {
                wire.take_state(&state.payload().to_bytes());
            })?,
            subscribe(&session, wire.keys.record(wire.id()), wire, |wire, record| {
                wire.take_record(record.payload());
            })?,
        ];
        Ok(Self { session, _received: received })
    }
}

fn subscribe(
    session: &Session,
    key: String,
    wire: &Arc<Wire>,
    take: fn(&Wire, &Sample),
) -> Result<Subscriber<()>, NetworkError> {
    let wire = Arc::downgrade(wire);
    let subscriber = session.declare_subscriber(key).callback(move |sample| {
        wire.upgrade().into_iter().for_each(|wire| take(&wire, &sample));
    });
    subscriber.wait().map_err(NetworkError::of)
}

/// Latencies and losses of the network since the last reset, as this side sees them.
#[derive(Debug, Default)]
pub(super) struct Measured {
    /// A frame to the robot, and the state that repeats it, without the time that the robot held it.
    pub(super) round_trip: Latencies,
    /// Upper bound of the age of a state when it arrives.
    pub(super) state_age: Latencies,
    /// Time between the arrivals of two states.
    pub(super) state_interval: Latencies,
    /// States that were sent and did not arrive before a newer one.
    lost: AtomicU64,
    /// Records that were missing before a later one.
    lost_records: AtomicU64,
    /// Frames that are no state or record of this version, or are older than one before.
    refused: AtomicU64,
}

impl Measured {
    pub(super) fn reset(&self) {
        [&self.round_trip, &self.state_age, &self.state_interval].into_iter().for_each(Latencies::reset);
        [&self.lost, &self.lost_records, &self.refused]
            .into_iter()
            .for_each(|count| count.store(0, Ordering::Relaxed));
    }

    pub(super) fn report(&self) -> NetworkLatency {
        NetworkLatency {
            round_trip_us: self.round_trip.percentiles(),
            state_age_us: self.state_age.percentiles(),
            state_interval_us: self.state_interval.percentiles(),
            lost: self.lost.load(Ordering::Relaxed),
            refused: self.refused.load(Ordering::Relaxed),
        }
    }

    /// Counts records that were lost.
    pub(super) fn count_records(&self, lost: u64) {
        self.lost_records.fetch_add(lost, Ordering::Relaxed);
    }

    /// Counts a frame that does not count.
    pub(super) fn refuse_frame(&self) {
        self.refused.fetch_add(1, Ordering::Relaxed);
    }
}

/// The newest frame of the robot.
#[derive(Debug, Default)]
struct Received {
    run: u64,
    sequence: u64,
    /// Time of sending of the newest frame, by the robot's clock, ns.
    sent_ns: u64,
    /// When it arrived, ns.
    arrived_ns: u64,
    clocks: Clocks,
    /// Not published yet.
    newest: Option<Box<StateMessage>>,
}

impl Received {
    /// Takes a frame that arrived at `now_ns`. Returns how many were lost before it; `None` for one
    /// that does not count.
    fn take(&mut self, down: Down, session: u64, now_ns: u64, measured: &Measured) -> Option<u64> {
        let Head { from: run, sequence, sent_ns } = down.head;
        let is_new_run = run != self.run;
        let echo = down.echoes.iter().find(|echo| echo.of == session);
        // A capture of an earlier run repeats no frame of now.
        let proves = |echo: &Echo| echo.age(session, now_ns).is_some_and(|age| age <= NEW_RUN_AGE_MAX);
        let is_next = if is_new_run { echo.is_some_and(proves) } else { sequence > self.sequence };
        if run == 0 || !is_next {
            return None;
        }
        if is_new_run {
            self.clocks = Clocks::default();
        } else {
            measured.state_interval.record(Duration::from_nanos(now_ns.saturating_sub(self.arrived_ns)));
        }
        if let Some(echo) = echo {
            let trip = RoundTrip {
                left_ns: echo.sent_ns,
                other_ns: sent_ns,
                held_ns: echo.held_ns,
                arrived_ns: now_ns,
            };
            self.clocks.take(&trip);
            trip.duration().into_iter().for_each(|duration| measured.round_trip.record(duration));
            echo.age(session, now_ns).into_iter().for_each(|age| measured.state_age.record(age));
        }
        let lost = if is_new_run { 0 } else { sequence - self.sequence - 1 };
        (self.run, self.sequence, self.sent_ns, self.arrived_ns) = (run, sequence, sent_ns, now_ns);
        self.newest = Some(down.state);
        Some(lost)
    }

    fn echo(&self, now_ns: u64) -> Echo {
        Echo { of: self.run, sent_ns: self.sent_ns, held_ns: now_ns.saturating_sub(self.arrived_ns) }
    }
}

impl Wire {
    /// For the calling thread.
    pub(super) fn new(keys: Keys) -> Result<Self, NetworkError> {
        Ok(Self {
            link: Mutex::default(),
            keys,
            main: std::thread::current(),
            records: Mutex::default(),
            id: random().map_err(NetworkError::of)?,
            sequence: AtomicU64::new(0),
            requests: AtomicU64::new(0),
            received: Mutex::default(),
            latencies: Measured::default(),
        })
    }

    /// Uses `session` from now on, and closes the one before it.
    pub(super) fn link(self: &Arc<Self>, session: Session) -> Result<(), NetworkError> {
        let link = Link::new(session, self)?;
        let before = lock(&self.link).replace(link);
        // It may have no link any more.
        let _closed = before.map(|before| before.session.close().wait());
        Ok(())
    }

    /// Returns the session. `None` before the first.
    pub(super) fn session(&self) -> Option<Session> {
        lock(&self.link).as_ref().map(|link| link.session.clone())
    }

    /// Passes records on to `records`; with `None` they are dropped.
    pub(super) fn receive_records(&self, records: Option<SyncSender<ZBytes>>) {
        *lock(&self.records) = records;
    }

    /// Takes the bytes of a record. Never waits: the states of the robot use the same thread of zenoh,
    /// so a record that finds its queue full is lost.
    pub(super) fn take_record(&self, bytes: &ZBytes) {
        let _lost = lock(&self.records).as_ref().map(|records| records.try_send(bytes.clone()));
    }

    /// Takes the bytes of a state, and wakes the thread that waits for it.
    pub(super) fn take_state(&self, bytes: &[u8]) {
        let now_ns = clock::now_ns();
        let taken = Down::read(bytes)
            .ok()
            .and_then(|down| self.received().take(down, self.id, now_ns, &self.latencies));
        match taken {
            Some(lost) => drop(self.latencies.lost.fetch_add(lost, Ordering::Relaxed)),
            None => self.latencies.refuse_frame(),
        }
        self.main.unpark();
    }

    /// Returns the newest state that was not taken yet, with times of the own clock. `None` also
    /// while the clocks are not compared.
    pub(super) fn newest(&self) -> Option<Box<StateMessage>> {
        let mut received = self.received();
        let offset = received.clocks.offset()?;
        let mut state = received.newest.take()?;
        drop(received);
        let now_ns = clock::now_ns();
        move_times(&mut state, |time| *time = offset.own(*time, now_ns));
        Some(state)
    }

    /// Returns the number of this process in frames.
    pub(super) fn id(&self) -> u64 {
        self.id
    }

    /// Returns the run of the robot's side; 0 before its first state.
    pub(super) fn run(&self) -> u64 {
        self.received().run
    }

    /// Returns the best comparison of the clocks. `None` before the first round trip.
    pub(super) fn offset(&self) -> Option<Offset> {
        self.received().clocks.offset()
    }

    /// Returns the head of the next frame.
    pub(super) fn up(&self) -> Up {
        let received = self.received();
        let now_ns = clock::now_ns();
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed) + 1;
        Up { head: Head { from: self.id, sequence, sent_ns: now_ns }, echo: received.echo(now_ns) }
    }

    /// Returns a sender of frames with this key.
    pub(super) fn sender(&self, key: String) -> Result<Sender<'_>, NetworkError> {
        Ok(Sender { wire: self, key: KeyExpr::new(key).map_err(NetworkError::of)? })
    }

    /// Returns the numbers of states and records that were lost, and of frames that did not count.
    pub(super) fn losses(&self) -> [u64; 3] {
        let Measured { lost, lost_records, refused, .. } = &self.latencies;
        [lost, lost_records, refused].map(|count| count.load(Ordering::Relaxed))
    }

    /// Returns the number of another request.
    pub(super) fn next_request(&self) -> u64 {
        self.requests.fetch_add(1, Ordering::Relaxed) + 1
    }

    fn received(&self) -> MutexGuard<'_, Received> {
        lock(&self.received)
    }

    pub(super) fn time_since_state(&self) -> Duration {
        Duration::from_nanos(clock::now_ns().saturating_sub(self.received().arrived_ns))
    }
}

fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Sends frames with one key to the robot.
#[derive(Debug)]
pub(super) struct Sender<'a> {
    wire: &'a Wire,
    key: KeyExpr<'static>,
}

impl Sender<'_> {
    /// Sends a frame with its whole key. Never waits: a slow link drops the frame.
    pub(super) fn put(&self, frame: Vec<u8>) {
        let Some(session) = self.wire.session() else { return };
        let frame = session.put(&self.key, frame).congestion_control(CongestionControl::Drop);
        let frame = frame.priority(Priority::RealTime).reliability(Reliability::BestEffort);
        let _dropped = frame.express(true).wait();
    }
}

/// Passes each time of a state of the robot to `change`.
pub(super) fn move_times(state: &mut StateMessage, mut change: impl FnMut(&mut u64)) {
    change(&mut state.tick_ns);
    change(&mut state.publish_ns);
    state.joints.iter_mut().for_each(|joint| change(&mut joint.receive_ns));
    state.imus.iter_mut().for_each(|imu| change(&mut imu.receive_ns));
}

#[cfg(test)]
mod tests {
    use super::*;

    const SESSION: u64 = 5;

    fn down(from: u64, sequence: u64) -> Down {
        let head = Head { from, sequence, sent_ns: 70 };
        let echo = Echo { of: SESSION, sent_ns: 10, held_ns: 4 };
        Down { head, echoes: vec![echo], state: Box::default() }
    }

    #[test]
    fn old_and_repeated_states_are_refused() {
        let (mut received, measured) = (Received::default(), Measured::default());
        let mut take = |from, sequence| received.take(down(from, sequence), SESSION, 30, &measured);
        assert_eq!(take(1, 5), Some(0));
        assert_eq!(take(1, 5), None);
        assert_eq!(take(1, 4), None);
        assert_eq!(take(1, 8), Some(2));
        assert_eq!(take(2, 1), Some(0), "the robot's side was started again");
        assert_eq!(take(0, 9), None);
    }

    #[test]
    fn new_run_needs_a_fresh_echo() {
        let (mut received, measured) = (Received::default(), Measured::default());
        let silent = Down { echoes: vec![], ..down(1, 5) };
        assert_eq!(received.take(silent, SESSION, 30, &measured), None);
        let later = 30 + NEW_RUN_AGE_MAX.as_nanos() as u64;
        assert_eq!(received.take(down(1, 5), SESSION, later, &measured), None, "a capture");
        assert_eq!(received.take(down(1, 5), SESSION, 30, &measured), Some(0));
        let silent = Down { echoes: vec![], ..down(1, 6) };
        assert_eq!(received.take(silent, SESSION, later, &measured), Some(0), "of the same run");
    }

    #[test]
    fn state_tells_round_trip_and_age() {
        let (mut received, measured) = (Received::default(), Measured::default());
        received.take(down(1, 1), SESSION, 30, &measured);
        assert_eq!(measured.round_trip.percentiles().max, 0.016);
        assert_eq!(measured.state_age.percentiles().max, 0.016);
        assert_eq!(received.echo(37), Echo { of: 1, sent_ns: 70, held_ns: 7 });
    }
}
