//! Values of a caller: one number for all joints, one for each, or a mapping by name; and times.
//!
//! Reading a value may run code of the caller, and the handler of a signal. An exception of these
//! passes on: `KeyboardInterrupt` too.

use numpy::PyReadonlyArray1;
use pyo3::PyTypeInfo;
use pyo3::exceptions::{PyKeyError, PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyBytes, PyDict, PyFloat, PyFrozenSet, PySet, PyString, PyTuple};
use std::time::Duration;

/// Limit on the joints of a robot.
pub(crate) const JOINTS_MAX: usize = 64;

/// A number for each joint.
pub(crate) type Values = [f32; JOINTS_MAX];

/// Reads finite numbers for the joints; see [`read`]. The daemon would reject any other, and with it the whole message.
pub(crate) fn values(
    name: &str,
    value: Option<&Bound<'_, PyAny>>,
    joints: &[impl AsRef<str>],
) -> PyResult<Values> {
    let values = read(name, value, joints)?;
    let is_gain = name == "kp" || name == "kd";
    let is_bad = |value: &f32| !value.is_finite() || is_gain && *value < 0.0;
    match values.iter().take(joints.len()).position(is_bad) {
        None => Ok(values),
        Some(at) => {
            let expected = if is_gain { "a finite number, 0 or more" } else { "a finite number" };
            let is_named = value.map_or(Ok(false), is_mapping)?;
            let key = if is_named { format!("{:?}", joints[at].as_ref()) } else { at.to_string() };
            Err(PyValueError::new_err(format!("{name}[{key}] is {}: give {expected}", values[at])))
        }
    }
}

/// Reads position, velocity, stiffness, damping and torque of the joints. A stiffness needs a position. A position without a
/// stiffness, or a position or velocity without a damping, gets that of `hold`: a joint without them would be limp.
pub(crate) fn setpoints(
    given: [Option<&Bound<'_, PyAny>>; 5],
    hold: (f64, f64),
    joints: &[impl AsRef<str>],
) -> PyResult<[Values; 5]> {
    let given = given.map(|value| value.filter(|value| !value.is_none()));
    let [q, dq, kp, kd, _] = given;
    if q.is_none() && kp.is_some() {
        return Err(PyValueError::new_err("kp without q: a stiffness needs a position to follow"));
    }
    let mut read = [[0.0; JOINTS_MAX]; 5];
    for ((name, value), read) in ["q", "dq", "kp", "kd", "tau"].into_iter().zip(given).zip(&mut read) {
        *read = values(name, value, joints)?;
    }
    if q.is_some() && kp.is_none() {
        read[2] = [hold.0 as f32; JOINTS_MAX];
    }
    if (q.is_some() || dq.is_some()) && kd.is_none() {
        read[3] = [hold.1 as f32; JOINTS_MAX];
    }
    Ok(read)
}

/// The values of a setpoint for joints of these names, checked as those of Claim.send: a row for each argument.
#[pyfunction]
#[pyo3(name = "setpoints")]
#[allow(clippy::too_many_arguments, reason = "they are named in Python")]
pub(crate) fn checked_setpoints(
    q: Option<&Bound<'_, PyAny>>,
    dq: Option<&Bound<'_, PyAny>>,
    kp: Option<&Bound<'_, PyAny>>,
    kd: Option<&Bound<'_, PyAny>>,
    tau: Option<&Bound<'_, PyAny>>,
    hold: (f64, f64),
    joints: Vec<String>,
) -> PyResult<Vec<Vec<f32>>> {
    let count = joints.len();
    if count > JOINTS_MAX {
        return Err(PyValueError::new_err(format!("{count} joints: at most {JOINTS_MAX}")));
    }
    Ok(setpoints([q, dq, kp, kd, tau], hold, &joints)?
        .iter()
        .map(|values| values[..count].to_vec())
        .collect())
}

/// Reads the position of each joint: a number, an array, or a mapping that names each joint.
pub(crate) fn pose(value: &Bound<'_, PyAny>, joints: &[impl AsRef<str>]) -> PyResult<Values> {
    if value.is_none() {
        return Err(no_array("pose", value, joints.len()));
    }
    values("pose", Some(value), joints)
}

/// Returns `true` for a dict, and for any other value that names its entries, such as a `pandas.Series`.
fn is_mapping(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    value.hasattr("keys")
}

/// Reads a mapping that names each joint, and nothing else.
fn named(name: &str, value: &Bound<'_, PyAny>, joints: &[impl AsRef<str>]) -> PyResult<Vec<f64>> {
    for key in value.call_method0("keys")?.try_iter()? {
        // `to_string` would ignore an exception.
        let key = key?.str()?.to_string_lossy().into_owned();
        if !joints.iter().any(|joint| joint.as_ref() == key) {
            let known = joints.iter().map(AsRef::as_ref).collect::<Vec<_>>().join(", ");
            return Err(PyValueError::new_err(format!("{name} has {key:?}; there are {known}")));
        }
    }
    let mut listed = Vec::new();
    for joint in joints.iter().map(AsRef::as_ref) {
        let lacks = || PyValueError::new_err(format!("{name} lacks {joint}: give a value for each joint"));
        let found = without::<PyKeyError, _>(value.py(), value.get_item(joint))?.ok_or_else(lacks)?;
        let no_number = || PyValueError::new_err(format!("{name}[{joint:?}] is no number"));
        listed.push(number(&found)?.ok_or_else(no_number)?);
    }
    Ok(listed)
}

/// Returns `None` for an exception of the kind `E`. Another one passes on: that of a signal's handler, or of the caller's code.
fn without<E: PyTypeInfo, T>(py: Python<'_>, outcome: PyResult<T>) -> PyResult<Option<T>> {
    match outcome {
        Err(error) if error.is_instance_of::<E>(py) => Ok(None),
        outcome => outcome.map(Some),
    }
}

/// Reads a number; `None` for a value of another type, and for one with a length: libraries convert an array of one value to a
/// number. An integer that is too large is infinite.
fn number(value: &Bound<'_, PyAny>) -> PyResult<Option<f64>> {
    let has_length = || without::<PyTypeError, _>(value.py(), value.len()).map(|length| length.is_some());
    // The check of a float would cost more than its conversion.
    if !value.is_instance_of::<PyFloat>() && (has_length()? || is_complex(value)?) {
        return Ok(None);
    }
    let read = without::<PyTypeError, _>(value.py(), value.extract::<f64>());
    Ok(without::<PyOverflowError, _>(value.py(), read)?.unwrap_or(Some(f64::INFINITY)))
}

/// numpy converts a complex number, with a warning only.
fn is_complex(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    let Some(dtype) = value.getattr_opt("dtype")? else { return Ok(false) };
    dtype.getattr_opt("kind")?.map_or(Ok(false), |kind| kind.eq("c"))
}

/// Returns `true` for values that iterate as numbers and are none: text in bytes, and arrays of which some entries are invalid.
fn is_no_data(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    let is_bytes = value.is_instance_of::<PyBytes>() || value.is_instance_of::<PyByteArray>();
    Ok(is_bytes || (value.hasattr("mask")? && value.hasattr("fill_value")?))
}

/// Nothing is 0, a number is that of every joint, an array has one for each, a mapping names each.
fn read(name: &str, value: Option<&Bound<'_, PyAny>>, joints: &[impl AsRef<str>]) -> PyResult<Values> {
    let (mut values, count) = ([0.0; JOINTS_MAX], joints.len());
    let Some(value) = value.filter(|value| !value.is_none()) else { return Ok(values) };
    if let Some(number) = number(value)? {
        values[..count.min(JOINTS_MAX)].fill(number as f32);
        return Ok(values);
    }
    if is_no_data(value)? {
        return Err(no_array(name, value, count));
    }
    let py = value.py();
    if let Some(array) = without::<PyTypeError, _>(py, value.extract::<PyReadonlyArray1<'_, f64>>())? {
        let array = array.as_array();
        fill(name, &mut values, count, array.len(), array.iter().map(|value| *value as f32))?;
    } else if let Some(array) = without::<PyTypeError, _>(py, value.extract::<PyReadonlyArray1<'_, f32>>())? {
        let array = array.as_array();
        fill(name, &mut values, count, array.len(), array.iter().copied())?;
    } else if is_mapping(value)? {
        let named = named(name, value, joints)?;
        fill(name, &mut values, count, count, named.into_iter().map(|value| value as f32))?;
    } else {
        let (listed, received) = listed(name, value, count)?;
        fill(name, &mut values, count, received, listed.into_iter().map(|value| value as f32))?;
    }
    Ok(values)
}

/// Reads the numbers of a sequence, at most one more than `count`. Returns them and their number in the sequence.
fn listed(name: &str, value: &Bound<'_, PyAny>, count: usize) -> PyResult<(Vec<f64>, usize)> {
    let py = value.py();
    // A set has no order.
    if value.is_instance_of::<PySet>() || value.is_instance_of::<PyFrozenSet>() {
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
    match no_array_text(name, value, count) {
        Ok(text) => PyValueError::new_err(text),
        Err(raised) => raised,
    }
}

fn no_array_text(name: &str, value: &Bound<'_, PyAny>, count: usize) -> PyResult<String> {
    let Some(shape) = shape(value)?.filter(|shape| !shape.is_empty() && shape != &[count]) else {
        let found = value.get_type().repr()?;
        let found = found.to_string_lossy();
        let of = value.getattr_opt("dtype")?.map_or(String::new(), |dtype| format!(" of {dtype}"));
        return Ok(format!(
            "{name} is {found}{of}: give a number, a one-dimensional array of {count}, or a mapping by name"
        ));
    };
    // A network returns a batch of one.
    let row = if shape == [1, count] { format!(", such as {name}[0]") } else { String::new() };
    let shape = PyTuple::new(value.py(), shape)?.repr()?;
    let shape = shape.to_string_lossy();
    Ok(format!("{name} has the shape {shape}: give a number, or an array of {count}{row}"))
}

/// Returns the shape of an array of any library; `None` of another value.
fn shape(value: &Bound<'_, PyAny>) -> PyResult<Option<Vec<usize>>> {
    let Some(shape) = value.getattr_opt("shape")? else { return Ok(None) };
    without::<PyTypeError, _>(value.py(), shape.extract())
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
