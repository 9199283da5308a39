//! Classic CAN frames with an 11-bit identifier, and reports of a controller about the bus.
//!
//! A serial bus uses the same [`Frame`]: its identifier is the address byte of the RS485 header.

use crate::time::Instant;

/// The arbitration id of a standard frame: 11 bits, the lower the more urgent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FrameId(u16);

impl From<u8> for FrameId {
    fn from(id: u8) -> Self {
        Self(id.into())
    }
}

impl FrameId {
    /// The largest id, 0x7FF.
    pub const MAX: Self = Self(0x7FF);

    /// `None` when `raw` has more than 11 bits.
    #[must_use]
    pub const fn new(raw: u16) -> Option<Self> {
        if raw <= Self::MAX.0 { Some(Self(raw)) } else { None }
    }

    /// The id as a number, 0 to 0x7FF.
    #[must_use]
    pub const fn raw(self) -> u16 {
        self.0
    }
}

/// A data frame with 0 to 8 bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    id: FrameId,
    len: u8,
    data: [u8; 8],
}

impl Frame {
    /// `None` when `payload` is longer than 8 bytes.
    #[must_use]
    pub fn new(id: FrameId, payload: &[u8]) -> Option<Self> {
        let mut data = [0; 8];
        data.get_mut(..payload.len())?.copy_from_slice(payload);
        Some(Self { id, len: payload.len() as u8, data })
    }

    /// A frame with all 8 bytes, as every command to a motor is.
    #[must_use]
    pub const fn full(id: FrameId, data: [u8; 8]) -> Self {
        Self { id, len: 8, data }
    }

    /// `None` when `len` is more than 8. The bytes of `data` beyond it are dropped.
    #[must_use]
    #[inline]
    pub const fn cut(id: FrameId, len: u8, data: [u8; 8]) -> Option<Self> {
        let kept = match len {
            0 => 0,
            1..=8 => u64::MAX >> (64 - 8 * len as u32),
            _ => return None,
        };
        Some(Self { id, len, data: (u64::from_le_bytes(data) & kept).to_le_bytes() })
    }

    /// The bytes, and zeros up to the eighth.
    #[must_use]
    pub const fn padded(&self) -> [u8; 8] {
        self.data
    }

    /// The arbitration id.
    #[must_use]
    pub const fn id(&self) -> FrameId {
        self.id
    }

    /// The bytes: as many as the DLC says.
    #[must_use]
    #[inline]
    pub fn payload(&self) -> &[u8] {
        &self.data[..usize::from(self.len)]
    }
}

impl core::fmt::Debug for Frame {
    /// As `candump` prints it: `101#0180008008001E00`.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:03X}#", self.id.raw())?;
        self.payload().iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

/// A frame or a report from a bus, with its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival {
    /// When the frame was complete: the kernel's receive stamp, or the simulation's end of frame.
    pub at: Instant,
    /// The frame or the report.
    pub content: Content,
}

/// A frame or a report from a bus. Only [`Content::Frame`] ever reaches a motor decoder.
///
/// A serial line names the receiver only: on a serial bus the id is that of the motor whose request is answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// A data frame with an 11-bit id and at most 8 bytes.
    Frame(Frame),
    /// The motor with this id could not read its request, and will not answer it: an ACK frame on a serial line (GIM document,
    /// table 3).
    Refused(FrameId),
    /// A frame of a kind that motord does not support.
    Unsupported(Unsupported),
    /// A report of the controller on itself or on the bus.
    Error(ErrorFrame),
}

/// Kinds of frames that are counted and dropped: no motor sends them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unsupported {
    /// 29-bit identifier.
    Extended,
    /// Remote transmission request.
    Remote,
    /// CAN FD.
    Fd,
    /// A length no classic frame has, or a raw DLC of 9 to 15.
    Length,
    /// Bytes on a serial line that are part of no reply to the open request. Reported once for those of one read.
    Unmatched,
}

/// An error message frame of Linux: the class bits of its id, and its 8 bytes (`linux/can/error.h`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ErrorFrame {
    /// `CAN_ERR_*` class bits, without the error flag.
    pub class: u32,
    /// Details, by class.
    pub data: [u8; 8],
}

/// The state of a controller (fault confinement of ISO 11898-1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ControllerState {
    /// Takes part in full.
    Active,
    /// An error counter passed 96.
    Warning,
    /// An error counter passed 127: the controller may no longer destroy the frames of others with error flags.
    Passive,
    /// The transmit error counter passed 255: it has left the bus.
    Off,
}

impl ErrorFrame {
    /// `CAN_ERR_TX_TIMEOUT`.
    pub const TX_TIMEOUT: u32 = 0x001;
    /// `CAN_ERR_LOSTARB`.
    pub const LOST_ARBITRATION: u32 = 0x002;
    /// `CAN_ERR_CRTL`: controller problems, details in byte 1.
    pub const CONTROLLER: u32 = 0x004;
    /// `CAN_ERR_PROT`: protocol violations, details in bytes 2 and 3.
    pub const PROTOCOL: u32 = 0x008;
    /// `CAN_ERR_ACK`: nobody acknowledged.
    pub const NO_ACKNOWLEDGE: u32 = 0x020;
    /// `CAN_ERR_BUSOFF`.
    pub const BUS_OFF: u32 = 0x040;
    /// `CAN_ERR_BUSERROR`.
    pub const BUS_ERROR: u32 = 0x080;
    /// `CAN_ERR_RESTARTED`.
    pub const RESTARTED: u32 = 0x100;

    const RX_OVERFLOW: u8 = 0x01;
    const WARNING: u8 = 0x04 | 0x08;
    const PASSIVE: u8 = 0x10 | 0x20;
    const ACTIVE: u8 = 0x40;

    /// The state this report announces, if it announces one.
    #[must_use]
    pub fn state(&self) -> Option<ControllerState> {
        let controller = if self.class & Self::CONTROLLER == 0 { 0 } else { self.data[1] };
        if self.class & Self::BUS_OFF != 0 {
            Some(ControllerState::Off)
        } else if controller & Self::PASSIVE != 0 {
            Some(ControllerState::Passive)
        } else if controller & Self::WARNING != 0 {
            Some(ControllerState::Warning)
        } else if controller & Self::ACTIVE != 0 || self.class & Self::RESTARTED != 0 {
            Some(ControllerState::Active)
        } else {
            None
        }
    }

    /// The controller lost received frames.
    #[must_use]
    pub fn receive_overflow(&self) -> bool {
        self.class & Self::CONTROLLER != 0 && self.data[1] & Self::RX_OVERFLOW != 0
    }
}

/// The place where [`Bus::receive`](crate::Bus::receive) puts arrivals. Its size is fixed, so
/// that a flood of frames cannot use up the time of the cycle.
#[derive(Debug, Clone)]
pub struct Inbox {
    arrivals: [Arrival; Inbox::CAPACITY],
    len: usize,
    /// The inbox is full when it holds so many arrivals.
    space: usize,
    /// Frames that the kernel dropped before they could be read (`SO_RXQ_OVFL`), since the last [`clear`](Self::clear).
    pub lost: u32,
}

impl Inbox {
    /// The most arrivals one call can deliver.
    pub const CAPACITY: usize = 64;

    /// An empty inbox.
    #[must_use]
    pub const fn new() -> Self {
        let nothing = Arrival { at: Instant::ZERO, content: Content::Unsupported(Unsupported::Length) };
        Self { arrivals: [nothing; Self::CAPACITY], len: 0, space: Self::CAPACITY, lost: 0 }
    }

    /// Forgets everything. There is space for [`CAPACITY`](Self::CAPACITY) arrivals then.
    #[inline]
    pub fn clear(&mut self) {
        self.clear_for(Self::CAPACITY);
    }

    /// Forgets everything. Then there is space for `arrivals`, but never for more than [`CAPACITY`](Self::CAPACITY).
    #[inline]
    pub fn clear_for(&mut self, arrivals: usize) {
        self.len = 0;
        self.space = if arrivals < Self::CAPACITY { arrivals } else { Self::CAPACITY };
        self.lost = 0;
    }

    /// Adds an arrival, or gives it back.
    ///
    /// # Errors
    ///
    /// The arrival itself, when the inbox is full.
    #[inline]
    pub fn push(&mut self, arrival: Arrival) -> Result<(), Arrival> {
        match self.arrivals.get_mut(self.len) {
            Some(place) if self.len < self.space => *place = arrival,
            _ => return Err(arrival),
        }
        self.len += 1;
        Ok(())
    }

    /// The number of arrivals that still fit.
    #[must_use]
    #[inline]
    pub fn free(&self) -> usize {
        self.space.saturating_sub(self.len)
    }

    /// The arrivals, oldest first.
    #[must_use]
    #[inline]
    pub fn arrivals(&self) -> &[Arrival] {
        &self.arrivals[..self.len]
    }
}

impl Default for Inbox {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_holds_eight_bytes_and_eleven_id_bits() {
        let id = FrameId::new(0x7FF).unwrap();
        assert_eq!(FrameId::new(0x800), None);
        assert_eq!(Frame::new(id, &[0; 9]), None);
        let frame = Frame::new(id, &[1, 2, 3]).unwrap();
        assert_eq!(frame.payload(), [1, 2, 3]);
        assert_eq!(format!("{frame:?}"), "7FF#010203");
    }

    #[test]
    fn controller_state_is_the_worst_announced() {
        let report = |class, detail| ErrorFrame { class, data: [0, detail, 0, 0, 0, 0, 0, 0] };
        assert_eq!(report(ErrorFrame::BUS_OFF, 0).state(), Some(ControllerState::Off));
        assert_eq!(report(ErrorFrame::CONTROLLER, 0x20 | 0x08).state(), Some(ControllerState::Passive));
        assert_eq!(report(ErrorFrame::CONTROLLER, 0x04).state(), Some(ControllerState::Warning));
        assert_eq!(report(ErrorFrame::CONTROLLER, 0x40).state(), Some(ControllerState::Active));
        assert_eq!(report(ErrorFrame::RESTARTED, 0).state(), Some(ControllerState::Active));
        assert_eq!(report(ErrorFrame::PROTOCOL, 0x20).state(), None, "byte 1 counts for its class only");
    }

    #[test]
    fn a_full_inbox_gives_the_arrival_back() {
        let mut inbox = Inbox::new();
        let arrival = Arrival { at: Instant::ZERO, content: Content::Unsupported(Unsupported::Fd) };
        for _ in 0..Inbox::CAPACITY {
            inbox.push(arrival).unwrap();
        }
        assert_eq!((inbox.free(), inbox.push(arrival)), (0, Err(arrival)));
        inbox.clear_for(2);
        assert_eq!((inbox.arrivals(), inbox.free()), (&[][..], 2));
        let pushed: Vec<_> = (0..3).map(|_| inbox.push(arrival)).collect();
        assert_eq!(pushed, [Ok(()), Ok(()), Err(arrival)]);
        inbox.clear();
        assert_eq!((inbox.arrivals(), inbox.free()), (&[][..], Inbox::CAPACITY));
        inbox.clear_for(usize::MAX);
        assert_eq!(inbox.free(), Inbox::CAPACITY);
    }
}
