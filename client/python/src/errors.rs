//! The exceptions.

use crate::arrays::duration;
use motord_client::{Cause, Error as ClientError, Lateness, Phase, Refusal, Stop};
use pyo3::create_exception;
use pyo3::exceptions::{PyBaseException, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};

create_exception!(motord, Error, PyRuntimeError, "A call failed. Its text says what to do.");
create_exception!(
    motord,
    Stopped,
    Error,
    "The group is stopped: it needs a person and a reset.\n\n\
     cause is its name, such as motor-lost, and joint the joint that gave it; None without one. If this program sent no\n\
     setpoint for longer than timeout, the setpoint timeout in s, gap is that time in s; otherwise both are None."
);
create_exception!(
    motord,
    Refused,
    Error,
    "The daemon refused a request. reason is the name of its reason, such as owned."
);
create_exception!(motord, Restarted, Error, "Another daemon runs now: claim again.");
create_exception!(
    motord,
    NotRunning,
    Error,
    "No daemon runs, or it publishes no states. Calls work again once one does."
);
create_exception!(motord, ClaimLost, Error, "The claim no longer owns its group: claim again.");
create_exception!(motord, TimedOut, Error, "No state arrived in time, or a phase was not reached.");
create_exception!(
    motord,
    MotorsOffline,
    Error,
    "An emergency stop was confirmed, but motors do not answer and may still move: cut the power. joints names them."
);
create_exception!(
    motord,
    Forked,
    Error,
    "This process was forked from the one that created the object: connect again."
);

/// Converts an error of the client library. Mistakes of the caller are a `ValueError`.
pub(crate) fn raised(error: &ClientError) -> PyErr {
    let text = error.to_string();
    match error {
        ClientError::Stopped { stop, .. } => {
            let late = lateness_of(stop);
            let [gap, timeout] = [late.map(|late| late.gap), late.map(|late| late.timeout)]
                .map(|time| time.map(|time| time.as_secs_f64()));
            let error = PyErr::new::<Stopped, _>(text);
            let error = with(error, &[("cause", cause_of(stop)), ("joint", joint_of(stop))]);
            with(error, &[("gap", gap), ("timeout", timeout)])
        }
        ClientError::Refused { refusal, .. } => {
            with(PyErr::new::<Refused, _>(text), &[("reason", Some(refusal.name().to_owned()))])
        }
        ClientError::Restarted => PyErr::new::<Restarted, _>(text),
        ClientError::NotRunning { .. } | ClientError::Silent { .. } => PyErr::new::<NotRunning, _>(text),
        ClientError::ClaimLost { .. } => PyErr::new::<ClaimLost, _>(text),
        ClientError::MotorsOffline { joints } => {
            with(PyErr::new::<MotorsOffline, _>(text), &[("joints", joints.clone())])
        }
        ClientError::Forked => PyErr::new::<Forked, _>(text),
        ClientError::Timeout { .. } | ClientError::NotReached { .. } => PyErr::new::<TimedOut, _>(text),
        ClientError::UnknownGroup { .. }
        | ClientError::UnknownJoint { .. }
        | ClientError::JointOrder { .. }
        | ClientError::UnknownImu { .. }
        | ClientError::NotExternal { .. }
        | ClientError::SetpointCount { .. }
        | ClientError::NotSet { .. }
        | ClientError::BadSetpoint { .. }
        | ClientError::HorizonTooLong { .. }
        | ClientError::BadSample { .. }
        | ClientError::SampleTime { .. } => PyErr::new::<PyValueError, _>(text),
        _ => PyErr::new::<Error, _>(text),
    }
}

/// The exception for a group that does not follow setpoints, as a claim raises it.
///
/// late is the time since the last message of the owner, the horizon of that message, and the setpoint timeout, s.
#[pyfunction]
pub(crate) fn stopped(
    py: Python<'_>,
    group: String,
    phase: Option<&str>,
    cause: Option<&str>,
    joint: Option<String>,
    late: (f64, f64, f64),
) -> PyResult<Py<PyBaseException>> {
    let known = |name: &str| Cause::ALL.iter().find(|cause| cause.name() == name).copied();
    let (gap, horizon, timeout) =
        (duration("gap", late.0)?, duration("horizon", late.1)?, duration("timeout", late.2)?);
    let is_late = cause == Some(Cause::SetpointTimeout.name()) && gap > horizon + timeout;
    let lateness = is_late.then_some(Lateness { gap, horizon, timeout });
    let stop = match cause {
        Some(name) => {
            known(name).map_or(Stop::Unknown, |cause| Stop::Cause { cause, joint, pid: None, lateness })
        }
        None if phase == Some(Phase::Starting.name()) => Stop::Starting,
        None => Stop::Disabled,
    };
    Ok(raised(&ClientError::Stopped { group, stop }).into_value(py))
}

/// Converts a refusal of a twin's cycle.
pub(crate) fn refused(refusal: Refusal) -> PyErr {
    with(PyErr::new::<Refused, _>(refusal.sentence()), &[("reason", Some(refusal.name().to_owned()))])
}

fn cause_of(stop: &Stop) -> Option<String> {
    match stop {
        Stop::Cause { cause, .. } => Some(cause.name().to_owned()),
        _ => None,
    }
}

fn joint_of(stop: &Stop) -> Option<String> {
    match stop {
        Stop::Cause { joint, .. } => joint.clone(),
        _ => None,
    }
}

fn lateness_of(stop: &Stop) -> Option<Lateness> {
    match stop {
        Stop::Cause { lateness, .. } => *lateness,
        _ => None,
    }
}

/// Adds attributes to an exception.
fn with<T: Clone + for<'py> IntoPyObject<'py>>(error: PyErr, attributes: &[(&str, T)]) -> PyErr {
    Python::attach(|py| {
        let value = error.value(py);
        for (name, attribute) in attributes {
            if let Err(raised) = value.setattr(*name, attribute.clone()) {
                return raised;
            }
        }
        error
    })
}

/// Calls the client library. A panic becomes an `Error`: Python's `PanicException` passes each `except Exception`.
pub(crate) fn caught<T>(call: impl FnOnce() -> T) -> PyResult<T> {
    catch_unwind(AssertUnwindSafe(call))
        .map_err(|_| PyErr::new::<Error, _>("a defect of motord: please report it, with standard error"))
}
