//! The ownership of a group, and its loop.

use crate::arrays::{JOINTS_MAX, Values, duration, pose, setpoints, values};
use crate::errors::{self, caught, raised};
use crate::interpreter::{unused, without_lock};
use crate::keep::{Keep, Owned, Schedule, locked};
use crate::motion::Begun;
use crate::state::{Clock, State, StateLayout, deprecated};
use motord_client::{Claim as ClientClaim, Client, Error, Phase, Setpoint, State as ClientState};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// Longer than a shared machine stalls.
const TIMEOUT: Duration = Duration::from_secs(1);
/// Longer than motors take to start or to stop.
const CHANGE: Duration = Duration::from_secs(60);

/// The ownership of a group. One thread uses it at a time. Use it in a with statement.
#[pyclass(frozen, module = "motord")]
pub(crate) struct Claim {
    client: Arc<Client>,
    /// Locked by the call of a thread.
    in_use: Mutex<()>,
    /// Locked for less than a call, by it and by the thread of `keep`.
    owned: Arc<Mutex<Option<Owned>>>,
    order: Arc<StateLayout>,
    /// The place in the claim of each entry of `order`.
    slots: Vec<usize>,
    group: String,
}

/// Stiffness, N·m/rad, and damping, N·m·s/rad, of a group that is enabled without others.
const HOLD: (f64, f64) = (20.0, 0.5);

/// Returns the place in the group of each of `names`, which must be all of `known`.
fn slots(group: &str, known: &[&str], names: &[String]) -> PyResult<Vec<usize>> {
    let bad = |text: String| Err(PyValueError::new_err(format!("{text}; {group} has {}", known.join(", "))));
    let mut slots = Vec::new();
    for name in names {
        match known.iter().position(|other| other == name) {
            None => return bad(format!("there is no joint {name:?}")),
            Some(slot) if slots.contains(&slot) => return bad(format!("names has {name} twice")),
            Some(slot) => slots.push(slot),
        }
    }
    match known.iter().enumerate().find(|(slot, _)| !slots.contains(slot)) {
        Some((_, name)) => bad(format!("names lacks {name}: name each joint of the group")),
        None => Ok(slots),
    }
}

impl Claim {
    /// Wraps a claim, with its joints in the order of `names`.
    pub(crate) fn new(client: Arc<Client>, claim: ClientClaim, names: Option<Vec<String>>) -> PyResult<Self> {
        let known: Vec<_> = claim.names().collect();
        let slots = match &names {
            None => (0..known.len()).collect(),
            Some(names) => slots(claim.group(), &known, names)?,
        };
        let order = StateLayout {
            joints: slots.iter().map(|slot| claim.joints()[*slot]).collect(),
            names: slots.iter().map(|slot| known[*slot].to_owned()).collect(),
            imus: client.description().imus.iter().map(|imu| imu.name.clone()).collect(),
            has_samples: true,
            group: Some(claim.index()),
        };
        let group = claim.group().to_owned();
        let owned = Arc::new(Mutex::new(Some(Owned::new(claim, HOLD))));
        Ok(Self { client, in_use: Mutex::new(()), owned, order: Arc::new(order), slots, group })
    }

    /// Reserves the claim for the call of this thread.
    fn alone(&self) -> PyResult<MutexGuard<'_, ()>> {
        // First: in a forked process a thread that does not exist may hold the lock.
        self.client.check_process().map_err(|error| raised(&error))?;
        unused(&self.in_use).ok_or_else(|| {
            let group = &self.group;
            let text = format!("another thread uses the claim of {group}: one thread controls a group");
            PyErr::new::<errors::Error, _>(text)
        })
    }

    /// Calls with the claim.
    fn with<T>(&self, call: impl FnOnce(&mut Owned) -> PyResult<T>) -> PyResult<T> {
        let _alone = self.alone()?;
        self.with_owned(call)
    }

    /// Calls with the claim, for a call that has reserved it.
    fn with_owned<T>(&self, call: impl FnOnce(&mut Owned) -> PyResult<T>) -> PyResult<T> {
        match &mut *locked(&self.owned) {
            Some(owned) => call(owned),
            None => Err(PyValueError::new_err(format!("the claim of {} was released", self.group))),
        }
    }

    /// Reads the times of `keep`.
    fn schedule(&self, hz: f64, seconds: f64) -> PyResult<Schedule> {
        let robot = self.client.description();
        let lowest = 2.0 / robot.setpoint_timeout.as_secs_f64();
        if !(lowest..=robot.rate_hz).contains(&hz) {
            let timeout = robot.setpoint_timeout.as_secs_f64() * 1e3;
            return Err(PyValueError::new_err(format!(
                "hz is {hz}: give {lowest} to {}, since setpoint-timeout-ms is {timeout}",
                robot.rate_hz
            )));
        }
        Ok(Schedule { period: Duration::from_secs_f64(1.0 / hz), most: duration("seconds", seconds)? })
    }

    /// Waits without the interpreter's lock. The thread of `keep` may repeat setpoints meanwhile.
    fn wait_alone(
        &self,
        py: Python<'_>,
        wait: impl Send + FnOnce(&Client) -> Result<ClientState, Error>,
    ) -> PyResult<ClientState> {
        self.with_owned(|_| Ok(()))?;
        let client = &self.client;
        without_lock(py, || wait(client))?.map_err(|error| raised(&error))
    }

    /// Waits for the state of a cycle that is due, of a group that must be active.
    fn next_active(&self, py: Python<'_>, every: u32, timeout: Duration) -> PyResult<ClientState> {
        let _alone = self.alone()?;
        let state = self.wait_alone(py, |client| client.wait_cycles(every, timeout))?;
        self.with_owned(|owned| {
            let group = state.of(&owned.claim).and_then(|group| group.must_be_active());
            group.map_err(|error| raised(&error))
        })?;
        Ok(state)
    }

    /// Reads stiffness and damping; those of the last `enable` where none is given.
    fn gains(
        &self,
        kp: Option<&Bound<'_, PyAny>>,
        kd: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<(Values, Values)> {
        let or = |name, given: Option<&Bound<'_, PyAny>>, default: f64| match given {
            Some(given) => values(name, Some(given), &self.order.names),
            None => Ok([default as f32; JOINTS_MAX]),
        };
        let hold = self.with(|owned| Ok(owned.hold))?;
        Ok((or("kp", kp, hold.0)?, or("kd", kd, hold.1)?))
    }

    /// Calls the daemon without the interpreter's lock, in a call that sends new setpoints.
    fn call_anew<T: Send>(
        &self,
        py: Python<'_>,
        call: impl Send + FnOnce(&Client, &mut ClientClaim) -> Result<T, Error>,
    ) -> PyResult<T> {
        self.with(|owned| {
            let called = without_lock(py, || call(&self.client, &mut owned.claim))?;
            owned.renew(Duration::ZERO);
            called.map_err(|error| raised(&error))
        })
    }

    /// Calls the daemon without the interpreter's lock.
    pub(crate) fn call<T: Send>(
        &self,
        py: Python<'_>,
        call: impl Send + FnOnce(&Client, &mut ClientClaim) -> Result<T, Error>,
    ) -> PyResult<T> {
        self.with(|owned| {
            without_lock(py, || call(&self.client, &mut owned.claim))?.map_err(|error| raised(&error))
        })
    }
}

#[pymethods]
impl Claim {
    /// Name of the group.
    #[getter]
    fn group(&self) -> &str {
        &self.group
    }

    /// Names of the joints, in the order of the arrays.
    #[getter]
    fn joints(&self) -> Vec<String> {
        self.order.names.clone()
    }

    /// Deprecated: joints.
    #[getter]
    fn names(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        deprecated(py, c"Claim.names is deprecated: use joints")?;
        Ok(self.joints())
    }

    fn __len__(&self) -> usize {
        self.order.joints.len()
    }

    /// Starts the motors where they are, with this stiffness (N·m/rad) and damping (N·m·s/rad), and waits until they follow.
    #[pyo3(signature = (hold = HOLD))]
    fn enable(&self, py: Python<'_>, hold: (f64, f64)) -> PyResult<()> {
        let (kp, kd) = (hold.0 as f32, hold.1 as f32);
        self.with(|owned| {
            owned.hold = hold;
            Ok(())
        })?;
        self.call_anew(py, |client, claim| {
            claim.wait_for(Phase::Disarmed, CHANGE)?;
            claim.hold(&client.wait(TIMEOUT)?, kp, kd)?;
            match claim.commit() {
                // The daemon refuses to enable it, and names the cause.
                Ok(()) | Err(Error::Stopped { .. }) => claim.enable()?,
                Err(error) => return Err(error),
            }
            claim.wait_for(Phase::Active, CHANGE)
        })
    }

    /// Damps and stops the motors.
    fn disable(&self, py: Python<'_>) -> PyResult<()> {
        self.call(py, |_, claim| claim.disable())
    }

    /// Clears the latched cause of a stop. Leave this to a person who has inspected the robot.
    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        self.call(py, |_, claim| claim.reset())
    }

    /// Releases the group. An active one is stopped.
    fn release(&self, py: Python<'_>) -> PyResult<()> {
        let _alone = self.alone()?;
        let Some(Owned { claim, .. }) = locked(&self.owned).take() else { return Ok(()) };
        py.detach(|| caught(|| claim.release()))?.map_err(|error| raised(&error))
    }

    /// Sends a setpoint for each joint: rad, rad/s, N·m/rad, N·m·s/rad, N·m.
    ///
    /// Each argument is a number for all joints, an array in the order of the claim, or a mapping that names each joint, in any
    /// order; the default is 0. Without kp, q has the stiffness of the last enable; without kd, q and dq have its damping. The
    /// motor's torque is kp (q - position) + kd (dq - velocity) + tau, within the limits. Does not wait. Call it in every
    /// cycle.
    ///
    /// Raises Stopped with each call after a stop of the group, until a reset, and ClaimLost.
    ///
    /// With a horizon, s, the daemon moves q, dq and tau linearly from the present command to these within that time after
    /// they were sent; the setpoint timeout begins at its end. For a controller slower than the cycle: a horizon of its
    /// period and what it may be late. ValueError when it is longer than setpoint-horizon-max-ms of the configuration.
    #[pyo3(signature = (*, q = None, dq = None, kp = None, kd = None, tau = None, horizon = 0.0))]
    #[allow(clippy::too_many_arguments, reason = "they are named in Python")]
    fn send(
        &self,
        q: Option<&Bound<'_, PyAny>>,
        dq: Option<&Bound<'_, PyAny>>,
        kp: Option<&Bound<'_, PyAny>>,
        kd: Option<&Bound<'_, PyAny>>,
        tau: Option<&Bound<'_, PyAny>>,
        horizon: f64,
    ) -> PyResult<()> {
        let count = self.order.joints.len();
        let horizon = duration("horizon", horizon)?;
        let hold = self.with(|owned| Ok(owned.hold))?;
        let [q, dq, kp, kd, tau] = self::setpoints([q, dq, kp, kd, tau], hold, &self.order.names)?;
        let mut setpoints = [Setpoint::torque(0.0); JOINTS_MAX];
        for (at, slot) in self.slots.iter().enumerate() {
            setpoints[*slot] = Setpoint::impedance(q[at], dq[at], kp[at], kd[at], tau[at]);
        }
        self.with(|owned| {
            owned.renew(horizon);
            let claim = &mut owned.claim;
            let sent = caught(|| claim.set_horizon(horizon).and_then(|()| claim.send(&setpoints[..count])))?;
            sent.map_err(|error| raised(&error))
        })
    }

    /// Moves the joints to a pose, rad, smoothly within seconds, and returns when the pose is sent.
    ///
    /// pose is a number, an array, or a mapping that names each joint. The gains are those of enable unless given. Raises
    /// ValueError before it moves if a joint would leave its limits of position or velocity, and Stopped when the group is
    /// not active or is stopped. The pose is held for setpoint-horizon-max-ms and the setpoint timeout: send the next
    /// setpoint before.
    #[pyo3(signature = (pose, seconds, *, kp = None, kd = None))]
    fn move_to(
        &self,
        py: Python<'_>,
        pose: &Bound<'_, PyAny>,
        seconds: f64,
        kp: Option<&Bound<'_, PyAny>>,
        kd: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let seconds = duration("seconds", seconds)?.as_secs_f64();
        let goals = self::pose(pose, &self.order.names)?;
        let (kp, kd) = self.gains(kp, kd)?;
        let mut by_slot = [[0.0; 3]; JOINTS_MAX];
        for (at, slot) in self.slots.iter().enumerate() {
            by_slot[*slot] = [goals[at], kp[at], kd[at]];
        }
        let motion = self.call(py, |client, claim| {
            claim.set_horizon(Duration::ZERO)?;
            let state = client.wait(TIMEOUT)?;
            Begun::plan(claim, &state, |slot| by_slot[slot], seconds)
        })?;
        let motion = motion.map_err(PyValueError::new_err)?;
        while !self.call_anew(py, |client, claim| motion.advance(client, claim))? {
            py.check_signals()?;
        }
        Ok(())
    }

    /// Waits for the cycles that are due at hz, or for all, and yields their states.
    ///
    /// The last setpoints are kept until the first state of a slow loop, as far as setpoint-horizon-max-ms permits.
    /// Raises Stopped when the group is stopped, ClaimLost, Restarted, NotRunning or TimedOut. hz must be a whole part of
    /// the daemon's rate.
    #[pyo3(signature = (hz = None, *, timeout = 1.0))]
    fn cycles(slf: Bound<'_, Self>, hz: Option<f64>, timeout: f64) -> PyResult<Cycles> {
        let rate_hz = slf.get().client.description().rate_hz;
        let every = match hz {
            None => 1,
            Some(hz) => every(rate_hz, hz)?,
        };
        let period = Duration::try_from_secs_f64(f64::from(every) / rate_hz).unwrap_or_default();
        Ok(Cycles {
            claim: slf.unbind(),
            every,
            period,
            timeout: duration("timeout", timeout)?,
            has_begun: false,
        })
    }

    /// Repeats the last setpoints hz times a second in a thread, so that a cell of a notebook may end.
    ///
    /// This removes the setpoint timeout: a program that hangs holds its last setpoint. seconds bounds that: without a new
    /// setpoint for so long the thread ends, and the daemon damps the group. It also ends with stop of the result, with the
    /// claim, with a stop of the group, with a cell of a notebook that raises, and with the interpreter, and prints an end that
    /// the program did not cause.
    ///
    /// The repeated setpoints have the velocity 0. A torque or velocity without a stiffness is not repeated. Another keep
    /// replaces the first. ValueError for a rate below twice that of the setpoint timeout.
    #[pyo3(signature = (hz = 100.0, *, seconds = 60.0))]
    fn keep(&self, py: Python<'_>, hz: f64, seconds: f64) -> PyResult<Py<Keep>> {
        let schedule = self.schedule(hz, seconds)?;
        let keep = self.with(|owned| {
            owned.renew(Duration::ZERO);
            Ok(Keep::start(&self.group, owned, &self.owned, schedule)?)
        })?;
        let keep = Py::new(py, keep)?;
        py.import("motord._notebook")?.call_method1("end_with_exception", (&keep,))?;
        Ok(keep)
    }

    /// Waits for the next state, at most timeout, s, whatever the phase. TimedOut without one.
    #[pyo3(signature = (timeout = 1.0))]
    fn wait(&self, py: Python<'_>, timeout: f64) -> PyResult<State> {
        let timeout = duration("timeout", timeout)?;
        let _alone = self.alone()?;
        let state = self.wait_alone(py, |client| client.wait(timeout))?;
        Ok(State { state, order: Arc::clone(&self.order), clock: Clock::Monotonic })
    }

    /// Returns the claim.
    fn __enter__(slf: Bound<'_, Self>) -> Bound<'_, Self> {
        slf
    }

    /// Damps and stops the motors, and releases the group. In a forked process it does nothing.
    fn __exit__(
        &self,
        py: Python<'_>,
        _kind: &Bound<'_, PyAny>,
        _value: &Bound<'_, PyAny>,
        _trace: &Bound<'_, PyAny>,
    ) -> PyResult<bool> {
        if self.client.check_process().is_err() {
            return Ok(false);
        }
        let end = || {
            let Some(Owned { mut claim, .. }) = locked(&self.owned).take() else { return };
            // A group that cannot be disabled is stopped by its release, or by the daemon after its
            // last setpoint.
            let _stopped = claim.disable().and_then(|()| claim.wait_for(Phase::Disarmed, CHANGE));
            let _released = claim.release();
        };
        py.detach(|| caught(end))?;
        Ok(false)
    }

    fn __repr__(&self) -> String {
        format!("<motord.Claim of {:?}: {} joints>", self.group, self.order.joints.len())
    }
}

/// The number of cycles between two states at hz. ValueError when that is none.
#[pyfunction]
pub(crate) fn every(rate_hz: f64, hz: f64) -> PyResult<u32> {
    let cycles = (rate_hz / hz).round();
    let is_whole = hz > 0.0 && cycles >= 1.0 && ((rate_hz / cycles - hz).abs() < 1e-6 * rate_hz);
    if !is_whole {
        let fits = [1, 2, 4, 5, 10, 20].map(|every| format!("{}", rate_hz / f64::from(every))).join(", ");
        return Err(PyValueError::new_err(format!(
            "hz is {hz}: the daemon runs {rate_hz} cycles a second, so give a whole part of that, such as {fits}"
        )));
    }
    Ok(cycles as u32)
}

/// The loop of a controller: Claim.cycles.
#[pyclass(module = "motord")]
pub(crate) struct Cycles {
    claim: Py<Claim>,
    every: u32,
    period: Duration,
    timeout: Duration,
    has_begun: bool,
}

#[pymethods]
impl Cycles {
    fn __iter__(slf: Bound<'_, Self>) -> Bound<'_, Self> {
        slf
    }

    fn __next__(&mut self, py: Python<'_>) -> PyResult<State> {
        let (every, timeout) = (self.every, self.timeout);
        let is_first = !std::mem::replace(&mut self.has_begun, true);
        // The first state is due within a period, and may be as late as another one.
        let first = self.period.saturating_mul(2);
        let claim = self.claim.get();
        if is_first {
            claim.call(py, |_, claim| claim.keep_for(first))?;
        }
        let state = claim.next_active(py, every, timeout)?;
        Ok(State { state, order: Arc::clone(&claim.order), clock: Clock::Monotonic })
    }
}
