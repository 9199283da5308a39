//! The dead man's switch at work: hears registrations, watches one daemon, and carries its will out.

use crate::deadman::heartbeat::{AT_REST, Pulse};
use motord_bus::{Instant, Readiness, Ready, clock, wait};
use std::os::fd::AsFd;

use super::channel::{Answer, Channel, Listener, Refusal, Request};
use super::executor::{Executor, Executors};
use super::switch::{Cause, Switch};
use super::will::{Outlet, Will, WillError};

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
    executors: Executors,
    /// Whether it was told that only buses that refuse are left.
    waits: bool,
}

/// What is worth a line in the log.
enum News {
    /// Only buses that refuse are left.
    Waits(Cause),
    /// Every bus is served, or the daemon has its motors back.
    Over(Cause),
}

/// Places in what is waited for.
const LISTENER: usize = 0;
const CALLER: usize = 1;
const WARD: usize = 2;

impl<O: FnMut(&str, u32) -> Result<Box<dyn Outlet>, WillError>> Server<O> {
    /// Nobody is watched yet.
    pub fn new(listener: Listener, open: O) -> Self {
        Self { listener, open, caller: None, ward: None }
    }

    /// Whether a will is being carried out.
    #[must_use]
    pub fn is_acting(&self) -> bool {
        self.ward.as_ref().is_some_and(|ward| ward.duty.switch.acts().is_some())
    }

    /// The interfaces whose motors are still to be damped or stopped; none when no will is being carried out. Allocates.
    #[must_use]
    pub fn owed(&self) -> Vec<String> {
        let acting = self.ward.as_ref().filter(|_| self.is_acting());
        acting.map_or_else(Vec::new, |ward| ward.duty.executors.owed())
    }

    /// Goes on while a will is being carried out, at most until `end`. Returns what is [owed](Self::owed) then.
    pub fn finish(&mut self, end: Instant) -> Vec<String> {
        while self.is_acting() && clock::monotonic() < end {
            self.turn(end);
        }
        self.owed()
    }

    /// Waits until something is due, at most until `until`, and does it. While a daemon is watched and nobody calls, that is
    /// two system calls and those of one [round](Executors::round), which looks for at most one interface: only that can
    /// block, while another process configures interfaces. Allocates when somebody calls, and when the log is told.
    pub fn turn(&mut self, until: Instant) {
        let wake = self.ward.as_ref().map_or(until, |ward| ward.duty.due().min(until));
        let ready = wait(&self.readiness(), clock::monotonic(), wake);
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

    fn readiness(&self) -> [Readiness<'_>; 3] {
        let ward = self.ward.as_ref().filter(|ward| ward.connected);
        [
            Readiness::Readable(self.listener.as_fd()),
            readable(self.caller.as_ref()),
            readable(ward.map(|ward| &ward.channel)),
        ]
    }

    /// What the caller wants. Allocates. Opening an interface takes milliseconds, and longer while another process configures
    /// interfaces: meanwhile the motors keep the last command.
    fn hear(&mut self) {
        let Some(caller) = self.caller.take() else { return };
        // Strangers are not answered.
        let Some(pid) = caller.peer() else { return };
        let answer = match caller.receive() {
            Ok((Request::AskWhetherActing, _)) => Answer::Acting(self.owed()),
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
        let executors = Executors::new(executors, will.damp);
        let heartbeat = pulse.read().filter(|heartbeat| *heartbeat != AT_REST).ok_or(Refusal::NoHeartbeat)?;
        let switch = Switch::new(will.patience, heartbeat, clock::monotonic());
        Ok(Duty { pulse, switch, executors, waits: false })
    }

    /// From here on the ward before, dead as it is, is left to this one.
    fn take_on(&mut self, ward: Ward) {
        let ward = self.ward.insert(ward);
        let _closed_is_seen = ward.channel.send(&Answer::Registered, None);
        tracing::info!(pid = ward.pid, interfaces = ward.duty.executors.count(), "watching");
    }
}

fn readable(channel: Option<&Channel>) -> Readiness<'_> {
    channel.map_or(Readiness::Never, |channel| Readiness::Readable(channel.as_fd()))
}

impl Ward {
    fn watch(&mut self, ready: Ready) {
        self.connected &= !(ready.contains(WARD) && self.channel.has_ended());
        match self.duty.step(self.connected) {
            Some(News::Over(cause)) => {
                tracing::warn!(pid = self.pid, "damped or stopped its motors: {cause}");
            }
            Some(News::Waits(cause)) => tracing::error!(
                pid = self.pid,
                "{cause}, and motors keep their last command, for these interfaces refuse frames: {}. Keeps trying.",
                self.duty.executors.owed().join(", ")
            ),
            None => {}
        }
    }
}

impl Duty {
    fn due(&self) -> Instant {
        let round = self.switch.acts().and_then(|_| self.executors.due());
        round.unwrap_or(self.switch.due())
    }

    /// Real-time: does not allocate; one system call, and while the switch acts those of a [round](Executors::round), which
    /// can block when an interface is away.
    fn step(&mut self, connected: bool) -> Option<News> {
        let acted = self.switch.acts();
        let now = clock::monotonic();
        // A file that can be read no more does not move.
        let heartbeat = self.pulse.read().unwrap_or(self.switch.heartbeat());
        self.switch.step(now, connected, heartbeat);
        let Some(cause) = self.switch.acts() else { return acted.map(News::Over) };
        if acted.is_none() {
            self.executors.begin(now);
            self.waits = false;
        }
        self.executors.round(now);
        if self.executors.due().is_none() {
            self.switch.served();
            return Some(News::Over(cause));
        }
        let told = self.waits;
        self.waits |= self.executors.only_wait();
        (self.waits && !told).then_some(News::Waits(cause))
    }
}
