//! One bus in the cycle: what is sent on it, who answers there, and what is counted.

use crate::drive::{Answer, Drive};
use crate::plan::BusPlan;
use crate::settings::Settings;
use motord_bus::frame::ControllerState;
use motord_bus::{Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Readiness, Refusal, Sent};
use motord_shared::{BusCondition, BusState};

/// A bus, and everything the cycle knows of it.
pub(super) struct Slot {
    bus: Box<dyn Bus>,
    /// Reply id and motor, in the order of the configuration.
    routes: Vec<(FrameId, usize)>,
    frames: Vec<Frame>,
    senders: Vec<usize>,
    inbox: Inbox,
    counters: BusState,
    condition: BusCondition,
    sent_at: Instant,
    heard_at: Instant,
    asks: Asks,
    usual: [Usual; 2],
    poll_time: Duration,
}

/// What a round of frames asks, as an index: both take their own time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Asks {
    /// Every motor for its state.
    States,
    /// One motor for its faults.
    Faults,
}

/// How long the last reply of a round usually takes: the first look at a bus comes then, and mostly it is the only one.
/// Rises at once, falls slowly.
#[derive(Debug, Clone, Copy)]
struct Usual(Duration);

impl Usual {
    const FALL: u32 = 32;

    fn observe(&mut self, time: Duration) {
        self.0 = if time > self.0 { time } else { self.0 - (self.0 - time) / Self::FALL };
    }
}

impl Slot {
    pub(super) fn new(bus: Box<dyn Bus>, index: usize, settings: &Settings, plan: &BusPlan) -> Self {
        let motors = settings.motors.iter().enumerate().filter(|(_, motor)| motor.bus == index);
        let routes: Vec<_> = motors.map(|(motor, settings)| (settings.host_id, motor)).collect();
        Self {
            bus,
            frames: Vec::with_capacity(routes.len()),
            senders: Vec::with_capacity(routes.len()),
            routes,
            inbox: Inbox::new(),
            counters: BusState::default(),
            condition: BusCondition::Active,
            sent_at: Instant::ZERO,
            heard_at: Instant::ZERO,
            asks: Asks::States,
            usual: [Usual(plan.expected), Usual(plan.exchange_least)],
            poll_time: plan.exchange_worst,
        }
    }

    /// Puts an opened bus in the place of one that went away.
    pub(super) fn replace(&mut self, bus: Box<dyn Bus>) -> Box<dyn Bus> {
        self.condition = BusCondition::Active;
        std::mem::replace(&mut self.bus, bus)
    }

    /// Begins a round: forgets the frames of the one before.
    pub(super) fn begin(&mut self, asks: Asks) {
        self.asks = asks;
        self.frames.clear();
        self.senders.clear();
    }

    /// Adds the frame of a motor, if there is one.
    pub(super) fn queue(&mut self, motor: usize, frame: Option<Frame>) {
        if let Some(frame) = frame {
            self.frames.push(frame);
            self.senders.push(motor);
        }
    }

    /// Sends what was queued; to a bus that is off or gone, nothing. What is not accepted is dropped and counted: its
    /// motor was not asked. Tells whether all was accepted.
    pub(super) fn send(&mut self, now: Instant, unask: impl FnMut(usize)) -> bool {
        self.sent_at = now;
        self.heard_at = now;
        if self.frames.is_empty() {
            return true;
        }
        let sent = match self.condition {
            BusCondition::Off | BusCondition::Gone => Sent { accepted: 0, refusal: None },
            _ => self.bus.send(now, &self.frames),
        };
        match sent.refusal {
            Some(Refusal::Down) => self.condition = BusCondition::Down,
            Some(Refusal::Gone) => self.condition = BusCondition::Gone,
            Some(Refusal::Full | Refusal::Error(_)) => {}
            None if self.condition == BusCondition::Down => self.condition = BusCondition::Active,
            None => {}
        }
        self.account(sent.accepted, unask)
    }

    /// Sends nothing of what was queued, as if the bus had not accepted it.
    pub(super) fn withhold(&mut self, unask: impl FnMut(usize)) -> bool {
        self.account(0, unask)
    }

    fn account(&mut self, accepted: usize, mut unask: impl FnMut(usize)) -> bool {
        let accepted = accepted.min(self.frames.len());
        let dropped = self.frames.len() - accepted;
        self.senders[accepted..].iter().for_each(|&motor| unask(motor));
        self.counters.sent = self.counters.sent.wrapping_add(accepted as u32);
        self.counters.dropped = self.counters.dropped.wrapping_add(dropped as u32);
        dropped == 0
    }

    /// Sends frames whose answers nobody waits for, after what came meanwhile was thrown away.
    pub(super) fn send_unasked(&mut self, now: Instant, frames: &[Frame], unread: &mut Inbox) {
        unread.clear();
        self.bus.receive(now, unread);
        let _refused = self.bus.send(now, frames);
    }

    /// When all answers to this round are usually there.
    pub(super) fn expected(&self) -> Instant {
        self.sent_at + self.usual[self.asks as usize].0
    }

    /// Every answer to this round has come: learns how long that takes.
    pub(super) fn complete(&mut self) {
        if !self.frames.is_empty() {
            self.usual[self.asks as usize].observe(self.heard_at.since(self.sent_at));
        }
    }

    /// A request on this bus is open.
    pub(super) fn is_open(&self, drives: &[Drive]) -> bool {
        self.routes.iter().any(|&(_, motor)| drives[motor].is_open())
    }

    pub(super) fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }

    /// How long a question for a fault and its answer take at worst.
    pub(super) const fn poll_time(&self) -> Duration {
        self.poll_time
    }

    pub(super) const fn condition(&self) -> BusCondition {
        self.condition
    }

    pub(super) const fn report(&self) -> BusState {
        BusState { condition: self.condition.code(), ..self.counters }
    }

    /// Reads one inbox full and gives every frame to the motor it is from.
    pub(super) fn receive(&mut self, now: Instant, mut read: impl FnMut(usize, &[u8], Instant) -> Answer) {
        self.inbox.clear();
        self.bus.receive(now, &mut self.inbox);
        self.counters.lost = self.counters.lost.wrapping_add(self.inbox.lost);
        let Self { inbox, routes, counters, condition, heard_at, .. } = self;
        for arrival in inbox.arrivals() {
            count(&mut counters.received);
            match arrival.content {
                Content::Frame(frame) => {
                    let route = routes.iter().find(|(id, _)| *id == frame.id());
                    match route
                        .map_or(Answer::Stranger, |&(_, motor)| read(motor, frame.payload(), arrival.at))
                    {
                        Answer::Heard(_) => *heard_at = arrival.at,
                        Answer::Duplicate => count(&mut counters.duplicate),
                        Answer::Stranger => count(&mut counters.unknown),
                        Answer::Malformed => count(&mut counters.malformed),
                    }
                }
                Content::Foreign(_) => count(&mut counters.malformed),
                Content::Error(error) => {
                    count(&mut counters.errors);
                    if let Some(state) = error.state() {
                        *condition = condition_of(state);
                    }
                }
            }
        }
    }
}

fn count(counter: &mut u32) {
    *counter = counter.wrapping_add(1);
}

fn condition_of(state: ControllerState) -> BusCondition {
    match state {
        ControllerState::Active => BusCondition::Active,
        ControllerState::Warning => BusCondition::Warning,
        ControllerState::Passive => BusCondition::Passive,
        ControllerState::Off => BusCondition::Off,
    }
}
