//! One cycle: wake, decide, transmit, collect, publish.
//!
//! The functions here run in the real-time thread. After [`assemble`] none allocates, locks or logs, every loop is
//! bounded by motors, buses or an inbox, and none returns early: that a motor is silent is data for a later phase. System
//! calls of a cycle: one sleep, one send per bus, and for waiting and receiving at most three further calls per bus, and two. On
//! top come a read of each line and of each bus on which a request of an earlier cycle is open; busy polling, where configured:
//! one sleep, and the reads that [`Polled`] counts; and questions: one send per bus that is asked, and the calls for its reply.

mod assemble;
mod channel;
mod emergency;
mod history;
mod link;
mod local;
mod replacement;
mod report;
mod run;

pub use assemble::assemble;
pub use emergency::{EmergencyStops, StopRequest};
pub use history::History;
pub use link::{Alarms, Counters, Ends, Link, Polled, REQUESTS_MAX, Record, link};
pub use local::LocalClient;
pub use replacement::Supply;
pub use run::Order;

use crate::clock::Clock;
use crate::control::{Control, Wake};
use crate::drive::{Drive, Received};
use crate::plan::BusPlan;
use crate::settings::{BusKind, Settings};
use crate::stopper::{BusFrames, Stopper};
use channel::{Batch, BusChannel};
use motord_bus::time::nanos;
use motord_bus::{Backoff, Bus, Duration, Instant, Lateness, Readiness, Ready};
use motord_shared::limits::{ADMINS_MAX, BUSES_MAX, REQUESTS_PER_CLIENT};

/// Most requests answered in one cycle: all that the clients may have under way, so an emergency stop does not wait behind
/// those of others.
const REQUESTS_PER_CYCLE: usize = ADMINS_MAX * REQUESTS_PER_CLIENT;
/// System calls for waiting and receiving in a cycle, beside those of busy polling: so many per bus, and so many more.
const CALLS_PER_BUS: usize = 3;
const CALLS_MORE: usize = 2;
/// Most reads of the open buses, or of the clock in one wait, should the clock not move.
const READS_MAX: usize = 1000;
/// The longest time for which a cycle stays awake for its tick, or for expected replies if it does not poll.
const AWAKE_MAX: Duration = Duration::from_micros(50);
/// [`AWAKE_MAX`] is cut to the period divided by this.
const PERIODS_PER_AWAKE: u32 = 20;
/// So long after the expected reply time of a bus, replies that are a little late have come, too. To read it then is seldom in vain.
const OVERDUE: Duration = Duration::from_micros(20);

/// Everything the real-time thread owns.
pub struct Cycle {
    clock: Box<dyn Clock + Send>,
    timing: Timing,
    channels: Vec<BusChannel>,
    drives: Vec<Drive>,
    /// The buses that are serial lines.
    lines: Vec<usize>,
    control: Control,
    link: Link,
    stopper: Stopper,
    missed_ticks: u64,
    /// How late the sleeps for ticks end.
    tick_lateness: Lateness,
    /// How late the sleeps for replies end.
    reply_lateness: Lateness,
    backoff: Backoff,
    polled: Polled,
    boot_id: u64,
    realtime: bool,
}

/// The configured times of a cycle.
#[derive(Debug, Clone, Copy)]
struct Timing {
    /// From tick to tick.
    period: Duration,
    /// How long a safe stop damps at most.
    damp: Duration,
    /// From the sending of the commands to the time when replies count as missed.
    reply_deadline: Duration,
    /// Commands are stale so long after their cycle began: the dead man's switch may have acted by then, or the cycle lost its
    /// time base.
    stale_after: Duration,
    /// Time for which the buses are polled for the last replies of a cycle, without a sleep.
    busy_poll: Duration,
    /// The longest time for which a cycle stays awake for its tick, or for expected replies if it does not poll.
    awake: Duration,
}

impl Timing {
    fn new(settings: &Settings) -> Self {
        Self {
            period: settings.cycle.period,
            damp: settings.safety.damp,
            reply_deadline: settings.cycle.reply_deadline,
            stale_after: settings.cycle.max_lateness.min(settings.safety.deadman),
            busy_poll: settings.cycle.busy_poll,
            awake: longest_awake(settings),
        }
    }
}

/// The longest time for which a cycle stays awake. On a single processor half of the lead is left to the ipc thread, which fetches the
/// setpoints before the tick.
fn longest_awake(settings: &Settings) -> Duration {
    let has_others = std::thread::available_parallelism().is_ok_and(|processors| processors.get() > 1);
    let lead = if has_others { Duration::MAX } else { settings.ipc.lead / 2 };
    AWAKE_MAX.min(settings.cycle.period / PERIODS_PER_AWAKE).min(lead)
}

impl Cycle {
    /// A cycle that has not run yet. `buses` and `plans` are in the order of the configuration. Allocates; nothing after
    /// it does.
    fn new(
        settings: &Settings,
        plans: &[BusPlan],
        buses: Vec<Box<dyn Bus>>,
        clock: Box<dyn Clock + Send>,
        link: Link,
        boot_id: u64,
    ) -> Self {
        let drives = settings.motors.iter().map(|motor| {
            Drive::new(motor, fastest_reply(settings, plans, motor.bus), settings.safety.error_feedback)
        });
        let channels = buses
            .into_iter()
            .enumerate()
            .map(|(index, bus)| BusChannel::new(bus, index, settings, &plans[index]));
        let frames = (0..settings.buses.len()).map(|bus| BusFrames::of(settings, bus));
        Self {
            clock,
            timing: Timing::new(settings),
            channels: channels.collect(),
            drives: drives.collect(),
            lines: (0..settings.buses.len()).filter(|&bus| settings.buses[bus].is_line()).collect(),
            control: Control::new(settings, boot_id),
            link,
            stopper: Stopper::new(frames, settings.safety.damp),
            missed_ticks: 0,
            tick_lateness: Lateness::default(),
            reply_lateness: Lateness::default(),
            backoff: Backoff::default(),
            polled: Polled::default(),
            boot_id,
            realtime: false,
        }
    }

    /// `begun` is called at the beginning of every cycle with its number. It must not allocate or block, and makes no system
    /// call.
    pub fn on_begin(&mut self, begun: impl Fn(u64) + Send + 'static) {
        self.link.on_begin(begun);
    }

    /// `published` is called in every cycle once its states are published. It must not allocate or block, and makes at most
    /// one system call.
    pub fn on_publish(&mut self, published: impl Fn() + Send + 'static) {
        self.link.on_publish(published);
    }

    /// Tells clients whether this thread has real-time scheduling and locked memory.
    pub const fn set_realtime(&mut self, realtime: bool) {
        self.realtime = realtime;
    }

    /// The decisions, for tests.
    #[must_use]
    pub const fn control(&self) -> &Control {
        &self.control
    }

    /// Damps and stops everything, for good; [`is_disarmed`](Self::is_disarmed) is true when it has. An alarm that waits is
    /// latched as the cause instead of the shutdown.
    pub fn shut_down(&mut self) {
        self.heed_alarms();
        self.control.shut_down();
    }

    /// Stops every motor without damping it first.
    pub fn stop_now(&mut self) {
        self.control.stop_now();
    }

    /// Damps and stops every motor after a panic in [`run`](Self::run), by frames that were made beforehand. It trusts
    /// nothing of the cycle but its buses and its clock; the cycle must not be run again.
    pub fn stop_after_panic(&mut self) {
        self.stopper.run(&mut *self.clock, &mut self.channels);
    }

    /// The motors that were started and have not answered a stop since.
    pub fn unstopped(&self) -> impl Iterator<Item = usize> {
        self.control.unstopped()
    }

    /// Every group is disarmed: every motor that can be reached is commanded to stop.
    #[must_use]
    pub fn is_disarmed(&self) -> bool {
        self.control.is_disarmed()
    }

    /// Sleeps until `tick`, runs its cycle, and returns the next tick. Ticks that have passed meanwhile are missed: no
    /// burst of cycles makes up for them, and the cycle bears the number of the latest tick that has passed.
    ///
    /// Real-time: does not allocate; blocks only in the clock, at most until the replies are overdue.
    pub fn run(&mut self, tick: Tick) -> Tick {
        self.await_tick(tick.at);
        let (begun, suspended) = self.clock.now_and_suspended();
        let missed = nanos(begun.since(tick.at)) / nanos(self.timing.period);
        let missed = u32::try_from(missed).unwrap_or(u32::MAX);
        let reached = tick.later(missed, self.timing.period);
        self.missed_ticks += u64::from(missed);
        self.cycle(&Wake {
            cycle: reached.number,
            scheduled: tick.at,
            begun,
            missed_ticks: u64::from(missed),
            suspended,
        });
        reached.later(1, self.timing.period)
    }

    /// Sleeps until `tick`, less the time by which this thread is usually woken late, and stays awake for the rest. One system call,
    /// and one more should the clock not move.
    fn await_tick(&mut self, tick: Instant) {
        let due = tick - self.early();
        let sleeps = self.clock.now() < due;
        self.clock.sleep_until(due);
        let woken = self.clock.now();
        if sleeps {
            self.tick_lateness.observe(due, woken);
        }
        if self.stay_awake(woken, tick) < tick {
            self.clock.sleep_until(tick);
        }
    }

    /// How long before a tick the sleep for it should end.
    fn early(&self) -> Duration {
        self.tick_lateness.expected().min(self.timing.awake)
    }

    /// The phases of one cycle. Real-time: does not allocate; blocks only in the clock, while replies are awaited. Bounded by
    /// motors, buses, inboxes and [`REQUESTS_PER_CYCLE`].
    fn cycle(&mut self, wake: &Wake) {
        self.link.beat(wake.cycle);
        self.replace_buses();
        self.read_early();
        self.serve(wake.begun);
        let sent = self.transmit(wake);
        let transmitted = self.clock.now();
        self.polled = Polled::default();
        let polls = !self.timing.busy_poll.is_zero() && self.backoff.attempts();
        let open = self.collect(transmitted, sent + self.timing.reply_deadline, polls);
        self.control.end_cycle();
        self.publish(wake, transmitted);
        self.control.published();
        if self.control.asks_questions() {
            // The replies are awaited until the sleep for the next tick should end.
            self.ask(open, wake.scheduled + self.timing.period - self.early());
        }
    }

    /// Reads each serial line, and each bus on which a request of an earlier cycle is open: a reply must be judged before the next
    /// command to its motor is decided. One system call for each of them; bounded by motors and inboxes.
    fn read_early(&mut self) {
        for bus in 0..self.channels.len() {
            if self.channels[bus].is_line() || self.channels[bus].owes() {
                let now = self.clock.now();
                self.channels[bus].take_all();
                self.read(bus, now);
            }
        }
    }

    /// Takes at most one bus that was opened again. Its motors stay offline until they answer. Does not block: another thread
    /// closes the old bus.
    fn replace_buses(&mut self) {
        if let Some((index, bus)) = self.link.next_bus() {
            let old = self.channels[index].replace(bus);
            self.link.retire_bus(index, old);
        }
    }

    /// Stops what other threads say must be stopped. No system call; bounded by groups.
    fn heed_alarms(&mut self) {
        let Self { link, control, .. } = self;
        link.take_stops().into_iter().flatten().for_each(|cause| control.stop_all(cause, None));
        link.take_ended().for_each(|lease| control.end_owner(lease));
    }

    /// Hands control what clients ask for: at most [`REQUESTS_PER_CYCLE`] requests, and the newest setpoints of every group. No
    /// system call.
    fn serve(&mut self, now: Instant) {
        self.heed_alarms();
        let Self { link, control, .. } = self;
        for _ in 0..REQUESTS_PER_CYCLE {
            let Some((ticket, request)) = link.next_request() else { break };
            if let Some(reply) = control.request(ticket, &request, now) {
                link.answer(ticket, reply);
            }
        }
        // An emergency stop is heeded after the requests, so that no reset in the same cycle takes it back.
        if let Some(pid) = link.next_stop() {
            control.emergency_stop(pid);
        }
        link.newest_setpoints(|message| control.offer(message, now));
    }

    /// Decides, and sends one frame to each motor whose turn it is. Returns the time just before the last frames are handed over
    /// whose replies this cycle awaits. Bounded by motors; one system call per bus.
    fn transmit(&mut self, wake: &Wake) -> Instant {
        self.control.decide(*wake);
        let mut sent = wake.begun;
        for bus in 0..self.channels.len() {
            if !self.channels[bus].is_line() {
                sent = self.send(bus, wake);
            }
        }
        // A serial port takes longer to write to than a CAN socket, and no reply of it is awaited in this cycle.
        for line in 0..self.lines.len() {
            self.send(self.lines[line], wake);
        }
        sent
    }

    /// Sends one frame to each motor of a bus whose turn it is. Returns the time just before they are handed over. Bounded by
    /// the motors of the bus; one system call.
    fn send(&mut self, bus: usize, wake: &Wake) -> Instant {
        let now = self.clock.now();
        let Self { control, drives, channels, .. } = self;
        channels[bus].begin_commands(now, |motor| drives[motor].request(control.command(motor), now));
        if channels[bus].is_line() {
            self.queue_question(bus, now);
        }
        let Self { control, drives, channels, timing, .. } = self;
        let channel = &mut channels[bus];
        // A process that was frozen since it decided goes on here, when others may have stopped its motors.
        let is_stale = now.since(wake.begun) > timing.stale_after;
        let unsent = |motor: usize| {
            drives[motor].withdraw();
            control.unsent(motor);
        };
        let took_all = if is_stale { channel.withhold(unsent) } else { channel.send(now, unsent) };
        if !channel.is_idle() {
            control.bus_took(bus, took_all);
        }
        control.bus_changed(bus, channel.condition());
        now
    }

    /// Queues the question to a motor of a line, when it is the turn of the questions.
    fn queue_question(&mut self, bus: usize, now: Instant) {
        if !self.control.begin_questions(bus) || !self.channels[bus].is_idle() {
            return;
        }
        let Some((motor, question)) = self.control.question(bus) else { return };
        let frame = self.drives[motor].request(&question, now);
        self.channels[bus].queue(motor, frame);
    }

    /// Waits from `now` for the replies to all open requests, at most until `deadline`. Returns the buses whose replies have not all
    /// come. System calls as in [`gather`](Self::gather), and if it `polls`, those of [`busy_poll`](Self::busy_poll), too.
    fn collect(&mut self, now: Instant, deadline: Instant, polls: bool) -> Ready {
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
        let channels = self.channels.iter_mut().enumerate();
        channels.filter(|&(bus, _)| !open.contains(bus)).for_each(|(_, channel)| channel.complete());
        open
    }

    /// Sleeps until the last reply on the `open` buses may come, less the time by which this thread is woken late; then reads the
    /// buses again and again without a sleep, for as long as configured and at most until `deadline`: the last reply waits for no
    /// wake-up. Returns the buses whose replies have not all come. One sleep, and at most [`READS_MAX`] reads of each bus.
    fn busy_poll(&mut self, mut open: Ready, now: Instant, deadline: Instant) -> Ready {
        let earliest = self.last_of(open, BusChannel::earliest).min(deadline);
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
        let expected = self.last_of(open, BusChannel::expected).min(deadline);
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
            let channel = &self.channels[bus];
            if channel.is_line() {
                continue;
            }
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
        channels.any(|(bus, channel)| open.contains(bus) && channel.is_cut_short())
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
    fn stay_awake(&self, mut now: Instant, time: Instant) -> Instant {
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
    fn last_of(&self, open: Ready, time: impl Fn(&BusChannel) -> Instant) -> Instant {
        let channels = self.channels.iter().enumerate().filter(|&(bus, _)| open.contains(bus));
        channels.map(|(_, channel)| time(channel)).fold(Instant::ZERO, Instant::max)
    }

    /// Waits until something arrives on an `open` bus, at most until `until`. Returns the buses that are worth reading. One
    /// system call.
    fn wait(&mut self, open: Ready, until: Instant) -> Ready {
        let mut readiness = [Readiness::Never; BUSES_MAX];
        for (bus, (readiness, channel)) in readiness.iter_mut().zip(&self.channels).enumerate() {
            *readiness = if open.contains(bus) { channel.readiness() } else { Readiness::Never };
        }
        self.clock.wait(&readiness[..self.channels.len().min(BUSES_MAX)], until)
    }

    /// The buses with an open request whose reply this cycle awaits. Bounded by buses.
    fn open_buses(&self) -> Ready {
        Ready::of(self.channels.iter().map(BusChannel::is_open))
    }

    /// Reads the buses that are `ready` at `now`, or all when that is not known, but never a line. Returns how many were read. One
    /// system call for each of them; bounded by their inboxes.
    fn receive(&mut self, ready: Option<Ready>, now: Instant) -> usize {
        let mut read = 0;
        for bus in 0..self.channels.len() {
            if self.channels[bus].is_line() || ready.is_some_and(|ready| !ready.contains(bus)) {
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
        let is_complete = channel.receive(now, |motor, payload, at| {
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
        });
        if !is_complete {
            channel.settle(drives);
        }
        control.bus_changed(bus, channel.condition());
    }

    /// Publishes the states, answers and events of this cycle. At most one system call: that of the function which
    /// [`on_publish`](Self::on_publish) was given.
    fn publish(&mut self, wake: &Wake, transmitted: Instant) {
        let now = self.clock.now();
        self.report(wake, now);
        let Self { link, control, .. } = self;
        let (age, state) = (control.setpoint_age(), link.state().0);
        let record = Record::of(wake, transmitted, now, age, self.polled, state);
        link.publish(record);
        while let Some((ticket, reply)) = control.next_answer() {
            link.answer(ticket, reply);
        }
        control.events().for_each(|event| link.push(wake.cycle, event));
        link.lose(control.clear_events());
    }

    /// Asks at most one motor of each bus but lines for its faults or an indicator, if the bus is not `open`, and if request
    /// and reply still fit before `end`, the next tick. Waits for the replies at most until `end`. One system call per bus that
    /// is asked, and those of [`collect`](Self::collect).
    fn ask(&mut self, open: Ready, end: Instant) {
        let now = self.clock.now();
        let mut asked = false;
        for bus in 0..self.channels.len() {
            let channel = &self.channels[bus];
            if channel.is_line() || open.contains(bus) || now + channel.poll_time() > end {
                continue;
            }
            let Some((motor, question)) = self.control.question(bus) else { continue };
            let Self { channels, drives, .. } = self;
            channels[bus].begin(Batch::FaultRequest, now);
            channels[bus].queue(motor, drives[motor].request(&question, now));
            channels[bus].send(now, |motor| drives[motor].withdraw());
            asked = true;
        }
        if asked {
            // Those that are still open are overdue: only the replies to these questions are waited for.
            let overdue = self.channels.iter_mut().enumerate().filter(|&(bus, _)| open.contains(bus));
            overdue.for_each(|(_, channel)| channel.give_up(end));
            // No client waits for these replies, so the buses are not polled for them.
            self.collect(now, end, false);
        }
    }
}

/// The least time from a command to its reply. Nothing is known of a CAN interface: a virtual one has no wire.
fn fastest_reply(settings: &Settings, plans: &[BusPlan], bus: usize) -> Duration {
    match settings.buses[bus].kind {
        BusKind::SocketCan { .. } => Duration::ZERO,
        BusKind::Serial { .. } | BusKind::Simulated { .. } => plans[bus].transaction_least,
    }
}

/// One point of the time grid: when a cycle should begin. Ticks are a period apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tick {
    /// Its number, from 1; its cycle bears the same.
    pub number: u64,
    /// Its time.
    pub at: Instant,
}

impl Tick {
    fn later(self, ticks: u32, period: Duration) -> Self {
        Self { number: self.number + u64::from(ticks), at: self.at + ticks * period }
    }
}
