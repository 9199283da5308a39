//! Decides on the robot's side which frames of mirrors count.
//!
//! A frame counts when it is newer than each one before it of its session, and when it provably left
//! the mirror at most `age-max-ms` ago: by the echo in it, which needs no common clock. So nothing
//! that a network delays, repeats or reorders moves a motor, and no capture that is sent again.

use crate::frame::{Echo, FrameError, Head, SESSIONS_MAX, Up, nanos};
use motord_shared::{Lease, Operation};
use std::collections::BTreeMap;
use std::time::Duration;

/// The session of a mirror that has been silent for longer gives its slot to another one.
const SILENT_NS: u64 = 2_000_000_000;
/// The groups of a mirror that has been silent for longer are released: its computer may be dead. The
/// daemon's timeout damped them long before.
const ABANDONED_NS: u64 = 5_000_000_000;
/// Slots that watchers cannot take: a controller finds one.
const RESERVED: usize = 2;
/// The echo of an older state proves nothing: two clocks drift apart by up to 1 ms in this time.
const HELD: Duration = Duration::from_secs(2);
/// The daemon's states name a lease at most so long after it was granted.
const GRANTED_NS: u64 = 1_000_000_000;
/// Ages of frames are compared within this time.
const AGES_WINDOW_NS: u64 = 100_000_000;

/// The reason why a frame does not count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Refused {
    /// It is damaged.
    Malformed,
    /// Another version of motord-remote sent it.
    Layout,
    /// A frame of its session with this number, or a later one, has arrived already.
    Old,
    /// It repeats no state of this run: the mirror has received none yet.
    Unechoed,
    /// It may be older than `age-max-ms`.
    Late,
    /// Its lease was not granted to its session.
    Foreign,
    /// Too many mirrors are connected.
    Full,
}

impl Refused {
    /// All reasons.
    pub(crate) const ALL: [Self; 7] =
        [Self::Malformed, Self::Layout, Self::Old, Self::Unechoed, Self::Late, Self::Foreign, Self::Full];
}

impl From<FrameError> for Refused {
    fn from(error: FrameError) -> Self {
        match error {
            FrameError::Layout => Self::Layout,
            FrameError::Malformed => Self::Malformed,
        }
    }
}

/// Who may send a frame, by its key. Everybody may forge the number of a session in a frame of
/// watchers, so it hides none of a controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sender {
    Watcher,
    Controller,
}

/// A mirror.
#[derive(Debug)]
struct Session {
    id: u64,
    /// Numbers of its newest frames, by [`Sender`].
    sequences: [u64; 2],
    /// When the newest left, by the mirror's clock, ns.
    sent_ns: u64,
    /// When it arrived, by the own clock, ns.
    arrived_ns: u64,
    ages: Ages,
}

impl Session {
    /// Returns the time since its newest frame, ns.
    const fn silence_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.arrived_ns)
    }
}

/// Upper bounds of the ages of the frames of a session that arrived in the last one to two windows.
/// A full network delays each frame, a busy computer some of them.
#[derive(Debug, Clone, Copy, Default)]
struct Ages {
    /// Lowest of this window and of the one before.
    lowest: [Option<Duration>; 2],
    begun_ns: u64,
}

impl Ages {
    fn take(&mut self, age: Option<Duration>, now_ns: u64) {
        let since_ns = now_ns.saturating_sub(self.begun_ns);
        if since_ns > AGES_WINDOW_NS {
            self.lowest = [None, self.lowest[0].filter(|_| since_ns <= 2 * AGES_WINDOW_NS)];
            self.begun_ns = now_ns;
        }
        self.lowest[0] = self.lowest[0].into_iter().chain(age).min();
    }

    fn lowest(&self, now_ns: u64) -> Option<Duration> {
        let is_recent = now_ns.saturating_sub(self.begun_ns) <= 2 * AGES_WINDOW_NS;
        self.lowest.into_iter().flatten().min().filter(|_| is_recent)
    }
}

/// The mirrors that are connected, and the leases that they hold.
#[derive(Debug)]
pub(crate) struct Admission {
    /// A random number of this process.
    run: u64,
    age_max: Duration,
    sessions: Vec<Session>,
    /// By lease, the session that it was granted to, and when, ns.
    leases: BTreeMap<u64, (u64, u64)>,
}

impl Admission {
    pub(crate) fn new(run: u64, age_max: Duration) -> Self {
        Self { run, age_max, sessions: Vec::new(), leases: BTreeMap::new() }
    }

    /// Takes a frame that only measures, which every watcher may send.
    pub(crate) fn admit_watcher(&mut self, up: &Up, now_ns: u64) -> Result<Duration, Refused> {
        self.admit_as(up, now_ns, Sender::Watcher)
    }

    /// Takes a frame that arrived at `now_ns`. Returns an upper bound of the time since it left.
    pub(crate) fn admit(&mut self, up: &Up, now_ns: u64) -> Result<Duration, Refused> {
        self.admit_as(up, now_ns, Sender::Controller)
    }

    fn admit_as(&mut self, up: &Up, now_ns: u64, sender: Sender) -> Result<Duration, Refused> {
        let age = up.echo.age(self.run, now_ns);
        self.note(&up.head, age, now_ns, sender)?;
        let age = age.ok_or(Refused::Unechoed)?;
        let is_proof = up.echo.held_ns <= nanos(HELD);
        if age <= self.age_max && is_proof { Ok(age) } else { Err(Refused::Late) }
    }

    /// Notes the newest frame of a session.
    fn note(
        &mut self,
        head: &Head,
        age: Option<Duration>,
        now_ns: u64,
        sender: Sender,
    ) -> Result<(), Refused> {
        if head.from == 0 {
            return Err(Refused::Malformed);
        }
        let Head { from: id, sequence, sent_ns } = *head;
        let (mut ages, mut sequences) = (Ages::default(), [0; 2]);
        let slot = match self.sessions.iter_mut().find(|known| known.id == id) {
            Some(known) if sequence <= known.sequences[sender as usize] => return Err(Refused::Old),
            Some(known) => {
                (ages, sequences) = (known.ages, known.sequences);
                known
            }
            None => self.slot(now_ns, sender)?,
        };
        ages.take(age, now_ns);
        sequences[sender as usize] = sequence;
        *slot = Session { id, sequences, sent_ns, arrived_ns: now_ns, ages };
        Ok(())
    }

    /// Returns a slot for a new session: a free one, or that of a silent session without a lease.
    fn slot(&mut self, now_ns: u64, sender: Sender) -> Result<&mut Session, Refused> {
        let reserved = if sender == Sender::Watcher { RESERVED } else { 0 };
        let slots = SESSIONS_MAX - reserved;
        if self.sessions.len() < slots {
            let empty =
                Session { id: 0, sequences: [0; 2], sent_ns: 0, arrived_ns: 0, ages: Ages::default() };
            self.sessions.push(empty);
            return self.sessions.last_mut().ok_or(Refused::Full);
        }
        let Self { sessions, leases, .. } = self;
        let is_silent = |session: &Session| session.silence_ns(now_ns) > SILENT_NS;
        let is_free = |session: &&mut Session| {
            is_silent(session) && !leases.values().any(|(owner, _)| *owner == session.id)
        };
        let eldest = sessions.iter_mut().filter(is_free).min_by_key(|session| session.arrived_ns);
        eldest.ok_or(Refused::Full)
    }

    /// Checks that `session` holds the lease of a setpoint or a request.
    pub(crate) fn check_lease(&self, session: u64, lease: u64) -> Result<Lease, Refused> {
        let is_owner = self.leases.get(&lease).is_some_and(|(owner, _)| *owner == session);
        Lease::from_raw(lease).filter(|_| is_owner).ok_or(Refused::Foreign)
    }

    /// Notes that `session` was granted `lease` at `now_ns`. An earlier lease of the group has ended.
    pub(crate) fn granted(&mut self, session: u64, lease: Lease, now_ns: u64) {
        let other_group =
            |raw: &u64| Lease::from_raw(*raw).is_some_and(|other| other.group() != lease.group());
        self.leases.retain(|raw, _| other_group(raw));
        self.leases.insert(lease.raw(), (session, now_ns));
    }

    /// Keeps only the leases that the daemon's states still name, and new ones.
    pub(crate) fn keep(&mut self, owned: impl Fn(u64) -> bool, now_ns: u64) {
        self.leases.retain(|lease, (_, granted_ns)| {
            owned(*lease) || now_ns.saturating_sub(*granted_ns) < GRANTED_NS
        });
    }

    /// Takes the leases of sessions that have been silent for [`ABANDONED_NS`]. Allocates only when
    /// there are any.
    pub(crate) fn abandoned(&mut self, now_ns: u64) -> Vec<Lease> {
        let Self { sessions, leases, .. } = self;
        let is_connected = |id: u64| {
            sessions.iter().any(|session| session.id == id && session.silence_ns(now_ns) <= ABANDONED_NS)
        };
        let is_abandoned = |(_, (owner, _)): &(&u64, &(u64, u64))| !is_connected(*owner);
        let raw = leases.iter().filter(is_abandoned).map(|(raw, _)| *raw);
        let abandoned: Vec<_> = raw.filter_map(Lease::from_raw).collect();
        leases.retain(|_, (owner, _)| is_connected(*owner));
        abandoned
    }

    /// Returns `true` if a frame of `session` that arrived lately was at most half as old as one may
    /// be that counts. Otherwise bulk data must leave the network to states and setpoints.
    pub(crate) fn has_capacity(&self, session: u64, now_ns: u64) -> bool {
        let session = self.sessions.iter().find(|known| known.id == session);
        session.and_then(|session| session.ages.lowest(now_ns)).is_some_and(|age| age <= self.age_max / 2)
    }

    /// Returns the echoes of all sessions for a frame that leaves at `now_ns`.
    pub(crate) fn echoes(&self, now_ns: u64) -> Vec<Echo> {
        let echo = |session: &Session| Echo {
            of: session.id,
            sent_ns: session.sent_ns,
            held_ns: session.silence_ns(now_ns),
        };
        self.sessions.iter().map(echo).collect()
    }
}

/// Returns `true` for a request that only reads: any watcher may send it.
pub(crate) fn only_reads(operation: Operation) -> bool {
    matches!(operation, Operation::Describe | Operation::Telemetry | Operation::Histograms)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RUN: u64 = 99;
    const MS: u64 = 1_000_000;

    fn admission() -> Admission {
        Admission::new(RUN, Duration::from_millis(50))
    }

    /// A frame that repeats a state of the run sent at `echoed_ns`.
    fn up(from: u64, sequence: u64, echoed_ns: u64) -> Up {
        let head = Head { from, sequence, sent_ns: 17 };
        Up { head, echo: Echo { of: RUN, sent_ns: echoed_ns, held_ns: 0 } }
    }

    #[test]
    fn repeated_and_reordered_frames_are_old() {
        let mut admission = admission();
        assert_eq!(admission.admit(&up(1, 5, 0), 3), Ok(Duration::from_nanos(3)));
        assert_eq!(admission.admit(&up(1, 5, 0), 3), Err(Refused::Old));
        assert_eq!(admission.admit(&up(1, 4, 0), 3), Err(Refused::Old));
        assert!(admission.admit(&up(2, 4, 0), 3).is_ok(), "numbers belong to a session");
        assert!(admission.admit(&up(1, 6, 0), 3).is_ok());
    }

    #[test]
    fn forged_frame_of_watcher_hides_no_setpoint() {
        let mut admission = admission();
        assert!(admission.admit(&up(1, 5, 0), 3).is_ok());
        assert!(admission.admit_watcher(&up(1, u64::MAX, 0), 3).is_ok());
        assert!(admission.admit(&up(1, 6, 0), 3).is_ok());
        assert_eq!(admission.admit_watcher(&up(1, 7, 0), 3), Err(Refused::Old));
    }

    #[test]
    fn frame_that_may_be_late_is_refused() {
        let mut admission = admission();
        assert!(admission.admit(&up(1, 1, 0), 50 * MS).is_ok());
        assert_eq!(admission.admit(&up(1, 2, 0), 50 * MS + 1), Err(Refused::Late));
        assert_eq!(admission.admit(&up(1, 2, 50 * MS), 51 * MS), Err(Refused::Old), "a late one counts");
    }

    #[test]
    fn echo_of_long_ago_proves_nothing() {
        let held = |held: Duration| Echo { of: RUN, sent_ns: 0, held_ns: nanos(held) };
        let up = |sequence, held_for| Up { echo: held(held_for), ..up(1, sequence, 0) };
        let later = HELD + Duration::from_millis(1);
        assert!(admission().admit(&up(1, HELD), nanos(HELD)).is_ok());
        assert_eq!(admission().admit(&up(2, later), nanos(later)), Err(Refused::Late));
    }

    #[test]
    fn capture_of_an_earlier_run_is_refused() {
        let echo = Echo { of: RUN - 1, sent_ns: 0, held_ns: 0 };
        let captured = Up { echo, ..up(1, 1, 0) };
        assert_eq!(admission().admit(&captured, 3), Err(Refused::Unechoed));
        assert_eq!(admission().admit(&up(1, 1, 4), 3), Err(Refused::Unechoed), "of the future");
        assert_eq!(admission().admit(&up(0, 1, 0), 3), Err(Refused::Malformed));
    }

    #[test]
    fn lease_belongs_to_session_it_was_granted_to() {
        let mut admission = admission();
        let (first, second) = (Lease::new(1, 1, 0).unwrap(), Lease::new(1, 2, 0).unwrap());
        let other = Lease::new(1, 3, 1).unwrap();
        admission.granted(7, first, 0);
        admission.granted(8, other, 0);
        assert_eq!(admission.check_lease(7, first.raw()), Ok(first));
        assert_eq!(admission.check_lease(8, first.raw()), Err(Refused::Foreign));
        assert_eq!(admission.check_lease(7, 0), Err(Refused::Foreign));
        admission.granted(8, second, 0);
        assert_eq!(admission.check_lease(7, first.raw()), Err(Refused::Foreign), "the group has another");
        admission.keep(|_| false, GRANTED_NS - 1);
        assert_eq!(admission.check_lease(8, other.raw()), Ok(other), "the states may not name it yet");
        admission.keep(|lease| lease == second.raw(), GRANTED_NS);
        assert_eq!(admission.check_lease(8, other.raw()), Err(Refused::Foreign));
        assert_eq!(admission.check_lease(8, second.raw()), Ok(second));
    }

    #[test]
    fn silent_session_without_lease_leaves_its_slot() {
        let mut admission = admission();
        for session in 1..=SESSIONS_MAX as u64 {
            admission.admit(&up(session, 1, 0), session).unwrap();
        }
        assert_eq!(admission.admit(&up(100, 1, 0), 50), Err(Refused::Full));
        admission.granted(1, Lease::new(1, 1, 0).unwrap(), 0);
        let later = 3 * SILENT_NS;
        assert!(admission.admit(&up(100, 1, later), later).is_ok());
        let sessions: Vec<_> = admission.echoes(later).iter().map(|echo| echo.of).collect();
        assert!(sessions.contains(&1) && !sessions.contains(&2) && sessions.contains(&100));
    }

    #[test]
    fn silent_mirror_loses_its_leases() {
        let mut admission = admission();
        let (first, second) = (Lease::new(1, 1, 0).unwrap(), Lease::new(1, 2, 1).unwrap());
        admission.admit(&up(7, 1, 0), 0).unwrap();
        admission.admit(&up(8, 1, 0), 1).unwrap();
        admission.granted(7, first, 0);
        admission.granted(8, second, 0);
        assert_eq!(admission.abandoned(ABANDONED_NS), []);
        assert_eq!(admission.abandoned(ABANDONED_NS + 1), [first]);
        assert_eq!(admission.check_lease(7, first.raw()), Err(Refused::Foreign));
        assert_eq!(admission.check_lease(8, second.raw()), Ok(second));
        assert_eq!(admission.abandoned(ABANDONED_NS + 1), [], "each is taken once");
    }

    #[test]
    fn watchers_leave_slots_for_controllers() {
        let mut admission = admission();
        let admitted = (1..=20).filter(|session| admission.admit_watcher(&up(*session, 1, 0), 3).is_ok());
        assert_eq!(admitted.count(), SESSIONS_MAX - RESERVED);
        assert!(admission.admit(&up(50, 1, 0), 3).is_ok() && admission.admit(&up(51, 1, 0), 3).is_ok());
        assert_eq!(admission.admit(&up(52, 1, 0), 3), Err(Refused::Full));
    }

    #[test]
    fn slow_network_carries_no_records() {
        let mut admission = admission();
        assert!(!admission.has_capacity(1, 25 * MS), "an unknown session");
        admission.admit(&up(1, 1, 0), 25 * MS).unwrap();
        assert!(admission.has_capacity(1, 25 * MS));
        // Each later frame needs longer, first one that counts, then one that does not.
        admission.admit(&up(1, 2, 0), 40 * MS).unwrap();
        assert!(admission.has_capacity(1, 40 * MS), "one frame may be late");
        for (number, ms) in (3..).zip([150, 250, 350]) {
            let _counts = admission.admit(&up(1, number, (ms - 60) * MS), ms * MS);
        }
        assert!(!admission.has_capacity(1, 350 * MS));
        admission.admit(&up(1, 9, 350 * MS), 351 * MS).unwrap();
        assert!(
            admission.has_capacity(1, 351 * MS) && !admission.has_capacity(1, 900 * MS),
            "a silent mirror"
        );
    }

    #[test]
    fn echo_tells_how_long_a_frame_was_held() {
        let mut admission = admission();
        admission.admit(&up(1, 1, 0), 1000).unwrap();
        assert_eq!(admission.echoes(1300), [Echo { of: 1, sent_ns: 17, held_ns: 300 }]);
    }

    /// A frame or a state on a network that delays, reorders and repeats, in real time, ns.
    #[derive(Debug, Clone)]
    struct Sent {
        at: u64,
        arrivals: [u64; 2],
    }

    /// The echo that a mirror, whose clock is `ahead` of real time, sends at `now`.
    fn echo_at(states: &[Sent], ahead: u64, now: u64) -> Echo {
        let arrived = states.iter().filter(|state| state.arrivals[0] <= now);
        let Some(newest) = arrived.max_by_key(|state| state.at) else { return Echo::default() };
        let held_ns = (now + ahead) - (newest.arrivals[0] + ahead);
        Echo { of: RUN, sent_ns: newest.at, held_ns }
    }

    fn sent() -> impl Strategy<Value = Sent> {
        let delay = || 0..200 * MS;
        (0..1000 * MS, delay(), delay())
            .prop_map(|(at, first, second)| Sent { at, arrivals: [at + first, at + second] })
    }

    proptest! {
        #[test]
        fn admitted_frame_is_no_older_than_stated(
            mut states in proptest::collection::vec(sent(), 1..60),
            mut frames in proptest::collection::vec(sent(), 1..60),
            ahead in 0..u64::MAX / 2,
        ) {
            states.sort_by_key(|state| state.at);
            frames.sort_by_key(|frame| frame.at);
            let ups = frames.iter().enumerate().map(|(number, frame)| {
                let head = Head { from: 1, sequence: number as u64 + 1, sent_ns: frame.at + ahead };
                (frame, Up { head, echo: echo_at(&states, ahead, frame.at) })
            });
            let arrive = |(frame, up): (&Sent, Up)| frame.arrivals.map(|arrival| (arrival, frame.at, up));
            let mut arrivals: Vec<_> = ups.flat_map(arrive).collect();
            arrivals.sort_by_key(|(arrival, ..)| *arrival);
            let (mut admission, mut newest) = (admission(), None);
            for (arrival, left, up) in arrivals {
                let Ok(age) = admission.admit(&up, arrival) else { continue };
                prop_assert!(arrival - left <= nanos(age) && age <= admission.age_max);
                prop_assert!(newest.replace(up.head.sequence).is_none_or(|before| before < up.head.sequence));
            }
        }
    }
}
