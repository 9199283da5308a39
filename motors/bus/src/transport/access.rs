//! The questions to a transport.

use crate::frame::FrameId;
use crate::serial;
use crate::time::Duration;
use crate::{IdFilter, IdSet};

#[cfg(feature = "linux")]
use crate::{Bus, ErrorFrame, Holder, Identity, LockError, Sent, lock::BusLock, socketcan::LinkNote};

/// The facts of a configured bus that its transport decides.
pub trait Transport {
    /// Returns its type, as configurations name it.
    fn name(&self) -> &'static str;

    /// Returns the bit rate of the wire, bit/s.
    fn bitrate(&self) -> u32;

    /// Returns the bit rate of the payload of CAN FD frames with BRS, bit/s:
    /// [`bitrate`](Self::bitrate) on a bus without a second one.
    fn data_bitrate(&self) -> u32 {
        self.bitrate()
    }

    /// Returns the longest time from the end of a request to the beginning of its reply, the host's
    /// adapter included, on a line: a bus that carries one request at a time, whose reply may
    /// arrive in a later cycle. `None` for a bus that carries the requests of all motors at a time.
    fn turnaround(&self) -> Option<Duration> {
        None
    }

    /// Returns whether it is a line: see [`turnaround`](Self::turnaround).
    fn is_line(&self) -> bool {
        self.turnaround().is_some()
    }

    /// Returns whether a reply takes at least the time of its bits.
    fn has_wire_time(&self) -> bool {
        true
    }

    /// Returns the CAN interface of Linux that it uses.
    fn interface(&self) -> Option<&str> {
        None
    }

    /// Returns the device of the serial port that it uses.
    fn port(&self) -> Option<&str> {
        None
    }

    /// Returns the text by which [`find`](super::find) finds it; `None` for a bus inside the
    /// daemon.
    fn address(&self) -> Option<&str> {
        self.interface().or_else(|| self.port())
    }

    /// Returns the bit rate that each process sets which opens it, bit/s; `None` for a bus that is
    /// used as the first process has set it.
    fn baud(&self) -> Option<u32> {
        None
    }

    /// Returns the seed of everything random in a simulated bus; `None` for another bus.
    fn seed(&self) -> Option<u64> {
        None
    }

    /// Returns whether its motors are simulated inside the daemon.
    fn is_simulated(&self) -> bool {
        self.seed().is_some()
    }

    /// Returns the settings of a serial line with these nodes; `None` for another bus. Allocates.
    fn line(&self, _nodes: &Nodes) -> Option<serial::Settings> {
        None
    }

    /// Returns the way to its adapter; `None` for a bus inside the daemon.
    #[cfg(feature = "linux")]
    fn hardware(&self) -> Option<&dyn Hardware> {
        None
    }
}

/// A motor on a bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Node {
    /// The id that the commands to it name on a line.
    pub command_id: FrameId,
    /// The id that its replies name on a line.
    pub host_id: FrameId,
    /// The frames that command it on a CAN bus.
    pub commands: IdSet,
    /// The frames that are its replies on a CAN bus.
    pub replies: IdSet,
}

/// The nodes of a bus, as its transport needs them to open it.
#[derive(Debug, Clone)]
pub struct Nodes {
    /// The motors, in the order of the configuration.
    pub motors: Vec<Node>,
    /// The ids of the frames that sensors send.
    pub sensor_ids: Vec<FrameId>,
    /// The frames of a cycle that ask sensors.
    pub requests: u32,
    /// A request on a line that is older than this no longer keeps it busy.
    pub reply_timeout: Duration,
    /// Decides whether a reply on a line answers a request.
    pub answers: serial::Answers,
}

impl Nodes {
    /// Returns no nodes: for a bus that is opened to search for them, or only to listen.
    #[must_use]
    pub fn none() -> Self {
        Self {
            motors: Vec::new(),
            sensor_ids: Vec::new(),
            requests: 0,
            reply_timeout: Duration::ZERO,
            answers: |_, _| false,
        }
    }
}

/// The adapter of a bus. Nothing here is for the real-time thread: each method allocates, and takes
/// up to some milliseconds.
#[cfg(feature = "linux")]
pub trait Hardware {
    /// Keeps other daemons away from the bus.
    ///
    /// # Errors
    ///
    /// [`Cause::Locked`] with the holder; [`Cause::Other`] when the address cannot be one.
    fn lock(&self) -> Result<BusLock, OpenError>;

    /// Returns the processes that hold the bus, as [`BusLock::holders_of_interface`] finds them.
    fn holders(&self, thorough: bool) -> [Option<Holder>; 2];

    /// Opens the bus for the cycle, for the first time or again, and sets it up as far as
    /// permitted. With `expected` it sets up no other adapter than this one.
    ///
    /// # Errors
    ///
    /// The reason for which it cannot be used, with a remedy.
    fn open(&self, nodes: &Nodes, expected: Option<Identity>) -> Result<Opened, OpenError>;

    /// Discards the frames that the kernel and the adapter keep for the wire, by taking the
    /// interface down and up. With `expected`, only on this adapter. Returns whether it did: not
    /// where no frame waits. A serial line keeps at most the request that is open.
    ///
    /// # Errors
    ///
    /// The reason for which the frames may be sent later, with a remedy.
    fn discard_queue(&self, _expected: Option<Identity>) -> Result<bool, OpenError> {
        Ok(false)
    }

    /// Returns the error for a bus whose address no adapter has. `None` where an adapter has it by
    /// now; it may be another one than before.
    fn absent(&self, nodes: &Nodes) -> Option<OpenError> {
        self.open(nodes, None).err()
    }

    /// Opens the bus for a tool, which searches for motors: as it is, and to receive every frame.
    ///
    /// # Errors
    ///
    /// The reason for which it cannot be used, with a remedy.
    fn open_as_is(&self, nodes: &Nodes) -> Result<OpenedAsIs, OpenError>;

    /// Opens the bus as it is, to send up to `frames` at a time and receive nothing, for the stop
    /// of motors whose daemon has died. An adapter that is missing may come later.
    ///
    /// # Errors
    ///
    /// The system refuses it. A bus with a [`baud`](Transport::baud) has no such sender: it must be
    /// opened in a thread of its own.
    fn sender(&self, frames: u32) -> Result<OpenedSender, OpenError>;

    /// Returns whether the bus must be closed before it is opened again.
    fn closes_before_reopening(&self) -> bool {
        false
    }

    /// Returns whether the bus delivers the frames that other senders send to its motors.
    fn shows_other_senders(&self) -> bool {
        false
    }

    /// Returns the way to its motors' end, for a program that simulates them. `None` where they are
    /// at the other end of a cable, such as a serial line: a simulator then serves a device of its
    /// own.
    fn motors_end(&self) -> Option<&dyn MotorsEnd> {
        None
    }
}

/// The motors' end of a bus.
#[cfg(feature = "linux")]
pub trait MotorsEnd {
    /// Keeps other simulators away from it. Its driver may hold [`Hardware::lock`].
    ///
    /// # Errors
    ///
    /// As [`Hardware::lock`].
    fn lock(&self) -> Result<BusLock, OpenError>;

    /// Opens it, to receive the frames with these ids.
    ///
    /// # Errors
    ///
    /// The reason for which it cannot be used, with a remedy.
    fn open(&self, received: &[IdFilter]) -> Result<Box<dyn MotorsBus>, OpenError>;
}

/// The motors' end of a bus, open. No method but those of [`Bus`] is for the real-time thread.
#[cfg(feature = "linux")]
pub trait MotorsBus: Bus {
    /// Replaces the ids of the frames that it receives. Allocates.
    ///
    /// # Errors
    ///
    /// The system rejects them. The previous ones stay.
    fn listen(&mut self, received: &[IdFilter]) -> Result<(), OpenError>;

    /// Sends `error` as the driver's controller would report it, where the transport can.
    fn report(&mut self, error: &ErrorFrame) -> Sent;
}

/// An open bus.
#[cfg(feature = "linux")]
pub struct Opened {
    /// The bus.
    pub bus: Box<dyn Bus>,
    /// The adapter that was opened, where the bus reports it.
    pub identity: Option<Identity>,
    /// Remarks on the adapter, for the log.
    pub notes: Vec<LinkNote>,
}

#[cfg(feature = "linux")]
impl Opened {
    /// Returns an open bus without remarks.
    #[must_use]
    pub fn plain(bus: impl Bus + 'static) -> Self {
        Self { bus: Box::new(bus), identity: None, notes: Vec::new() }
    }
}

/// A bus that is open for a tool.
#[cfg(feature = "linux")]
pub struct OpenedAsIs {
    /// The bus.
    pub bus: Box<dyn Bus>,
    /// The bit rate that the adapter reports, bit/s.
    pub bitrate: Option<u32>,
    /// The adapter has a bit rate that it does not report: another program set it.
    pub hides_bitrate: bool,
}

/// A bus that only sends, and finds its adapter again.
#[cfg(feature = "linux")]
pub trait SendingBus: Bus {
    /// Searches the adapter after [`Refusal::Gone`](crate::Refusal::Gone). Returns whether it is
    /// there. Does not allocate; may wait while another process configures adapters.
    fn find(&mut self) -> bool;
}

/// A bus that is open to send.
#[cfg(feature = "linux")]
pub struct OpenedSender {
    /// The bus.
    pub bus: Box<dyn SendingBus>,
    /// The reason for which it sends nothing yet; `None` where the adapter is there.
    pub missing: Option<OpenError>,
}

/// The kind of reason for which a bus cannot be opened.
#[cfg(feature = "linux")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// The adapter is missing or down, and may come by itself.
    Absent,
    /// Another process has the lock of the bus.
    Locked,
    /// Another program uses the adapter.
    Busy,
    /// This user or service has no permission.
    Forbidden,
    /// Any other reason.
    Other,
}

/// The reason for which a bus cannot be opened.
#[cfg(feature = "linux")]
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{reason}")]
pub struct OpenError {
    cause: Cause,
    reason: String,
    holder: Option<Holder>,
}

#[cfg(feature = "linux")]
impl OpenError {
    /// Returns the error with the sentence `reason`, which names the adapter and a remedy.
    pub(super) fn new(cause: Cause, reason: impl ToString) -> Self {
        Self { cause, reason: reason.to_string(), holder: None }
    }

    /// Returns the kind of reason.
    #[must_use]
    pub const fn cause(&self) -> Cause {
        self.cause
    }

    /// Returns the process that has the lock of the bus.
    #[must_use]
    pub const fn holder(&self) -> Option<Holder> {
        self.holder
    }
}

#[cfg(feature = "linux")]
impl From<LockError> for OpenError {
    fn from(error: LockError) -> Self {
        let (cause, holder) = match error {
            LockError::Held { holder, .. } => (Cause::Locked, Some(holder)),
            LockError::System { .. } => (Cause::Other, None),
        };
        Self { holder, ..Self::new(cause, error) }
    }
}
