//! The inputs that all decisions of a cycle share, and the queues of events and answers.

use super::answers::{Answers, Refused};
use super::event::{Event, Events, LOSS_TIME};
use super::time_base::Wake;
use motord_bus::{Duration, Instant};
use motord_settings::settings::{SafetySettings, Settings};
use motord_shared::limits::{BUSES_MAX, JOINTS_MAX};

/// Passed to groups and motors in every call.
#[derive(Debug)]
pub(super) struct Context {
    pub(super) safety: SafetySettings,
    pub(super) period: Duration,
    pub(super) wake: Wake,
    /// Time of the current call.
    pub(super) now: Instant,
    /// Time since the cycle before, at most two periods, s.
    pub(super) elapsed: f32,
    /// Number of publications of the states.
    pub(super) publications: u64,
    /// The joints whose motors were lost since [`take_lost`](Self::take_lost), as bits.
    lost: u64,
    /// When a bus lost received frames last, by bus.
    lost_at: [Option<Instant>; BUSES_MAX],
    /// When the first cycle began.
    started: Option<Instant>,
    events: Events,
    answers: Answers,
}

/// A set of joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Joints(u64);

const _: () = assert!(JOINTS_MAX <= u64::BITS as usize);

impl Joints {
    pub(super) const NONE: Self = Self(0);

    pub(super) const fn contains(self, joint: usize) -> bool {
        self.0 & 1 << joint != 0
    }

    /// Returns the joints, rising.
    pub(super) fn iter(self) -> impl Iterator<Item = usize> {
        (0..JOINTS_MAX).filter(move |&joint| self.contains(joint))
    }
}

impl Context {
    pub(super) fn new(settings: &Settings) -> Self {
        Self {
            safety: settings.safety.clone(),
            period: settings.cycle.period,
            wake: Wake::default(),
            now: Instant::ZERO,
            elapsed: 0.0,
            publications: 0,
            lost: 0,
            lost_at: [None; BUSES_MAX],
            started: None,
            events: Events::new(),
            answers: Answers::new(),
        }
    }

    /// Begins a cycle. Returns the time since the previous cycle.
    pub(super) fn begin(&mut self, wake: Wake) -> Duration {
        let elapsed = wake.begun.since(self.wake.begun);
        self.elapsed = elapsed.min(2 * self.period).as_secs_f32();
        self.wake = wake;
        self.now = wake.begun;
        self.started.get_or_insert(wake.begun);
        elapsed
    }

    /// Returns the time since the first cycle began.
    pub(super) fn uptime(&self) -> Duration {
        self.started.map_or(Duration::ZERO, |started| self.now.since(started))
    }

    pub(super) fn note_loss(&mut self, bus: usize, at: Instant) {
        self.lost_at[bus] = Some(at);
    }

    /// Returns whether lost frames of `bus` may be the reason why a motor seems silent.
    pub(super) fn loses_frames(&self, bus: usize) -> bool {
        self.lost_at[bus].is_some_and(|at| self.now.since(at) <= LOSS_TIME)
    }

    /// Records that the motor of `joint` is lost.
    pub(super) const fn note_lost(&mut self, joint: usize) {
        self.lost |= 1 << joint;
    }

    /// Returns whether a motor was lost since [`take_lost`](Self::take_lost).
    #[inline]
    pub(super) const fn has_lost(&self) -> bool {
        self.lost != 0
    }

    /// Returns the joints whose motors were lost since the last call.
    pub(super) fn take_lost(&mut self) -> Joints {
        Joints(core::mem::take(&mut self.lost))
    }

    pub(super) fn push(&mut self, event: Event) {
        self.events.push(event);
    }

    /// Answers a service request.
    pub(super) fn answer(&mut self, ticket: u32, outcome: Result<(), Refused>) {
        self.answers.push(ticket, outcome);
    }

    pub(super) const fn events(&self) -> &Events {
        &self.events
    }

    pub(super) const fn events_mut(&mut self) -> &mut Events {
        &mut self.events
    }

    pub(super) const fn answers_mut(&mut self) -> &mut Answers {
        &mut self.answers
    }
}
