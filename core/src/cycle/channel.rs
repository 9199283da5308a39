//! One bus in the cycle: the frames sent on it, the motors that reply there, and the counters.
//!
//! Real-time: after [`BusChannel::new`] nothing here allocates or blocks; every loop is bounded by the motors of the bus
//! or by one inbox.

use crate::control::Reported;
use crate::drive::{Drive, LATEST_REPLY, Received};
use crate::plan::BusPlan;
use crate::settings::{MotorSettings, Settings};
use crate::stopper::{LineRound, Outlet};
use motord_bus::frame::ControllerState;
use motord_bus::{
    Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Readiness, Refusal, ReplyTime, Sent,
};
use motord_shared::{BusCondition, BusState};

/// A bus, and everything the cycle knows of it.
pub(super) struct BusChannel {
    bus: Box<dyn Bus>,
    pace: Pace,
    line_round: LineRound,
    /// Id of the arrivals of a motor, and the motor, in the order of the configuration.
    routes: Vec<(FrameId, usize)>,
    frames: Vec<Frame>,
    senders: Vec<usize>,
    inbox: Inbox,
    /// Requests of the last batch that are not answered.
    awaited: usize,
    /// A late reply may come before the reply to a request that is sent until then.
    unsettled_until: Instant,
    /// The last read took as many arrivals as replies were awaited, but not every one was a reply: the others may be unread.
    is_cut_short: bool,
    /// A motor that has no frame in this batch may not have answered an earlier one.
    owes: bool,
    counters: BusState,
    condition: BusCondition,
    sent_at: Instant,
    replied_at: Instant,
    batch: Batch,
    /// By [`Batch`].
    expected: [ReplyTime; 2],
    /// How long a fault request and its reply take on the wire at worst.
    poll_time: Duration,
}

/// When the motors of a bus are asked, and when their replies come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pace {
    /// All in every cycle, which waits for their replies.
    EachCycle,
    /// Some in every cycle, which waits for the replies of these.
    InTurns,
    /// A serial line: one request at a time, and its reply may come in a later cycle.
    Line,
}

/// The kind of frames that are sent together. Each kind has its own expected reply time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Batch {
    /// One command per motor. Most are answered with a state.
    Commands,
    /// A question to one motor, for its faults or an indicator.
    FaultRequest,
}

impl BusChannel {
    /// `index` is that of the bus in `settings`. Allocates.
    pub(super) fn new(bus: Box<dyn Bus>, index: usize, settings: &Settings, plan: &BusPlan) -> Self {
        let pace = match settings.buses[index].every {
            _ if settings.buses[index].is_line() => Pace::Line,
            0 | 1 => Pace::EachCycle,
            _ => Pace::InTurns,
        };
        let motors = settings.motors.iter().enumerate().filter(|(_, motor)| motor.bus == index);
        // A frame on a line names its receiver only, so a serial bus names the motor that answers.
        let id_of = |motor: &MotorSettings| match pace {
            Pace::Line => motor.command_id(),
            Pace::EachCycle | Pace::InTurns => motor.host_id,
        };
        let routes: Vec<_> = motors.map(|(motor, settings)| (id_of(settings), motor)).collect();
        Self {
            bus,
            pace,
            line_round: LineRound::default(),
            frames: Vec::with_capacity(routes.len()),
            senders: Vec::with_capacity(routes.len()),
            routes,
            inbox: Inbox::new(),
            awaited: 0,
            unsettled_until: Instant::ZERO,
            is_cut_short: false,
            owes: false,
            counters: BusState::default(),
            condition: BusCondition::Active,
            sent_at: Instant::ZERO,
            replied_at: Instant::ZERO,
            batch: Batch::Commands,
            expected: [plan.expected, plan.transaction_least].map(ReplyTime::new),
            poll_time: plan.transaction_worst,
        }
    }

    /// Replaces a bus that is gone by one that was opened again, and returns the old one: closing it may block.
    pub(super) fn replace(&mut self, bus: Box<dyn Bus>) -> Box<dyn Bus> {
        self.condition = BusCondition::Active;
        std::mem::replace(&mut self.bus, bus)
    }

    /// Begins a batch without frames, to be sent at `now`. A reply to the last one that has not come may still do so.
    pub(super) fn begin(&mut self, batch: Batch, now: Instant) {
        self.give_up(now);
        self.batch = batch;
        self.frames.clear();
        self.senders.clear();
    }

    /// Waits no longer for the replies to the last batch, before another one is sent at `now` or later.
    pub(super) fn give_up(&mut self, now: Instant) {
        if self.awaited > 0 {
            self.unsettle(now);
            self.awaited = 0;
            self.owes = true;
        }
    }

    /// Begins a batch of commands with a frame for each motor that `command` has one for, to be sent at `now`.
    #[inline]
    pub(super) fn begin_commands(&mut self, now: Instant, mut command: impl FnMut(usize) -> Option<Frame>) {
        self.begin(Batch::Commands, now);
        for &(_, motor) in &self.routes {
            if let Some(frame) = command(motor) {
                self.frames.push(frame);
                self.senders.push(motor);
            }
        }
    }

    /// Adds the frame of a motor, if there is one. There is reserved space for one frame per motor of the bus.
    pub(super) fn queue(&mut self, motor: usize, frame: Option<Frame>) {
        if let Some(frame) = frame {
            self.frames.push(frame);
            self.senders.push(motor);
        }
    }

    /// Sends the queued frames; nothing to a bus that is off or gone. Frames that the bus does not accept are dropped and
    /// counted, and `unsent` is called with their motors. Returns whether the bus accepted all. At most one system call.
    pub(super) fn send(&mut self, now: Instant, unsent: impl FnMut(usize)) -> bool {
        self.sent_at = now;
        self.replied_at = now;
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
        self.account(sent.accepted, unsent)
    }

    /// Sends none of the queued frames, as if the bus had not accepted them. No system call.
    pub(super) fn withhold(&mut self, unsent: impl FnMut(usize)) -> bool {
        self.account(0, unsent)
    }

    #[inline]
    fn account(&mut self, accepted: usize, mut unsent: impl FnMut(usize)) -> bool {
        let accepted = accepted.min(self.frames.len());
        let dropped = self.frames.len() - accepted;
        self.awaited = accepted;
        self.senders[accepted..].iter().for_each(|&motor| unsent(motor));
        self.counters.sent = self.counters.sent.wrapping_add(accepted as u32);
        self.counters.dropped = self.counters.dropped.wrapping_add(dropped as u32);
        dropped == 0
    }

    /// When all replies to this batch are expected to have arrived.
    #[inline]
    pub(super) fn expected(&self) -> Instant {
        self.sent_at + self.expected[self.batch as usize].latest()
    }

    /// Before it the last reply to this batch seldom arrives.
    pub(super) fn earliest(&self) -> Instant {
        self.sent_at + self.expected[self.batch as usize].earliest()
    }

    /// Every reply to this batch has arrived: learns how long that takes.
    #[inline]
    pub(super) fn complete(&mut self) {
        if !self.frames.is_empty() {
            self.expected[self.batch as usize].observe(self.replied_at.since(self.sent_at));
        }
    }

    /// The cycle waits for a reply to the last batch; never on a line. A motor that is seldom asked, since it does not answer, is not
    /// waited for in between.
    #[inline]
    pub(super) const fn is_open(&self) -> bool {
        self.awaited > 0 && !self.is_line()
    }

    /// A motor may still answer that is not waited for: one that was lost, and is asked only now and then.
    pub(super) const fn owes(&self) -> bool {
        self.owes
    }

    /// A serial line: read when a cycle begins, and written to after the other buses.
    pub(super) const fn is_line(&self) -> bool {
        matches!(self.pace, Pace::Line)
    }

    /// No frame is queued.
    pub(super) fn is_idle(&self) -> bool {
        self.frames.is_empty()
    }

    /// How to wait for the bus. No system call.
    pub(super) fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }

    /// How long a fault request and its reply take on the wire at worst.
    pub(super) const fn poll_time(&self) -> Duration {
        self.poll_time
    }

    /// The condition of the bus as of its last report or refusal.
    pub(super) const fn condition(&self) -> BusCondition {
        self.condition
    }

    /// The counters and the condition, as they are published.
    #[inline]
    pub(super) const fn report(&self) -> BusState {
        BusState { condition: self.condition.code(), ..self.counters }
    }

    /// For [`LATEST_REPLY`] every request was answered in its cycle, and nothing else came: no reply is late.
    const fn is_settled(&self) -> bool {
        self.sent_at.as_nanos() > self.unsettled_until.as_nanos()
    }

    /// The most arrivals of the next read. While the bus is settled, they are the replies that are awaited: to look for one more, in
    /// vain, costs the kernel as much as a third of a frame. What has come behind them is read with the next replies.
    const fn space(&self) -> usize {
        let takes_all = !self.is_settled() || self.is_cut_short || !matches!(self.pace, Pace::EachCycle);
        if takes_all || self.awaited == 0 { Inbox::CAPACITY } else { self.awaited }
    }

    /// The next read takes all that there is.
    pub(super) const fn take_all(&mut self) {
        self.is_cut_short = true;
    }

    /// A reply that is awaited may be unread, behind something else. The next read takes all.
    pub(super) const fn is_cut_short(&self) -> bool {
        self.is_cut_short
    }

    /// Reads at most one inbox full, and gives every frame to the motor that it is from: its payload, or `None` for a request
    /// that the motor refused. Returns whether these are the awaited replies and nothing else; if not, [`settle`](Self::settle)
    /// follows. Bounded by the inbox times the motors of the bus; at most one system call.
    pub(super) fn receive(
        &mut self,
        now: Instant,
        mut judge: impl FnMut(usize, Option<&[u8]>, Instant) -> Received,
    ) -> bool {
        self.inbox.clear_for(self.space());
        self.bus.receive(now, &mut self.inbox);
        self.counters.lost = self.counters.lost.wrapping_add(self.inbox.lost);
        let Self { inbox, routes, counters, condition, replied_at, .. } = self;
        counters.received = counters.received.wrapping_add(inbox.arrivals().len() as u32);
        let mut answers = 0;
        for arrival in inbox.arrivals() {
            let (id, payload) = match &arrival.content {
                Content::Frame(frame) => (frame.id(), Some(frame.payload())),
                Content::Refused(id) => (*id, None),
                Content::Unsupported(_) => {
                    count(&mut counters.malformed);
                    continue;
                }
                Content::Error(error) => {
                    count(&mut counters.errors);
                    *condition = error.state().map_or(*condition, condition_of);
                    continue;
                }
            };
            let route = routes.iter().find(|(routed, _)| *routed == id);
            let received =
                route.map_or(Received::UnexpectedId, |&(_, motor)| judge(motor, payload, arrival.at));
            match received {
                Received::Reply(reported) => {
                    *replied_at = arrival.at;
                    answers += usize::from(!matches!(reported, Reported::Late));
                }
                Received::Duplicate => count(&mut counters.duplicate),
                Received::UnexpectedId => count(&mut counters.unexpected_id),
                Received::Malformed => count(&mut counters.malformed),
            }
        }
        let arrivals = inbox.arrivals().len();
        if answers < arrivals {
            self.unsettle(now);
        } else if answers == self.awaited && !self.owes && self.is_settled() {
            (self.awaited, self.is_cut_short) = (0, false);
            return true;
        }
        false
    }

    /// Looks which requests of the last batch are still open after a read. Bounded by the motors of the bus.
    #[cold]
    pub(super) fn settle(&mut self, drives: &[Drive]) {
        self.awaited = self.senders.iter().filter(|&&motor| drives[motor].is_open()).count();
        let is_full = self.inbox.free() == 0 && self.inbox.arrivals().len() < Inbox::CAPACITY;
        self.is_cut_short = is_full && self.awaited > 0;
        let owes = |motor: &usize| drives[*motor].is_open() && !self.senders.contains(motor);
        self.owes =
            self.senders.len() < self.routes.len() && self.routes.iter().any(|(_, motor)| owes(motor));
    }

    /// Something else than an answer came by `now`, or a request is sent then and the one before has no answer.
    fn unsettle(&mut self, now: Instant) {
        self.unsettled_until = self.unsettled_until.max(now + LATEST_REPLY);
    }
}

impl Outlet for BusChannel {
    /// Discards what has arrived, then sends frames whose replies nobody waits for; on a line one of them. At most two
    /// system calls.
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        self.inbox.clear();
        self.bus.receive(now, &mut self.inbox);
        match self.pace {
            Pace::Line => self.line_round.send(frames, |frame| self.bus.send(now, frame).refusal),
            Pace::EachCycle | Pace::InTurns => self.bus.send(now, frames).refusal,
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
