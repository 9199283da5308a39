//! Motor to host. Source: MIT document 1.2.

use crate::error::DecodeError;
use crate::fault::FaultBits;
use crate::scale::TorqueScale;
use crate::state::StateCodes;

/// What the open request asked for. The same bytes are a state or a fault, by the question.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Asked {
    /// Start, stop, set zero or control: all are answered with the state.
    State,
    /// Get fault.
    Fault,
    /// Clear fault.
    Clear,
}

/// A motor's answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reply {
    /// Its motion.
    State(State),
    /// Its faults.
    Fault {
        /// The motor's CAN id.
        id: u8,
        /// The fault number.
        fault: FaultBits,
    },
    /// It was asked to forget its fault. Whether it did, only the next get fault tells.
    Cleared {
        /// The motor's CAN id.
        id: u8,
    },
}

/// The motion a motor tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// The motor's CAN id.
    pub id: u8,
    /// Position of the output shaft, rad, -12.5 to 12.5.
    pub position: f32,
    /// Velocity of the output shaft, rad/s, -65 to 65.
    pub velocity: f32,
    /// Torque at the output shaft, N·m, as the torque scale reads the motor's q-axis current.
    pub torque: f32,
    /// The same as the wire had it.
    pub codes: StateCodes,
}

impl State {
    /// The state that these codes tell.
    #[must_use]
    pub fn new(id: u8, codes: StateCodes, scale: &TorqueScale) -> Self {
        let [position, velocity, torque] = codes.scaled(scale);
        Self { id, position, velocity, torque, codes }
    }
}

/// What `payload` answers to what was `asked`. Its first six bytes count; two more may follow.
///
/// Real-time: does not allocate or block; takes constant time.
///
/// # Errors
///
/// When there are fewer than 6 or more than 8 bytes.
pub fn decode_reply(payload: &[u8], asked: Asked, scale: &TorqueScale) -> Result<Reply, DecodeError> {
    let refused = DecodeError::Length { least: 6, most: 8, received: payload.len() };
    let (&[id, a, b, c, d, e], rest) = payload.split_first_chunk().ok_or(refused)?;
    if rest.len() > 2 {
        return Err(refused);
    }
    Ok(match asked {
        Asked::State => Reply::State(State::new(id, StateCodes::unpack([a, b, c, d, e]), scale)),
        Asked::Fault => Reply::Fault { id, fault: FaultBits(a) },
        Asked::Clear => Reply::Cleared { id },
    })
}

impl Reply {
    /// The CAN id of the motor that answers.
    #[must_use]
    pub const fn id(&self) -> u8 {
        match self {
            Self::State(State { id, .. }) | Self::Fault { id, .. } | Self::Cleared { id } => *id,
        }
    }

    /// The reply's bytes, with `filler` showing through where they mean nothing. For tools and tests: a host only
    /// receives replies.
    #[must_use]
    pub fn encode_over(&self, filler: [u8; 6]) -> [u8; 6] {
        let [_, a, b, c, d, e] = filler;
        match self {
            Self::State(State { id, codes, .. }) => {
                let [a, b, c, d, e] = codes.pack();
                [*id, a, b, c, d, e]
            }
            Self::Fault { id, fault } => [*id, fault.0, b, c, d, e],
            Self::Cleared { id } => [*id, a, b, c, d, e],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_bytes_are_read_as_what_was_asked() {
        let scale = TorqueScale::new(0.1, 8.0).unwrap();
        let bytes = [7, 0x02, 0x34, 0x56, 0x78, 0x9A];
        let codes = StateCodes { position: 0x0234, velocity: 0x567, torque: 0x89A };
        let reply = |asked| decode_reply(&bytes, asked, &scale).unwrap();
        assert_eq!(reply(Asked::State), Reply::State(State::new(7, codes, &scale)));
        assert_eq!(reply(Asked::Fault), Reply::Fault { id: 7, fault: FaultBits(0x02) });
        assert_eq!(reply(Asked::Clear), Reply::Cleared { id: 7 });
        assert!([Asked::State, Asked::Fault, Asked::Clear].iter().all(|&asked| reply(asked).id() == 7));
    }

    #[test]
    fn a_reply_has_six_to_eight_bytes() {
        let scale = TorqueScale::new(0.1, 8.0).unwrap();
        for received in 0..=64 {
            let reply = decode_reply(&[0x55; 64][..received], Asked::State, &scale);
            if (6..=8).contains(&received) {
                assert_eq!(reply, decode_reply(&[0x55; 6], Asked::State, &scale));
            } else {
                assert_eq!(reply, Err(DecodeError::Length { least: 6, most: 8, received }));
            }
        }
    }

    #[test]
    fn every_code_a_motor_can_tell_survives_a_round_trip() {
        let scale = TorqueScale::new(0.1, 8.0).unwrap();
        for code in 0..=u16::MAX {
            let codes = StateCodes { position: code, velocity: code >> 4, torque: code & 0x0FFF };
            let reply = Reply::State(State::new(1, codes, &scale));
            assert_eq!(decode_reply(&reply.encode_over([0xA5; 6]), Asked::State, &scale), Ok(reply));
        }
    }
}
