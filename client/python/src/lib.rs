//! The client library for Python: `python/motord/_motord.pyi` describes each class and function.
//!
//! - `robot`: a connection.
//! - `claim`: the ownership of a group, and its loop.
//! - `keep`: repeating setpoints for a notebook.
//! - `state`: a cycle, as numpy arrays.
//! - `motion`: a smooth motion to a pose.
//! - `twin`: a robot on virtual time.
//! - `arrays`: values of a caller, one for each joint.
//! - `errors`: the exceptions.
//! - `interpreter`: waiting without the interpreter's lock, and the warning when that does not help.
//! - `bench`: the loop of the benchmark without Python.
//!
//! Waiting releases the interpreter's lock. Sending does not: it takes microseconds.

mod arrays;
mod bench;
mod claim;
mod errors;
mod interpreter;
mod keep;
mod motion;
mod robot;
mod state;
mod twin;

/// The compiled part of motord.
#[pyo3::pymodule]
mod _motord {
    #[pymodule_export]
    use crate::arrays::checked_setpoints;
    #[pymodule_export]
    use crate::bench::measure;
    #[pymodule_export]
    use crate::claim::{Claim, Cycles, every};
    #[pymodule_export]
    use crate::errors::{
        ClaimLost, Error, Forked, MotorsOffline, NotRunning, Refused, Restarted, Stopped, TimedOut, stopped,
    };
    #[pymodule_export]
    use crate::keep::Keep;
    #[pymodule_export]
    use crate::motion::Motion;
    #[pymodule_export]
    use crate::robot::{ImuPublisher, Robot, connect, estop};
    #[pymodule_export]
    use crate::state::{Imu, Imus, State};
    #[pymodule_export]
    use crate::twin::{Engine, describe};
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::keep::prepare(module.py())?;
        crate::interpreter::prepare(module.py())
    }
}
