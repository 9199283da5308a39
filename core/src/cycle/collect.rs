//! Waits for replies and reads them.

use super::Cycle;
use super::channel::{Batch, CanChannel, FrameRole};
use super::link::Polled;
use super::pass_condition;
use crate::control::Control;
use crate::drive::{Drive, Received};
use motord_bus::{Duration, Frame, Instant, Readiness, Ready};
use motord_protocol::drive::Reported;
use motord_shared::limits::BUSES_MAX;

/// Most system calls for waiting and receiving in a cycle, without those of busy polling: this many
/// per CAN bus, plus [`CALLS_MORE`]. After the first sleep and a read of each of n buses without a
/// reply, they permit a wait, a read of each, and the same again at the deadline: 2n + 2.
const CALLS_PER_BUS: usize = 3;
const CALLS_MORE: usize = 3;
/// Most reads of the open buses, or of the clock in one wait, if the clock does not advance.
const READS_MAX: usize = 1000;
/// This long after the expected reply time of a bus nearly all late replies have arrived.
const OVERDUE: Duration = Duration::from_micros(20);

impl Cycle {
    /// Reads each line, and each bus with an open request of an earlier cycle: a reply must be
    /// checked before the next command to its motor is decided. One system call for each; bounded
    /// by motors and inboxes.
    pub(super) fn read_early(&mut self) {
        for bus in 0..self.channels.len() {
            if self.channels[bus].reads_early() {
                let now = self.clock.now();
                self.read(bus, now);
            }
        }
    }

    /// Waits from `now` for the replies to all open requests, at most until `deadline`. Returns the
    /// buses with missing replies. System calls as in [`gather`](Self::gather). If it `polls`,
    /// those of [`busy_poll`](Self::busy_poll) are added.
    pub(super) fn collect(&mut self, now: Instant, deadline: Instant, polls: bool) -> Ready {
        let mut open = self.open_buses();
        if !open.any() {
            // Also reads buses without an open request: a controller may have recovered, or frames
            // with an unexpected id may have arrived.
            self.receive(None, now);
            return open;
        }
        if polls {
            open = self.busy_poll(open, now, deadline);
        }
        if open.any() {
            open = self.gather(open, now, deadline);
        }
        for (bus, channel) in self.channels.iter_mut().enumerate() {
            if let Some(channel) = channel.can_mut().filter(|_| !open.contains(bus)) {
                channel.complete();
            }
        }
        open
    }

    /// Sleeps until the last reply on the `open` buses may arrive, less the usual lateness of
    /// wake-ups. Then reads the buses repeatedly without a sleep, for the configured time and at
    /// most until `deadline`. Returns the buses with missing replies. One sleep, and at most
    /// [`READS_MAX`] reads of each bus.
    fn busy_poll(&mut self, mut open: Ready, now: Instant, deadline: Instant) -> Ready {
        let earliest = self.last_of(open, CanChannel::earliest).min(deadline);
        let begun = self.sleep_towards(now, earliest, Duration::MAX);
        let until = deadline.min(begun + self.timing.busy_poll);
        let (mut ready, mut reads, mut now) = (None, 0, begun);
        for _ in 0..READS_MAX {
            reads += self.receive(ready, now) as u32;
            open = self.open_buses();
            now = self.clock.now();
            self.polled = Polled { time: now.since(begun), reads, is_incomplete: open.any() };
            if !open.any() || now >= until {
                break;
            }
            ready = Some(open);
        }
        self.backoff.observe(self.polled.is_incomplete);
        open
    }

    /// Reads the `open` buses as replies arrive, at most until `deadline`, and once more where a
    /// reply may be unread then. Returns the buses with missing replies. The first wait lasts for
    /// the expected reply time: waking for every frame would cost more calls. At most
    /// [`CALLS_PER_BUS`] system calls per CAN bus, plus [`CALLS_MORE`].
    fn gather(&mut self, mut open: Ready, now: Instant, deadline: Instant) -> Ready {
        let buses = self.channels.len() - self.lines.len();
        let expected = self.last_of(open, CanChannel::expected).min(deadline);
        let woken = self.sleep_towards(now, expected, self.timing.awake);
        let mut calls = CALLS_PER_BUS * buses + CALLS_MORE - 1;
        let mut read = self.receive_expected(open, woken, expected);
        loop {
            calls = calls.saturating_sub(read);
            open = self.open_buses();
            if !open.any() || calls == 0 {
                return open;
            }
            let (mut ready, mut now) = (open, self.clock.now());
            // A last sleep, and a read of each open bus after it.
            let last = 1 + open.count();
            let kept = if now < deadline { last } else { 0 };
            let reads_on = self.is_cut_short(open) && calls >= open.count() + kept;
            if !reads_on {
                if now >= deadline {
                    return open;
                }
                // Enough is left for a wait that ends with a read of each open bus, or only for the
                // last sleep.
                match calls >= 2 * last {
                    true => ready = self.wait(open, deadline),
                    false => self.clock.sleep_until(deadline),
                }
                calls = calls.saturating_sub(1);
                now = self.clock.now();
            }
            read = self.receive(Some(ready), now);
        }
    }

    /// Reads each bus but the lines from `now` on, in the order of the configuration. An `open` one
    /// is read when the last replies of all are `expected`, or [`OVERDUE`] after its own were, and
    /// the cycle stays awake until then: reads that find replies missing leave too few calls to
    /// wait for them. Returns how many were read. One system call for each of them; bounded by
    /// their inboxes, and by [`READS_MAX`] readings of the clock for each.
    fn receive_expected(&mut self, open: Ready, mut now: Instant, expected: Instant) -> usize {
        let mut read = 0;
        for bus in 0..self.channels.len() {
            let Some(channel) = self.channels[bus].can() else { continue };
            if open.contains(bus) {
                now = self.stay_awake(now, expected.min(channel.expected() + OVERDUE));
            }
            read += 1;
            self.read(bus, now);
        }
        read
    }

    /// Returns whether replies may be unread on an `open` bus, behind other arrivals. No system
    /// call; the next read takes them.
    fn is_cut_short(&self, open: Ready) -> bool {
        let mut channels = self.channels.iter().enumerate();
        channels
            .any(|(bus, channel)| open.contains(bus) && channel.can().is_some_and(CanChannel::is_cut_short))
    }

    /// Sleeps from `now` until `time`, less the usual lateness of wake-ups, which is limited to
    /// `shorter`. Returns the time after it. At most one system call.
    fn sleep_towards(&mut self, now: Instant, time: Instant, shorter: Duration) -> Instant {
        let due = time - self.reply_lateness.expected().min(shorter);
        if due <= now {
            return now;
        }
        self.clock.sleep_until(due);
        let woken = self.clock.now();
        self.reply_lateness.observe(due, woken);
        woken
    }

    /// Reads the clock from `now` until `time`, at most [`READS_MAX`] times. Returns the last
    /// reading.
    pub(super) fn stay_awake(&self, mut now: Instant, time: Instant) -> Instant {
        for _ in 0..READS_MAX {
            if now >= time {
                break;
            }
            std::hint::spin_loop();
            now = self.clock.now();
        }
        now
    }

    /// Returns the last of these times of the `open` buses; [`Instant::ZERO`] without one.
    fn last_of(&self, open: Ready, time: impl Fn(&CanChannel) -> Instant) -> Instant {
        let channels = self.channels.iter().enumerate().filter(|&(bus, _)| open.contains(bus));
        channels.filter_map(|(_, channel)| channel.can()).map(time).fold(Instant::ZERO, Instant::max)
    }

    /// Waits until a frame arrives on an `open` bus, at most until `until`. Returns the buses to
    /// read. One system call.
    fn wait(&mut self, open: Ready, until: Instant) -> Ready {
        let mut readiness = [Readiness::Never; BUSES_MAX];
        for (bus, (readiness, channel)) in readiness.iter_mut().zip(&self.channels).enumerate() {
            let channel = channel.can().filter(|_| open.contains(bus));
            *readiness = channel.map_or(Readiness::Never, CanChannel::readiness);
        }
        self.clock.wait(&readiness[..self.channels.len().min(BUSES_MAX)], until)
    }

    /// Returns the buses with an open request whose reply this cycle waits for. Bounded by buses.
    fn open_buses(&self) -> Ready {
        Ready::of(self.channels.iter().map(|channel| channel.can().is_some_and(CanChannel::is_open)))
    }

    /// Reads the buses that are `ready` at `now`, or all when that is not known, but never a line.
    /// Returns how many were read. One system call for each of them; bounded by their inboxes.
    fn receive(&mut self, ready: Option<Ready>, now: Instant) -> usize {
        let mut read = 0;
        for bus in 0..self.channels.len() {
            if self.channels[bus].can().is_none() || ready.is_some_and(|ready| !ready.contains(bus)) {
                continue;
            }
            read += 1;
            self.read(bus, now);
        }
        read
    }

    /// Reads one bus, and passes the replies to control. One system call; bounded by its inbox.
    fn read(&mut self, bus: usize, now: Instant) {
        let Self { channels, drives, control, .. } = self;
        let channel = &mut channels[bus];
        let classify = |motor: usize, frame: Option<&Frame>, at| {
            let drive = &mut drives[motor];
            if let Some(state) = frame.and_then(|frame| drive.receive_state(frame, at)) {
                control.receive_state(motor, state, at);
                return FrameRole::Answer;
            }
            receive_other(control, drive, motor, frame, at)
        };
        let arrivals = channel.receive(now, classify);
        if let Some(can) = channel.can_mut()
            && !can.record_read(arrivals, now)
        {
            can.settle(drives);
        }
        let foreign = channel.base_mut().foreign();
        if foreign.is_any() {
            foreign.take(|id, motor, frames| control.receive_foreign(motor, id, frames, now));
        }
        let losses = channel.base_mut().take_losses();
        if losses.any() {
            control.frames_lost(bus, losses, now);
        }
        pass_condition(bus, channel, control);
    }

    /// Asks at most one motor of each bus but lines for its faults, an indicator or its supply, if the
    /// bus is not `open`, and if the reply is still expected before the next `tick`. Waits for the
    /// replies at most until the sleep for the tick should end. One system call per bus that is asked,
    /// and those of [`collect`](Self::collect).
    pub(super) fn ask(&mut self, open: Ready, tick: Instant) {
        let (now, end) = (self.clock.now(), tick - self.early());
        let mut asked = false;
        for bus in 0..self.channels.len() {
            let Some(channel) = self.channels[bus].can() else { continue };
            if open.contains(bus) || now + channel.question_time() > tick {
                continue;
            }
            let Some((motor, question)) = self.control.question(bus) else { continue };
            let Self { channels, drives, .. } = self;
            let Some(channel) = channels[bus].can_mut() else { continue };
            channel.begin(Batch::Question, now);
            channel.base.queue(motor, |frame| drives[motor].write_request(&question, now, frame));
            channel.send(now, |motor| drives[motor].withdraw());
            asked = true;
        }
        if asked {
            // Open requests are overdue: the cycle waits only for the replies to these
            // questions.
            let overdue = self.channels.iter_mut().enumerate().filter(|&(bus, _)| open.contains(bus));
            overdue.filter_map(|(_, channel)| channel.can_mut()).for_each(|channel| channel.give_up(end));
            // No client waits for these replies, so the cycle does not poll for them.
            self.collect(now, end, false);
        }
    }
}

/// Reads a frame of a motor, or `None` for a request that it refused, and passes a reply to control.
/// Returns its role. Uses the ends of the codes that a motor reports.
#[inline(never)]
fn receive_other(
    control: &mut Control,
    drive: &mut Drive,
    motor: usize,
    frame: Option<&Frame>,
    at: Instant,
) -> FrameRole {
    let was_open = drive.is_open();
    let received = match frame {
        Some(frame) => drive.receive(frame, at),
        None => drive.refuse(),
    };
    match received {
        Received::Reply(reported) => {
            control.receive(motor, &reported, at);
            if let Reported::Register(..) | Reported::LateRegister(..) = reported
                && let Some(ends) = control.reported_ends(motor)
            {
                drive.use_ends(ends);
            }
            if reported == Reported::Unprompted {
                return FrameRole::Unprompted;
            }
            let is_late = matches!(reported, Reported::Late | Reported::LateRegister(..));
            // A reply that did not close the open request answers an earlier one.
            if is_late || !was_open || drive.is_open() { FrameRole::Late } else { FrameRole::Answer }
        }
        Received::Duplicate => {
            control.receive_duplicate(motor);
            FrameRole::Duplicate
        }
        Received::UnexpectedId => FrameRole::UnexpectedId,
        Received::Malformed => FrameRole::Malformed,
    }
}
