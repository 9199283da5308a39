//! The start and the end of the cycle's thread.

use super::starter::{Orders, Starter, await_report};
use crate::buses::claims::SharedClaims;
use crate::run_error::RunError;
use motord_core::cycle::Cycle;
use motord_deadman::heartbeat::Heartbeat;
use motord_realtime::{SchedulingRequest, Step, lock_memory, prepare_thread, tighten_timers};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

/// The values that the thread owns.
pub(super) struct Owned {
    pub(super) claims: SharedClaims,
    pub(super) cycle: Cycle,
    pub(super) heartbeat: Heartbeat,
}

/// The running thread.
pub(super) struct Handle {
    pub(super) thread: JoinHandle<()>,
    /// The steps by which it became real-time, and their outcomes.
    pub(super) realtime: Vec<Step>,
}

/// Starts the thread. Returns when it is about to run the first cycle.
pub(super) fn start(starter: &Starter, mut owned: Owned) -> Result<Handle, RunError> {
    if !std::thread::available_parallelism().is_ok_and(|processors| processors.get() > 1) {
        owned.cycle.share_processor();
    }
    let settings = &starter.settings;
    let request = SchedulingRequest { cpu: settings.cycle.cpu, priority: Some(settings.cycle.priority) };
    let is_required = settings.cycle.require_realtime;
    let names: Vec<_> = settings.motors.iter().map(|motor| motor.name.clone()).collect();
    let (prepared, ready) = channel();
    let thread = starter.start("cycle", move |orders| {
        if become_realtime(&mut owned.cycle, request, is_required, prepared) {
            owned.run(orders, &names);
        }
    })?;
    let realtime = await_report(&ready, "cycle")??;
    Ok(Handle { thread, realtime })
}

/// Reports the outcomes to `prepared`. Returns false if the thread is refused something that is
/// required.
fn become_realtime(
    cycle: &mut Cycle,
    request: SchedulingRequest,
    is_required: bool,
    prepared: Sender<Result<Vec<Step>, RunError>>,
) -> bool {
    let mut steps = prepare_thread(request);
    steps.push(tighten_timers());
    steps.push(lock_memory());
    let refused = steps.iter().find_map(|step| Some((step.clone(), step.outcome.err()?)));
    steps.iter().for_each(|step| step.log("cycle"));
    cycle.set_realtime(refused.is_none());
    let outcome = match refused.filter(|_| is_required) {
        Some((step, errno)) => Err(RunError::Realtime { what: step.what, errno, remedy: step.remedy }),
        None => Ok(steps),
    };
    let may_run = outcome.is_ok();
    let _starter_ended = prepared.send(outcome);
    may_run
}

impl Owned {
    /// Runs the cycle until it is ordered to stop and the motors are stopped. Closes the buses
    /// before it releases them.
    fn run(self, orders: &Orders, names: &[String]) {
        let Self { claims: _claims, mut cycle, heartbeat } = self;
        let ran = catch_unwind(AssertUnwindSafe(|| cycle.run_until(|| orders.cycle_order())));
        if let Err(panic) = ran {
            cycle.stop_after_panic();
            resume_unwind(panic);
        }
        let unstopped: Vec<String> = cycle.unstopped().map(|motor| names[motor].clone()).collect();
        // Without it the dead man's switch acts: on motors that may still run it should.
        if unstopped.is_empty() {
            heartbeat.rest();
        } else {
            let _the_only_one = orders.unstopped.set(unstopped);
        }
    }
}
