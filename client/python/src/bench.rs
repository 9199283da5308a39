//! The loop of `python -m motord.bench` without Python, for comparison in the same run.

use crate::claim::Claim;
use motord_client::{Claim as ClientClaim, Client, Error};
use numpy::PyArray1;
use pyo3::prelude::*;
use std::time::{Duration, Instant};

const TIMEOUT: Duration = Duration::from_secs(1);

/// Times, s, and the setpoints that a cycle used.
#[derive(Default)]
struct Measured {
    wake: Vec<f64>,
    send: Vec<f64>,
    used: u64,
    late: u64,
}

/// The loop of motord.bench without Python. Returns times of wake-up and send, s, and the used and the late setpoints.
#[pyfunction]
#[expect(clippy::type_complexity, reason = "the values of a tuple")]
pub(crate) fn measure<'py>(
    py: Python<'py>,
    claim: &Claim,
    every: u32,
    seconds: f64,
) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, u64, u64)> {
    let measured = claim.call(py, |client, claim| control(client, claim, every, seconds))?;
    let Measured { wake, send, used, late } = measured;
    Ok((PyArray1::from_vec(py, wake), PyArray1::from_vec(py, send), used, late))
}

fn control(client: &Client, claim: &mut ClientClaim, every: u32, seconds: f64) -> Result<Measured, Error> {
    let mut measured = Measured::default();
    let (begun, mut in_use) = (Instant::now(), 0);
    while begun.elapsed().as_secs_f64() < seconds {
        let state = client.wait_cycles(every, TIMEOUT)?;
        let woken = state.age();
        state.of(claim)?.must_be_active()?;
        let before = Instant::now();
        claim.commit()?;
        measured.send.push(before.elapsed().as_secs_f64());
        measured.wake.push(woken.as_secs_f64());
        let Some(group) = state.group(claim.index()) else { continue };
        let is_new = std::mem::replace(&mut in_use, group.sequence) != group.sequence;
        if let Some(cycles) = group.control_cycles.filter(|_| is_new) {
            measured.used += 1;
            measured.late += u64::from(cycles > 1);
        }
    }
    Ok(measured)
}
