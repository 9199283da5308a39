//! The dead man's switch at work: hears registrations, watches one daemon, and carries its will out.

use crate::heartbeat::{AT_REST, Pulse};
use motord_bus::wait::{self, Ready};
use motord_bus::{Bus, Instant, Readiness, clock};
use std::os::fd::AsRawFd;

use super::channel::{Answer, Channel, Listener, Refusal, Request};
use super::switch::{Cause, Switch};
use super::will::{Executor, Will, WillError};

/// The switch of one instance. `O` opens an interface, to send up to so many frames at a time.
pub struct Server<O> {
    listener: Listener,
    open: O,
    /// Connected, and has not said what it wants. Only the latest: whoever is silent makes room.
    caller: Option<Channel>,
    ward: Option<Ward>,
}

/// The daemon that is watched, and its will.
struct Ward {
    channel: Channel,
    pid: i32,
    connected: bool,
    duty: Duty,
}

struct Duty {
    pulse: Pulse,
    switch: Switch,
    executors: Vec<Executor>,
}

/// Places in what is waited for.
const LISTENER: usize = 0;
const CALLER: usize = 1;
const WARD: usize = 2;

impl<O: FnMut(&str, u32) -> Result<Box<dyn Bus>, WillError>> Server<O> {
    /// Nobody is watched yet.
    pub fn new(listener: Listener, open: O) -> Self {
        Self { listener, open, caller: None, ward: None }
    }

    /// Whether a will is being carried out.
    #[must_use]
    pub fn is_acting(&self) -> bool {
        self.ward.as_ref().is_some_and(|ward| ward.duty.switch.acts().is_some())
    }

    /// Waits until something is due, at most until `until`, and does it. While a daemon is watched and nobody calls:
    /// neither allocates nor blocks otherwise; two system calls and one more per interface, seven per interface that is away.
    pub fn turn(&mut self, until: Instant) {
        let wake = self.ward.as_ref().map_or(until, |ward| ward.duty.switch.due().min(until));
        let ready = wait::wait(&self.readiness(), clock::monotonic(), wake);
        if let Some(ward) = &mut self.ward {
            ward.watch(ready);
        }
        self.ward.take_if(|ward| !ward.connected && ward.duty.switch.acts().is_none());
        if ready.contains(CALLER) {
            self.hear();
        }
        if ready.contains(LISTENER) {
            self.caller = self.listener.accept().ok();
        }
    }

    fn readiness(&self) -> [Readiness; 3] {
        let readable = |channel: &Channel| Readiness::Readable(channel.as_raw_fd());
        let ward = self.ward.as_ref().filter(|ward| ward.connected);
        [
            Readiness::Readable(self.listener.as_raw_fd()),
            self.caller.as_ref().map_or(Readiness::Never, readable),
            ward.map_or(Readiness::Never, |ward| readable(&ward.channel)),
        ]
    }

    /// What the caller wants. Allocates, and opening an interface takes milliseconds: meanwhile the motors keep the last
    /// command.
    fn hear(&mut self) {
        let Some(caller) = self.caller.take() else { return };
        // Strangers are not answered.
        let Some(pid) = caller.peer() else { return };
        let answer = match caller.receive() {
            Ok((Request::AskWhetherActing, _)) => Answer::Acting(self.is_acting()),
            Ok((Request::Register(will), pulse)) => match self.prepare(&will, pulse) {
                Ok(duty) => return self.take_on(Ward { channel: caller, pid, connected: true, duty }),
                Err(refusal) => Answer::Refused(refusal),
            },
            Err(error) => return tracing::warn!(pid, "no request: {error}"),
        };
        let _gone = caller.send(&answer, None);
    }

    fn prepare(&mut self, will: &Will, pulse: Option<Pulse>) -> Result<Duty, Refusal> {
        if let Some(Ward { pid, .. }) = self.ward.as_ref().filter(|ward| ward.connected) {
            return Err(Refusal::Busy { pid: *pid });
        }
        let pulse = pulse.ok_or(Refusal::NoHeartbeat)?;
        let executors = will.buses.iter().map(|bus| Executor::new(bus, &mut self.open));
        let executors = executors.collect::<Result<_, _>>().map_err(Refusal::Will)?;
        let heartbeat = pulse.read().filter(|heartbeat| *heartbeat != AT_REST).ok_or(Refusal::NoHeartbeat)?;
        let switch = Switch::new(will.patience, will.damp, heartbeat, clock::monotonic());
        Ok(Duty { pulse, switch, executors })
    }

    /// From here on the ward before, dead as it is, is left to this one.
    fn take_on(&mut self, ward: Ward) {
        let ward = self.ward.insert(ward);
        let _closed_is_seen = ward.channel.send(&Answer::Registered, None);
        tracing::info!(pid = ward.pid, interfaces = ward.duty.executors.len(), "watching");
    }
}

impl Ward {
    fn watch(&mut self, ready: Ready) {
        self.connected &= !(ready.contains(WARD) && self.channel.has_ended());
        if let Some(cause) = self.duty.step(self.connected) {
            tracing::warn!(pid = self.pid, "damped or stopped its motors: {cause}");
        }
    }
}

impl Duty {
    /// Real-time: does not allocate or block; one system call, and when something is due those of [`Executor`]. Returns why
    /// it acted, when that is over.
    fn step(&mut self, connected: bool) -> Option<Cause> {
        let acted = self.switch.acts();
        let now = clock::monotonic();
        // A file that can be read no more does not move.
        let heartbeat = self.pulse.read().unwrap_or(self.switch.heartbeat());
        if let Some(order) = self.switch.step(now, connected, heartbeat) {
            self.executors.iter_mut().for_each(|executor| executor.carry_out(order, now));
        }
        acted.filter(|_| self.switch.acts().is_none())
    }
}
