//! The scheduling and the memory of the daemon's threads, and its lines in the log.

pub use motord_realtime::{
    SchedulingRequest, Step, forbid_deep_sleep, lock_memory, prepare_thread, tighten_timers,
};

/// Logs the outcome of `step` for `thread`.
pub fn log(step: &Step, thread: &str) {
    let Step { what, outcome, without, remedy } = *step;
    match outcome {
        Ok(()) => tracing::info!(thread, "{what}: yes"),
        Err(errno) => {
            tracing::warn!(thread, "{what}: no ({}). Without it {without}. {remedy}.", errno.desc());
        }
    }
}
