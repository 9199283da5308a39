//! The inputs that all decisions of a cycle share, and the queues of events and answers.

use super::answers::{Answers, Refused};
use super::event::{Event, Events};
use super::wake::Wake;
use crate::settings::{SafetySettings, Settings};
use motord_bus::{Duration, Instant};

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
    /// When the first cycle began.
    started: Option<Instant>,
    events: Events,
    answers: Answers,
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
