//! The daemon's side: leaves its will with the switch, and does so again whenever the switch is gone.

use crate::deadman::heartbeat::{AT_REST, Pulse};
use crate::host::kernel;
use motord_bus::{Duration, Readiness, clock, wait};
use motord_shared::instance::Instance;
use std::io;
use std::os::fd::AsFd;

use super::channel::{Answer, Channel, Refusal, Request};
use super::will::Will;

/// Between two tries.
const RETRY: Duration = Duration::from_secs(1);
/// How often the thread looks whether the daemon ends.
const TURN: Duration = Duration::from_millis(50);

/// Why the daemon has no dead man's switch.
#[derive(Debug, thiserror::Error)]
enum RegistrarError {
    #[error("no process `motord deadman` runs for this instance ({0})")]
    NotThere(#[from] io::Error),
    #[error("`motord deadman` refuses: {0}")]
    Refused(Refusal),
    #[error("`motord deadman` answers something else")]
    Answer,
}

/// Keeps a daemon's will with the dead man's switch.
#[derive(Debug)]
pub struct Registrar {
    instance: Instance,
    will: Will,
    pulse: Pulse,
    /// Closed with this value, not when `run` ends: a panic in it must not set the switch on a cycle that lives.
    switch: Option<Channel>,
    told: bool,
}

impl Registrar {
    /// For the daemon of `instance`, whose heartbeat is `pulse`.
    #[must_use]
    pub fn new(instance: Instance, will: Will, pulse: Pulse) -> Self {
        Self { instance, will, pulse, switch: None, told: false }
    }

    /// Runs until `stop` says so, in a thread of its own, which loses the descriptors of all others. Nothing waits for it:
    /// the daemon drives its motors with or without a switch.
    pub fn run(&mut self, stop: impl Fn() -> bool) {
        // A killed process closes what its threads share after it has given back all of its memory, which takes
        // milliseconds. What only this thread has is closed at once. Refused, the switch hears of the death later.
        let _later = kernel::keep_only(self.pulse.as_fd());
        while !stop() {
            match self.register() {
                Ok(switch) => {
                    tracing::info!("dead man's switch: yes");
                    self.told = false;
                    let switch = self.switch.insert(switch);
                    while !stop() && !has_ended(switch) {}
                    self.switch = None;
                }
                Err(reason) if !self.told => {
                    tracing::warn!(
                        "no dead man's switch: {reason}. If this process dies, nothing damps the robot."
                    );
                    self.told = true;
                }
                Err(_) => {}
            }
            let end = clock::monotonic() + RETRY;
            while !stop() && clock::monotonic() < end {
                std::thread::sleep(TURN);
            }
        }
    }

    fn register(&self) -> Result<Channel, RegistrarError> {
        // The switch watches nobody who is at rest, and the first cycle begins within a period.
        while self.pulse.read() == Some(AT_REST) {
            std::thread::sleep(TURN);
        }
        let switch = Channel::connect(&self.instance)?;
        switch.send(&Request::Register(self.will.clone()), Some(&self.pulse))?;
        match switch.receive()?.0 {
            Answer::Registered => Ok(switch),
            Answer::Refused(refusal) => Err(RegistrarError::Refused(refusal)),
            Answer::Acting(_) => Err(RegistrarError::Answer),
        }
    }
}

/// Looks after at most [`TURN`].
fn has_ended(switch: &Channel) -> bool {
    let now = clock::monotonic();
    wait(&[Readiness::Readable(switch.as_fd())], now, now + TURN).any() && switch.has_ended()
}
