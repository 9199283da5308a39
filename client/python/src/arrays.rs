//! Values of a caller: one number for all joints, or one for each; and times.
//!
//! Reading a value may run code of the caller, and the handler of a signal. An exception of these passes on: `KeyboardInterrupt` too.

use numpy::PyReadonlyArray1;
use pyo3::PyTypeInfo;
use pyo3::exceptions::{PyKeyError, PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyFrozenSet, PyList, PySet, PyString};
use std::time::Duration;

/// Limit on the joints of a robot.
pub(crate) const JOINTS_MAX: usize = 64;

/// A number for each joint.
pub(crate) type Values = [f32; JOINTS_MAX];

/// Reads finite numbers for `count` joints; see [`read`]. The daemon would reject any other, and with it the whole message.
pub(crate) fn values(name: &str, value: Option<&Bound<'_, PyAny>>, count: usize) -> PyResult<Values> {
    let values = read(name, value, count)?;
    let is_gain = name == "kp" || name == "kd";
    let is_bad = |value: &f32| !value.is_finite() || is_gain && *value < 0.0;
    match values.iter().take(count).position(is_bad) {
        None => Ok(values),
        Some(at) => {
            let expected = if is_gain { "a finite number, 0 or more" } else { "a finite number" };
            Err(PyValueError::new_err(format!("{name}[{at}] is {}: give {expected}", values[at])))
        }
    }
}

/// Reads position, velocity, stiffness, damping and torque of `count` joints. A stiffness needs a position.
pub(crate) fn setpoints(given: [Option<&Bound<'_, PyAny>>; 5], count: usize) -> PyResult<[Values; 5]> {
    let [q, _, kp, ..] = given;
    if q.is_none() && kp.is_some_and(|kp| !kp.is_none()) {
        return Err(PyValueError::new_err("kp without q: a stiffness needs a position to follow"));
    }
    let mut read = [[0.0; JOINTS_MAX]; 5];
    for ((name, value), read) in ["q", "dq", "kp", "kd", "tau"].into_iter().zip(given).zip(&mut read) {
        *read = values(name, value, count)?;
    }
    Ok(read)
}

/// Reads the position of each joint: a number, an array, or a mapping that names each joint.
pub(crate) fn pose(value: &Bound<'_, PyAny>, names: &[String]) -> PyResult<Values> {
    if !is_mapping(value)? {
        return values("pose", Some(value), names.len());
    }
    for key in value.call_method0("keys")?.try_iter()? {
        // `to_string` would ignore an exception.
        let key = key?.str()?.to_string_lossy().into_owned();
        if !names.contains(&key) {
            let known = names.join(", ");
            return Err(PyValueError::new_err(format!("pose has {key:?}; there are {known}")));
        }
    }
    let mut listed = Vec::new();
    for name in names {
        let lacks = || PyValueError::new_err(format!("pose lacks {name}: give a position for each joint"));
        let position = without::<PyKeyError, _>(value.py(), value.get_item(name))?.ok_or_else(lacks)?;
        let no_number = || PyValueError::new_err(format!("pose[{name:?}] is no number"));
        listed.push(number(&position)?.ok_or_else(no_number)?);
    }
    values("pose", Some(&PyList::new(value.py(), listed)?.into_any()), names.len())
}

/// A cast to `PyMapping` would ignore an exception of the check.
fn is_mapping(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    let is_dict = value.is_instance_of::<PyDict>();
    Ok(is_dict || value.is_instance(&value.py().import("collections.abc")?.getattr("Mapping")?)?)
}

/// Returns `None` for an exception of the kind `E`. Another one passes on: that of a signal's handler, or of the caller's code.
fn without<E: PyTypeInfo, T>(py: Python<'_>, outcome: PyResult<T>) -> PyResult<Option<T>> {
    match outcome {
        Err(error) if error.is_instance_of::<E>(py) => Ok(None),
        outcome => outcome.map(Some),
    }
}

/// Reads a number; `None` for a value of another type. An integer that is too large is infinite.
fn number(value: &Bound<'_, PyAny>) -> PyResult<Option<f64>> {
    let read = without::<PyTypeError, _>(value.py(), value.extract::<f64>());
    Ok(without::<PyOverflowError, _>(value.py(), read)?.unwrap_or(Some(f64::INFINITY)))
}

/// Nothing is 0, a number is that of every joint, an array has one for each.
fn read(name: &str, value: Option<&Bound<'_, PyAny>>, count: usize) -> PyResult<Values> {
    let mut values = [0.0; JOINTS_MAX];
    let Some(value) = value.filter(|value| !value.is_none()) else { return Ok(values) };
    if let Some(number) = number(value)? {
        values[..count.min(JOINTS_MAX)].fill(number as f32);
        return Ok(values);
    }
    let py = value.py();
    if let Some(array) = without::<PyTypeError, _>(py, value.extract::<PyReadonlyArray1<'_, f64>>())? {
        let array = array.as_array();
        fill(name, &mut values, count, array.len(), array.iter().map(|value| *value as f32))?;
    } else if let Some(array) = without::<PyTypeError, _>(py, value.extract::<PyReadonlyArray1<'_, f32>>())? {
        let array = array.as_array();
        fill(name, &mut values, count, array.len(), array.iter().copied())?;
    } else {
        let (listed, received) = listed(name, value, count)?;
        fill(name, &mut values, count, received, listed.into_iter().map(|value| value as f32))?;
    }
    Ok(values)
}

/// Reads the numbers of a sequence, at most one more than `count`. Returns them and their number in the sequence.
fn listed(name: &str, value: &Bound<'_, PyAny>, count: usize) -> PyResult<(Vec<f64>, usize)> {
    let py = value.py();
    // A set has no order, and a dict has names: neither is a list of values.
    if value.is_instance_of::<PySet>()
        || value.is_instance_of::<PyFrozenSet>()
        || value.is_instance_of::<PyDict>()
    {
        return Err(no_array(name, value, count));
    }
    let Some(length) = without::<PyTypeError, _>(py, value.len())? else {
        return Err(no_array(name, value, count));
    };
    let Some(items) = without::<PyTypeError, _>(py, value.try_iter())? else {
        return Err(no_array(name, value, count));
    };
    let mut listed = Vec::new();
    for item in items.take(count + 1) {
        listed.push(number(&item?)?.ok_or_else(|| no_array(name, value, count))?);
    }
    let received = if listed.len() > count { length.max(listed.len()) } else { listed.len() };
    Ok((listed, received))
}

fn no_array(name: &str, value: &Bound<'_, PyAny>, count: usize) -> PyErr {
    match value.get_type().repr() {
        Ok(found) => PyValueError::new_err(format!(
            "{name} is {}: give a number, or a one-dimensional array of {count}",
            found.to_string_lossy()
        )),
        Err(raised) => raised,
    }
}

/// Names of a caller, in their order. A conversion to `Vec` would ignore an exception of `__len__`.
pub(crate) struct Names(pub(crate) Vec<String>);

impl<'py> FromPyObject<'_, 'py> for Names {
    type Error = PyErr;

    fn extract(value: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if value.is_instance_of::<PyString>() || value.is_instance_of::<PyDict>() {
            return Err(PyTypeError::new_err("give a list of names"));
        }
        let name = |at| value.get_item(at)?.extract::<String>();
        (0..value.len()?).map(name).collect::<PyResult<_>>().map(Self)
    }
}

fn fill(
    name: &str,
    values: &mut Values,
    count: usize,
    received: usize,
    source: impl Iterator<Item = f32>,
) -> PyResult<()> {
    if received != count {
        return Err(PyValueError::new_err(format!(
            "{name} has {received} values; the group has {count} joints"
        )));
    }
    values.iter_mut().zip(source).for_each(|(value, given)| *value = given);
    Ok(())
}

/// Converts a time of a caller, s.
pub(crate) fn duration(name: &str, seconds: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(seconds)
        .map_err(|_| PyValueError::new_err(format!("{name} is {seconds}: give a time in seconds, 0 or more")))
}
