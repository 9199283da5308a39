//! A robot on virtual time: the engine below `motord.sim.Twin`.

use crate::arrays::{JOINTS_MAX, duration, setpoints};
use crate::errors::{caught, raised, refused};
use crate::interpreter::unused;
use crate::state::{Clock, StateLayout, State};
use motord_client::{Error as ClientError, Operation, State as ClientState};
use motord_shared::JointSetpoint;
use motord_shared::description::RobotDescription;
use motord_twin::{Body, FaultVerb, ImuValues, JointPhysics, Mechanics, Options, Twin, TwinClock};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The first exception of a callable, which the next step raises.
type Raised = Arc<Mutex<Option<PyErr>>>;

fn note(raised: &Raised, error: PyErr) {
    raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
}

/// A callable that moves the joints.
struct PyMechanics {
    step: Py<PyAny>,
    /// Torques, positions and velocities, as the callable sees them.
    arrays: [Py<PyArray1<f64>>; 3],
    begin: Option<Vec<f64>>,
    raised: Raised,
}

impl Mechanics for PyMechanics {
    fn begin(&mut self, positions: &mut [f64]) {
        if let Some(begin) = self.begin.take().filter(|begin| begin.len() == positions.len()) {
            positions.copy_from_slice(&begin);
        }
    }

    fn step(&mut self, torques: &[f64], seconds: f64, positions: &mut [f64], velocities: &mut [f64]) {
        if self.raised.lock().unwrap_or_else(PoisonError::into_inner).is_some() {
            return;
        }
        let outcome = Python::attach(|py| {
            let [of_torques, of_positions, of_velocities] =
                self.arrays.each_ref().map(|array| array.bind(py));
            let pairs = [(of_torques, torques), (of_positions, &*positions), (of_velocities, &*velocities)];
            for (array, values) in pairs {
                array.try_readwrite()?.as_slice_mut()?.copy_from_slice(values);
            }
            self.step.call1(py, (of_torques, seconds, of_positions, of_velocities))?;
            for (array, values) in [(of_positions, positions), (of_velocities, velocities)] {
                let moved = array.try_readonly()?;
                let moved = moved.as_slice()?;
                if let Some(joint) = moved.iter().position(|value| !value.is_finite()) {
                    return Err(PyValueError::new_err(format!(
                        "the plant made joint {joint} {}",
                        moved[joint]
                    )));
                }
                values.copy_from_slice(moved);
            }
            Ok(())
        });
        outcome.unwrap_or_else(|error| note(&self.raised, error));
    }
}

/// A callable that measures the body: orientation, angular velocity and acceleration.
struct PyBody {
    measure: Py<PyAny>,
    raised: Raised,
}

impl Body for PyBody {
    fn measure(&mut self) -> ImuValues {
        let outcome =
            Python::attach(|py| self.measure.call0(py)?.extract::<([f64; 4], [f64; 3], [f64; 3])>(py));
        let (orientation, angular_velocity, acceleration) = outcome.unwrap_or_else(|error| {
            note(&self.raised, error);
            ([f64::NAN; 4], [f64::NAN; 3], [f64::NAN; 3])
        });
        ImuValues { orientation, angular_velocity, acceleration, temperature: f64::NAN }
    }
}

fn refuse(error: impl ToString) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// The description of a configuration, as JSON, and name, armature, damping, friction and begin of each joint.
#[pyfunction]
pub(crate) fn describe(py: Python<'_>, config: PathBuf) -> PyResult<(String, Vec<Bound<'_, PyDict>>)> {
    let settings = motord_configuration::load(&config).map_err(refuse)?.settings;
    let description = serde_json::to_string(&motord_configuration::describe(&settings, 0)).map_err(refuse)?;
    let joint = |joint: JointPhysics| {
        let values = PyDict::new(py);
        values.set_item("name", joint.name)?;
        values.set_item("armature", joint.armature)?;
        values.set_item("damping", joint.damping)?;
        values.set_item("friction", joint.friction)?;
        values.set_item("begin", joint.begin)?;
        Ok(values)
    };
    let physics = JointPhysics::of(&settings).into_iter().map(joint).collect::<PyResult<_>>()?;
    Ok((description, physics))
}

/// The robot below motord.sim.Twin, which describes each value.
#[pyclass(frozen, module = "motord._motord")]
pub(crate) struct Engine {
    twin: Mutex<Twin>,
    clock: TwinClock,
    raised: Raised,
    description: RobotDescription,
    /// The IMUs have a body.
    has_samples: bool,
}

impl Engine {
    fn twin(&self) -> PyResult<MutexGuard<'_, Twin>> {
        unused(&self.twin).ok_or_else(|| {
            PyRuntimeError::new_err(
                "the twin is in a call: its plant, and other threads, can read its time only",
            )
        })
    }

    /// The names of the joints at these places of a group.
    fn names(&self, group: usize, places: &[usize]) -> PyResult<Vec<&str>> {
        let members = self.description.groups.get(group).map_or(&[][..], |group| &group.joints);
        let name = |slot: &usize| Some(&*self.description.joints.get(*members.get(*slot)?)?.name);
        let names = places.iter().map(name).collect::<Option<_>>();
        names.ok_or_else(|| PyValueError::new_err("no such joint in the group"))
    }

    /// Raises the exception of a callable.
    fn checked<T>(&self, value: T) -> PyResult<T> {
        match self.raised.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(error) => Err(error),
            None => Ok(value),
        }
    }
}

#[pymethods]
impl Engine {
    #[new]
    #[pyo3(signature = (config, *, seed = 0, compute = 0.0, step = None, begin = None, measure = None))]
    fn new(
        py: Python<'_>,
        config: PathBuf,
        seed: u64,
        compute: f64,
        step: Option<Py<PyAny>>,
        begin: Option<Vec<f64>>,
        measure: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let raised = Raised::default();
        let settings = motord_configuration::load(&config).map_err(refuse)?.settings;
        let (count, has_samples) = (settings.motors.len(), measure.is_some());
        let description = motord_configuration::describe(&settings, seed);
        let mechanics = step.map(|step| {
            let arrays = [(); 3].map(|()| PyArray1::<f64>::zeros(py, count, false).unbind());
            Box::new(PyMechanics { step, arrays, begin, raised: Arc::clone(&raised) }) as Box<dyn Mechanics>
        });
        let body =
            measure.map(|measure| Box::new(PyBody { measure, raised: Arc::clone(&raised) }) as Box<dyn Body>);
        let options = Options { seed, compute: duration("compute", compute)? };
        let twin = caught(|| Twin::new(settings, options, mechanics, body))?.map_err(refuse)?;
        let engine = Self { clock: twin.clock(), twin: Mutex::new(twin), raised, description, has_samples };
        engine.checked(())?;
        Ok(engine)
    }

    /// Virtual time since the first tick, s. The plant and other threads may read it.
    #[getter]
    fn time(&self) -> f64 {
        self.clock.time().as_secs_f64()
    }

    /// Runs cycles.
    fn step(&self, cycles: u32) -> PyResult<()> {
        let mut twin = self.twin()?;
        for _ in 0..cycles {
            caught(|| twin.step())?;
            self.checked(())?;
        }
        Ok(())
    }

    /// The state of the last cycle, of the joints with these indices.
    fn state(&self, names: Vec<String>, joints: Vec<usize>, group: Option<usize>) -> PyResult<State> {
        let imus = self.description.imus.iter().map(|imu| imu.name.clone()).collect();
        let state = ClientState::from(self.twin()?.state());
        let order = Arc::new(StateLayout { joints, names, imus, has_samples: self.has_samples, group });
        Ok(State { state, order, clock: Clock::Virtual(self.clock.clone()) })
    }

    /// Sends a setpoint for each joint of a group; places are the places in the group of the values.
    ///
    /// values are q, dq, kp, kd and tau. hold are the gains of positions and velocities without others. Raises ClaimLost.
    fn send(
        &self,
        group: usize,
        places: Vec<usize>,
        values: [Bound<'_, PyAny>; 5],
        horizon: f64,
        hold: (f64, f64),
    ) -> PyResult<()> {
        let count = places.len();
        let names = self.names(group, &places)?;
        let [q, dq, kp, kd, tau] = setpoints(values.each_ref().map(Some), hold, &names)?;
        let mut joints = [JointSetpoint::default(); JOINTS_MAX];
        for (at, slot) in places.into_iter().enumerate() {
            let setpoint = JointSetpoint {
                position: q[at],
                velocity: dq[at],
                kp: kp[at],
                kd: kd[at],
                torque: tau[at],
                ..JointSetpoint::default()
            };
            *joints.get_mut(slot).ok_or_else(|| PyValueError::new_err("no such place"))? = setpoint;
        }
        let horizon = duration("horizon", horizon)?;
        let most = self.description.setpoint_horizon_max;
        if horizon > most {
            return Err(raised(&ClientError::HorizonTooLong { horizon, most }));
        }
        let mut twin = self.twin()?;
        if !caught(|| twin.owns(group))? {
            let group =
                self.description.groups.get(group).map_or_else(String::new, |group| group.name.clone());
            return Err(raised(&ClientError::ClaimLost { group }));
        }
        caught(|| twin.send(group, &joints[..count], horizon))?.map_err(refused)
    }

    /// Sends a request, and runs cycles until it is answered.
    fn ask(&self, operation: &str, group: usize) -> PyResult<()> {
        let operation = Operation::ALL.iter().find(|known| known.name() == operation);
        let operation = *operation.ok_or_else(|| PyValueError::new_err("no such operation"))?;
        let mut twin = self.twin()?;
        let reply = caught(|| twin.reply_to(operation, group))?;
        let position = |joint: usize| twin.state().joints().get(joint).map(|joint| joint.position);
        let refused =
            (reply.refusal != 0).then(|| ClientError::refusal(operation, reply, &self.description, position));
        drop(twin);
        self.checked(())?;
        refused.map_or(Ok(()), |error| Err(raised(&error)))
    }

    /// Gives a bus, a motor or an IMU a fault at a virtual time, s.
    fn inject_at(&self, at: f64, verb: &str) -> PyResult<()> {
        let bad = |text: String| PyValueError::new_err(format!("{verb}: {text}"));
        let parsed: FaultVerb =
            verb.parse().map_err(|error: motord_twin::VerbError| bad(error.to_string()))?;
        let at = duration("at", at)?;
        self.twin()?.inject_at(at, parsed).map_err(|error| bad(error.to_string()))
    }
}
