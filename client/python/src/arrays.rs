//! Values of a caller: one number for all joints, or one for each; and times.

use numpy::PyReadonlyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyList, PyMapping};
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
    let Ok(mapping) = value.cast::<PyMapping>().cloned() else {
        return values("pose", Some(value), names.len());
    };
    if let Some(other) = mapping.keys()?.iter().map(|key| key.to_string()).find(|key| !names.contains(key)) {
        return Err(PyValueError::new_err(format!("pose has {other:?}; there are {}", names.join(", "))));
    }
    let mut listed = Vec::new();
    for name in names {
        let lacks = || PyValueError::new_err(format!("pose lacks {name}: give a position for each joint"));
        let position = mapping.get_item(name).map_err(|_| lacks())?;
        listed.push(
            position
                .extract::<f64>()
                .map_err(|_| PyValueError::new_err(format!("pose[{name:?}] is no number")))?,
        );
    }
    values("pose", Some(&PyList::new(value.py(), listed)?.into_any()), names.len())
}

/// Nothing is 0, a number is that of every joint, an array has one for each.
fn read(name: &str, value: Option<&Bound<'_, PyAny>>, count: usize) -> PyResult<Values> {
    let mut values = [0.0; JOINTS_MAX];
    let Some(value) = value.filter(|value| !value.is_none()) else { return Ok(values) };
    if let Ok(number) = value.extract::<f64>() {
        values[..count.min(JOINTS_MAX)].fill(number as f32);
        return Ok(values);
    }
    if let Ok(array) = value.extract::<PyReadonlyArray1<'_, f64>>() {
        fill(
            name,
            &mut values,
            count,
            array.as_array().len(),
            array.as_array().iter().map(|value| *value as f32),
        )?;
    } else if let Ok(array) = value.extract::<PyReadonlyArray1<'_, f32>>() {
        fill(name, &mut values, count, array.as_array().len(), array.as_array().iter().copied())?;
    } else {
        let listed = value.extract::<Vec<f64>>().map_err(|_| {
            let found = value.get_type().to_string();
            PyValueError::new_err(format!(
                "{name} is {found}: give a number, or a one-dimensional array of {count}"
            ))
        })?;
        fill(name, &mut values, count, listed.len(), listed.iter().map(|value| *value as f32))?;
    }
    Ok(values)
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
