//! The scheduling and the memory of the daemon's threads, and its lines in the log.

pub use motord_realtime::{
    SchedulingRequest, Step, forbid_deep_sleep, lock_memory, prepare_thread, tighten_timers,
};

/// Logs the outcome of `step` for `thread`: a refusal for everybody, with its remedy.
pub fn log(step: &Step, thread: &str) {
    let Step { what, outcome, without, remedy } = *step;
    match outcome {
        Ok(()) => tracing::debug!(thread, "{what}: yes"),
        Err(errno) => {
            tracing::warn!(thread, "{what}: no ({}). Without it {without}. {remedy}.", errno.desc());
        }
    }
}

/// The names of the granted steps, for the log.
#[must_use]
pub fn granted(steps: &[Step]) -> String {
    let granted: Vec<_> = steps.iter().filter(|step| step.outcome.is_ok()).map(|step| step.what).collect();
    if granted.is_empty() { "nothing".to_owned() } else { granted.join(", ") }
}
