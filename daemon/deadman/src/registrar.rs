//! The daemon's side: registers its safe frames with the switch, and again after the switch
//! disconnected.

use crate::heartbeat::{AT_REST, Pulse};
use motord_bus::{Duration, Readiness, clock, wait};
use motord_ports::Impostor;
use motord_ports::instance::Instance;
use motord_realtime::descriptors::keep_only;
use std::io;
use std::os::fd::AsFd;

use crate::channel::{Answer, Channel, Refusal, Request, TIMEOUT};
use crate::safe_frames::SafeFrames;

/// Between two attempts to register.
const RETRY: Duration = Duration::from_secs(1);
/// How often the thread checks whether the daemon ends.
const TURN: Duration = Duration::from_millis(20);
/// A switch without a sign of life for this long hangs: a healthy one sends one every 20 ms.
const SILENCE: Duration = Duration::from_millis(80);

/// Why the daemon has no dead man's switch.
#[derive(Debug, thiserror::Error)]
enum RegistrarError {
    #[error("no process `motord deadman` runs for this instance ({0})")]
    NotThere(io::Error),
    #[error("{0}, then restart `motord deadman`")]
    Impostor(io::Error),
    #[error("`motord deadman` gives no answer ({0}): if it is of another version, restart it")]
    Unanswered(#[from] io::Error),
    #[error("`motord deadman` refuses: {0}")]
    Refused(Refusal),
    #[error("`motord deadman` gives an answer of another kind")]
    Answer,
}

impl RegistrarError {
    fn of_connection(error: io::Error) -> Self {
        match error.get_ref() {
            Some(inner) if inner.is::<Impostor>() => Self::Impostor(error),
            Some(_) | None => Self::NotThere(error),
        }
    }
}

/// Keeps a daemon registered with its dead man's switch.
pub struct Registrar {
    instance: Instance,
    frames: SafeFrames,
    pulse: Pulse,
    /// The connection from before the request on. The switch may read the request late, and treats
    /// a registered connection that is closed as a dead daemon: so this one stays open until the
    /// switch answers or closes it. It is closed when this value is dropped, not when
    /// [`run`](Self::run) ends: after a panic there, the cycle still drives its motors.
    switch: Option<Channel>,
    /// The reason of the last line of the log about a missing switch; empty while there is one.
    logged: String,
    /// Called with true when the switch is unavailable or hangs, and with false when it answers
    /// again.
    lost: Box<dyn Fn(bool) + Send>,
}

impl Registrar {
    /// Creates the registrar of the daemon of `instance`, whose heartbeat is `pulse`.
    #[must_use]
    pub fn new(instance: Instance, frames: SafeFrames, pulse: Pulse) -> Self {
        Self { instance, frames, pulse, switch: None, logged: String::new(), lost: Box::new(|_| ()) }
    }

    /// Calls `lost` when the switch becomes unavailable or answers again.
    #[must_use]
    pub fn reports(self, lost: impl Fn(bool) + Send + 'static) -> Self {
        Self { lost: Box::new(lost), ..self }
    }

    /// Runs until `stop` returns true, in a dedicated thread, which loses the descriptors of all
    /// other threads. No thread waits for it: the daemon drives its motors with or without a
    /// switch.
    pub fn run(&mut self, stop: impl Fn() -> bool) {
        // The kernel frees all memory of a killed process, which takes milliseconds, before it
        // closes the descriptors that its threads share. It closes a descriptor of this thread
        // alone immediately. If the kernel refuses the separate table, the switch detects the death
        // later.
        let _refused = keep_only(self.pulse.as_fd());
        (self.lost)(true);
        while !stop() {
            // The switch refuses a heartbeat that is at rest, and the first cycle begins within a
            // period.
            if self.pulse.read() == Some(AT_REST) {
                std::thread::sleep(TURN);
                continue;
            }
            match self.register(&stop) {
                Ok(()) => {
                    tracing::info!("dead man's switch: yes");
                    self.logged.clear();
                    (self.lost)(false);
                    if let Some(switch) = &self.switch {
                        watch(switch, &self.lost, &stop);
                    }
                    (self.lost)(true);
                }
                Err(reason) => log(&mut self.logged, &reason),
            }
            if stop() {
                return;
            }
            self.switch = None;
            let end = clock::monotonic() + RETRY;
            while !stop() && clock::monotonic() < end {
                std::thread::sleep(TURN);
            }
        }
    }

    /// Sends the request, and waits until the switch answers or disconnects, or `stop` returns
    /// true.
    fn register(&mut self, stop: &impl Fn() -> bool) -> Result<(), RegistrarError> {
        let Self { instance, frames, pulse, switch, logged, .. } = self;
        let connected = Channel::connect(instance, TIMEOUT).map_err(RegistrarError::of_connection)?;
        let switch = switch.insert(connected);
        switch.send(&Request::Register(frames.clone()), Some(pulse))?;
        loop {
            match switch.receive() {
                Ok((Answer::Registered, _)) => return Ok(()),
                Ok((Answer::Refused(refusal), _)) => return Err(RegistrarError::Refused(refusal)),
                Ok((Answer::Acting(_), _)) => return Err(RegistrarError::Answer),
                Err(error) if is_late(&error) && !stop() => log(logged, &error.into()),
                Err(error) => return Err(error.into()),
            }
        }
    }
}

/// Logs a reason once, not for each attempt. `logged` is that of the last line.
fn log(logged: &mut String, reason: &RegistrarError) {
    let reason = reason.to_string();
    if *logged != reason {
        tracing::warn!(
            see = "no-switch",
            "no dead man's switch: {reason}. If this process dies, nothing damps the robot."
        );
        *logged = reason;
    }
}

/// Returns `true` for a switch that has not answered yet, also where this process was stopped and
/// continued meanwhile.
fn is_late(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

/// Returns when the switch disconnected, or `stop` returns true. Logs when the switch hangs and
/// when it answers again, and calls `lost`.
fn watch(switch: &Channel, lost: &impl Fn(bool), stop: &impl Fn() -> bool) {
    let (mut last_seen, mut hangs) = (clock::monotonic(), false);
    while !stop() {
        let now = clock::monotonic();
        let _woken = wait(&[Readiness::Readable(switch.as_fd())], now, now + TURN);
        match switch.take_beats() {
            None => return,
            Some(true) => {
                last_seen = clock::monotonic();
                if std::mem::take(&mut hangs) {
                    lost(false);
                    tracing::warn!("the dead man's switch answers again");
                }
            }
            Some(false) if !hangs && now.since(last_seen) >= SILENCE => {
                hangs = true;
                lost(true);
                tracing::error!(
                    see = "switch-hangs",
                    "the dead man's switch hangs: if this process dies, nothing damps the robot until the switch goes on"
                );
            }
            Some(false) => {}
        }
    }
}
