//! The role of a reply: classified by its shape and by the requests that were sent before it.

use motord_bus::Duration;
use motord_protocol::drive::Question;

/// The role of a payload, classified by its bytes and by the requests that were sent before it.
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
    /// The motor reports it by itself: it says nothing about requests.
    Unprompted,
    /// It is no reply, or cannot be an answer to the open request.
    Malformed,
    /// Comes from another motor.
    UnexpectedId,
}
