//! Frames of a CAN bus, classic and FD, and reports of a controller about the bus.
//!
//! A serial bus uses the same [`Frame`]: its identifier is the address byte of the RS485 header.

use crate::time::Instant;
use core::cmp::Ordering;
use core::fmt;

/// An arbitration id of 11 bits (standard) or 29 bits (extended). The lowest id wins the bus.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct FrameId(pub(crate) u32);

impl From<u8> for FrameId {
    fn from(id: u8) -> Self {
        Self(id.into())
    }
}

impl FrameId {
    /// The largest standard id, 0x7FF.
    pub const MAX: Self = Self(0x7FF);
    /// The largest extended id, 0x1FFF_FFFF.
    pub const MAX_EXTENDED: Self = Self(Self::EXTENDED | Self::RAW);

    /// `CAN_EFF_FLAG` of `linux/can.h`: the id has 29 bits.
    const EXTENDED: u32 = 0x8000_0000;
    const RAW: u32 = 0x1FFF_FFFF;

    /// Returns a standard id. `None` when `raw` has more than 11 bits.
    #[must_use]
    pub const fn new(raw: u16) -> Option<Self> {
        let raw = raw as u32;
        if raw <= Self::MAX.0 { Some(Self(raw)) } else { None }
    }

    /// Returns an extended id. `None` when `raw` has more than 29 bits.
    #[must_use]
    pub const fn extended(raw: u32) -> Option<Self> {
        if raw <= Self::RAW { Some(Self(Self::EXTENDED | raw)) } else { None }
    }

    /// Returns the id as a number, up to 0x7FF or 0x1FFF_FFFF.
    #[must_use]
    pub const fn raw(self) -> u32 {
        self.0 & Self::RAW
    }

    /// Returns `true` when the id has 29 bits.
    #[must_use]
    pub const fn is_extended(self) -> bool {
        self.0 & Self::EXTENDED != 0
    }

    /// Returns the id of a motor: a standard id of at most 8 bits.
    #[must_use]
    pub fn byte(self) -> Option<u8> {
        u8::try_from(self.0).ok()
    }

    /// Returns the id with the kernel's flag for extended ids.
    pub(crate) const fn word(self) -> u32 {
        self.0
    }

    /// Returns the bits in the order of arbitration: the 11 upper ones, IDE, the 18 lower ones.
    const fn arbitration(self) -> u32 {
        let raw = self.raw();
        if self.is_extended() { (raw >> 18) << 19 | 1 << 18 | raw & 0x3_FFFF } else { raw << 19 }
    }
}

impl Ord for FrameId {
    fn cmp(&self, other: &Self) -> Ordering {
        self.arbitration().cmp(&other.arbitration())
    }
}

impl PartialOrd for FrameId {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl fmt::Display for FrameId {
    /// Writes the format of `candump`: three hexadecimal digits, or eight for an extended id.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_extended() { write!(f, "{:08X}", self.raw()) } else { write!(f, "{:03X}", self.raw()) }
    }
}

impl fmt::Debug for FrameId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FrameId({self})")
    }
}

/// The format of a frame on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// At most 8 bytes.
    Classic,
    /// CAN FD: at most 64 bytes.
    Fd {
        /// BRS: the payload is sent at the data bit rate.
        switches_rate: bool,
        /// ESI: the sender is error passive.
        error_passive: bool,
    },
}

impl Format {
    /// CAN FD at one bit rate.
    pub const FD: Self = Self::Fd { switches_rate: false, error_passive: false };
    /// CAN FD with the payload at the data bit rate.
    pub const FD_BRS: Self = Self::Fd { switches_rate: true, error_passive: false };

    /// Returns `true` when a frame of this format can have `len` bytes. CAN FD has no DLC for most
    /// lengths above 8.
    #[must_use]
    pub const fn fits(self, len: usize) -> bool {
        match self {
            Self::Classic => len <= Frame::CLASSIC_LEN_MAX,
            Self::Fd { .. } => matches!(len, 0..=8 | 12 | 16 | 20 | 24 | 32 | 48 | 64),
        }
    }
}

/// A data frame: an id of either width, 0 to 64 bytes, and the flags of CAN FD.
///
/// A frame takes 72 bytes. Code that runs in every cycle writes a frame where it will be read
/// ([`set`](Self::set)), and passes references. Only the bytes of the payload are written.
#[derive(Clone, Copy)]
pub struct Frame {
    id: FrameId,
    format: Format,
    len: u8,
    /// Bytes after `len` have no meaning, except that the first eight of a classic frame are zero
    /// there.
    data: [u8; Frame::LEN_MAX],
}

impl Frame {
    /// The longest payload of a CAN FD frame.
    pub const LEN_MAX: usize = 64;
    /// The longest payload of a classic frame.
    pub const CLASSIC_LEN_MAX: usize = 8;
    /// A classic frame with id 0 and no bytes: space for another frame.
    pub const EMPTY: Self =
        Self { id: FrameId(0), format: Format::Classic, len: 0, data: [0; Self::LEN_MAX] };

    /// Returns a classic frame. `None` when `payload` is longer than 8 bytes.
    #[must_use]
    pub fn new(id: FrameId, payload: &[u8]) -> Option<Self> {
        Self::with_format(id, Format::Classic, payload)
    }

    /// Returns a frame of any format. `None` when no such frame has the length of `payload`.
    #[must_use]
    pub fn with_format(id: FrameId, format: Format, payload: &[u8]) -> Option<Self> {
        if !format.fits(payload.len()) {
            return None;
        }
        let mut frame = Self { id, format, len: payload.len() as u8, ..Self::EMPTY };
        frame.data.get_mut(..payload.len())?.copy_from_slice(payload);
        Some(frame)
    }

    /// Returns a classic frame with a payload of known length, at most 8 bytes.
    #[must_use]
    #[inline]
    pub fn classic<const N: usize>(id: FrameId, payload: [u8; N]) -> Self {
        let mut frame = Self::EMPTY;
        frame.set(id, payload);
        frame
    }

    /// Makes this a classic frame with a payload of known length, at most 8 bytes.
    #[inline]
    pub fn set<const N: usize>(&mut self, id: FrameId, payload: [u8; N]) {
        const { assert!(N <= Self::CLASSIC_LEN_MAX, "a classic frame has at most 8 bytes") };
        let mut data = [0; Self::CLASSIC_LEN_MAX];
        data[..N].copy_from_slice(&payload);
        self.set_padded(id, N as u8, data);
    }

    /// Makes this a classic frame of the first `len` bytes of `data`; `false`, unchanged, above 8.
    #[must_use]
    #[inline]
    #[cfg(any(feature = "linux", test))]
    pub(crate) fn set_cut(&mut self, id: FrameId, len: u8, data: [u8; Self::CLASSIC_LEN_MAX]) -> bool {
        let kept = match len {
            0 => 0,
            1..=8 => u64::MAX >> (64 - 8 * u32::from(len)),
            _ => return false,
        };
        self.set_padded(id, len, (u64::from_le_bytes(data) & kept).to_le_bytes());
        true
    }

    #[inline]
    fn set_padded(&mut self, id: FrameId, len: u8, data: [u8; Self::CLASSIC_LEN_MAX]) {
        (self.id, self.format, self.len) = (id, Format::Classic, len);
        if let Some(first) = self.data.first_chunk_mut() {
            *first = data;
        }
    }

    /// Returns the bytes of a classic frame, and zeros up to the eighth byte.
    #[inline]
    #[cfg(feature = "linux")]
    pub(crate) fn padded(&self) -> [u8; Self::CLASSIC_LEN_MAX] {
        self.data.first_chunk().copied().unwrap_or_default()
    }

    /// Returns the arbitration id.
    #[must_use]
    #[inline]
    pub const fn id(&self) -> FrameId {
        self.id
    }

    /// Returns the format.
    #[must_use]
    #[inline]
    pub const fn format(&self) -> Format {
        self.format
    }

    /// Returns `true` for a classic frame, and `false` for one of CAN FD.
    #[must_use]
    #[inline]
    pub const fn is_classic(&self) -> bool {
        matches!(self.format, Format::Classic)
    }

    /// Returns the bytes of the payload.
    #[must_use]
    #[inline]
    pub fn payload(&self) -> &[u8] {
        &self.data[..usize::from(self.len)]
    }
}

impl PartialEq for Frame {
    fn eq(&self, other: &Self) -> bool {
        (self.id, self.format, self.payload()) == (other.id, other.format, other.payload())
    }
}

impl Eq for Frame {}

impl fmt::Display for Frame {
    /// Writes the format of `candump -L`: `101#0180008008001E00`, or `101##1` and up to 64 bytes,
    /// with the flags of CAN FD.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.format {
            Format::Classic => write!(f, "{}#", self.id)?,
            Format::Fd { switches_rate, error_passive } => {
                write!(f, "{}##{}", self.id, u8::from(switches_rate) | u8::from(error_passive) << 1)?;
            }
        }
        self.payload().iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// A frame or a report from a bus, with its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival {
    /// Time of completion: the kernel's receive stamp, or the simulation's end of frame.
    pub at: Instant,
    /// The frame or the report.
    pub content: Content,
}

/// A frame or a report from a bus. Motor decoders receive only [`Content::Frame`].
///
/// A serial frame names only its receiver. On a serial bus the id is that of the motor whose
/// request is answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// A data frame that the bus supports.
    Frame(Frame),
    /// ACK frame on a serial line: this motor could not read its request (GIM document, table 3).
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
    /// A length that no classic frame has, or a raw DLC of 9 to 15.
    Length,
    /// Bytes on a serial line that are part of no reply to the open request. Reported at most once
    /// per read.
    Unmatched,
}

/// An error frame of Linux: the class bits of its id, and its 8 bytes (`linux/can/error.h`).
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
    /// Takes full part in the traffic.
    Active,
    /// An error counter passed 96.
    Warning,
    /// An error counter passed 127: its error flags may no longer destroy the frames of others.
    Passive,
    /// The transmit error counter passed 255: the controller has left the bus.
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
    /// `CAN_ERR_ACK`: no node acknowledged.
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

    /// Returns the state that this report announces, if it announces one.
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

    /// Returns `true` when the controller lost received frames.
    #[must_use]
    pub fn receive_overflow(&self) -> bool {
        self.class & Self::CONTROLLER != 0 && self.data[1] & Self::RX_OVERFLOW != 0
    }
}

/// Buffer into which [`Bus::receive`](crate::Bus::receive) puts arrivals. Its size is fixed, so
/// that a flood of frames cannot use up the time of the cycle.
#[derive(Debug, Clone)]
pub struct Inbox {
    arrivals: [Arrival; Inbox::CAPACITY],
    len: usize,
    /// The inbox is full when it holds this number of arrivals.
    space: usize,
    /// Frames that the kernel dropped unread (`SO_RXQ_OVFL`) since the last [`clear`](Self::clear).
    pub lost: u32,
}

impl Inbox {
    /// Most arrivals that one call can deliver.
    pub const CAPACITY: usize = 64;

    /// Returns an empty inbox.
    #[must_use]
    pub const fn new() -> Self {
        let nothing = Arrival { at: Instant::ZERO, content: Content::Frame(Frame::EMPTY) };
        Self { arrivals: [nothing; Self::CAPACITY], len: 0, space: Self::CAPACITY, lost: 0 }
    }

    /// Removes all arrivals, and makes space for [`CAPACITY`](Self::CAPACITY) arrivals.
    #[inline]
    pub fn clear(&mut self) {
        self.clear_for(Self::CAPACITY);
    }

    /// Removes all arrivals, and makes space for `arrivals`, at most [`CAPACITY`](Self::CAPACITY).
    #[inline]
    pub fn clear_for(&mut self, arrivals: usize) {
        self.len = 0;
        self.space = if arrivals < Self::CAPACITY { arrivals } else { Self::CAPACITY };
        self.lost = 0;
    }

    /// Adds an arrival.
    ///
    /// # Errors
    ///
    /// The arrival itself, when the inbox is full.
    #[inline]
    pub fn push(&mut self, arrival: Arrival) -> Result<(), Arrival> {
        match self.arrivals.get_mut(self.len) {
            Some(slot) if self.len < self.space => *slot = arrival,
            _ => return Err(arrival),
        }
        self.len += 1;
        Ok(())
    }

    /// Lets `write` overwrite an old frame as the next arrival, without a copy. Returns `false`
    /// when the inbox is full or `write` returns `false`.
    #[must_use]
    #[inline]
    pub fn push_frame(&mut self, at: Instant, write: impl FnOnce(&mut Frame) -> bool) -> bool {
        let is_full = self.len >= self.space;
        let Some(slot) = self.arrivals.get_mut(self.len).filter(|_| !is_full) else { return false };
        slot.at = at;
        let is_written = match &mut slot.content {
            Content::Frame(frame) => write(frame),
            other => {
                *other = Content::Frame(Frame::EMPTY);
                if let Content::Frame(frame) = other { write(frame) } else { false }
            }
        };
        self.len += usize::from(is_written);
        is_written
    }

    /// Returns the number of arrivals that still fit.
    #[must_use]
    #[inline]
    pub fn free(&self) -> usize {
        self.space.saturating_sub(self.len)
    }

    /// Returns the arrivals, oldest first.
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
    use proptest::prelude::*;

    fn any_id() -> impl Strategy<Value = FrameId> {
        prop_oneof![
            (0..=0x7FF_u16).prop_map(|raw| FrameId::new(raw).unwrap()),
            (0..=0x1FFF_FFFF_u32).prop_map(|raw| FrameId::extended(raw).unwrap()),
        ]
    }

    proptest! {
        #[test]
        fn ids_of_either_width_keep_value_and_width(raw in any::<u32>()) {
            let standard = u16::try_from(raw).ok().and_then(FrameId::new);
            prop_assert_eq!(standard.map(FrameId::raw), Some(raw).filter(|raw| *raw <= 0x7FF));
            prop_assert!(standard.is_none_or(|id| !id.is_extended()));
            let extended = FrameId::extended(raw);
            prop_assert_eq!(extended.map(FrameId::raw), Some(raw).filter(|raw| *raw <= 0x1FFF_FFFF));
            prop_assert!(extended.is_none_or(FrameId::is_extended));
            prop_assert!(standard.is_none() || standard != extended);
        }

        #[test]
        fn ids_are_ordered_by_arbitration(one in any_id(), other in any_id()) {
            // Bit by bit as on the wire: 11 bits, then RTR 0 of a standard frame, or SRR 1 of an
            // extended one.
            let wire = |id: FrameId| match id.is_extended() {
                false => (id.raw(), 0, 0),
                true => (id.raw() >> 18, 1, id.raw() & 0x3_FFFF),
            };
            prop_assert_eq!(one.cmp(&other), wire(one).cmp(&wire(other)));
        }

        #[test]
        fn frames_keep_id_format_and_payload(id in any_id(), bytes in prop::collection::vec(any::<u8>(), 0..80)) {
            for format in [Format::Classic, Format::FD, Format::FD_BRS] {
                let frame = Frame::with_format(id, format, &bytes);
                prop_assert_eq!(frame.is_some(), format.fits(bytes.len()));
                let parts = frame.map(|frame| (frame.id(), frame.format(), frame.payload().to_vec()));
                prop_assert_eq!(parts, frame.map(|_| (id, format, bytes.clone())));
            }
        }

        #[test]
        fn frame_written_over_another_equals_new_one(
            id in any_id(),
            before in prop::collection::vec(any::<u8>(), 64),
            data in any::<[u8; 8]>(),
            len in 0..=8_u8,
        ) {
            let mut frame = Frame::with_format(FrameId::MAX, Format::FD_BRS, &before).unwrap();
            prop_assert!(frame.set_cut(id, len, data));
            prop_assert_eq!(frame, Frame::new(id, &data[..usize::from(len)]).unwrap());
            prop_assert!(!frame.set_cut(id, 9, data));
            frame.set(id, data);
            prop_assert_eq!(frame, Frame::new(id, &data).unwrap());
        }
    }

    #[test]
    fn frame_has_72_bytes_and_prints_as_candump() {
        assert_eq!(size_of::<Frame>(), 72);
        let id = FrameId::new(0x7FF).unwrap();
        assert_eq!(FrameId::new(0x800), None);
        assert_eq!(Frame::new(id, &[0; 9]), None);
        let frame = Frame::new(id, &[1, 2, 3]).unwrap();
        assert_eq!(frame.payload(), [1, 2, 3]);
        assert_eq!(format!("{frame:?}"), "7FF#010203");
        let extended = FrameId::extended(0x1234).unwrap();
        assert_eq!(Frame::classic(extended, [0xAB]).to_string(), "00001234#AB");
        let fd = Frame::with_format(extended, Format::FD_BRS, &[0xAB; 12]).unwrap();
        assert_eq!(fd.to_string(), "00001234##1ABABABABABABABABABABABAB");
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

    #[test]
    fn frame_written_into_inbox_replaces_any_content() {
        let mut inbox = Inbox::new();
        let frame = Frame::classic(FrameId::MAX, [1, 2]);
        let content =
            |inbox: &Inbox| inbox.arrivals().iter().map(|arrival| arrival.content).collect::<Vec<_>>();
        for before in [Content::Unsupported(Unsupported::Fd), Content::Frame(Frame::EMPTY)] {
            inbox.clear_for(1);
            inbox.push(Arrival { at: Instant::ZERO, content: before }).unwrap();
            inbox.clear_for(1);
            assert!(!inbox.push_frame(Instant::ZERO, |_| false));
            assert_eq!(inbox.arrivals(), []);
            let write = |slot: &mut Frame| {
                *slot = frame;
                true
            };
            assert!(inbox.push_frame(Instant::ZERO, write));
            assert_eq!(content(&inbox), [Content::Frame(frame)]);
            assert!(!inbox.push_frame(Instant::ZERO, write), "it is full");
        }
    }
}
