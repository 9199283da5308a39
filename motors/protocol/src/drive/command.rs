//! The commands to a motor, its reports, the content that a request asks for, and the shape of a
//! reply.

use super::{JointSide, Measured, Setpoint};
use crate::Faults;
use motord_bus::Duration;

/// The command of one motor in a cycle, joint side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// No frame: the motor is offline, and its next probe is not due.
    Nothing,
    /// No frame: it is another motor's turn. The reply to the last command may still arrive.
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
    /// Report the supply.
    GetSupply,
    /// Report the register with this number, in place of the state.
    GetRegister(u8),
    /// Acknowledge the fault.
    ClearFault,
    /// Follow this setpoint.
    Control(Setpoint),
}

impl Command {
    /// Returns whether the motor answers with its state.
    #[must_use]
    pub const fn is_answered_by_state(&self) -> bool {
        use Command::{ClearFault, GetFault, GetIndicator, GetRegister, GetSupply, Nothing, Wait};
        !matches!(self, Nothing | Wait | GetFault | GetIndicator(_) | GetSupply | GetRegister(_) | ClearFault)
    }
}

/// The part of a state besides the motion. The default is for motors whose states carry the motion
/// only.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Status {
    /// The faults of the motor; `None` where its states have none.
    pub faults: Option<Faults>,
    /// The motor reports a fault without its name, which it reports on request.
    pub has_unnamed_fault: bool,
    /// The motor reports that it is enabled, or that it is not; `None` where its states do not
    /// contain this.
    pub runs: Option<bool>,
}

/// The supply of a motor, as it reports it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Supply {
    /// V. It may be any number.
    pub voltage: f32,
    /// A, where the motor reports it. It may be any number.
    pub current: Option<f32>,
}

/// A reply of one motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reported {
    /// Its state, the time from the command to the answer, and the status in the state.
    State(Measured<JointSide>, Duration, Status),
    /// Its fault bits.
    Fault(Faults),
    /// Perhaps its fault bits, perhaps a late state. Its fault must be asked for again.
    Ambiguous(Faults),
    /// The value of the indicator with this number, in the unit of that indicator; NaN when the
    /// motor refuses.
    Indicator(u8, f32),
    /// Its supply.
    Supply(Supply),
    /// The value of the register with this number, in the unit of that register; it may be any
    /// number.
    Register(u8, f32),
    /// As [`Register`](Self::Register), in answer to a question of an earlier cycle.
    LateRegister(u8, f32),
    /// It received the request to clear its fault.
    Cleared,
    /// It received the command; the answer has no other content.
    Alive,
    /// It stopped.
    Stopped,
    /// It refuses the command: it may have a fault.
    Refused,
    /// The answer to a question of an earlier cycle. Not used.
    Late,
    /// No request asked for it. Not used.
    Unprompted,
}

/// The content that a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Question {
    /// The state: every command but the next two. A GIM motor may confirm such a command without a
    /// state.
    State,
    /// The fault bits.
    Fault,
    /// The value of a register, or the supply.
    Register,
    /// The confirmation that the motor received the request to clear its fault.
    Clear,
    /// None: the motor does not answer this command.
    Unanswered,
}

/// The shape of a reply, by its bytes alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// It has the id of another motor.
    OtherId,
    /// It is no reply, or it names another request than the open one.
    Unreadable,
    /// The answer to an access to a register, of this program or of another one, or to a question for
    /// the supply.
    Register,
    /// An unambiguous fault report: no state has its shape.
    Report,
    /// Read as a state, it continues the last state. It may be an ambiguous fault report.
    Continuation,
    /// No request asks for it: the motor reports something by itself, or answers another program.
    Unprompted,
    /// Any other reply.
    Plain,
}
