//! Vendor facts as data: a [`Profile`] describes one vendor's motors that speak MIT.
//!
//! A profile is one text file. With the feature `models`, [`parse`] reads such a file, and
//! [`Profile::all`] returns those in the folder `models` of this crate and those that the user
//! registered. The codec, the drive, the configuration and `motorctl frame` read profiles. They
//! contain no vendor-specific code.
//!
//! All vendors share one frame layout, "the common frame". A command has position 16, velocity 12,
//! kp 12, kd 12 and torque 12 bits, big endian ([`ControlCodes`](crate::mit::ControlCodes)). A
//! reply has position 16, velocity 12 and torque 12 bits from its second byte on.

mod capabilities;
#[cfg(feature = "models")]
mod catalog;
#[cfg(feature = "models")]
mod file;

pub use capabilities::{Capabilities, SupplyReport};
#[cfg(feature = "models")]
pub use catalog::{CUBEMARS, DAMIAO, MYACTUATOR, NameTaken, ODRIVE, ROBSTRIDE, STEADYWIN, register, shipped};
#[cfg(feature = "models")]
pub use file::{FileProblem, parse};

use crate::fault::Faults;
use crate::model::Model;

/// The facts of one vendor.
#[derive(Debug, PartialEq)]
pub struct Profile {
    /// Its name on command lines, in kebab-case.
    pub name: &'static str,
    /// The motors that it describes, as text for display.
    pub motors: &'static str,
    /// The names of the protocols that they speak ([`Family::name`](crate::Family::name)).
    pub protocols: &'static [&'static str],
    /// The arbitration ids of its motors.
    pub ids: Ids,
    /// Their frames that are no control frame.
    pub special: SpecialFrames,
    /// The layout of its replies.
    pub reply: ReplyLayout,
    /// The way in which a motor reports its faults.
    pub faults: FaultReport,
    /// The motors report the ends of their codes in registers ([`register`](crate::register)).
    pub has_registers: bool,
    /// The models of this vendor.
    pub models: &'static [Model],
}

/// Arbitration ids, 11 bits. A motor receives commands at its id and replies with its reply id. On
/// one bus every reply id has one sender, whatever the vendor allows: two nodes that send the same
/// id at once destroy each other's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ids {
    /// Largest id of a motor. The smallest is 1.
    pub largest: u8,
    /// Largest reply id of a motor.
    pub largest_reply: u16,
    /// A motor's reply id, unless the configuration specifies another.
    pub reply: ReplyId,
    /// A motor also receives commands of other modes at its id plus each of these offsets. No reply
    /// may have such an id.
    pub also_receives: &'static [u16],
}

/// The reply id of a motor that the configuration gives none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReplyId {
    /// Its id plus this offset.
    Offset(u16),
    /// The same for all motors of the vendor: a bus carries one of them.
    Shared(u16),
}

impl Ids {
    /// Returns the reply id of the motor `id`, unless the configuration specifies another.
    #[must_use]
    pub const fn reply_id(&self, id: u8) -> u16 {
        match self.reply {
            ReplyId::Offset(offset) => offset + id as u16,
            ReplyId::Shared(shared) => shared,
        }
    }
}

/// The frames that are no control frame. Each begins with six bytes 0xFF, as no control frame does
/// ([`ControlCodes::pack`](crate::mit::ControlCodes::pack)).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpecialFrames {
    /// Enter the running state.
    pub start: [u8; 8],
    /// Leave the running state.
    pub stop: [u8; 8],
    /// Make the present position zero.
    pub zero: [u8; 8],
    /// Clear the fault. `None`: the motors would read such a frame as a control frame of full
    /// position, velocity and torque, and are sent `stop` in its place.
    pub clear: Option<[u8; 8]>,
}

impl SpecialFrames {
    /// Those of most vendors.
    pub const COMMON: Self = Self {
        start: [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC],
        stop: [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD],
        zero: [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFE],
        clear: Some([0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFB]),
    };
}

/// The layout of a reply. The second to sixth byte are the codes of the state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplyLayout {
    /// Fewest and most bytes of a reply with a state. Bytes after the known ones have no meaning.
    pub lengths: [usize; 2],
    /// Bits of the first byte that are the motor's id. The others are a status.
    pub id_mask: u8,
    /// The temperatures that the reply carries after the codes.
    pub temperatures: &'static [Temperature],
    /// The status that newer firmware sends in the same byte as the highest bits of a temperature.
    pub flags: Option<Flags>,
}

/// A temperature in a reply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Temperature {
    /// Short name of the measured part.
    pub of: &'static str,
    /// Index of its first byte in the reply. The number is big endian.
    pub at: usize,
    /// Number of bits, 8 to 16: the lowest ones of one or two bytes.
    pub bits: u32,
    /// Number of codes per 1 °C.
    pub per_celsius: f32,
    /// The lowest code that is a negative number, in two's complement. As a positive number it
    /// would be a temperature that no motor survives.
    pub negative_from: u16,
}

/// A status in the upper four bits of a byte of a reply. All four are zero in every reply of older
/// firmware, unless it reports frost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flags {
    /// Index of the byte.
    pub at: usize,
    /// The bits of the mode, of the four.
    pub mode: u8,
    /// The mode of an enabled drive, in these bits.
    pub on: u8,
    /// A mode that no document lists, in these bits: the sign of older firmware's temperature.
    pub no_mode: u8,
    /// The bit of a fault, whose name the motor reports on request only.
    pub fault: u8,
}

impl Flags {
    /// Returns `true` when the `status` shows an enabled drive; `None` when it is no status.
    #[must_use]
    pub const fn is_on(&self, status: u8) -> Option<bool> {
        let mode = status & self.mode;
        if mode == self.no_mode { None } else { Some(mode == self.on) }
    }
}

/// The way in which a motor reports its faults.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultReport {
    /// Only on request: six bytes 0xFF, F_CMD, 0xFB, where F_CMD 0xFF clears the fault and any
    /// other value requests it.
    Asked(FaultReply),
    /// In a byte of every reply. The host must never send such a motor a fault request. The
    /// motor may read it as a control frame with the largest position, velocity and stiffness.
    InEveryReply(Status),
    /// Never. The host must never send such a motor a fault request either.
    Never,
}

/// The reply to a fault request: the motor's id, then a little-endian number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultReply {
    /// Number of bytes of the number, 1 to 4.
    pub bytes: usize,
    /// Fewest and most bytes of the reply.
    pub lengths: [usize; 2],
    /// Bits that are zero in every such reply (first byte first), and cannot all be zero in a
    /// state. In a state they would mean full negative speed and full negative torque. A reply of
    /// this shape is certainly a fault report.
    pub zeros: [u8; 8],
    /// Mapping of the bits of the number to faults.
    pub words: &'static [(u32, Faults)],
}

/// The status code in a byte of every reply. In the first byte it is above the motor's id.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// Index of the byte.
    pub at: usize,
    /// Number of bits by which the code is shifted left in that byte.
    pub shift: u32,
    /// The codes of a motor without a fault.
    pub healthy: Healthy,
    /// Mapping of the other codes to faults. A code that no document lists is also a fault.
    pub words: &'static [(u8, Faults)],
}

/// The status codes of a motor without a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Healthy {
    /// One for a disabled motor, and one for an enabled motor.
    Mode {
        /// The code of a motor that is disabled.
        off: u8,
        /// The code of a motor that is enabled.
        on: u8,
    },
    /// One code. The motor does not report whether it is enabled.
    Code(u8),
}

impl FaultReply {
    /// Returns the faults of this `number`. Of the bits without a mapping, the lowest is reported
    /// by its index.
    #[must_use]
    pub fn faults(&self, number: u32) -> Faults {
        let (faults, rest) = self
            .words
            .iter()
            .filter(|(bit, _)| number & bit != 0)
            .fold((Faults::NONE, number), |(faults, rest), (bit, word)| (faults.and(*word), rest & !bit));
        if rest == 0 { faults } else { faults.and(Faults::of_unknown_code(rest.trailing_zeros() as u8)) }
    }
}

impl Status {
    /// Returns `true` when a motor that reports `code` is enabled. It is not where the code is that
    /// of a disabled motor, or of a fault, which disables it. `None` where the motor does not report
    /// it.
    #[must_use]
    pub fn is_on(&self, code: u8) -> Option<bool> {
        let Healthy::Mode { off, .. } = self.healthy else { return None };
        Some(code != off && !self.words.iter().any(|(known, _)| *known == code))
    }

    /// Returns the faults of this `code`.
    #[must_use]
    pub fn faults(&self, code: u8) -> Faults {
        let is_healthy = match self.healthy {
            Healthy::Mode { off, on } => code == off || code == on,
            Healthy::Code(known) => code == known,
        };
        if is_healthy {
            return Faults::NONE;
        }
        let word = self.words.iter().find(|(known, _)| *known == code);
        word.map_or_else(|| Faults::of_unknown_code(code), |(_, faults)| *faults)
    }
}

impl Profile {
    /// Returns `true` when its motors speak the protocol with this name.
    #[must_use]
    pub fn speaks(&self, protocol: &str) -> bool {
        self.protocols.contains(&protocol)
    }

    /// Returns `true` when its motors report faults on request. Otherwise every reply reports
    /// them, or none does.
    #[must_use]
    pub const fn is_asked_for_faults(&self) -> bool {
        matches!(self.faults, FaultReport::Asked(_))
    }

    /// Returns the mapped numbers of the vendor's fault list, each with its faults.
    pub fn fault_numbers(&self) -> impl Iterator<Item = (u32, Faults)> {
        let (bits, codes): (&[_], &[_]) = match self.faults {
            FaultReport::Asked(FaultReply { words, .. }) => (words, &[]),
            FaultReport::InEveryReply(Status { words, .. }) => (&[], words),
            FaultReport::Never => (&[], &[]),
        };
        bits.iter().copied().chain(codes.iter().map(|(code, faults)| (u32::from(*code), *faults)))
    }

    /// Returns `true` when `payload` is certainly a fault report: no state has its shape. Missing
    /// bytes count as zero, but the payload must be as long as the shortest reply,
    /// [`FaultReply::lengths`].
    ///
    /// Real-time: does not allocate or block; takes constant time.
    #[must_use]
    #[inline]
    pub fn is_fault_report(&self, payload: &[u8]) -> bool {
        let FaultReport::Asked(FaultReply { zeros, lengths: [least, _], .. }) = self.faults else {
            return false;
        };
        // The first four bytes already rule out most states.
        let [a, b, c, d, ..] = zeros;
        let head =
            payload.first_chunk().map(|head| u32::from_ne_bytes(*head) & u32::from_ne_bytes([a, b, c, d]));
        head == Some(0)
            && payload.len() >= least
            && payload.iter().zip(zeros).all(|(byte, zeros)| byte & zeros == 0)
    }

    /// Returns `true` when a motor with this `id` may have sent `payload`, by its first byte. An
    /// empty payload may come from any motor.
    #[must_use]
    #[inline]
    pub fn is_from(&self, id: u8, payload: &[u8]) -> bool {
        payload.first().is_none_or(|first| (first ^ id) & self.reply.id_mask == 0)
    }
}
