//! One bus in the cycle: frames sent on it, motors that reply there, counters.
//!
//! Real-time: after [`BusChannel::new`] nothing here allocates or blocks; every loop is bounded by
//! the motors of the bus or by one inbox.

mod base;
mod can;
mod foreign;
mod routes;

pub(super) use base::{ChannelBase, FrameRole};
pub(super) use can::{Batch, CanChannel};

use crate::sensor::Sensors;
use crate::stopper::{LineRound, Outlet};
use base::Arrivals;
use foreign::ForeignCommands;
use motord_bus::{Bus, Frame, IdFilter, Instant, Refusal};
use motord_settings::plan::BusPlan;
use motord_settings::settings::{MotorSettings, Settings};
use routes::Routes;

/// A bus, and everything the cycle knows of it.
pub(super) enum BusChannel {
    /// The cycle waits for the replies to its commands.
    Can(CanChannel),
    /// One request is open at a time, and its reply is read at the beginning of a later cycle.
    Line(LineChannel),
}

impl BusChannel {
    /// `index` is that of the bus in `settings`. Allocates.
    pub(super) fn new(bus: Box<dyn Bus>, index: usize, settings: &Settings, plan: &BusPlan) -> Self {
        let motors = || settings.motors.iter().enumerate().filter(|(_, motor)| motor.bus == index);
        if settings.buses[index].is_line() {
            // A frame on a line names its receiver only, so such a bus names the motor that
            // answers.
            let line_id = |settings: &MotorSettings| IdFilter::exact(settings.command_id()).into();
            let routes = motors().map(|(motor, settings)| (line_id(settings), motor));
            return Self::Line(LineChannel::new(ChannelBase::new(
                bus,
                Routes::new(routes),
                ForeignCommands::none(),
                Sensors::default(),
            )));
        }
        let routes = motors().map(|(motor, settings)| (settings.addresses().replies, motor));
        let (foreign, sensors) = (ForeignCommands::new(settings, index), Sensors::new(settings, index));
        let reads_all = settings.buses[index].has_turns() || !sensors.is_empty();
        Self::Can(CanChannel::new(
            ChannelBase::new(bus, Routes::new(routes), foreign, sensors),
            reads_all,
            plan,
        ))
    }

    /// Returns the channel of a CAN bus.
    #[inline]
    pub(super) const fn can(&self) -> Option<&CanChannel> {
        match self {
            Self::Can(channel) => Some(channel),
            Self::Line(_) => None,
        }
    }

    /// Returns the channel of a CAN bus.
    #[inline]
    pub(super) const fn can_mut(&mut self) -> Option<&mut CanChannel> {
        match self {
            Self::Can(channel) => Some(channel),
            Self::Line(_) => None,
        }
    }

    /// Reads at most one inbox full, as [`ChannelBase::receive`] does. At most one system call.
    #[inline]
    pub(super) fn receive(
        &mut self,
        now: Instant,
        classify: impl FnMut(usize, Option<&Frame>, Instant) -> FrameRole,
    ) -> Arrivals {
        match self {
            Self::Can(channel) => channel.begin_read(),
            Self::Line(channel) => channel.base.clear_inbox(),
        }
        self.base_mut().receive(now, classify)
    }

    /// Returns the part that all buses have in common.
    #[inline]
    pub(super) const fn base(&self) -> &ChannelBase {
        match self {
            Self::Can(channel) => &channel.base,
            Self::Line(channel) => &channel.base,
        }
    }

    /// Returns the part that all buses have in common.
    #[inline]
    pub(super) const fn base_mut(&mut self) -> &mut ChannelBase {
        match self {
            Self::Can(channel) => &mut channel.base,
            Self::Line(channel) => &mut channel.base,
        }
    }

    /// Returns whether the bus is read before the decisions of a cycle: a reply must be checked
    /// before the next command to its motor is decided. That read takes everything that has
    /// arrived.
    pub(super) const fn reads_early(&mut self) -> bool {
        match self {
            Self::Can(channel) => channel.reads_early(),
            Self::Line(_) => true,
        }
    }

    /// Begins a batch of commands without frames, to be sent at `now`.
    #[inline]
    pub(super) fn begin(&mut self, now: Instant) {
        match self {
            Self::Can(channel) => channel.begin(Batch::Commands, now),
            Self::Line(channel) => channel.base.clear(),
        }
    }

    /// Sends the queued frames, as [`ChannelBase::send`] does. Returns whether the bus accepted
    /// all. At most one system call.
    #[inline]
    pub(super) fn send(&mut self, now: Instant, unsent: impl FnMut(usize)) -> bool {
        match self {
            Self::Can(channel) => channel.send(now, unsent),
            Self::Line(channel) => channel.base.send(now, unsent).accepted_all,
        }
    }

    /// Sends none of the queued frames, as if the bus had not accepted them. No system call.
    pub(super) fn withhold(&mut self, unsent: impl FnMut(usize)) -> bool {
        match self {
            Self::Can(channel) => channel.withhold(unsent),
            Self::Line(channel) => channel.base.withhold(unsent).accepted_all,
        }
    }
}

impl Outlet for BusChannel {
    /// Discards what has arrived, then sends frames whose replies are not read; on a line one of
    /// them. At most two system calls.
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        match self {
            Self::Can(channel) => channel.base.send_unanswered(now, frames),
            Self::Line(channel) => channel.send_round(now, frames),
        }
    }
}

/// A line: a bus with one open request at a time.
pub(crate) struct LineChannel {
    base: ChannelBase,
    round: LineRound,
}

impl LineChannel {
    fn new(base: ChannelBase) -> Self {
        Self { base, round: LineRound::default() }
    }

    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        let Self { base, round } = self;
        round.send(frames, |frame| base.send_unanswered(now, frame))
    }
}
