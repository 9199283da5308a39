//! Sends one frame to each motor whose turn it is.

use super::Cycle;
use super::channel::BusChannel;
use super::pass_condition;
use crate::control::Wake;
use motord_bus::{Frame, Instant};

impl Cycle {
    /// Decides, and sends one frame to each motor whose turn it is. Returns the time just before
    /// the last frames are handed over whose replies this cycle awaits. Bounded by motors; one
    /// system call per bus.
    pub(super) fn transmit(&mut self, wake: &Wake) -> Instant {
        self.control.decide(*wake);
        let mut sent = wake.begun;
        for bus in 0..self.channels.len() {
            if self.channels[bus].can().is_some() {
                sent = self.send(bus, wake);
            }
        }
        // After the CAN buses: a write to a line takes longer, and this cycle does not wait
        // for its reply.
        for line in 0..self.lines.len() {
            self.send(self.lines[line], wake);
        }
        sent
    }

    /// Sends one frame to each motor of a bus whose turn it is. Returns the time just before they
    /// are handed over. Bounded by the motors of the bus; one system call.
    fn send(&mut self, bus: usize, wake: &Wake) -> Instant {
        let now = self.clock.now();
        let Self { control, drives, channels, .. } = self;
        let channel = &mut channels[bus];
        if control.is_emptying(bus) && channel.base_mut().discard_queue() {
            control.bus_emptied(bus);
        }
        channel.begin(now);
        let write =
            |motor: usize, frame: &mut Frame| drives[motor].write_request(control.command(motor), now, frame);
        channel.base_mut().queue_each(write);
        for &motor in channel.base().senders() {
            if !drives[motor].is_open() {
                control.expect_no_answer(motor);
            }
        }
        if matches!(channel, BusChannel::Line(_)) {
            self.queue_question(bus, now);
        } else if !channel.base_mut().sensors().is_empty() && !self.control.withholds_requests(bus) {
            channel.base_mut().queue_sensors(wake.cycle, now);
        }
        let Self { control, drives, channels, timing, .. } = self;
        let channel = &mut channels[bus];
        // A process that was frozen since it decided continues here, when another process may have
        // stopped the motors.
        let is_stale = now.since(wake.begun) > timing.stale_after;
        let unsent = |motor: usize| {
            drives[motor].withdraw();
            control.unsent(motor);
        };
        let accepted_all = if is_stale { channel.withhold(unsent) } else { channel.send(now, unsent) };
        if !channel.base().is_idle() {
            control.bus_accepted(bus, accepted_all);
        }
        pass_condition(bus, channel, control);
        now
    }

    /// Queues the question to a motor of a line, when it is the turn of the questions.
    fn queue_question(&mut self, bus: usize, now: Instant) {
        if !self.control.begin_questions(bus) || !self.channels[bus].base().is_idle() {
            return;
        }
        let Some((motor, question)) = self.control.question(bus) else { return };
        let Self { channels, drives, .. } = self;
        channels[bus].base_mut().queue(motor, |frame| drives[motor].write_request(&question, now, frame));
    }
}
