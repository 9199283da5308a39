//! Requests of services to the motor thread.

/// An operation on a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Operation {
    Claim,
    Release,
    Enable,
    Disable,
    Reset,
}

/// The outcome, as a sentence for the caller.
pub(crate) type Answer = Result<String, String>;

/// A request of a service.
#[derive(Debug)]
pub(crate) struct Request {
    /// Index of the group in the description.
    pub(crate) group: usize,
    pub(crate) operation: Operation,
    pub(crate) answer: async_channel::Sender<Answer>,
}
