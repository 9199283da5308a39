//! A last will: the frames that damp and stop every motor, made beforehand by whoever knows how.

use core::fmt::Display;
use motord_bus::socketcan::{InterfaceName, OpenError, Sender};
use motord_bus::{Bus, Duration, Frame, Inbox};
use motord_core::drive::last_frames;
use motord_core::settings::{BusKind, Settings};
use serde::{Deserialize, Serialize};

/// What to tell the motors of a daemon that cannot any more, and when.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Will {
    /// A heartbeat that stands still for this long is dead.
    pub patience: Duration,
    /// Motors are damped for this long, then stopped.
    pub damp: Duration,
    /// CAN interfaces, and the frames for each.
    pub buses: Vec<BusWill>,
}

/// The frames for one CAN interface.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BusWill {
    /// The interface.
    pub interface: String,
    /// One frame per motor that damps it.
    pub damp: Vec<WrittenFrame>,
    /// One frame per motor that stops it.
    pub stop: Vec<WrittenFrame>,
}

/// A frame on its way between processes: arbitration id and payload.
pub type WrittenFrame = (u16, [u8; 8]);

/// Why a will cannot be carried out.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
pub enum WillError {
    /// An interface cannot be opened.
    #[error("{reason}")]
    Interface {
        /// The error of the interface, as text: it comes from another process.
        reason: String,
    },
    /// An arbitration id has more than 11 bits.
    #[error("{id:#x} is no arbitration id: it has more than 11 bits")]
    Id {
        /// What was given.
        id: u16,
    },
    /// More frames for an interface than fit into one call.
    #[error("{count} motors on {interface}: at most {} fit", Inbox::CAPACITY)]
    Count {
        /// The interface.
        interface: String,
        /// How many there are.
        count: usize,
    },
}

impl Will {
    /// The will of a daemon with these settings. Simulated buses are inside the daemon and die with it; serial ones are not
    /// cycled. Neither takes part.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        let bus = |(index, bus): (usize, &_)| BusWill::of(settings, index, bus);
        Self {
            patience: settings.safety.deadman,
            damp: settings.safety.damp,
            buses: settings.buses.iter().map(|bus| &bus.kind).enumerate().filter_map(bus).collect(),
        }
    }
}

impl BusWill {
    fn of(settings: &Settings, index: usize, kind: &BusKind) -> Option<Self> {
        let BusKind::SocketCan { interface, .. } = kind else { return None };
        let motors = settings.motors.iter().filter(|motor| motor.bus == index);
        let written = |frame: Frame| Some((frame.id().raw(), frame.payload().try_into().ok()?));
        let frames = motors.filter_map(last_frames);
        let (damp, stop) = frames.filter_map(|(damp, stop)| Some((written(damp)?, written(stop)?))).unzip();
        Some(Self { interface: interface.clone(), damp, stop })
    }
}

/// Where frames leave for an interface, which may be missing for a while.
pub trait Outlet: Bus {
    /// Looks for the interface after [`Refusal::Gone`](motord_bus::Refusal::Gone), and tells whether it is there. Does not
    /// allocate; may wait while another process configures interfaces.
    fn look_for(&mut self) -> bool;
}

impl Outlet for Sender {
    fn look_for(&mut self) -> bool {
        self.find().is_ok()
    }
}

/// Opens an interface by name, to send up to so many frames at a time.
pub type Open<'a> = &'a mut dyn FnMut(&str, u32) -> Result<Box<dyn Outlet>, WillError>;

/// Opens an interface of this machine as it is.
///
/// # Errors
///
/// [`WillError::Interface`].
pub fn open_interface(name: &str, frames: u32) -> Result<Box<dyn Outlet>, WillError> {
    let (sender, found) = prepare(name, frames)?;
    found.map_err(|error| failed(&error))?;
    Ok(Box::new(sender))
}

/// The same, but one that is missing may come later.
///
/// # Errors
///
/// [`WillError::Interface`].
pub fn expect_interface(name: &str, frames: u32) -> Result<Box<dyn Outlet>, WillError> {
    let (sender, found) = prepare(name, frames)?;
    if let Err(error) = found {
        tracing::warn!("{error}. It is looked for again when its motors are to be damped.");
    }
    Ok(Box::new(sender))
}

fn prepare(name: &str, frames: u32) -> Result<(Sender, Result<(), OpenError>), WillError> {
    let interface: InterfaceName = name.parse().map_err(|error| failed(&error))?;
    let mut sender = Sender::new(interface, frames).map_err(|error| failed(&error))?;
    let found = sender.find();
    Ok((sender, found))
}

fn failed(reason: &dyn Display) -> WillError {
    WillError::Interface { reason: reason.to_string() }
}
