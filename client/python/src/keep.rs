//! Repeating the last setpoints of a claim while its program computes nothing: `Claim.keep`.
//!
//! The thread needs no lock of the interpreter, except to report its end.

use motord_client::{Claim as ClientClaim, Error, Setpoint, SetpointMode};
use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

/// The interpreter exits: each repetition ends.
static IS_EXITING: AtomicBool = AtomicBool::new(false);

/// A claim that is not released, and what was sent.
pub(crate) struct Owned {
    pub(crate) claim: ClientClaim,
    /// Stiffness and damping of the last `enable`.
    pub(crate) hold: (f64, f64),
    /// The time of the last new setpoint.
    renewed: Instant,
    /// The time of the last setpoint, also a repeated one, and its horizon.
    sent: Instant,
    horizon: Duration,
    keep: Option<Arc<Repetition>>,
}

impl Owned {
    pub(crate) fn new(claim: ClientClaim, hold: (f64, f64)) -> Self {
        let now = Instant::now();
        let (renewed, sent, horizon) = (now, now, Duration::ZERO);
        Self { claim, hold, renewed, sent, horizon, keep: None }
    }

    /// Records a new setpoint with this horizon.
    pub(crate) fn renew(&mut self, horizon: Duration) {
        self.renewed = Instant::now();
        self.sent = self.renewed;
        self.horizon = horizon;
    }
}

/// Locks content that no panic leaves half changed.
pub(crate) fn locked<T>(content: &Mutex<T>) -> MutexGuard<'_, T> {
    content.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The times of a repetition.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Schedule {
    /// From a setpoint, or the end of its horizon, to its repetition.
    pub(crate) period: Duration,
    /// From a new setpoint to the last repetition.
    pub(crate) most: Duration,
}

/// The cause of an end.
enum End {
    /// The program ended it, its claim or itself.
    Own(&'static str),
    /// Nothing repeats the setpoints any more, which the program must know.
    Other(String),
}

/// The end of a repetition, shared by its thread and its handle.
#[derive(Debug, Default)]
struct Repetition {
    /// The reason of the end.
    end: Mutex<Option<String>>,
    ended: Condvar,
}

impl Repetition {
    /// Ends it. A later end changes nothing.
    fn finish(&self, reason: &str) {
        locked(&self.end).get_or_insert_with(|| reason.to_owned());
        self.ended.notify_all();
    }

    /// Waits, and returns whether it has ended.
    fn is_ended_within(&self, time: Duration) -> bool {
        let end = locked(&self.end);
        let waited = self.ended.wait_timeout_while(end, time, |end| end.is_none());
        let (end, _) = waited.unwrap_or_else(PoisonError::into_inner);
        end.is_some()
    }

    /// Repeats the setpoints of `owned` until an end. Reports one that the program did not cause.
    fn run(&self, group: &str, owned: &Weak<Mutex<Option<Owned>>>, schedule: Schedule) {
        let mut pause = schedule.period;
        while !self.is_ended_within(pause) {
            match step(owned, schedule) {
                Ok(next) => pause = next,
                Err(End::Own(reason)) => self.finish(reason),
                Err(End::Other(reason)) => {
                    self.finish(&reason);
                    report(group, &reason);
                }
            }
        }
    }
}

/// Repeats the setpoints if they are due. Returns the time until they are.
fn step(owned: &Weak<Mutex<Option<Owned>>>, schedule: Schedule) -> Result<Duration, End> {
    if IS_EXITING.load(Ordering::Relaxed) {
        return Err(End::Own("the interpreter exits"));
    }
    let owned = owned.upgrade().ok_or(End::Own("the claim was deleted"))?;
    let mut owned = locked(&owned);
    let owned = owned.as_mut().ok_or(End::Own("the claim was released"))?;
    let Owned { claim, renewed, sent, horizon, .. } = owned;
    if renewed.elapsed() >= schedule.most {
        let seconds = schedule.most.as_secs_f64();
        return Err(End::Other(format!("the program sent no new setpoint for {seconds} s")));
    }
    let left = (*horizon + schedule.period).saturating_sub(sent.elapsed());
    if !left.is_zero() {
        return Ok(left);
    }
    hold(claim)?;
    claim.repeat().map_err(|error| End::Other(error.to_string()))?;
    *sent = Instant::now();
    Ok(*horizon + schedule.period)
}

/// Makes the velocities of the setpoints zero. A torque without a stiffness must not be repeated:
/// nothing would bound the motion.
fn hold(claim: &mut ClientClaim) -> Result<(), End> {
    let other = |error: Error| End::Other(error.to_string());
    let names: Vec<_> = claim.names().map(str::to_owned).collect();
    for name in &names {
        let setpoint = claim.setpoint(name).map_err(other)?;
        if is_unbounded(&setpoint) {
            let text = format!("the last setpoint of {name} has a torque or a velocity without a stiffness");
            return Err(End::Other(text));
        }
        claim.set(name, Setpoint { velocity: 0.0, ..setpoint }).map_err(other)?;
    }
    Ok(())
}

/// Returns whether a joint with this setpoint moves until something stops it.
fn is_unbounded(setpoint: &Setpoint) -> bool {
    let Setpoint { velocity, kp, kd, torque, mode, .. } = *setpoint;
    mode != SetpointMode::Impedance || kp == 0.0 && (torque != 0.0 || velocity * kd != 0.0)
}

/// Prints the end on `sys.stderr`, which a notebook shows.
fn report(group: &str, reason: &str) {
    let text = format!(
        "motord: keep of {group} ended, and nothing repeats its setpoints any more: {reason}. The daemon damps a group \
         without setpoints. To go on: claim it again if it is lost, reset it if it was stopped, then keep and enable.\n"
    );
    Python::try_attach(|py| {
        let stream = py.import("sys").and_then(|sys| sys.getattr("stderr"));
        // A program without a standard error learns the end from the handle.
        let _written = stream.and_then(|stream| stream.call_method1("write", (text,)));
    });
}

/// The repetition of a claim's last setpoints: Claim.keep.
#[pyclass(frozen, module = "motord")]
pub(crate) struct Keep {
    repetition: Arc<Repetition>,
    group: String,
}

impl Keep {
    /// Starts the thread, in place of an earlier one.
    pub(crate) fn start(
        group: &str,
        owned: &mut Owned,
        shared: &Arc<Mutex<Option<Owned>>>,
        schedule: Schedule,
    ) -> std::io::Result<Self> {
        let repetition = Arc::<Repetition>::default();
        let (inner, name, shared) = (Arc::clone(&repetition), group.to_owned(), Arc::downgrade(shared));
        std::thread::Builder::new()
            .name("motord-keep".to_owned())
            .spawn(move || inner.run(&name, &shared, schedule))?;
        if let Some(earlier) = owned.keep.replace(Arc::clone(&repetition)) {
            earlier.finish("another keep replaced it");
        }
        Ok(Self { repetition, group: group.to_owned() })
    }
}

#[pymethods]
impl Keep {
    /// Ends the repetition. The group keeps its owner: send the next setpoint within the setpoint timeout.
    fn stop(&self) {
        self.repetition.finish("stop was called");
    }

    /// Ends the repetition for a reason that it prints.
    fn _fail(&self, reason: &str) {
        self.repetition.finish(reason);
        report(&self.group, reason);
    }

    /// The reason why it ended; None while it repeats.
    #[getter]
    fn end(&self) -> Option<String> {
        locked(&self.repetition.end).clone()
    }

    fn __repr__(&self) -> String {
        let state = self.end().map_or_else(|| "repeats".to_owned(), |end| format!("ended: {end}"));
        format!("<motord.Keep of {:?}: {state}>", self.group)
    }
}

#[pyfunction]
fn end_all() {
    IS_EXITING.store(true, Ordering::Relaxed);
}

/// Ends each repetition when the interpreter exits.
///
/// # Errors
/// `atexit` cannot be imported.
pub(crate) fn prepare(py: Python<'_>) -> PyResult<()> {
    let end = pyo3::wrap_pyfunction!(end_all, py)?;
    py.import("atexit")?.call_method1("register", (end,))?;
    Ok(())
}
