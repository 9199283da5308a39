//! The results of the functions, and the message of the last failure.

use motord_client::{Error, Obstacle, StopError};
use std::cell::RefCell;
use std::ffi::{CStr, CString};

/// The result of a function. `motord_error_message` explains a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub enum Status {
    /// It succeeded.
    Ok = 0,
    /// No state arrived in time, or the phase was not reached.
    Timeout = 1,
    /// No daemon runs, or it publishes no states. Calls work again once one does.
    NotRunning = 2,
    /// Another daemon runs now: claim again.
    Restarted = 3,
    /// The daemon refused the request.
    Refused = 4,
    /// The group is stopped. It needs a person and a reset.
    Stopped = 5,
    /// The claim no longer owns its group: claim again.
    ClaimLost = 6,
    /// There is no joint, group or IMU of this name or index.
    Unknown = 7,
    /// An argument is a null pointer, a freed handle, a wrong number of values, or no text in UTF-8.
    BadArgument = 8,
    /// A value is not finite, a gain is negative, or a horizon is longer than the configuration permits.
    BadSetpoint = 9,
    /// A motor has not reported its position.
    NotHeard = 10,
    /// The user lacks the permission.
    Permission = 11,
    /// Library and daemon have different versions.
    Version = 12,
    /// The daemon did not confirm a request. It may have executed it. After an emergency stop: cut the power.
    NotConfirmed = 13,
    /// A service is damaged, or every slot of it is taken.
    Unavailable = 14,
    /// Another thread uses this claim, state or publisher.
    Busy = 15,
    /// A defect of this library.
    Defect = 16,
    /// This process was forked from the one that created the object: connect again.
    Forked = 17,
    /// An emergency stop was confirmed, but motors do not answer and may still move: cut the power. `motord_error_joint` names them.
    MotorsOffline = 18,
    /// An emergency stop was confirmed, but whether each motor answers was not checked: watch the robot.
    MotorsUnchecked = 19,
}

/// The reason of a failure.
#[derive(Debug)]
pub struct Failure {
    /// Its kind.
    pub status: Status,
    /// A sentence for people.
    pub message: String,
    /// Joints whose motors do not answer.
    pub joints: Vec<String>,
}

impl Failure {
    /// Returns the failure of an argument.
    pub fn bad_argument(message: impl Into<String>) -> Self {
        Self::new(Status::BadArgument, message)
    }

    /// Returns a failure that names no joints.
    pub fn new(status: Status, message: impl Into<String>) -> Self {
        Self { status, message: message.into(), joints: Vec::new() }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let (status, message) = (Status::of(&error), error.to_string());
        match error {
            Error::MotorsOffline { joints } => Self { status, message, joints },
            _ => Self::new(status, message),
        }
    }
}

impl Status {
    /// Returns the kind of an error of the client library.
    #[must_use]
    pub const fn of(error: &Error) -> Self {
        match error {
            Error::Timeout { .. } | Error::NotReached { .. } => Self::Timeout,
            Error::NotRunning { .. } | Error::Silent { .. } => Self::NotRunning,
            Error::Restarted => Self::Restarted,
            Error::Refused { .. } | Error::OtherPublisher { .. } => Self::Refused,
            Error::Stopped { .. } => Self::Stopped,
            Error::ClaimLost { .. } => Self::ClaimLost,
            Error::UnknownGroup { .. } | Error::UnknownJoint { .. } | Error::UnknownImu { .. } => {
                Self::Unknown
            }
            Error::BadSetpoint { .. }
            | Error::BadSample { .. }
            | Error::SampleTime { .. }
            | Error::HorizonTooLong { .. } => Self::BadSetpoint,
            Error::NotHeard { .. } => Self::NotHeard,
            Error::Permission { .. } => Self::Permission,
            Error::Version { .. } | Error::NotUnderstood { .. } => Self::Version,
            Error::NoAnswer { .. } | Error::NotStopped { .. } => Self::NotConfirmed,
            Error::Service(error) => match error.obstacle {
                Obstacle::Permission => Self::Permission,
                Obstacle::Version => Self::Version,
                _ => Self::Unavailable,
            },
            Error::Instance(_) => Self::Unavailable,
            Error::Forked => Self::Forked,
            Error::MotorsOffline { .. } => Self::MotorsOffline,
            Error::MotorsUnchecked { .. } => Self::MotorsUnchecked,
            _ => Self::BadArgument,
        }
    }
}

impl From<StopError> for Status {
    fn from(error: StopError) -> Self {
        match error {
            StopError::NotRunning => Self::NotRunning,
            StopError::NotPermitted => Self::Permission,
            _ => Self::NotConfirmed,
        }
    }
}

/// The texts of the last failure.
#[derive(Default)]
struct Last {
    message: CString,
    joints: Vec<CString>,
}

thread_local! {
    static LAST: RefCell<Last> = RefCell::default();
}

/// Names come from other processes: a null byte would end the text.
fn text(text: &str) -> CString {
    CString::new(text.replace('\0', "?")).unwrap_or_default()
}

/// Stores the texts of a failure for this thread. Returns its kind.
pub fn fail(failure: Failure) -> Status {
    let Failure { status, message, joints } = failure;
    let last = Last { message: text(&message), joints: joints.iter().map(|joint| text(joint)).collect() };
    // The status alone, once the thread ends: exit handlers and destructors of static objects may
    // still call.
    let _stored = LAST.try_with(|kept| *kept.borrow_mut() = last);
    status
}

/// Passes the message of the last failure of this thread. It is empty before the first failure, and while the thread ends. It is valid
/// until the next failure.
pub fn message<T>(read: impl Fn(&CStr) -> T) -> T {
    LAST.try_with(|kept| read(&kept.borrow().message)).unwrap_or_else(|_| read(c""))
}

/// Passes a joint of the last failure of this thread, if there is one with this index. It is valid until the next failure.
pub fn joint<T>(index: usize, read: impl Fn(&CStr) -> T) -> Option<T> {
    LAST.try_with(|kept| kept.borrow().joints.get(index).map(|joint| read(joint))).ok().flatten()
}
