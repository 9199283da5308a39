//! The words of the correlation: what a request asks for, what a payload looks like, and which role it has.

use motord_bus::Duration;

/// The content that a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Question {
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

/// The kind of a payload, judged by its bytes alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Payload {
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

/// The role of a payload, judged by its bytes and by the requests that were sent before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    /// The answer to the open request, and the time since that was sent.
    Answer(Question, Duration),
    /// An answer to the open fault request that may be a late state instead of a report.
    Ambiguous,
    /// A fault report, which answers an earlier fault request.
    LateReport,
    /// A register, which answers an earlier request: it names its number.
    LateRegister,
    /// Answers an earlier request. Its content is unknown or outdated.
    Late,
    /// Answers no request.
    Duplicate,
    /// It is no reply, or cannot be an answer to the open request.
    Malformed,
    /// Comes from another motor.
    UnexpectedId,
}
