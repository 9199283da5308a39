//! The server of the dead man's switch: accepts registrations, supervises one daemon, and stops its
//! motors when the daemon cannot.

use crate::heartbeat::{AT_REST, Pulse};
use motord_bus::{BusLock, Duration, Instant, Readiness, Ready, clock, wait};
use motord_core::stopper::Outlet;
use std::os::fd::AsFd;

use crate::channel::{Answer, Channel, Listener, Refusal, Request};
use crate::interfaces::{Interface, Interfaces, Locked};
use crate::safe_frames::{InterfaceError, SafeFrames};
use crate::switch::{Cause, Switch};

/// Period of the signs of life to the daemon.
const BEAT: Duration = Duration::from_millis(20);
/// A round that is later than this was not delayed by other processes only: this process was
/// stopped, and another daemon may have started.
const FROZEN: Duration = Duration::from_millis(100);

/// Least time between two lines of the log about callers without a valid request.
const REFUSED_PAUSE: Duration = Duration::from_secs(1);

/// The switch of one instance. `O` opens an interface to send up to the given number of frames at a
/// time.
pub struct Server<O> {
    listener: Listener,
    open: O,
    /// The latest connection without a request. A newer one replaces it.
    caller: Option<Channel>,
    supervised: Option<Supervised>,
    refused: Refused,
}

/// Callers without a valid request. The log reports them in at most one line per second.
#[derive(Default)]
struct Refused {
    /// When the next line may be written.
    due: Instant,
    /// The callers that it will count.
    count: u64,
}

impl Refused {
    /// Counts one more caller. Returns their number since the last line, if another line is due.
    fn next_line(&mut self, now: Instant) -> Option<u64> {
        self.count += 1;
        if now < self.due {
            return None;
        }
        self.due = now + REFUSED_PAUSE;
        Some(std::mem::take(&mut self.count))
    }
}

/// The daemon that is supervised.
struct Supervised {
    channel: Channel,
    pid: i32,
    connected: bool,
    /// The next sign of life.
    beat: Instant,
    watch: Watch,
}

/// Its heartbeat, and its motors.
struct Watch {
    pulse: Pulse,
    switch: Switch,
    interfaces: Interfaces,
    /// The log has reported that only interfaces that refuse frames are left.
    stalled: bool,
}

/// An event that is worth a line in the log.
enum Notice {
    /// Only interfaces that refuse frames are left.
    Stalled(Cause),
    /// Every interface is served, or the daemon has its motors back.
    Over(Cause),
}

/// Indices of the connections that are waited for.
const LISTENER: usize = 0;
const CALLER: usize = 1;
const SUPERVISED: usize = 2;

impl<O: FnMut(&str, u32) -> Result<Box<dyn Outlet>, InterfaceError>> Server<O> {
    /// Creates a switch that supervises no daemon yet. May block while the kernel loads a module.
    pub fn new(listener: Listener, open: O) -> Self {
        BusLock::prepare_search();
        Self { listener, open, caller: None, supervised: None, refused: Refused::default() }
    }

    /// Returns true while it damps or stops motors.
    #[must_use]
    pub fn is_acting(&self) -> bool {
        self.supervised.as_ref().is_some_and(|daemon| daemon.watch.switch.acts().is_some())
    }

    /// Returns the interfaces whose motors are still to be damped or stopped; none when it does not
    /// act. Allocates.
    #[must_use]
    pub fn unserved(&self) -> Vec<String> {
        let acting = self.supervised.as_ref().filter(|_| self.is_acting());
        acting.map_or_else(Vec::new, |daemon| daemon.watch.interfaces.unserved())
    }

    /// Continues while it acts, at most until `end`. Returns the interfaces that are
    /// [unserved](Self::unserved) then.
    pub fn finish(&mut self, end: Instant) -> Vec<String> {
        while self.is_acting() && clock::monotonic() < end {
            self.turn(end);
        }
        self.unserved()
    }

    /// Waits until something is due, at most until `until`, and does it. While a daemon is
    /// supervised and no caller connects, that is two system calls, and a third for a sign of life.
    /// While it acts, those of one [round](Interfaces::round) are added. A round searches for at
    /// most one interface, which can block while another process configures interfaces. Allocates
    /// when a caller connects, when it begins to act or is late, and when it logs.
    pub fn turn(&mut self, until: Instant) {
        let wake = self.supervised.as_ref().map_or(until, |daemon| daemon.watch.due().min(until));
        let ready = wait(&self.readiness(), clock::monotonic(), wake);
        if let Some(daemon) = &mut self.supervised {
            daemon.watch(ready);
        }
        self.supervised.take_if(|daemon| !daemon.connected && daemon.watch.switch.acts().is_none());
        if ready.contains(CALLER) {
            self.answer_caller();
        }
        if ready.contains(LISTENER) {
            self.caller = self.listener.accept().ok();
        }
    }

    fn readiness(&self) -> [Readiness<'_>; 3] {
        let connected = self.supervised.as_ref().filter(|daemon| daemon.connected);
        [
            Readiness::Readable(self.listener.as_fd()),
            readable(self.caller.as_ref()),
            readable(connected.map(|daemon| &daemon.channel)),
        ]
    }

    /// Executes the request of the caller. Processes of other users get no answer. Allocates.
    /// Opening an interface takes milliseconds, and longer while another process configures
    /// interfaces; during that the motors keep their last command.
    fn answer_caller(&mut self) {
        let Some(caller) = self.caller.take() else { return };
        let Some(pid) = caller.peer() else { return };
        let answer = match caller.receive() {
            Ok((Request::AskWhetherActing, _)) => Answer::Acting(self.unserved()),
            Ok((Request::Register(frames), pulse)) => match self.prepare(&frames, pulse) {
                Ok(watch) => {
                    return self.supervise(Supervised {
                        channel: caller,
                        pid,
                        connected: true,
                        beat: Instant::ZERO,
                        watch,
                    });
                }
                Err(refusal) => Answer::Refused(refusal),
            },
            Err(error) => {
                if let Some(callers) = self.refused.next_line(clock::monotonic()) {
                    tracing::warn!(pid, callers, "no request: {error}");
                }
                Answer::Refused(Refusal::Request { reason: error.to_string() })
            }
        };
        let _disconnected = caller.send(&answer, None);
    }

    fn prepare(&mut self, frames: &SafeFrames, pulse: Option<Pulse>) -> Result<Watch, Refusal> {
        if let Some(Supervised { pid, .. }) = self.supervised.as_ref().filter(|daemon| daemon.connected) {
            return Err(Refusal::Busy { pid: *pid });
        }
        let pulse = pulse.ok_or(Refusal::NoHeartbeat)?;
        let opened = frames.buses.iter().map(|bus| Interface::open(bus, &mut self.open));
        let opened: Vec<Interface> = opened.collect::<Result<_, _>>().map_err(Refusal::SafeFrames)?;
        let interfaces = Interfaces::new(opened, frames.damp);
        let heartbeat = pulse.read().filter(|heartbeat| *heartbeat != AT_REST).ok_or(Refusal::NoHeartbeat)?;
        let switch = Switch::new(frames.heartbeat_timeout, heartbeat, clock::monotonic());
        Ok(Watch { pulse, switch, interfaces, stalled: false })
    }

    /// Replaces the registration of the dead daemon.
    fn supervise(&mut self, daemon: Supervised) {
        let daemon = self.supervised.insert(daemon);
        let _closed_is_seen = daemon.channel.send(&Answer::Registered, None);
        tracing::info!(pid = daemon.pid, interfaces = daemon.watch.interfaces.count(), "watching");
    }
}

fn readable(channel: Option<&Channel>) -> Readiness<'_> {
    channel.map_or(Readiness::Never, |channel| Readiness::Readable(channel.as_fd()))
}

impl Supervised {
    fn watch(&mut self, ready: Ready) {
        self.connected &= !(ready.contains(SUPERVISED) && self.channel.has_ended());
        let now = clock::monotonic();
        if self.connected && now >= self.beat {
            self.beat = now + BEAT;
            self.channel.beat();
        }
        match self.watch.step(self.connected, self.pid) {
            Some(Notice::Over(cause)) => {
                let outcome = self.watch.interfaces.outcome();
                tracing::warn!(pid = self.pid, see = "switch-acted", "{cause}: {outcome}");
            }
            Some(Notice::Stalled(cause)) => tracing::error!(
                pid = self.pid,
                see = "frames-refused",
                "{cause}, and motors keep their last command, for these interfaces refuse frames: {}. Keeps trying.",
                self.watch.interfaces.unserved().join(", ")
            ),
            None => {}
        }
    }
}

impl Watch {
    fn due(&self) -> Instant {
        let round = self.switch.acts().and_then(|_| self.interfaces.due());
        round.unwrap_or(self.switch.due())
    }

    /// Real-time, but for the calls below. One system call; when the switch begins to act, and when
    /// it is late, those of [`leave_driven`](Interfaces::leave_driven), which allocates; and while
    /// it acts those of a [round](Interfaces::round), which can block when an interface is missing.
    fn step(&mut self, connected: bool, pid: i32) -> Option<Notice> {
        let acted = self.switch.acts();
        let now = clock::monotonic();
        // A file that cannot be read counts as a heartbeat that does not change.
        let heartbeat = self.pulse.read().unwrap_or(self.switch.heartbeat());
        let late = now.since(self.due()) >= FROZEN;
        self.switch.step(now, connected, heartbeat);
        let Some(cause) = self.switch.acts() else { return acted.map(Notice::Over) };
        if acted.is_none() {
            self.interfaces.begin(now);
            self.stalled = false;
        }
        // A successor has had the time to start only if this process was frozen. Until then, and
        // while the daemon lives, its own lock is the only possible one.
        let locked = (acted.is_none() || late).then(|| self.interfaces.leave_driven(pid, late && !connected));
        self.interfaces.round(now);
        locked.iter().flatten().for_each(|locked| log_locked(pid, locked));
        if self.interfaces.due().is_none() {
            self.switch.served();
            return Some(Notice::Over(cause));
        }
        let logged = self.stalled;
        self.stalled |= self.interfaces.is_stalled();
        (self.stalled && !logged).then_some(Notice::Stalled(cause))
    }
}

/// Logs who holds a lock of the dead daemon `pid`.
fn log_locked(pid: i32, Locked { interface, holder, is_daemon }: &Locked) {
    if *is_daemon {
        tracing::warn!(pid, see = "interface-in-use", "{holder} drives {interface} now: it is left alone");
    } else {
        tracing::error!(
            pid,
            see = "lock-held",
            "{holder} holds the lock of {interface} and is no daemon of this robot: the motors there are damped all the same. To let \
             motord start, {}",
            holder.remedy()
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn idle_callers_are_counted_once_a_second() {
        let (mut refused, begun) = (Refused::default(), Instant::ZERO + Duration::from_secs(1000));
        assert_eq!(refused.next_line(begun), Some(1));
        for caller in 0..5000 {
            assert_eq!(refused.next_line(begun + caller * REFUSED_PAUSE / 5000), None);
        }
        assert_eq!(refused.next_line(begun + REFUSED_PAUSE), Some(5001));
    }
}
