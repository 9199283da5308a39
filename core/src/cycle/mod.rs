//! One cycle: wake, decide, transmit, collect, publish.
//!
//! These functions run in the real-time thread. After [`assemble`] none allocates, locks or logs.
//! Every loop is bounded by motors, buses or an inbox. None returns early: a missed reply is data
//! for a later phase.
//!
//! | system calls of a cycle | at most |
//! |---|---|
//! | sleep until the tick | 2 |
//! | send | 1 per bus |
//! | wait and receive | 3 per CAN bus plus 3 |
//! | read before the decisions | 1 per line, and per bus with an open request of an earlier cycle |
//! | busy polling, where configured | 1, and the reads that [`Polled`] counts |
//! | questions | 1 send per bus that is asked, and the calls for its reply |

mod channel;
mod collect;
mod emergency;
mod history;
mod link;
mod local;
mod replacement;
mod report;
mod run;
mod timing;
mod transmit;

pub use emergency::{EmergencyStops, StopRequest};
pub use history::{Histories, History};
pub use link::{Alarms, Counters, Ends, Polled, REQUESTS_MAX, RealTimeEnd, Record, link};
pub use local::{ANSWER_CYCLES, LocalClient, outcome};
pub use replacement::Supply;
pub use run::{Order, assemble};
pub use timing::Tick;

use crate::control::{Control, Wake};
use crate::drive::Drive;
use crate::stopper::{BusFrames, Stopper};
use channel::BusChannel;
use motord_bus::time::nanos;
use motord_bus::{Backoff, Bus, Clock, Duration, Instant, Lateness};
use motord_settings::plan::BusPlan;
use motord_settings::settings::Settings;
use motord_shared::limits::{ADMINS_MAX, REQUESTS_PER_CLIENT};
use timing::Timing;

/// Most requests answered in one cycle: all that clients can have open, so that an emergency stop
/// does not wait behind other requests.
const REQUESTS_PER_CYCLE: usize = ADMINS_MAX * REQUESTS_PER_CLIENT;
/// Everything the real-time thread owns.
pub struct Cycle {
    clock: Box<dyn Clock + Send>,
    timing: Timing,
    channels: Vec<BusChannel>,
    drives: Vec<Drive>,
    /// The buses that are lines.
    lines: Vec<usize>,
    control: Control,
    link: RealTimeEnd,
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

impl Cycle {
    /// Creates a cycle. `buses` and `plans` are in the order of the configuration. Allocates;
    /// nothing after it does.
    fn new(
        settings: &Settings,
        plans: &[BusPlan],
        buses: Vec<Box<dyn Bus>>,
        clock: Box<dyn Clock + Send>,
        link: RealTimeEnd,
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

    /// Calls `begun` at the beginning of every cycle with its number. It must not allocate, block
    /// or make a system call.
    pub fn on_begin(&mut self, begun: impl Fn(u64) + Send + 'static) {
        self.link.on_begin(begun);
    }

    /// Calls `published` in every cycle after its states are published. It must not allocate or
    /// block, and may make one system call.
    pub fn on_publish(&mut self, published: impl Fn() + Send + 'static) {
        self.link.on_publish(published);
    }

    /// Publishes to clients whether this thread has real-time scheduling and locked memory.
    pub const fn set_realtime(&mut self, realtime: bool) {
        self.realtime = realtime;
    }

    /// Leaves time before each tick to the ipc thread, which runs on the processor of this thread.
    pub fn share_processor(&mut self) {
        self.timing.share_processor();
    }

    /// Marks a motor that differs from its configuration: its group is never enabled.
    pub fn mark_mismatch(&mut self, joint: usize) {
        self.control.mark_mismatch(joint);
    }

    /// Returns the decisions, for tests.
    #[must_use]
    pub const fn control(&self) -> &Control {
        &self.control
    }

    /// Damps and stops every group; none can be enabled afterwards.
    /// [`is_disarmed`](Self::is_disarmed) returns true when this is complete. A pending alarm is
    /// latched as the cause instead of the shutdown.
    pub fn shut_down(&mut self) {
        self.handle_alarms();
        self.control.shut_down();
    }

    /// Stops every motor without damping it first.
    pub fn stop_now(&mut self) {
        self.control.stop_now();
    }

    /// Damps and stops every motor after a panic in [`run`](Self::run), by frames that were made at
    /// the start. Uses only the buses and the clock of the cycle. The cycle must not run again.
    pub fn stop_after_panic(&mut self) {
        self.stopper.run(&mut *self.clock, &mut self.channels);
    }

    /// Returns the motors that were started and have not answered a stop since.
    pub fn unstopped(&self) -> impl Iterator<Item = usize> {
        self.control.unstopped()
    }

    /// Returns whether every group is disarmed: every reachable motor is commanded to stop.
    #[must_use]
    pub fn is_disarmed(&self) -> bool {
        self.control.is_disarmed()
    }

    /// Sleeps until `tick`, runs its cycle, and returns the next tick. Ticks that have passed in
    /// the meantime are missed: no burst of cycles replaces them. The cycle has the number of the
    /// latest tick that has passed.
    ///
    /// Real-time: does not allocate; blocks only in the clock, at most until the replies are
    /// overdue.
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

    /// Sleeps until `tick`, less the usual lateness of wake-ups, and polls the clock for the rest.
    /// One system call, and one more if the clock does not advance.
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

    /// Returns how long before a tick the sleep for it should end.
    fn early(&self) -> Duration {
        self.tick_lateness.expected().min(self.timing.awake)
    }

    /// The phases of one cycle. Real-time: does not allocate; blocks only in the clock, while
    /// replies are awaited. Bounded by motors, buses, inboxes and [`REQUESTS_PER_CYCLE`].
    fn cycle(&mut self, wake: &Wake) {
        self.link.beat(wake.cycle);
        self.replace_buses();
        self.read_early();
        self.take_bus_readings();
        self.serve(wake.begun);
        let sent = self.transmit(wake);
        let transmitted = self.clock.now();
        self.polled = Polled::default();
        let polls = !self.timing.busy_poll.is_zero() && self.backoff.attempts();
        let open = self.collect(transmitted, sent + self.timing.reply_deadline, polls);
        self.take_readings();
        self.control.end_cycle();
        self.publish(wake, transmitted);
        self.control.published();
        if self.control.has_questions() {
            self.ask(open, wake.scheduled + self.timing.period);
        }
    }

    /// Passes to control the readings that changed: first those of the sensors on buses, then those
    /// of other threads. Wait-free; no system call; bounded by sensors.
    fn take_readings(&mut self) {
        self.take_bus_readings();
        let Self { link, control, .. } = self;
        link.newest_readings(|reading| control.receive_reading(reading));
    }

    /// Passes to control the readings of sensors on buses that changed. After an early read, the
    /// decisions need them. No system call; bounded by sensors and buses.
    fn take_bus_readings(&mut self) {
        let Self { channels, control, .. } = self;
        for channel in channels {
            channel.base_mut().sensors().take_readings(|reading| control.receive_reading(reading));
        }
    }

    /// Takes at most one reopened bus. Its motors stay offline until they answer. Does not block:
    /// another thread closes the old bus.
    fn replace_buses(&mut self) {
        if let Some((index, bus, condition)) = self.link.next_bus() {
            let old = self.channels[index].base_mut().replace(bus, condition);
            self.link.retire_bus(old);
            self.control.bus_reopened(index);
        }
    }

    /// Stops the groups that other threads raised an alarm for. No system call; bounded by groups.
    fn handle_alarms(&mut self) {
        let Self { link, control, .. } = self;
        link.take_stops().into_iter().flatten().for_each(|cause| control.stop_all(cause, None));
        link.take_ended().for_each(|lease| control.end_owner(lease));
    }

    /// Passes to control at most [`REQUESTS_PER_CYCLE`] requests, and the newest setpoints of every
    /// group. No system call.
    fn serve(&mut self, now: Instant) {
        self.handle_alarms();
        let Self { link, control, .. } = self;
        for _ in 0..REQUESTS_PER_CYCLE {
            let Some((ticket, request)) = link.next_request() else { break };
            if let Some(reply) = control.request(ticket, &request, now) {
                link.answer(ticket, reply);
            }
        }
        // After the requests, so that no reset of the same cycle clears the emergency stop.
        if let Some(pid) = link.next_stop() {
            control.emergency_stop(pid);
        }
        link.newest_setpoints(|message| control.offer(message, now));
    }

    /// Publishes the states, answers and events of this cycle. At most one system call: that of the
    /// function which [`on_publish`](Self::on_publish) was given.
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
}

/// Passes the condition of a bus to control. While the bus is off or gone, its sensors are
/// disconnected. No system call; bounded by sensors.
#[inline]
fn pass_condition(bus: usize, channel: &mut BusChannel, control: &mut Control) {
    if control.bus_changed(bus, channel.base().condition()) {
        channel.base_mut().sensors().disconnect();
    }
}

/// Returns the least time from a command to its reply. Zero for a bus that may have no wire.
fn fastest_reply(settings: &Settings, plans: &[BusPlan], bus: usize) -> Duration {
    let has_wire_time = settings.buses[bus].kind.has_wire_time();
    if has_wire_time { plans[bus].transaction_least } else { Duration::ZERO }
}
