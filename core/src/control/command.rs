//! The two ends of control: one command per motor and cycle goes out, reports of the motors come in.

use crate::joint::{Joint, Measured, Setpoint};
use motord_bus::Duration;
use motord_protocol::Faults;

/// The command of one motor in a cycle, joint side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Nothing: the motor is offline, and it is not time to probe it.
    Nothing,
    /// Nothing: it is another motor's turn. The reply to the last command may still come.
    Wait,
    /// Stop. A motor whose state confirms a stop also reports its state.
    Stop,
    /// Start.
    Start,
    /// No stiffness, no damping, no torque.
    Neutral,
    /// Make the present position zero.
    SetZero,
    /// Report the fault bits.
    GetFault,
    /// Report the indicator with this number.
    GetIndicator(u8),
    /// Acknowledge the fault.
    ClearFault,
    /// Follow this.
    Control(Setpoint),
}

impl Command {
    /// The motor answers with its state.
    #[must_use]
    pub const fn is_answered_by_state(&self) -> bool {
        use Command::{ClearFault, GetFault, GetIndicator, Nothing, Wait};
        !matches!(self, Nothing | Wait | GetFault | GetIndicator(_) | ClearFault)
    }
}

/// The part of a state besides the motion. The default is for motors whose states carry the motion only.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Status {
    /// The faults of the motor; `None` where its states have none.
    pub faults: Option<Faults>,
    /// It says that it is enabled, or that it is not; `None` where its states say nothing of it.
    pub runs: Option<bool>,
}

/// A reply of one motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reported {
    /// Its state, the time from the command to the answer, and what else the state says.
    State(Measured<Joint>, Duration, Status),
    /// Its fault bits.
    Fault(Faults),
    /// The value of the indicator with this number, in its own unit; NaN when it refuses.
    Indicator(u8, f32),
    /// It received the request to clear its fault.
    Cleared,
    /// It received the command; the answer says nothing more.
    Alive,
    /// It stopped.
    Stopped,
    /// It refuses: it may have a fault.
    Refused,
    /// The answer to a question of an earlier cycle, meaningless by now.
    Late,
}
