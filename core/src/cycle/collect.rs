//! Waits for replies and reads them.

use super::Cycle;
use super::channel::{Batch, BusChannel, CanChannel};
use super::link::Polled;
use crate::drive::Received;
use motord_bus::{Duration, Instant, Readiness, Ready};
use motord_shared::limits::BUSES_MAX;

/// System calls for waiting and receiving in a cycle, beside those of busy polling: so many per bus, and so many more.
const CALLS_PER_BUS: usize = 3;
const CALLS_MORE: usize = 2;
/// Most reads of the open buses, or of the clock in one wait, should the clock not move.
const READS_MAX: usize = 1000;
/// So long after the expected reply time of a bus, replies that are a little late have come, too. To read it then is seldom in vain.
const OVERDUE: Duration = Duration::from_micros(20);

impl Cycle {
    /// Reads each serial line, and each bus on which a request of an earlier cycle is open: a reply must be judged before the next
    /// command to its motor is decided. One system call for each of them; bounded by motors and inboxes.
    pub(super) fn read_early(&mut self) {
        for bus in 0..self.channels.len() {
            if self.channels[bus].reads_early() {
                let now = self.clock.now();
                self.read(bus, now);
            }
        }
    }

    /// Waits from `now` for the replies to all open requests, at most until `deadline`. Returns the buses whose replies have not all
    /// come. System calls as in [`gather`](Self::gather), and if it `polls`, those of [`busy_poll`](Self::busy_poll), too.
    pub(super) fn collect(&mut self, now: Instant, deadline: Instant, polls: bool) -> Ready {
        let mut open = self.open_buses();
        if !open.any() {
            // A bus without an open request is read, too: its controller may be back, or frames with an unexpected id came.
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

    /// Sleeps until the last reply on the `open` buses may come, less the time by which this thread is woken late; then reads the
    /// buses again and again without a sleep, for as long as configured and at most until `deadline`: the last reply waits for no
    /// wake-up. Returns the buses whose replies have not all come. One sleep, and at most [`READS_MAX`] reads of each bus.
    fn busy_poll(&mut self, mut open: Ready, now: Instant, deadline: Instant) -> Ready {
        let earliest = self.last_of(open, CanChannel::earliest).min(deadline);
        let begun = self.sleep_towards(now, earliest, Duration::MAX);
        let until = deadline.min(begun + self.timing.busy_poll);
        let (mut ready, mut reads, mut now) = (None, 0, begun);
        for _ in 0..READS_MAX {
            reads += self.receive(ready, now) as u32;
            open = self.open_buses();
            now = self.clock.now();
            self.polled = Polled { time: now.since(begun), reads, in_vain: open.any() };
            if !open.any() || now >= until {
                break;
            }
            ready = Some(open);
        }
        self.backoff.observe(self.polled.in_vain);
        open
    }

    /// Reads the buses as the replies come that are `open`, at most until `deadline`, and once more where a reply may be unread then.
    /// Returns the buses whose replies have not all come. The first wait lasts for the expected reply time: waking for every single
    /// frame would cost more calls. At most [`CALLS_PER_BUS`] system calls per bus, and [`CALLS_MORE`].
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
                // Enough is left for a wait that ends with a read of each open bus, or only for the last sleep.
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

    /// Reads each bus but the lines from `now` on, in the order of the configuration. An `open` one is read when the last replies of all
    /// are `expected`, or [`OVERDUE`] after its own were, and the cycle stays awake until then: reads that find replies missing leave
    /// too few calls to wait for them. Returns how many were read. One system call for each of them; bounded by their inboxes, and by
    /// [`READS_MAX`] readings of the clock for each.
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

    /// Replies may have been left unread on an `open` bus, behind something else. No system call; the next read takes them.
    fn is_cut_short(&self, open: Ready) -> bool {
        let mut channels = self.channels.iter().enumerate();
        channels
            .any(|(bus, channel)| open.contains(bus) && channel.can().is_some_and(CanChannel::is_cut_short))
    }

    /// Sleeps from `now` until `time`, less the time by which this thread is usually woken late, but less at most `shorter`.
    /// Returns the time after it. At most one system call.
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

    /// Reads the clock from `now` until `time`, at most [`READS_MAX`] times. Returns the last reading.
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

    /// The last of these times of the buses that are `open`; [`Instant::ZERO`] when none is.
    fn last_of(&self, open: Ready, time: impl Fn(&CanChannel) -> Instant) -> Instant {
        let channels = self.channels.iter().enumerate().filter(|&(bus, _)| open.contains(bus));
        channels.filter_map(|(_, channel)| channel.can()).map(time).fold(Instant::ZERO, Instant::max)
    }

    /// Waits until something arrives on an `open` bus, at most until `until`. Returns the buses that are worth reading. One
    /// system call.
    fn wait(&mut self, open: Ready, until: Instant) -> Ready {
        let mut readiness = [Readiness::Never; BUSES_MAX];
        for (bus, (readiness, channel)) in readiness.iter_mut().zip(&self.channels).enumerate() {
            let channel = channel.can().filter(|_| open.contains(bus));
            *readiness = channel.map_or(Readiness::Never, CanChannel::readiness);
        }
        self.clock.wait(&readiness[..self.channels.len().min(BUSES_MAX)], until)
    }

    /// The buses with an open request whose reply this cycle awaits. Bounded by buses.
    fn open_buses(&self) -> Ready {
        Ready::of(self.channels.iter().map(|channel| channel.can().is_some_and(CanChannel::is_open)))
    }

    /// Reads the buses that are `ready` at `now`, or all when that is not known, but never a line. Returns how many were read. One
    /// system call for each of them; bounded by their inboxes.
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

    /// Reads one bus, and draws the consequences. One system call; bounded by its inbox.
    fn read(&mut self, bus: usize, now: Instant) {
        let Self { channels, drives, control, .. } = self;
        let channel = &mut channels[bus];
        let judge = |motor: usize, payload: Option<&[u8]>, at| {
            let drive = &mut drives[motor];
            let received = match payload {
                Some(payload) => drive.receive(payload, at),
                None => drive.refuse(),
            };
            match &received {
                Received::Reply(reported) => control.receive(motor, reported, at),
                Received::Duplicate => control.receive_duplicate(motor),
                Received::UnexpectedId | Received::Malformed => {}
            }
            received
        };
        match channel {
            BusChannel::Can(can) => {
                if !can.receive(now, judge) {
                    can.settle(drives);
                }
            }
            BusChannel::Line(line) => line.receive(now, judge),
        }
        control.bus_changed(bus, channel.wire().condition());
    }

    /// Asks at most one motor of each bus but lines for its faults or an indicator, if the bus is not `open`, and if request
    /// and reply still fit before `end`, the next tick. Waits for the replies at most until `end`. One system call per bus that
    /// is asked, and those of [`collect`](Self::collect).
    pub(super) fn ask(&mut self, open: Ready, end: Instant) {
        let now = self.clock.now();
        let mut asked = false;
        for bus in 0..self.channels.len() {
            let Some(channel) = self.channels[bus].can() else { continue };
            if open.contains(bus) || now + channel.question_time() > end {
                continue;
            }
            let Some((motor, question)) = self.control.question(bus) else { continue };
            let Self { channels, drives, .. } = self;
            let Some(channel) = channels[bus].can_mut() else { continue };
            channel.begin(Batch::Question, now);
            channel.wire.queue(motor, drives[motor].request(&question, now));
            channel.send(now, |motor| drives[motor].withdraw());
            asked = true;
        }
        if asked {
            // Those that are still open are overdue: only the replies to these questions are waited for.
            let overdue = self.channels.iter_mut().enumerate().filter(|&(bus, _)| open.contains(bus));
            overdue.filter_map(|(_, channel)| channel.can_mut()).for_each(|channel| channel.give_up(end));
            // No client waits for these replies, so the buses are not polled for them.
            self.collect(now, end, false);
        }
    }
}
