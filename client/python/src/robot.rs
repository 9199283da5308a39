//! A connection.

use crate::arrays::{Names, duration};
use crate::claim::Claim;
use crate::errors::{caught, raised};
use crate::interpreter::{probe, without_lock};
use crate::state::{Clock, StateLayout, State};
use motord_client::{
    Client, ImuPublisher as ClientPublisher, ImuSample, emergency_stop, emergency_stop_in, named_telemetry,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::os::fd::AsRawFd;
use std::path::PathBuf;
use std::sync::Arc;

/// A connection to a daemon. Threads may share it; one of those that wait gets each state.
///
/// It belongs to the process that created it, as do its claims and publishers: elsewhere each call but estop raises Forked.
#[pyclass(frozen, module = "motord")]
pub(crate) struct Robot {
    client: Arc<Client>,
}

/// Connects to the daemon of an instance. runtime is its runtime directory; the default is that of the environment.
#[pyfunction]
#[pyo3(signature = (instance = "robot", *, runtime = None))]
pub(crate) fn connect(py: Python<'_>, instance: &str, runtime: Option<PathBuf>) -> PyResult<Robot> {
    probe(py, 3)?;
    let client = without_lock(py, || match &runtime {
        Some(runtime) => Client::connect_in(runtime, instance),
        None => Client::connect(instance),
    })?;
    Ok(Robot { client: Arc::new(client.map_err(|error| raised(&error))?) })
}

/// Damps and stops every motor of an instance, over a connection of its own. Raises as Robot.estop.
#[pyfunction]
#[pyo3(signature = (instance = "robot", *, runtime = None))]
pub(crate) fn estop(py: Python<'_>, instance: &str, runtime: Option<PathBuf>) -> PyResult<()> {
    let stop = || match &runtime {
        Some(runtime) => emergency_stop_in(runtime, instance),
        None => emergency_stop(instance),
    };
    without_lock(py, stop)?.map_err(|error| raised(&error))
}

/// Converts a value to dictionaries and lists.
fn parsed<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(|error| PyValueError::new_err(error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}

impl Robot {
    /// The joints of `names`; all joints of the robot without names.
    fn order(&self, names: Option<Names>) -> PyResult<Arc<StateLayout>> {
        let robot = self.client.description();
        let all = || robot.joints.iter().map(|joint| joint.name.clone()).collect();
        let names: Vec<String> = names.map_or_else(all, |names| names.0);
        let index = |name: &String| self.client.joint_named(name).map_err(|error| raised(&error));
        Ok(Arc::new(StateLayout {
            joints: names.iter().map(index).collect::<PyResult<_>>()?,
            names,
            imus: robot.imus.iter().map(|imu| imu.name.clone()).collect(),
            has_samples: true,
            group: None,
        }))
    }

    /// Calls the daemon without the interpreter's lock.
    fn call<T: Send>(
        &self,
        py: Python<'_>,
        call: impl Send + FnOnce(&Client) -> Result<T, motord_client::Error>,
    ) -> PyResult<T> {
        let client = &self.client;
        without_lock(py, || call(client))?.map_err(|error| raised(&error))
    }
}

#[pymethods]
impl Robot {
    /// Name of the daemon's instance.
    #[getter]
    fn instance(&self) -> String {
        self.client.description().instance.clone()
    }

    /// Cycles per second.
    #[getter]
    fn rate_hz(&self) -> f64 {
        self.client.description().rate_hz
    }

    /// Names of the joints, in the order of the robot.
    #[getter]
    fn joints(&self) -> Vec<String> {
        self.client.description().joints.iter().map(|joint| joint.name.clone()).collect()
    }

    /// Names of the groups.
    #[getter]
    fn groups(&self) -> Vec<String> {
        self.client.description().groups.iter().map(|group| group.name.clone()).collect()
    }

    /// Names of the IMUs.
    #[getter]
    fn imus(&self) -> Vec<String> {
        self.client.description().imus.iter().map(|imu| imu.name.clone()).collect()
    }

    /// Longest time between two setpoints of a group, s.
    #[getter]
    fn setpoint_timeout(&self) -> f64 {
        self.client.description().setpoint_timeout.as_secs_f64()
    }

    /// Joints with their limits, groups, IMUs and buses.
    #[getter]
    fn description<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        parsed(py, &*self.client.description())
    }

    /// Waits for the next state, at most timeout, s, with all joints of the robot, or those of names. TimedOut without one.
    #[pyo3(signature = (timeout = 1.0, *, names = None))]
    fn wait(&self, py: Python<'_>, timeout: f64, names: Option<Names>) -> PyResult<State> {
        let timeout = duration("timeout", timeout)?;
        let state = self.call(py, |client| client.wait(timeout))?;
        Ok(State { state, order: self.order(names)?, clock: Clock::Monotonic })
    }

    /// Returns the newest state without waiting; None when a call has returned it already.
    #[pyo3(signature = (*, names = None))]
    fn newest(&self, names: Option<Names>) -> PyResult<Option<State>> {
        let newest = caught(|| self.client.newest())?.map_err(|error| raised(&error))?;
        newest
            .map(|state| Ok(State { state, order: self.order(names)?, clock: Clock::Monotonic }))
            .transpose()
    }

    /// Returns a file descriptor that becomes readable with each state, for asyncio and select.
    ///
    /// Read the state with newest; it may be None. The descriptor belongs to the robot, and survives a restart of the daemon.
    /// Use a timeout: without a daemon it stays unreadable, and wait raises the reason.
    fn fileno(&self) -> PyResult<i32> {
        let descriptor = caught(|| self.client.file_descriptor())?.map_err(|error| raised(&error))?;
        Ok(descriptor.as_raw_fd())
    }

    /// Becomes the owner of a group. names is the order of its joints in each array; it names each of them.
    #[pyo3(signature = (group, *, names = None))]
    fn claim(&self, py: Python<'_>, group: &str, names: Option<Names>) -> PyResult<Claim> {
        let claim = self.call(py, |client| client.claim(group))?;
        Claim::new(Arc::clone(&self.client), claim, names.map(|names| names.0))
    }

    /// Damps and stops every motor. No exception means that each motor answered after the stop.
    ///
    /// Otherwise motors may still move, so cut the power. MotorsOffline names those that do not answer.
    fn estop(&self, py: Python<'_>) -> PyResult<()> {
        self.call(py, Client::emergency_stop)
    }

    /// Damps and stops the motors of a group, also of another owner.
    fn disable(&self, py: Python<'_>, group: &str) -> PyResult<()> {
        self.call(py, |client| client.disable(group))
    }

    /// Clears the latched cause of a stop. Leave this to a person who has inspected the robot.
    fn reset(&self, py: Python<'_>, group: &str) -> PyResult<()> {
        self.call(py, |client| client.reset(group))
    }

    /// Counters and latencies, as `motorctl latency --json`.
    fn telemetry<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let telemetry = self.call(py, Client::telemetry)?;
        parsed(py, &named_telemetry(&self.client.description(), &telemetry))
    }

    /// Begins to publish the samples of an external IMU.
    fn publish_imu(&self, py: Python<'_>, name: &str) -> PyResult<ImuPublisher> {
        Ok(ImuPublisher(self.call(py, |client| client.publish_imu(name))?))
    }

    fn __repr__(&self) -> String {
        format!("<motord.Robot {:?}: {} joints>", self.instance(), self.client.description().joints.len())
    }
}

/// Publishes the samples of an external IMU. It survives a restart of the daemon.
#[pyclass(module = "motord")]
pub(crate) struct ImuPublisher(ClientPublisher);

#[pymethods]
impl ImuPublisher {
    /// Sends a sample in the frame of the sensor. time is that of the measurement, s of time.monotonic(); None is now.
    ///
    /// Raises ValueError for values that are no sample, and for a time of another clock.
    #[pyo3(signature = (orientation, angular_velocity, acceleration, *, temperature = None, time = None))]
    fn send(
        &mut self,
        orientation: [f64; 4],
        angular_velocity: [f64; 3],
        acceleration: [f64; 3],
        temperature: Option<f64>,
        time: Option<f64>,
    ) -> PyResult<()> {
        let time_ns = time.map_or(Ok(0), |time| Ok::<_, PyErr>(duration("time", time)?.as_nanos() as u64))?;
        let sample = ImuSample {
            orientation: orientation.map(|value| value as f32),
            angular_velocity: angular_velocity.map(|value| value as f32),
            acceleration: acceleration.map(|value| value as f32),
            temperature: temperature.map(|value| value as f32),
            time_ns,
        };
        caught(|| self.0.send(&sample))?.map_err(|error| raised(&error))
    }

    /// The daemon used a sample of this publisher last.
    #[getter]
    fn used(&self) -> bool {
        self.0.is_used()
    }
}
