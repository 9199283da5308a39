//! `motord safe-stop`: damps and stops every motor once, when neither the daemon nor its dead man's switch did.

use crate::config::{self, ConfigError};
use crate::deadman::channel::{Answer, Channel, Request};
use crate::deadman::switch::Switch;
use crate::deadman::will::{BusWill, Executor, Open, Will, WillError};
use motord_bus::socketcan::{InterfaceLock, LockError};
use motord_bus::{Duration, clock};
use motord_shared::instance::Instance;
use std::io;
use std::path::Path;

/// systemd waits for this program before it starts the daemon again.
const DAMP_MAX: Duration = Duration::from_secs(1);
/// A switch that acts needs so much longer than its damping.
const SWITCH_MARGIN: Duration = Duration::from_secs(1);
const SWITCH_TURN: Duration = Duration::from_millis(50);

/// Why not every motor was told to stop.
#[derive(Debug, thiserror::Error)]
pub enum SafeStopError {
    /// The configuration is refused: there is nothing to go by.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// These interfaces were left out; the motors on all others were told.
    #[error("not told to stop: {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    LeftOut(Vec<LeftOut>),
}

/// Why an interface was left out.
#[derive(Debug, thiserror::Error)]
pub enum LeftOut {
    /// A daemon that lives drives it.
    #[error("{0}; use `motorctl estop`")]
    Driven(LockError),
    /// It cannot be opened.
    #[error("{0}")]
    Will(#[from] WillError),
}

impl SafeStopError {
    /// The exit status, by `sysexits.h`.
    #[must_use]
    pub const fn exit_status(&self) -> u8 {
        match self {
            Self::Config(_) => 78,
            Self::LeftOut(_) => 69,
        }
    }
}

/// Damps and stops the motors on every CAN interface of a configuration, which takes at most a second. Interfaces are
/// used as they are. Leaves the work to a dead man's switch that is at it already, and waits for its end: two senders
/// would stop each other's damping, and so would the daemon that systemd starts next. `open` opens an interface to send.
///
/// # Errors
///
/// Which interfaces were left out, and why. The others are served all the same.
pub fn safe_stop(path: &Path, open: Open<'_>) -> Result<(), SafeStopError> {
    let settings = config::load(path)?.settings;
    let will = Will::of(&settings);
    let instance = Instance::find(&settings.instance).ok();
    if instance.as_ref().is_some_and(|instance| await_switch(instance, will.damp + SWITCH_MARGIN)) {
        tracing::info!("the dead man's switch stopped the motors");
        return Ok(());
    }
    let directory = instance.as_ref().map(Instance::runtime);
    let (mut ready, mut left_out) = (Vec::new(), Vec::new());
    for bus in &will.buses {
        match prepare(bus, directory, open) {
            Ok(bus) => ready.push(bus),
            Err(reason) => left_out.push(reason),
        }
    }
    carry_out(&mut ready, will.damp.min(DAMP_MAX));
    if left_out.is_empty() { Ok(()) } else { Err(SafeStopError::LeftOut(left_out)) }
}

/// Waits while the switch acts, at most for `patience`. Tells whether it did.
fn await_switch(instance: &Instance, patience: Duration) -> bool {
    let end = clock::monotonic() + patience;
    let mut acted = false;
    while switch_acts(instance).unwrap_or(false) && clock::monotonic() < end {
        acted = true;
        std::thread::sleep(SWITCH_TURN);
    }
    acted
}

fn switch_acts(instance: &Instance) -> io::Result<bool> {
    let switch = Channel::connect(instance)?;
    switch.send(&Request::AskWhetherActing, None)?;
    let (answer, _) = switch.receive()?;
    Ok(matches!(answer, Answer::Acting(true)))
}

/// An interface that is nobody else's while it is held.
struct Ready {
    executor: Executor,
    _lock: Option<InterfaceLock>,
}

fn prepare(bus: &BusWill, directory: Option<&Path>, open: Open<'_>) -> Result<Ready, LeftOut> {
    let interface = bus.interface.parse().ok();
    let lock = match directory.zip(interface).map(|(directory, name)| InterfaceLock::acquire(directory, name))
    {
        Some(Err(held @ LockError::Held { .. })) => return Err(LeftOut::Driven(held)),
        // Without a directory for locks there is no daemon that could hold one.
        Some(Err(LockError::File { .. })) | None => None,
        Some(Ok(lock)) => Some(lock),
    };
    Ok(Ready { executor: Executor::new(bus, open)?, _lock: lock })
}

fn carry_out(ready: &mut [Ready], damp: Duration) {
    let mut switch = Switch::asked(damp, clock::monotonic());
    while !ready.is_empty() && switch.acts().is_some() {
        clock::sleep_until(switch.due());
        let now = clock::monotonic();
        if let Some(order) = switch.step(now, false, switch.heartbeat()) {
            ready.iter_mut().for_each(|ready| ready.executor.carry_out(order, now));
        }
    }
}
