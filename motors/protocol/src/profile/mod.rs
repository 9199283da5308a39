//! Vendor facts as data: one [`Profile`] says all that a host must know of one vendor's MIT-speaking motors.
//!
//! The codec, the drive, the configuration and `motorctl frame` read the table [`PROFILES`]; none of them knows a vendor.
//! To add one: write a file like `steadywin.rs`, list it in [`PROFILES`], give it a twin in the simulator and golden
//! frames in `tests/golden/`.
//!
//! Frame layout common to all of them, "the common frame": a command has position 16, velocity 12, kp 12, kd 12 and
//! torque 12 bits, big endian ([`ControlCodes`](crate::mit::ControlCodes)); a reply has position 16, velocity 12 and
//! torque 12 bits from its second byte on.

mod capabilities;
mod damiao;
mod decode;
mod robstride;
mod steadywin;

pub use capabilities::{Capabilities, MotorProtocol};
pub use damiao::DAMIAO;
pub use robstride::ROBSTRIDE;
pub use steadywin::STEADYWIN;

use crate::fault::Faults;
use crate::model::Model;

/// Every vendor known here.
pub const PROFILES: &[&Profile] = &[&STEADYWIN, &DAMIAO, &ROBSTRIDE];

/// The facts of one vendor.
#[derive(Debug, PartialEq)]
pub struct Profile {
    /// Its name on command lines, in kebab-case.
    pub name: &'static str,
    /// The motors that it describes, as a text for people.
    pub motors: &'static str,
    /// The motors speak the native GIM protocol, too.
    pub speaks_gim: bool,
    /// Which arbitration ids its motors use.
    pub ids: Ids,
    /// How its replies are laid out.
    pub reply: ReplyLayout,
    /// How a motor reports its faults.
    pub faults: FaultReport,
    /// The motors sold.
    pub models: &'static [Model],
}

/// Arbitration ids, 11 bits. A motor hears commands at its id and answers at its reply id. On one bus every reply id has
/// one sender, whatever the vendor allows: two nodes that send the same id at the same time destroy each other's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ids {
    /// The largest id a motor may have; the smallest is 1.
    pub largest: u8,
    /// The largest reply id it may have.
    pub largest_reply: u16,
    /// A motor's reply id is its id plus this, unless the configuration says otherwise.
    pub reply_offset: u16,
    /// A motor also hears commands, of other modes, at its id plus each of these: no reply may bear such an id.
    pub also_hears: &'static [u16],
}

impl Ids {
    /// Whether a motor with this `id` takes a frame with the id `other` for a command to it.
    #[must_use]
    pub fn hears(&self, id: u8, other: u32) -> bool {
        let id = u32::from(id);
        id == other || self.also_hears.iter().any(|offset| id + u32::from(*offset) == other)
    }
}

/// The layout of a reply. Its second to sixth byte are the codes of the state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplyLayout {
    /// The fewest and the most bytes of a reply with a state. What follows the known bytes means nothing.
    pub lengths: [usize; 2],
    /// The bits of the first byte that are the motor's id; the others are a status.
    pub id_mask: u8,
    /// The temperatures that the reply carries after the codes.
    pub temperatures: &'static [Temperature],
}

/// A temperature in a reply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Temperature {
    /// The part whose temperature it is, as a short name.
    pub of: &'static str,
    /// The index of its first byte in the reply. The number is unsigned and big endian.
    pub at: usize,
    /// How many bytes it has, 1 or 2.
    pub bytes: usize,
    /// How many codes make 1 °C.
    pub per_celsius: f32,
}

/// How a motor reports its faults.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultReport {
    /// Only when it is asked: six bytes 0xFF, F_CMD, 0xFB, where F_CMD 0xFF clears and any other asks.
    Asked(FaultReply),
    /// In the first byte of every reply. Such a motor must never be asked: it may take the question for a control frame
    /// with the largest position, velocity and stiffness.
    InEveryReply(Status),
}

/// The answer to the question for the faults: the motor's id, then a little-endian number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultReply {
    /// How many bytes the number has, 1 to 4.
    pub bytes: usize,
    /// The fewest and the most bytes of the answer.
    pub lengths: [usize; 2],
    /// The bits that are zero in every such answer (first byte first), and cannot all be zero in a state: as a state they
    /// would be full speed and full torque backward. An answer of this shape is a fault report beyond doubt.
    pub zeros: [u8; 8],
    /// The bits of the number, in our words.
    pub words: &'static [(u32, Faults)],
}

/// The status code that shares the first byte of a reply with the motor's id.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// The number of bits by which the code is shifted left in that byte.
    pub shift: u32,
    /// The code of a motor that is disabled.
    pub off: u8,
    /// The code of a motor that is enabled.
    pub on: u8,
    /// The other codes, in our words. A code that is in no document is a fault, too.
    pub words: &'static [(u8, Faults)],
}

impl FaultReply {
    /// The faults of this `number`. Of the bits without a word, the lowest is reported by its index.
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
    /// A motor that reports `code` is not enabled: it says so, or names a fault, which disables it.
    #[must_use]
    pub fn is_off(&self, code: u8) -> bool {
        code == self.off || self.words.iter().any(|(known, _)| *known == code)
    }

    /// The faults of this `code`.
    #[must_use]
    pub fn faults(&self, code: u8) -> Faults {
        if code == self.off || code == self.on {
            return Faults::NONE;
        }
        let word = self.words.iter().find(|(known, _)| *known == code);
        word.map_or_else(|| Faults::of_unknown_code(code), |(_, faults)| *faults)
    }
}

impl Model {
    /// Returns the model with this name, of any vendor, upper or lower case.
    #[must_use]
    pub fn by_name(name: &str) -> Option<&'static Self> {
        Profile::of_model(name).map(|(_, model)| model)
    }
}

impl Profile {
    /// The profile of this name, upper or lower case.
    #[must_use]
    pub fn by_name(name: &str) -> Option<&'static Self> {
        PROFILES.iter().find(|profile| profile.name.eq_ignore_ascii_case(name)).copied()
    }

    /// The model of this name, upper or lower case, and its profile.
    #[must_use]
    pub fn of_model(name: &str) -> Option<(&'static Self, &'static Model)> {
        PROFILES.iter().find_map(|profile| {
            let model = profile.models.iter().find(|model| model.name.eq_ignore_ascii_case(name))?;
            Some((*profile, model))
        })
    }

    /// Whether its motors report faults only when they are asked. If not, every reply reports them.
    #[must_use]
    pub const fn is_asked_for_faults(&self) -> bool {
        matches!(self.faults, FaultReport::Asked(_))
    }

    /// The numbers of the vendor's fault list that have a word, each with its words.
    pub fn fault_numbers(&self) -> impl Iterator<Item = (u32, Faults)> {
        let (bits, codes): (&[_], &[_]) = match self.faults {
            FaultReport::Asked(FaultReply { words, .. }) => (words, &[]),
            FaultReport::InEveryReply(Status { words, .. }) => (&[], words),
        };
        bits.iter().copied().chain(codes.iter().map(|(code, faults)| (u32::from(*code), *faults)))
    }

    /// `payload` is a fault report beyond doubt: no state has its shape. Bytes that it lacks count as zero, but it has at
    /// least as many as the shortest answer, [`FaultReply::lengths`].
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

    /// Whether a motor of this `id` may have sent `payload`, by its first byte. An empty payload names no other motor.
    #[must_use]
    #[inline]
    pub fn is_from(&self, id: u8, payload: &[u8]) -> bool {
        payload.first().is_none_or(|first| (first ^ id) & self.reply.id_mask == 0)
    }
}
