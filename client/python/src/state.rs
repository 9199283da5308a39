//! The state of a cycle, as numpy arrays in the order of a claim or of the robot.

use motord_client::{Group, Imu as ClientImu, Joint, State as ClientState};
use motord_twin::TwinClock;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::{PyDeprecationWarning, PyKeyError, PyUserWarning};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;
use std::ffi::CStr;
use std::sync::Arc;

/// The names of the entries of states.
#[derive(Debug)]
pub(crate) struct StateLayout {
    /// Indices of the joints in the robot.
    pub(crate) joints: Vec<usize>,
    /// Their names.
    pub(crate) names: Vec<String>,
    /// Names of the IMUs of the robot.
    pub(crate) imus: Vec<String>,
    /// False for a twin without a body, whose IMUs never get samples.
    pub(crate) has_samples: bool,
    /// The group, by index in the robot; `None` for the whole robot.
    pub(crate) group: Option<usize>,
}

/// The state of a cycle. Arrays are read-only; a value is NaN while its motor has not reported it.
#[pyclass(frozen, module = "motord")]
pub(crate) struct State {
    pub(crate) state: ClientState,
    pub(crate) order: Arc<StateLayout>,
    pub(crate) clock: Clock,
}

/// The clock of the times in a state, on which ages count.
#[derive(Debug, Clone)]
pub(crate) enum Clock {
    /// `CLOCK_MONOTONIC`.
    Monotonic,
    /// The virtual time of a twin.
    Virtual(TwinClock),
}

/// Warns of a name that programs should no longer use.
///
/// # Errors
/// The warning, where the program turns warnings into exceptions.
pub(crate) fn deprecated(py: Python<'_>, text: &CStr) -> PyResult<()> {
    PyErr::warn(py, &py.get_type::<PyDeprecationWarning>(), text, 1)
}

type Array<'py> = Bound<'py, PyArray1<f64>>;

fn read_only<'py>(py: Python<'py>, values: impl Iterator<Item = f64>) -> Array<'py> {
    let array = PyArray1::from_iter(py, values);
    array.readwrite().make_nonwriteable();
    array
}

impl State {
    fn group(&self) -> Option<Group> {
        self.state.group(self.order.group?)
    }

    /// Now, ns of the clock of this state.
    fn now_ns(&self) -> u64 {
        match &self.clock {
            Clock::Monotonic => self.state.publish_ns().saturating_add(self.state.age().as_nanos() as u64),
            Clock::Virtual(clock) => clock.now_ns(),
        }
    }

    fn each(&self) -> impl Iterator<Item = Option<Joint>> + '_ {
        self.order.joints.iter().map(|index| self.state.joint(*index))
    }

    fn array<'py>(&self, py: Python<'py>, value: impl Fn(&Joint) -> Option<f32>) -> Array<'py> {
        read_only(py, self.each().map(|joint| joint.as_ref().and_then(&value).map_or(f64::NAN, f64::from)))
    }
}

#[pymethods]
impl State {
    /// Names of the joints, in the order of the arrays.
    #[getter]
    fn joints(&self) -> Vec<String> {
        self.order.names.clone()
    }

    /// Deprecated: joints.
    #[getter]
    fn names(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        deprecated(py, c"State.names is deprecated: use joints")?;
        Ok(self.joints())
    }

    /// Temperatures of the motors, °C; NaN where they report none.
    #[getter]
    fn temperature<'py>(&self, py: Python<'py>) -> Array<'py> {
        self.array(py, |joint| joint.temperature)
    }

    /// Voltages of the supply, V, as the motors reported them last; NaN where they report none.
    #[getter]
    fn supply_voltage<'py>(&self, py: Python<'py>) -> Array<'py> {
        self.array(py, |joint| joint.supply_voltage)
    }

    /// Currents from the supply, A, as the motors reported them last; NaN where they report none.
    #[getter]
    fn supply_current<'py>(&self, py: Python<'py>) -> Array<'py> {
        self.array(py, |joint| joint.supply_current)
    }

    /// True for each motor that answered in this cycle.
    #[getter]
    fn fresh<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        let array = PyArray1::from_iter(py, self.each().map(|joint| joint.is_some_and(|joint| joint.fresh)));
        array.readwrite().make_nonwriteable();
        array
    }

    /// Mode of each motor, such as active or offline; unknown for one that this library does not know.
    #[getter]
    fn mode(&self) -> Vec<&'static str> {
        self.each()
            .map(|joint| joint.and_then(|joint| joint.mode).map_or("unknown", |mode| mode.name()))
            .collect()
    }

    /// Limits that acted on the applied command of each joint, such as position; an empty list for none.
    #[getter]
    fn limits(&self) -> Vec<Vec<&'static str>> {
        let names = |joint: Joint| joint.limits.iter().map(|limit| limit.name()).collect();
        self.each().map(|joint| joint.map_or_else(Vec::new, names)).collect()
    }

    /// The commands that the motors got, after all limits: q, rad; dq, rad/s; kp, N·m/rad; kd, N·m·s/rad; tau, N·m.
    #[getter]
    fn applied<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let applied = PyDict::new(py);
        applied.set_item("q", self.array(py, |joint| Some(joint.applied.position)))?;
        applied.set_item("dq", self.array(py, |joint| Some(joint.applied.velocity)))?;
        applied.set_item("kp", self.array(py, |joint| Some(joint.applied.kp)))?;
        applied.set_item("kd", self.array(py, |joint| Some(joint.applied.kd)))?;
        applied.set_item("tau", self.array(py, |joint| Some(joint.applied.torque)))?;
        Ok(applied)
    }

    /// Faults that each motor reports, such as motor-over-temperature; an empty list for none.
    #[getter]
    fn faults(&self) -> Vec<Vec<&'static str>> {
        let names = |joint: Joint| joint.faults.iter().map(|fault| fault.name()).collect();
        self.each().map(|joint| joint.map_or_else(Vec::new, names)).collect()
    }

    /// Times since the motors answered, s; NaN before their first answer. In a twin, virtual time, as each age.
    #[getter]
    fn joint_age<'py>(&self, py: Python<'py>) -> Array<'py> {
        let now = self.now_ns();
        let age = |joint: Option<Joint>| {
            joint.and_then(|joint| joint.age_at(now)).map_or(f64::NAN, |age| age.as_secs_f64())
        };
        read_only(py, self.each().map(age))
    }

    /// Number of the setpoint message that the group used; 0 for none, and for the whole robot.
    #[getter]
    fn sequence(&self) -> u64 {
        self.group().map_or(0, |group| group.sequence)
    }

    /// Cycles from the states that this setpoint answers to the first cycle that used it: 1 for a timely one.
    #[getter]
    fn control_cycles(&self) -> Option<u64> {
        self.group()?.control_cycles
    }

    /// Time since the states were complete, s.
    #[getter]
    fn age(&self) -> f64 {
        self.now_ns().saturating_sub(self.state.publish_ns()) as f64 * 1e-9
    }

    /// Time of the tick, s, on the clock of time.monotonic(); in a twin, virtual time.
    #[getter]
    fn time(&self) -> f64 {
        self.state.time().as_secs_f64()
    }

    /// Number of the cycle. A gap means missed ticks, or a slow loop.
    #[getter]
    fn cycle(&self) -> u64 {
        self.state.cycle()
    }

    /// The emergency stop is latched.
    #[getter]
    fn estopped(&self) -> bool {
        self.state.emergency_stop()
    }

    /// The phase of the group; None for the whole robot.
    #[getter]
    fn phase(&self) -> Option<&'static str> {
        self.group()?.phase.map(|phase| phase.name())
    }

    /// The latched cause of the group's stop, such as motor-lost.
    #[getter]
    fn stop(&self) -> Option<&'static str> {
        self.group()?.cause.map(|cause| cause.name())
    }

    /// The joint that gave this cause; None without one.
    #[getter]
    fn stop_joint(&self) -> Option<String> {
        let joint = self.group()?.cause_joint?;
        let at = self.order.joints.iter().position(|index| *index == joint)?;
        self.order.names.get(at).cloned()
    }

    /// The IMUs, by name: state.imu["base"].
    #[getter]
    fn imu(&self) -> Imus {
        let (order, clock) = (Arc::clone(&self.order), self.clock.clone());
        Imus(Self { state: self.state.clone(), order, clock })
    }

    fn _repr_html_<'py>(slf: Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        slf.py().import("motord._notebook")?.call_method1("state", (slf,))
    }

    fn __repr__(&self) -> String {
        format!("<motord.State of cycle {}: {} joints>", self.state.cycle(), self.order.joints.len())
    }
}

macro_rules! measured {
    ($({ $doc:literal $unit:literal $name:ident $python:ident })+) => {
        /// The measured quantities of the joints, from the table of a joint's state.
        #[pymethods]
        impl State {
            $(
                #[doc = $doc]
                ///
                #[doc = concat!("A number for each joint, ", $unit, "; NaN until its motor has reported it.")]
                #[getter]
                fn $python<'py>(&self, py: Python<'py>) -> Array<'py> {
                    self.array(py, Joint::$name)
                }
            )+
        }
    };
}

motord_shared::joint_state!(python measured);

const WITHOUT_SAMPLES: &CStr =
    c"the IMUs of this twin get no samples, and their values are NaN: its plant measures none. Give \
    Mujoco imu=, the site of the IMU, or a plant whose imu() measures";

/// The IMUs after a cycle, by name.
#[pyclass(frozen, mapping, module = "motord")]
pub(crate) struct Imus(State);

#[pymethods]
impl Imus {
    /// The IMU with this name. Raises KeyError, which lists the names.
    fn __getitem__(&self, py: Python<'_>, name: &str) -> PyResult<Imu> {
        let State { state, order, clock } = &self.0;
        let index = order.imus.iter().position(|imu| imu == name);
        let imu = index.and_then(|index| state.imu(index));
        let imu = imu.map(|imu| Imu { imu, clock: clock.clone() }).ok_or_else(|| {
            let known = if order.imus.is_empty() { "none".to_owned() } else { order.imus.join(", ") };
            PyKeyError::new_err(format!("there is no IMU {name:?}; there are {known}"))
        })?;
        if !order.has_samples {
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), WITHOUT_SAMPLES, 1)?;
        }
        Ok(imu)
    }

    fn __len__(&self) -> usize {
        self.0.order.imus.len()
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.keys().into_pyobject(py)?.call_method0("__iter__")
    }

    /// Names of the IMUs, in the order of the robot.
    fn keys(&self) -> Vec<String> {
        self.0.order.imus.clone()
    }
}

/// An IMU after a cycle. Arrays are NaN before the first sample. The body has x forward, y left and z up.
#[pyclass(frozen, module = "motord")]
pub(crate) struct Imu {
    imu: ClientImu,
    clock: Clock,
}

fn vector<'py, const N: usize>(py: Python<'py>, values: Option<[f32; N]>) -> Array<'py> {
    read_only(py, values.map_or([f64::NAN; N], |values| values.map(f64::from)).into_iter())
}

#[pymethods]
impl Imu {
    /// Unit quaternion w, x, y, z from the body to the world.
    #[getter]
    fn orientation<'py>(&self, py: Python<'py>) -> Array<'py> {
        vector(py, self.imu.orientation())
    }

    /// Roll and yaw, from -pi to pi, and pitch, from -pi/2 to pi/2, rad. Pitch is positive with the nose down.
    #[getter]
    fn roll_pitch_yaw<'py>(&self, py: Python<'py>) -> Array<'py> {
        vector(py, self.imu.roll_pitch_yaw())
    }

    /// Direction of gravity in the frame of the body, of length 1: 0, 0, -1 for a level body.
    #[getter]
    fn projected_gravity<'py>(&self, py: Python<'py>) -> Array<'py> {
        vector(py, self.imu.projected_gravity())
    }

    /// Angular velocity, rad/s, in the frame of the body.
    #[getter]
    fn angular_velocity<'py>(&self, py: Python<'py>) -> Array<'py> {
        vector(py, self.imu.angular_velocity())
    }

    /// Specific force, m/s², in the frame of the body: at rest 9.81 upwards.
    #[getter]
    fn acceleration<'py>(&self, py: Python<'py>) -> Array<'py> {
        vector(py, self.imu.acceleration())
    }

    /// Temperature of the sensor, °C; None where it reports none.
    #[getter]
    fn temperature(&self) -> Option<f32> {
        self.imu.temperature
    }

    /// Time since the sample was received, s; None before the first.
    #[getter]
    fn age(&self) -> Option<f64> {
        let age = match &self.clock {
            Clock::Monotonic => self.imu.age(),
            Clock::Virtual(clock) => self.imu.age_at(clock.now_ns()),
        };
        age.map(|age| age.as_secs_f64())
    }

    /// A sample was received since the previous states were published.
    #[getter]
    fn fresh(&self) -> bool {
        self.imu.fresh
    }

    /// No sample for longer than lost-after-ms, or the device is disconnected.
    #[getter]
    fn lost(&self) -> bool {
        self.imu.lost
    }

    /// Samples received since the daemon started.
    #[getter]
    fn sequence(&self) -> u64 {
        self.imu.sequence
    }

    /// Conventions in which orientation and acceleration would agree about gravity, while they contradict each other at rest.
    ///
    /// By name, what to change. Empty while both agree, and until the body rested for 2 s.
    #[getter]
    fn contradictions(&self) -> BTreeMap<&'static str, &'static str> {
        self.imu.contradictions().map(|found| (found.name(), found.sentence())).collect()
    }
}
