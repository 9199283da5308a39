//! `motord safe-stop`: damps and stops every motor once, when neither the daemon nor its dead man's
//! switch did.

use crate::answers::{Answers, Listen};
use crate::channel::{Answer, Channel, Request};
use crate::interfaces::{Interface, Interfaces, Open, holders_of};
use crate::safe_frames::{InterfaceError, InterfaceFrames, SafeFrames};
use motord_bus::transport::Hardware;
use motord_bus::{BusLock, Duration, Holder, LockError, Monotonic, clock};
use motord_configuration::{self as config, ConfigError};
use motord_core::stopper::REFUSAL_TIMEOUT;
use motord_ports::TrustedUsers;
use motord_ports::instance::Instance;
use motord_terminal::exit_status;
use std::io;
use std::path::Path;

/// systemd waits for this program before it starts the daemon again.
const DAMP_MAX: Duration = Duration::from_secs(1);
/// A switch that does not answer within this time hangs, and the motors are stopped without it. A
/// healthy one answers within a millisecond.
const SWITCH_TIMEOUT: Duration = Duration::from_millis(150);
/// Period of the requests whether the dead man's switch still acts.
const SWITCH_TURN: Duration = Duration::from_millis(50);

/// Why not every motor was commanded to stop.
#[derive(Debug, thiserror::Error)]
pub enum SafeStopError {
    /// The configuration is refused: the motors are unknown.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// These interfaces were left out; the motors on all others were commanded to stop. Those with
    /// these names did not answer.
    #[error("not told to stop: {}{}", reasons(.0), also_silent(.1))]
    LeftOut(Vec<LeftOut>, Vec<String>),
    /// Every motor was commanded to stop, and these did not answer.
    #[error("the stop was sent, {}", silent(.0))]
    MotorsSilent(Vec<String>),
}

/// Why an interface was left out.
#[derive(Debug, thiserror::Error)]
pub enum LeftOut {
    /// A daemon that lives drives it.
    #[error("{0}; if it is motord, use `motorctl estop`")]
    Driven(LockError),
    /// It cannot be opened.
    #[error("{0}")]
    Interface(#[from] InterfaceError),
    /// It did not take all of its frames in time.
    #[error("{interface} refuses frames")]
    Refused {
        /// The interface.
        interface: String,
    },
    /// The same, and the dead man's switch keeps trying.
    #[error("{interface} refuses frames; the dead man's switch keeps trying")]
    Awaited {
        /// The interface.
        interface: String,
    },
}

fn reasons(left_out: &[LeftOut]) -> String {
    left_out.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

fn silent(motors: &[String]) -> String {
    let motors = motors.join(", ");
    format!("but these motors do not answer and may still move, so cut the power: {motors}")
}

fn also_silent(motors: &[String]) -> String {
    if motors.is_empty() {
        String::new()
    } else {
        format!("; on the others the stop was sent, {}", silent(motors))
    }
}

impl SafeStopError {
    /// The exit status, by `sysexits.h`.
    #[must_use]
    pub const fn exit_status(&self) -> u8 {
        match self {
            Self::Config(_) => exit_status::CONFIG,
            Self::LeftOut(..) => exit_status::UNAVAILABLE,
            Self::MotorsSilent(_) => exit_status::MOTORS_SILENT,
        }
    }
}

/// Damps and stops the motors on every CAN interface and serial port of a configuration, which
/// takes at most two seconds, and half a second more where motors on a line do not answer. Uses
/// interfaces as they are. Leaves the work to a dead man's switch that already acts, and waits for
/// its end, at most [`REFUSAL_TIMEOUT`] longer than its damping: two senders would end each other's
/// damping, and so would the daemon that systemd starts next. Any user may hold the lock of an
/// interface: only a process of root, of this user, or of the user of the daemon or the service
/// keeps it from this command. `open` opens an interface to send, `listen` to receive the answers.
///
/// # Errors
///
/// The interfaces that were left out or refused, and why. The others are served. The motors that
/// did not answer.
pub fn safe_stop(path: &Path, open: Open<'_>, listen: Listen<'_>) -> Result<(), SafeStopError> {
    let settings = config::load(path)?.settings;
    let frames = SafeFrames::of(&settings);
    let instance = Instance::find(&settings.instance).ok();
    let trusted = instance.iter().fold(TrustedUsers::find(), TrustedUsers::and_of);
    if let Some(unserved) =
        instance.as_ref().and_then(|instance| await_switch(instance, frames.damp + REFUSAL_TIMEOUT))
    {
        tracing::info!("left to the dead man's switch");
        return report(
            unserved.into_iter().map(|interface| LeftOut::Awaited { interface }).collect(),
            Vec::new(),
        );
    }
    // The locks keep a daemon that starts from driving these interfaces until their motors are
    // stopped.
    let (mut opened, mut locks, mut left_out) = (Vec::new(), Vec::new(), Vec::new());
    for bus in &frames.buses {
        match prepare(bus, &trusted, open) {
            Ok((interface, lock)) => {
                opened.push(interface);
                locks.push(lock);
            }
            Err(reason) => left_out.push(reason),
        }
    }
    let names: Vec<_> = opened.iter().map(|interface| interface.name().to_owned()).collect();
    let mut answers = Answers::listen(&settings, &names, listen);
    let mut interfaces = Interfaces::new(opened, frames.damp.min(DAMP_MAX));
    interfaces.run(&mut Monotonic);
    let refused = interfaces.unserved();
    // Closes the ports.
    drop(interfaces);
    // Motors of an interface that refuses frames were not commanded.
    let silent = answers.silent(&refused);
    left_out.extend(refused.into_iter().map(|interface| LeftOut::Refused { interface }));
    match answers.unchecked() {
        _ if !left_out.is_empty() || !silent.is_empty() => {}
        [] => tracing::info!("every motor was commanded to damp and stop, and answered"),
        motors => tracing::warn!(
            "every motor was commanded to damp and stop. The answers of these motors could not be read: check them, or cut the power: {}",
            motors.join(", ")
        ),
    }
    report(left_out, silent)
}

fn report(left_out: Vec<LeftOut>, silent: Vec<String>) -> Result<(), SafeStopError> {
    match (left_out.is_empty(), silent.is_empty()) {
        (true, true) => Ok(()),
        (true, false) => Err(SafeStopError::MotorsSilent(silent)),
        (false, _) => Err(SafeStopError::LeftOut(left_out, silent)),
    }
}

/// Waits while the switch acts, at most for `timeout`. Returns the interfaces that it has not
/// served by then; `None` when the switch does not act, hangs, or exits before its end.
fn await_switch(instance: &Instance, timeout: Duration) -> Option<Vec<String>> {
    let end = clock::monotonic() + timeout;
    let mut unserved = unserved_by_switch(instance).ok().filter(|unserved| !unserved.is_empty())?;
    while !unserved.is_empty() && clock::monotonic() < end {
        std::thread::sleep(SWITCH_TURN);
        unserved = unserved_by_switch(instance).ok()?;
    }
    Some(unserved)
}

fn unserved_by_switch(instance: &Instance) -> io::Result<Vec<String>> {
    let switch = Channel::connect(instance, SWITCH_TIMEOUT).inspect_err(|error| {
        if error.kind() == io::ErrorKind::PermissionDenied {
            tracing::warn!(see = "no-switch", "{error}");
        }
    })?;
    switch.send(&Request::AskWhetherActing, None)?;
    match switch.receive()?.0 {
        Answer::Acting(unserved) => Ok(unserved),
        Answer::Registered | Answer::Refused(_) => Err(io::ErrorKind::InvalidData.into()),
    }
}

/// Opens an interface or a port, with its lock. While the lock is held, no daemon of any user or
/// runtime directory drives it. Where the kernel gives no lock, or a process holds it that is no
/// daemon, the motors are stopped without one.
fn prepare(
    bus: &InterfaceFrames,
    trusted: &TrustedUsers,
    open: Open<'_>,
) -> Result<(Interface, Option<BusLock>), LeftOut> {
    if bus.baud.is_some() && !Path::new(&bus.interface).exists() {
        let reason = format!("{}: there is no such device", bus.interface);
        return Err(InterfaceError::Open { reason }.into());
    }
    let kind = bus.kind();
    let lock = match kind.as_ref().and_then(|kind| kind.hardware()).map(Hardware::lock) {
        Some(Err(error)) => {
            error.holder().map_or(Ok(()), |holder| refuse_driven(bus, holder, trusted))?;
            None
        }
        None => None,
        Some(Ok(lock)) => Some(lock),
    };
    Ok((Interface::open(bus, open)?, lock))
}

/// Refuses an interface that a daemon drives: a process of a trusted user, `holder` or the one that
/// holds its other name. Logs any other process.
fn refuse_driven(bus: &InterfaceFrames, holder: Holder, trusted: &TrustedUsers) -> Result<(), LeftOut> {
    let others = holders_of(bus.kind().as_ref(), true);
    let holders = || others.into_iter().flatten().chain([holder]);
    if let Some(holder) = holders().find(|holder| holder.uid.is_some_and(|uid| trusted.contains(uid))) {
        return Err(LeftOut::Driven(LockError::Held { bus: bus.interface.clone(), holder }));
    }
    tracing::warn!(
        see = "lock-held",
        "{holder} holds the lock of {} and is no daemon of this robot: the motors there are damped and stopped all the same. If it \
         drives them, they may move again: {}",
        bus.interface,
        holder.remedy()
    );
    Ok(())
}
