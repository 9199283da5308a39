//! A CAN bus in the cycle: which replies the cycle waits for, and for how long.

use super::base::{Arrivals, ChannelBase};
use crate::drive::{Drive, LATEST_REPLY};
use motord_bus::{Duration, Inbox, Instant, Readiness, ReplyTime};
use motord_settings::plan::BusPlan;

/// A CAN bus.
pub(crate) struct CanChannel {
    pub(crate) base: ChannelBase,
    /// Each read takes everything that has arrived: not every motor gets a command in every cycle,
    /// or a sensor sends frames.
    reads_all: bool,
    /// Requests of the last batch that are not answered.
    awaited: usize,
    /// Until this time, a late reply may arrive ahead of the reply to a request.
    unsettled_until: Instant,
    /// The last read was full and replies are missing: they may be unread.
    is_cut_short: bool,
    /// A motor without a frame in this batch may owe the reply to an earlier one.
    may_be_late: bool,
    sent_at: Instant,
    batch: Batch,
    /// Index of the last batch in `expected`.
    slot: usize,
    /// Separate for batches with different numbers of frames: a probed, an excluded or a waiting
    /// motor makes a difference of a command and its reply. The first is that of questions.
    expected: Vec<ReplyTime>,
    /// Most time from the sending of a question to its reply.
    question_time: Duration,
}

/// The kind of frames that are sent together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Batch {
    /// At most one command per motor, and requests to sensors. Most are answered.
    Commands,
    /// A question to one motor, for its faults or an indicator.
    Question,
}

impl CanChannel {
    /// Allocates; nothing after it does.
    pub(super) fn new(base: ChannelBase, reads_all: bool, plan: &BusPlan) -> Self {
        let least = |frames: usize| ReplyTime::new(plan.transaction_least * frames as u32);
        Self {
            expected: base.batches().map(|frames| least(frames.max(1))).collect(),
            base,
            reads_all,
            awaited: 0,
            unsettled_until: Instant::ZERO,
            is_cut_short: false,
            may_be_late: false,
            sent_at: Instant::ZERO,
            batch: Batch::Commands,
            slot: 0,
            question_time: plan.question,
        }
    }

    /// Begins a batch without frames, to be sent at `now`. A reply to the last one that has not
    /// arrived may still do so.
    #[inline]
    pub(crate) fn begin(&mut self, batch: Batch, now: Instant) {
        self.give_up(now);
        self.batch = batch;
        self.base.clear();
    }

    /// Ends the wait for the replies to the last batch, before another one is sent at `now` or
    /// later.
    pub(crate) fn give_up(&mut self, now: Instant) {
        if self.awaited > 0 {
            self.unsettle(now);
            self.awaited = 0;
            self.may_be_late = true;
        }
    }

    /// Sends the queued frames, as [`ChannelBase::send`] does. Returns whether the bus accepted
    /// all. At most one system call.
    #[inline]
    pub(crate) fn send(&mut self, now: Instant, unsent: impl FnMut(usize)) -> bool {
        self.sent_at = now;
        self.slot = if self.batch == Batch::Question { 0 } else { self.base.batch() };
        let accepted = self.base.send(now, unsent);
        self.awaited = accepted.awaited;
        accepted.accepted_all
    }

    pub(super) fn withhold(&mut self, unsent: impl FnMut(usize)) -> bool {
        self.base.withhold(unsent).accepted_all
    }

    /// Returns when all replies to this batch are expected to have arrived.
    #[inline]
    pub(crate) fn expected(&self) -> Instant {
        self.sent_at + self.expected[self.slot].latest()
    }

    /// Returns the time before which the last reply to this batch rarely arrives.
    pub(crate) fn earliest(&self) -> Instant {
        self.sent_at + self.expected[self.slot].earliest()
    }

    /// Records that every reply to this batch has arrived, and adapts the expected reply time.
    #[inline]
    pub(crate) fn complete(&mut self) {
        if !self.base.is_idle() {
            self.expected[self.slot].observe(self.base.replied_at().since(self.sent_at));
        }
    }

    /// Returns whether the cycle waits for a reply to the last batch. It does not wait for offline
    /// motors between their probes.
    #[inline]
    pub(crate) const fn is_open(&self) -> bool {
        self.awaited > 0
    }

    /// Returns whether a request of an earlier cycle may still be answered. If so, the next read
    /// takes everything that has arrived.
    pub(super) const fn reads_early(&mut self) -> bool {
        self.is_cut_short |= self.may_be_late;
        self.may_be_late
    }

    /// Returns how to wait for the bus. No system call.
    pub(crate) fn readiness(&self) -> Readiness<'_> {
        self.base.readiness()
    }

    /// Returns the most time from the sending of a question to its reply.
    pub(crate) const fn question_time(&self) -> Duration {
        self.question_time
    }

    /// For [`LATEST_REPLY`] every request was answered in its cycle, and nothing else arrived: no
    /// reply is late.
    const fn is_settled(&self) -> bool {
        self.sent_at.as_nanos() > self.unsettled_until.as_nanos()
    }

    /// The most arrivals of the next read. While the bus is settled, they are the replies that are
    /// awaited: to check for one more costs the kernel as much as a third of a frame. Later
    /// arrivals are read with the next replies.
    const fn space(&self) -> usize {
        let reads_all = !self.is_settled() || self.is_cut_short || self.reads_all;
        if reads_all || self.awaited == 0 { Inbox::CAPACITY } else { self.awaited }
    }

    /// Returns whether an awaited reply may be unread, behind another arrival. The next read takes
    /// all.
    pub(crate) const fn is_cut_short(&self) -> bool {
        self.is_cut_short
    }

    /// Prepares the next read: it takes as many arrivals as the cycle awaits, or an inbox full.
    #[inline]
    pub(super) fn begin_read(&mut self) {
        self.base.clear_inbox_for(self.space());
    }

    /// Checks what a read at `now` took. Returns whether the `arrivals` are awaited replies and
    /// nothing else; if not, [`settle`](Self::settle) follows.
    #[inline]
    pub(crate) fn record_read(&mut self, arrivals: Arrivals, now: Instant) -> bool {
        if arrivals.answers < arrivals.all {
            self.unsettle(now);
        } else if arrivals.answers <= self.awaited && !self.may_be_late && self.is_settled() {
            self.awaited -= arrivals.answers;
            self.is_cut_short = self.awaited > 0 && self.base.is_read_full();
            return true;
        }
        false
    }

    /// Finds the requests of the last batch that are still open after a read. Bounded by the motors
    /// of the bus.
    #[cold]
    pub(crate) fn settle(&mut self, drives: &[Drive]) {
        let motors = self.base.senders().iter().filter(|&&motor| drives[motor].is_open()).count();
        self.awaited = motors + self.base.open_requests();
        self.is_cut_short = self.base.is_read_full() && self.awaited > 0;
        self.may_be_late = self.base.others().any(|motor| drives[motor].is_open());
    }

    /// Something other than an answer arrived by `now`, or a request is sent then and the one
    /// before has no answer.
    fn unsettle(&mut self, now: Instant) {
        self.unsettled_until = self.unsettled_until.max(now + LATEST_REPLY);
    }
}
