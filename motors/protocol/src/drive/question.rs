//! The content that a request asks for, and the shape of a reply.

/// The content that a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Question {
    /// The state: every command but the next two. A GIM motor may confirm such a command without a
    /// state.
    State,
    /// The fault bits.
    Fault,
    /// The value of a register.
    Register,
    /// The confirmation that the motor received the request to clear its fault.
    Clear,
}

/// The shape of a reply, by its bytes alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// It has the id of another motor.
    OtherId,
    /// It is no reply, or it names another request than the open one.
    Unreadable,
    /// The answer to an access to a register, of this program or of another one.
    Register,
    /// An unambiguous fault report: no state has its shape.
    Report,
    /// Read as a state, it continues the last state. It may be an ambiguous fault report.
    Continuation,
    /// Any other reply.
    Plain,
}
