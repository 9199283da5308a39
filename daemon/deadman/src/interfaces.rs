//! The CAN interfaces and serial ports whose motors are stopped, each opened only to send.

use core::fmt::Display;
use motord_bus::transport::{self, BusKind, OpenedSender, SendingBus};
use motord_bus::{Clock, Duration, Frame, Holder, Instant, Refusal};
use motord_core::stopper::{BusFrames, Outlet, Stopper};
use nix::unistd::geteuid;

use crate::port::Port;
use crate::safe_frames::{InterfaceError, InterfaceFrames};

/// Opens a bus without a thread of its own by its address, to send up to the given number of frames
/// at a time.
pub type Open<'a> = &'a mut dyn FnMut(&str, u32) -> Result<Box<dyn Outlet>, InterfaceError>;

/// One interface, opened.
pub struct Interface {
    line: InterfaceOutlet,
    frames: BusFrames,
}

impl Interface {
    /// Checks the frames and opens the bus by `open`, or the serial port in a thread of its own.
    /// Allocates.
    ///
    /// # Errors
    ///
    /// Why its motors cannot be stopped.
    pub fn open(frames: &InterfaceFrames, open: Open<'_>) -> Result<Self, InterfaceError> {
        let checked = frames.checked()?;
        let count = checked.most();
        let outlet = match frames.baud {
            Some(baud) => Box::new(Port::open(&frames.interface, baud).map_err(|error| failed(&error))?),
            None => open(&frames.interface, 2 * count as u32)?,
        };
        let line = InterfaceOutlet {
            name: frames.interface.clone(),
            kind: frames.kind(),
            outlet: Some(outlet),
            accepted: false,
        };
        Ok(Self { line, frames: checked })
    }

    /// The interface, or the device of the port.
    #[must_use]
    pub(crate) fn name(&self) -> &str {
        &self.line.name
    }
}

/// Returns the holders of the locks of one interface: see
/// [`motord_bus::transport::Hardware::holders`].
pub(crate) fn holders_of(kind: Option<&BusKind>, thorough: bool) -> [Option<Holder>; 2] {
    let hardware = kind.and_then(|kind| kind.hardware());
    hardware.map_or([None; 2], |hardware| hardware.holders(thorough))
}

/// The way to the motors of one interface.
struct InterfaceOutlet {
    name: String,
    /// `None` for a name that no bus can have.
    kind: Option<BusKind>,
    /// `None` once its motors are left to another daemon: nothing is sent, and none of it is
    /// unserved.
    outlet: Option<Box<dyn Outlet>>,
    /// The interface has accepted a round since the stopper began.
    accepted: bool,
}

impl Outlet for InterfaceOutlet {
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        let refusal = self.outlet.as_mut()?.send_round(now, frames);
        self.accepted |= refusal.is_none();
        refusal
    }

    fn find(&mut self) -> bool {
        self.outlet.as_mut().is_none_or(Outlet::find)
    }
}

/// Another process than the daemon holds the lock of an interface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Locked {
    /// The interface.
    pub interface: String,
    /// The process.
    pub holder: Holder,
    /// It is a daemon: the motors are left to it. Otherwise they are damped.
    pub is_daemon: bool,
}

/// Interfaces with the [`Stopper`] of their motors.
pub struct Interfaces {
    lines: Vec<InterfaceOutlet>,
    stopper: Stopper,
}

impl Interfaces {
    /// Motors will be damped for `damp`. Nothing is due yet. Allocates; after it only
    /// [`unserved`](Self::unserved), [`leave_driven`](Self::leave_driven) and
    /// [`outcome`](Self::outcome) do.
    #[must_use]
    pub fn new(opened: impl IntoIterator<Item = Interface>, damp: Duration) -> Self {
        let (lines, frames): (Vec<_>, Vec<_>) =
            opened.into_iter().map(|interface| (interface.line, interface.frames)).unzip();
        Self { lines, stopper: Stopper::new(frames, damp) }
    }

    /// The number of interfaces.
    #[must_use]
    pub fn count(&self) -> usize {
        self.lines.len()
    }

    /// As [`Stopper::begin`].
    pub fn begin(&mut self, now: Instant) {
        self.lines.iter_mut().for_each(|line| line.accepted = false);
        self.stopper.begin(now);
    }

    /// From now on skips the interfaces that a successor of the dead daemon `dead` drives. Any user
    /// may hold the lock of an interface: a successor is a process of root or of this user, as
    /// which alone a daemon registers. Returns the processes that hold a lock, those that are no
    /// successors included.
    ///
    /// A successor has had the time to start only if this process `was_frozen`. Then the kernel is
    /// asked for the user of a process that hides, and one in another process namespace may be a
    /// successor. A process of unknown user never is, nor one with the number of the dead daemon:
    /// motors that keep their last command are the greater harm.
    ///
    /// Allocates. At most twelve system calls per interface, and a search for the path of a serial
    /// port. Blocks only where it closes a serial port of ours, at most 50 ms for each, and where a
    /// process hides, at most 80 ms for each.
    pub fn leave_driven(&mut self, dead: i32, was_frozen: bool) -> Vec<Locked> {
        let mut found = Vec::new();
        for line in &mut self.lines {
            for holder in holders_of(line.kind.as_ref(), was_frozen).into_iter().flatten() {
                let is_other = holder.pid.map_or(was_frozen, |pid| pid.cast_signed() != dead);
                let is_trusted = holder.uid.is_some_and(is_of_a_daemon);
                if is_trusted && !is_other {
                    continue;
                }
                if is_trusted {
                    line.outlet = None;
                }
                found.push(Locked { interface: line.name.clone(), holder, is_daemon: is_trusted });
            }
        }
        found
    }

    /// As [`Stopper::due`].
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        self.stopper.due()
    }

    /// As [`Stopper::is_stalled`].
    #[must_use]
    pub fn is_stalled(&self) -> bool {
        self.stopper.is_stalled()
    }

    /// As [`Stopper::round`]. One system call per interface; a search is five more and a send.
    pub fn round(&mut self, now: Instant) {
        self.stopper.round(now, &mut self.lines);
    }

    /// As [`Stopper::run`].
    pub fn run(&mut self, clock: &mut dyn Clock) {
        self.stopper.run(clock, &mut self.lines);
    }

    /// Returns the interfaces that are not served yet. Allocates.
    #[must_use]
    pub fn unserved(&self) -> Vec<String> {
        self.stopper.unserved().map(|index| self.lines[index].name.clone()).collect()
    }

    /// Returns what was done since the stopper began, for the log. Allocates.
    #[must_use]
    pub fn outcome(&self) -> String {
        let names = |of: fn(&InterfaceOutlet) -> bool| {
            let names: Vec<_> =
                self.lines.iter().filter(|line| of(line)).map(|line| line.name.as_str()).collect();
            (!names.is_empty()).then(|| names.join(", "))
        };
        let damped = names(|line| line.outlet.is_some() && line.accepted);
        let refused = names(|line| line.outlet.is_some() && !line.accepted);
        let left = names(|line| line.outlet.is_none());
        let parts = [
            damped.map(|names| format!("damped or stopped its motors on {names}")),
            refused.map(|names| format!("no frame was accepted by {names}")),
            left.map(|names| format!("left alone, for another daemon drives them: {names}")),
        ];
        parts.into_iter().flatten().collect::<Vec<_>>().join("; ")
    }
}

/// Returns true for a user as which a daemon can be registered here.
fn is_of_a_daemon(uid: u32) -> bool {
    uid == 0 || uid == geteuid().as_raw()
}

/// A bus of this machine.
struct Sending(Box<dyn SendingBus>);

impl Outlet for Sending {
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        self.0.send(now, frames).refusal
    }

    fn find(&mut self) -> bool {
        self.0.find()
    }
}

/// Opens an interface of this machine as it is.
///
/// # Errors
///
/// [`InterfaceError::Open`].
pub fn open_interface(name: &str, frames: u32) -> Result<Box<dyn Outlet>, InterfaceError> {
    let OpenedSender { bus, missing } = prepare(name, frames)?;
    missing.map_or_else(|| Ok(Box::new(Sending(bus)) as Box<dyn Outlet>), |error| Err(failed(&error)))
}

/// Opens an interface of this machine as it is. One that is missing may appear later.
///
/// # Errors
///
/// [`InterfaceError::Open`].
pub fn expect_interface(name: &str, frames: u32) -> Result<Box<dyn Outlet>, InterfaceError> {
    let OpenedSender { bus, missing } = prepare(name, frames)?;
    if let Some(error) = missing {
        tracing::warn!(
            see = "interface-missing",
            "{error}. The switch searches for it again when it must damp its motors."
        );
    }
    Ok(Box::new(Sending(bus)))
}

fn prepare(name: &str, frames: u32) -> Result<OpenedSender, InterfaceError> {
    let kind = transport::find(name, 0);
    let hardware = kind.as_ref().and_then(|kind| kind.hardware());
    let hardware = hardware.ok_or_else(|| failed(&format!("{name:?} is no address of a bus")))?;
    hardware.sender(frames).map_err(|error| failed(&error))
}

fn failed(reason: &dyn Display) -> InterfaceError {
    InterfaceError::Open { reason: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::BusLock;

    struct Taking(Option<Refusal>);

    impl Outlet for Taking {
        fn send_round(&mut self, _now: Instant, _frames: &[Frame]) -> Option<Refusal> {
            self.0
        }
    }

    /// Goal: the log claims no frame that was not sent.
    #[test]
    fn outcome_names_damped_refused_and_left_interfaces() {
        let [damped, jammed, driven] = ["a", "b", "c"].map(|name| format!("{name}{}", std::process::id()));
        let opened =
            [(&damped, None), (&jammed, Some(Refusal::Full)), (&driven, None)].map(|(name, refusal)| {
                let frames = InterfaceFrames {
                    interface: name.clone(),
                    baud: None,
                    damp: [vec!["001#00".into()], vec!["001#00".into()]],
                    stop: vec![],
                };
                Interface::open(&frames, &mut |_, _| Ok(Box::new(Taking(refusal)))).unwrap()
            });
        let mut interfaces = Interfaces::new(opened, Duration::ZERO);
        let _successor = BusLock::interface(driven.parse().unwrap()).unwrap();
        interfaces.begin(Instant::ZERO);
        let left = interfaces.leave_driven(0, false);
        assert_eq!(left.len(), 1);
        assert!(left[0].is_daemon && left[0].interface == driven, "{left:?}");
        interfaces.round(Instant::ZERO);
        let expected = format!(
            "damped or stopped its motors on {damped}; no frame was accepted by {jammed}; left alone, for another daemon drives them: \
             {driven}"
        );
        assert_eq!(interfaces.outcome(), expected);
    }
}
