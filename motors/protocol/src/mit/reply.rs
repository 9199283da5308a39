//! Motor to host. Source: MIT document 1.2, and those of the profiles.

use crate::fault::Faults;
use crate::state::StateCodes;

/// Content that the open request asks for. The same bytes can be a state or a fault; the request
/// determines which.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Asked {
    /// Start, stop, set zero or control: the motor replies with the state.
    State,
    /// Get fault.
    Fault,
    /// Clear fault.
    Clear,
}

/// A motor's reply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reply {
    /// The motion, and the vendor's further values.
    State(State),
    /// The faults.
    Fault {
        /// The motor's CAN id.
        id: u8,
        /// The fault number as received.
        number: u32,
        /// The same faults, in terms that all vendors share.
        faults: Faults,
    },
    /// Acknowledges a request to clear the fault. Only the next report of faults shows the result.
    Cleared {
        /// The motor's CAN id.
        id: u8,
    },
}

impl Reply {
    /// Returns the id of the replying motor, as far as the reply's first byte holds it.
    #[must_use]
    pub const fn id(&self) -> u8 {
        match self {
            Self::State(State { id, .. }) | Self::Fault { id, .. } | Self::Cleared { id } => *id,
        }
    }
}

/// The motion a motor reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// The motor's CAN id, as far as the first byte holds it.
    pub id: u8,
    /// Position of the output shaft, rad.
    pub position: f32,
    /// Velocity of the output shaft, rad/s.
    pub velocity: f32,
    /// Torque at the output shaft, N·m.
    pub torque: f32,
    /// The codes of position, velocity and torque, as received.
    pub codes: StateCodes,
    /// Temperatures in the order of the profile, °C; `None` where the profile has none.
    pub temperatures: [Option<f32>; 2],
    /// The status code of the first byte, or of the byte beside a temperature, where the profile
    /// has one and the motor sends it.
    pub status: Option<u8>,
}

impl State {
    /// Returns the highest of its temperatures, °C, if it reports one.
    #[must_use]
    pub fn hottest(&self) -> Option<f32> {
        let [first, second] = self.temperatures;
        match (first, second) {
            (Some(first), Some(second)) => Some(first.max(second)),
            (one, other) => one.or(other),
        }
    }
}
