//! The CAN interfaces and serial ports whose motors are stopped, each opened only to send.

use core::fmt::Display;
use motord_bus::socketcan::{InterfaceName, OpenError, Sender};
use motord_bus::{Bus, BusLock, Duration, Frame, Holder, Instant, Refusal};
use motord_core::clock::Clock;
use motord_core::stopper::{BusFrames, Outlet, Stopper};

use crate::port::Port;
use crate::safe_frames::{InterfaceError, InterfaceFrames};

/// Opens a CAN interface by name, to send up to the given number of frames at a time.
pub type Open<'a> = &'a mut dyn FnMut(&str, u32) -> Result<Box<dyn Outlet>, InterfaceError>;

/// One interface, opened.
pub struct Interface {
    name: String,
    holder: fn(&str) -> Option<Holder>,
    outlet: Box<dyn Outlet>,
    frames: BusFrames,
}

impl Interface {
    /// Checks the frames and opens the CAN interface by `open`, or the serial port in a thread of its own. Allocates.
    ///
    /// # Errors
    ///
    /// Why its motors cannot be stopped.
    pub fn open(frames: &InterfaceFrames, open: Open<'_>) -> Result<Self, InterfaceError> {
        let checked = frames.checked()?;
        let count = checked.damp.len().max(checked.stop.len());
        let outlet = match frames.baud {
            Some(baud) => Box::new(Port::open(&frames.interface, baud).map_err(|error| failed(&error))?),
            None => open(&frames.interface, 2 * count as u32)?,
        };
        let holder = match frames.baud {
            Some(_) => BusLock::holder_of_device,
            None => BusLock::holder_of_interface,
        };
        Ok(Self { name: frames.interface.clone(), holder, outlet, frames: checked })
    }

    /// The interface, or the device of the port.
    #[must_use]
    pub(crate) fn name(&self) -> &str {
        &self.name
    }
}

/// Interfaces with the [`Stopper`] of their motors.
pub struct Interfaces {
    names: Vec<String>,
    holders: Vec<fn(&str) -> Option<Holder>>,
    outlets: Vec<Box<dyn Outlet>>,
    stopper: Stopper,
}

impl Interfaces {
    /// Motors will be damped for `damp`. Nothing is due yet. Allocates; after it only [`owed`](Self::owed) and
    /// [`leave_driven`](Self::leave_driven) do.
    #[must_use]
    pub fn new(opened: impl IntoIterator<Item = Interface>, damp: Duration) -> Self {
        let (mut names, mut holders, mut outlets, mut frames) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for interface in opened {
            names.push(interface.name);
            holders.push(interface.holder);
            outlets.push(interface.outlet);
            frames.push(interface.frames);
        }
        Self { names, holders, outlets, stopper: Stopper::new(frames, damp) }
    }

    /// The number of interfaces.
    #[must_use]
    pub fn count(&self) -> usize {
        self.names.len()
    }

    /// As [`Stopper::begin`].
    pub fn begin(&mut self, now: Instant) {
        self.stopper.begin(now);
    }

    /// From now on skips the interfaces that another process than `pid` drives: their motors are not those of a dead daemon.
    /// Returns that process, if there is one. Any user can hide the holder of a lock by many connections to it: such a holder
    /// is another process if `unknown_is_other`. Allocates. At most eight system calls per interface, and a search for the path
    /// of a serial port. Blocks only where it closes a serial port of ours: at most 50 ms for each.
    pub fn leave_driven(&mut self, pid: i32, unknown_is_other: bool) -> Option<Holder> {
        let is_other = |holder: &Holder| match holder.0 {
            Some(holder) => holder.cast_signed() != pid,
            None => unknown_is_other,
        };
        let mut other = None;
        for ((name, holder), outlet) in self.names.iter().zip(&self.holders).zip(&mut self.outlets) {
            let driven = holder(name).filter(is_other);
            if driven.is_some() {
                *outlet = Box::new(LeftAlone);
                other = driven;
            }
        }
        other
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
        self.stopper.round(now, &mut self.outlets);
    }

    /// As [`Stopper::run`].
    pub fn run(&mut self, clock: &mut dyn Clock) {
        self.stopper.run(clock, &mut self.outlets);
    }

    /// Returns the interfaces that are not served yet. Allocates.
    #[must_use]
    pub fn owed(&self) -> Vec<String> {
        self.stopper.owed().map(|index| self.names[index].clone()).collect()
    }
}

/// Replaces an interface that another process drives: nothing is sent on it, and nothing is owed.
struct LeftAlone;

impl Outlet for LeftAlone {
    fn send_round(&mut self, _now: Instant, _frames: &[Frame]) -> Option<Refusal> {
        None
    }

    fn find(&mut self) -> bool {
        true
    }
}

/// A CAN interface of this machine.
struct CanInterface(Sender);

impl Outlet for CanInterface {
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        self.0.send(now, frames).refusal
    }

    fn find(&mut self) -> bool {
        self.0.find().is_ok()
    }
}

/// Opens an interface of this machine as it is.
///
/// # Errors
///
/// [`InterfaceError::Open`].
pub fn open_interface(name: &str, frames: u32) -> Result<Box<dyn Outlet>, InterfaceError> {
    let (sender, found) = prepare(name, frames)?;
    found.map_err(|error| failed(&error))?;
    Ok(Box::new(CanInterface(sender)))
}

/// Opens an interface of this machine as it is. One that is missing may appear later.
///
/// # Errors
///
/// [`InterfaceError::Open`].
pub fn expect_interface(name: &str, frames: u32) -> Result<Box<dyn Outlet>, InterfaceError> {
    let (sender, found) = prepare(name, frames)?;
    if let Err(error) = found {
        tracing::warn!(
            see = "interface-missing",
            "{error}. The switch searches for it again when it must damp its motors."
        );
    }
    Ok(Box::new(CanInterface(sender)))
}

fn prepare(name: &str, frames: u32) -> Result<(Sender, Result<(), OpenError>), InterfaceError> {
    let interface: InterfaceName = name.parse().map_err(|error| failed(&error))?;
    let mut sender = Sender::new(interface, frames).map_err(|error| failed(&error))?;
    let found = sender.find();
    Ok((sender, found))
}

fn failed(reason: &dyn Display) -> InterfaceError {
    InterfaceError::Open { reason: reason.to_string() }
}
