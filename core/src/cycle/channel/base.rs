//! The part of a bus that CAN buses and lines have in common.

use super::foreign::ForeignCommands;
use super::routes::Routes;
use crate::control::Losses;
use crate::sensor::Sensors;
use motord_bus::frame::ControllerState;
use motord_bus::{Bus, Content, ErrorFrame, Frame, FrameId, Inbox, Instant, Readiness, Refusal, Sent};
use motord_shared::{BusCondition, BusState};

/// A bus with the frames of one batch, the motors that reply there, and the counters.
pub(crate) struct ChannelBase {
    bus: Box<dyn Bus>,
    routes: Routes,
    foreign: ForeignCommands,
    sensors: Sensors,
    /// One slot for each motor of the bus, and those for its sensors. The first hold the batch: one
    /// frame for each of `senders`, then those to sensors.
    frames: Vec<Frame>,
    senders: Vec<usize>,
    inbox: Inbox,
    counters: BusState,
    condition: BusCondition,
    losses: Losses,
    replied_at: Instant,
}

/// The outcome of sending a batch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Accepted {
    /// The number of replies to the accepted frames.
    pub(super) awaited: usize,
    /// Those were all.
    pub(super) accepted_all: bool,
}

/// The role of a frame from a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FrameRole {
    /// Answers the open request.
    Answer,
    /// Answers a request of an earlier cycle.
    Late,
    /// Answers no request.
    Duplicate,
    /// The motor sent it by itself.
    Unprompted,
    /// It has the id of another motor.
    UnexpectedId,
    /// It does not decode, or cannot be an answer to the open request.
    Malformed,
}

/// The outcome of a read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Arrivals {
    /// The number of arrivals, without frames that sensors and motors sent by themselves.
    pub(super) all: usize,
    /// Those of them that answer a request which was open.
    pub(super) answers: usize,
}

impl ChannelBase {
    /// Allocates; nothing after it does.
    pub(super) fn new(
        bus: Box<dyn Bus>,
        routes: Routes,
        mut foreign: ForeignCommands,
        sensors: Sensors,
    ) -> Self {
        let frames = vec![Frame::EMPTY; routes.len() + sensors.frames_max()];
        foreign.expect_batches(&frames);
        Self {
            bus,
            frames,
            senders: Vec::with_capacity(routes.len()),
            sensors,
            routes,
            foreign,
            inbox: Inbox::new(),
            counters: BusState::default(),
            condition: BusCondition::Active,
            losses: Losses::NONE,
            replied_at: Instant::ZERO,
        }
    }

    /// Replaces a bus that disconnected by one that was opened again, or by a substitute in another
    /// condition. Returns the old one: closing it may block.
    pub(crate) fn replace(&mut self, bus: Box<dyn Bus>, condition: BusCondition) -> Box<dyn Bus> {
        self.condition = condition;
        std::mem::replace(&mut self.bus, bus)
    }

    /// Removes the frames of the last batch.
    #[inline]
    pub(super) fn clear(&mut self) {
        self.senders.clear();
        self.sensors.clear();
    }

    /// Returns the number of frames of each possible [`batch`](Self::batch).
    pub(super) fn batches(&self) -> impl Iterator<Item = usize> {
        let motors = self.routes.len();
        (0..=self.frames.len() - motors)
            .flat_map(move |to_sensors| (0..=motors).map(move |to_motors| to_sensors + to_motors))
    }

    /// Returns the number of the batch among all that differ in their frames to motors or to
    /// sensors; 0 without a frame.
    #[inline]
    pub(super) fn batch(&self) -> usize {
        self.senders.len() + self.sensors.queued() * (self.routes.len() + 1)
    }

    /// Queues the requests to the sensors in the cycle with this number, after the frames of the
    /// motors. Bounded by sensors.
    pub(crate) fn queue_sensors(&mut self, cycle: u64, now: Instant) {
        if matches!(self.condition, BusCondition::Active | BusCondition::Warning | BusCondition::Passive) {
            self.sensors.reconnect();
        }
        let Self { frames, senders, sensors, .. } = self;
        sensors.queue(cycle, now, &mut frames[senders.len()..]);
    }

    /// Queues a frame for each motor that `write` writes one for.
    #[inline]
    pub(crate) fn queue_each(&mut self, mut write: impl FnMut(usize, &mut Frame) -> bool) {
        let Self { routes, frames, senders, .. } = self;
        for motor in routes.motors() {
            if frames.get_mut(senders.len()).is_some_and(|frame| write(motor, frame)) {
                senders.push(motor);
            }
        }
    }

    /// Queues the frame of a motor, if `write` writes one. There is a slot for each motor of the
    /// bus.
    pub(crate) fn queue(&mut self, motor: usize, write: impl FnOnce(&mut Frame) -> bool) {
        if self.frames.get_mut(self.senders.len()).is_some_and(write) {
            self.senders.push(motor);
        }
    }

    /// Sends the queued frames; nothing to a bus that is off, gone or exchanged. Frames that the
    /// bus does not accept are dropped and counted, and `unsent` is called with their motors. At
    /// most one system call.
    #[inline]
    pub(super) fn send(&mut self, now: Instant, unsent: impl FnMut(usize)) -> Accepted {
        self.replied_at = now;
        if self.is_idle() {
            return Accepted { awaited: 0, accepted_all: true };
        }
        let sent = match self.condition {
            BusCondition::Off | BusCondition::Gone | BusCondition::Exchanged => {
                Sent { accepted: 0, refusal: None }
            }
            _ => {
                let sent = self.bus.send(now, &self.frames[..self.senders.len() + self.sensors.queued()]);
                self.foreign.keep_batch(&mut self.frames);
                sent
            }
        };
        match sent.refusal {
            Some(Refusal::Down) => self.condition = BusCondition::Down,
            Some(Refusal::Gone) => self.condition = BusCondition::Gone,
            Some(Refusal::Full | Refusal::Error(_)) => {}
            None if self.condition == BusCondition::Down => self.condition = BusCondition::Active,
            None => {}
        }
        self.account(sent.accepted, unsent)
    }

    /// Drops the queued frames, as if the bus had not accepted them. No system call.
    pub(super) fn withhold(&mut self, unsent: impl FnMut(usize)) -> Accepted {
        self.account(0, unsent)
    }

    #[inline]
    fn account(&mut self, accepted: usize, mut unsent: impl FnMut(usize)) -> Accepted {
        let (motors, total) = (self.senders.len(), self.senders.len() + self.sensors.queued());
        let accepted = accepted.min(total);
        let dropped = total - accepted;
        let of_motors = accepted.min(motors);
        self.senders[of_motors..].iter().for_each(|&motor| unsent(motor));
        if total > motors {
            self.sensors.accepted(accepted - of_motors);
        }
        self.counters.sent = self.counters.sent.wrapping_add(accepted as u32);
        self.counters.dropped = self.counters.dropped.wrapping_add(dropped as u32);
        Accepted { awaited: of_motors + self.sensors.open(), accepted_all: dropped == 0 }
    }

    /// Discards what has arrived, then sends `frames` whose replies are not read. At most two
    /// system calls.
    pub(super) fn send_unanswered(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        self.inbox.clear();
        self.bus.receive(now, &mut self.inbox);
        self.bus.send(now, frames).refusal
    }

    /// The next read takes a whole inbox.
    pub(super) fn clear_inbox(&mut self) {
        self.inbox.clear();
    }

    /// The next read takes at most `arrivals`.
    pub(super) fn clear_inbox_for(&mut self, arrivals: usize) {
        self.inbox.clear_for(arrivals);
    }

    /// Returns whether the last read filled the space that it was given, and the inbox has more.
    pub(super) fn is_read_full(&self) -> bool {
        self.inbox.free() == 0 && self.inbox.arrivals().len() < Inbox::CAPACITY
    }

    /// Reads once, and gives every frame to the motor that it is from, or `None` for a request that
    /// the motor refused. Bounded by the inbox times the motors of the bus; one system call.
    #[inline]
    pub(super) fn receive(
        &mut self,
        now: Instant,
        mut classify: impl FnMut(usize, Option<&Frame>, Instant) -> FrameRole,
    ) -> Arrivals {
        self.bus.receive(now, &mut self.inbox);
        self.counters.lost = self.counters.lost.wrapping_add(self.inbox.lost);
        self.losses.by_kernel = self.losses.by_kernel.saturating_add(self.inbox.lost);
        let Self { inbox, routes, foreign, sensors, counters, condition, losses, .. } = self;
        counters.received = counters.received.wrapping_add(inbox.arrivals().len() as u32);
        let (mut answers, mut unasked) = (0, 0);
        for arrival in inbox.arrivals() {
            // Nearly all arrivals are frames.
            let (id, frame) = if let Content::Frame(frame) = &arrival.content {
                (frame.id(), Some(frame))
            } else if let Some(id) = refused(&arrival.content, condition, counters, losses) {
                (id, None)
            } else {
                continue;
            };
            let role = match (routes.motor(id), frame) {
                (Some(motor), _) => classify(motor, frame, arrival.at),
                (None, Some(frame)) => match unrouted(sensors, foreign, frame, arrival.at) {
                    None => FrameRole::UnexpectedId,
                    Some(true) => {
                        (self.replied_at, answers) = (arrival.at, answers + 1);
                        continue;
                    }
                    Some(false) => {
                        unasked += 1;
                        continue;
                    }
                },
                (None, None) => FrameRole::UnexpectedId,
            };
            match role {
                FrameRole::Answer => (self.replied_at, answers) = (arrival.at, answers + 1),
                FrameRole::Late => self.replied_at = arrival.at,
                FrameRole::Unprompted => unasked += 1,
                useless => count_useless(counters, useless),
            }
        }
        Arrivals { all: inbox.arrivals().len() - unasked, answers }
    }

    /// Returns the frames that were lost since the last call.
    #[inline]
    pub(crate) fn take_losses(&mut self) -> Losses {
        core::mem::take(&mut self.losses)
    }

    /// Returns the frames that command motors of this bus and are not from this program.
    #[inline]
    pub(crate) const fn foreign(&mut self) -> &mut ForeignCommands {
        &mut self.foreign
    }

    /// Returns the sensors of the bus.
    #[inline]
    pub(crate) const fn sensors(&mut self) -> &mut Sensors {
        &mut self.sensors
    }

    /// Returns the number of open requests to sensors in the last batch.
    pub(super) fn open_requests(&self) -> usize {
        self.sensors.open()
    }

    /// Returns whether no frame is queued.
    #[inline]
    pub(crate) fn is_idle(&self) -> bool {
        self.senders.is_empty() && self.sensors.queued() == 0
    }

    /// Returns the motors of the last batch, in the order of its frames.
    pub(crate) fn senders(&self) -> &[usize] {
        &self.senders
    }

    /// Returns the motors of the bus without a frame in the last batch.
    pub(super) fn others(&self) -> impl Iterator<Item = usize> {
        let others = self.routes.motors().filter(|_| self.senders.len() < self.routes.len());
        others.filter(|motor| !self.senders.contains(motor))
    }

    /// Returns the arrival of the last reply; the time of the last sending where none has arrived
    /// since.
    #[inline]
    pub(super) const fn replied_at(&self) -> Instant {
        self.replied_at
    }

    /// Returns how to wait for the bus. No system call.
    pub(super) fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }

    /// Returns the condition of the bus as of its last report or refusal.
    #[inline]
    pub(crate) const fn condition(&self) -> BusCondition {
        self.condition
    }

    /// Returns the counters, without the condition.
    #[inline]
    pub(crate) const fn report(&self) -> BusState {
        self.counters
    }

    /// Discards the frames that wait for the wire, if the bus can do so without a system call.
    /// Returns whether none waits.
    pub(crate) fn discard_queue(&mut self) -> bool {
        self.bus.discard_queue()
    }
}

/// Takes a frame that is from no motor: from a sensor, as [`Sensors::receive`] does, or a command
/// of another program.
#[cold]
fn unrouted(
    sensors: &mut Sensors,
    foreign: &mut ForeignCommands,
    frame: &Frame,
    at: Instant,
) -> Option<bool> {
    let received = sensors.receive(frame, at);
    if received.is_none() {
        foreign.note(frame);
    }
    received
}

/// Counts an arrival that is no frame. Returns the id of a request that the motor refused.
#[cold]
fn refused(
    content: &Content,
    condition: &mut BusCondition,
    counters: &mut BusState,
    losses: &mut Losses,
) -> Option<FrameId> {
    match content {
        Content::Frame(_) => {}
        Content::Refused(id) => return Some(*id),
        Content::Unsupported(_) => count(&mut counters.malformed),
        Content::Error(error) => {
            note_error(error, counters, losses);
            *condition = error.state().map_or(*condition, condition_of);
        }
    }
    None
}

/// Counts an error report, and the frame that the controller lost at least with it.
fn note_error(error: &ErrorFrame, counters: &mut BusState, losses: &mut Losses) {
    count(&mut counters.errors);
    if error.receive_overflow() {
        count(&mut counters.lost);
        losses.by_controller = losses.by_controller.saturating_add(1);
    }
}

/// Counts a frame that is no reply.
#[cold]
fn count_useless(counters: &mut BusState, role: FrameRole) {
    match role {
        FrameRole::Duplicate => count(&mut counters.duplicate),
        FrameRole::UnexpectedId => count(&mut counters.unexpected_id),
        FrameRole::Malformed => count(&mut counters.malformed),
        FrameRole::Answer | FrameRole::Late | FrameRole::Unprompted => {}
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
