//! Real-time scheduling and locked memory for a thread, file descriptors, other processes and their
//! deaths, and systemd.

pub mod denial;
pub mod descriptors;
#[allow(unsafe_code, reason = "system calls that no safe crate offers")]
mod kernel;
pub mod process;
pub mod systemd;

use denial::{Denial, Facts};
pub use kernel::set_heap_reserve;
use nix::errno::Errno;
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::sys::resource::{Resource, getrlimit};
use std::borrow::Cow;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;

/// Lowest limit of locked memory, bytes. Below it, later allocations of other threads would fail.
pub const MEMLOCK_LEAST: u64 = 1 << 30;
/// Stack that [`prepare_thread`] touches once, so that it causes no page fault later. The cycle uses
/// 76 KiB in a debug build.
const STACK_BYTES: usize = 96 * 1024;

/// The scheduling that one thread asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SchedulingRequest {
    /// The processor to run on; `None` for any.
    pub cpu: Option<usize>,
    /// The `SCHED_FIFO` priority, 1 to 99; `None` for normal scheduling.
    pub priority: Option<u8>,
}

/// One step of the set-up, and its outcome.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// The name of the step, for the log.
    pub what: &'static str,
    /// Granted, or the error of the kernel.
    pub outcome: Result<(), Errno>,
    /// The consequence when it is refused.
    pub without: &'static str,
    /// The remedy when it is refused.
    pub remedy: Cow<'static, str>,
}

impl Step {
    /// Logs the outcome for `thread`. A refusal is a warning with its remedy.
    pub fn log(&self, thread: &str) {
        let Self { what, outcome, without, remedy } = self;
        match outcome {
            Ok(()) => tracing::debug!(thread, "{what}: yes"),
            Err(errno) => {
                tracing::warn!(
                    thread,
                    see = "rights",
                    "{what}: no ({}). Without it {without}. {remedy}.",
                    errno.desc()
                );
            }
        }
    }
}

/// The names of the granted steps, for the log.
#[must_use]
pub fn granted(steps: &[Step]) -> String {
    let granted: Vec<_> = steps.iter().filter(|step| step.outcome.is_ok()).map(|step| step.what).collect();
    if granted.is_empty() { "nothing".to_owned() } else { granted.join(", ") }
}

/// Gives the calling thread the scheduling of `request`, and a stack that is in memory.
#[must_use]
pub fn prepare_thread(request: SchedulingRequest) -> Vec<Step> {
    prefault_stack();
    let mut steps = Vec::new();
    if let Some(cpu) = request.cpu {
        steps.push(Step {
            what: "processor of its own",
            outcome: pin(cpu),
            without: "the scheduler may move this thread, with cold caches each time",
            remedy: "set its `cpu` to a processor that `taskset -p $$` allows".into(),
        });
    }
    if let Some(priority) = request.priority {
        let outcome = kernel::schedule_fifo(priority);
        steps.push(Step {
            what: "SCHED_FIFO",
            outcome,
            without: "any other program can delay this thread by milliseconds",
            remedy: if outcome.is_err() { why_refused(priority).into() } else { "".into() },
        });
    }
    steps
}

/// Returns the reason why this process was refused `priority`, and the remedy. Reads files.
fn why_refused(priority: u8) -> String {
    let facts = Facts::read("self", |path| fs::read_to_string(format!("/{path}")).ok());
    let denial = facts.denial(priority, true).unwrap_or(Denial::Unknown { may_divide: false });
    format!("The reason: {denial}. The remedy: {}", denial.remedy())
}

/// Locks all present and future memory of the process. Fails with `ENOMEM` where the limit would
/// make later allocations fail.
#[must_use]
pub fn lock_memory() -> Step {
    let enough = getrlimit(Resource::RLIMIT_MEMLOCK).is_ok_and(|(soft, _)| soft >= MEMLOCK_LEAST);
    let outcome = if enough || nix::unistd::geteuid().is_root() {
        mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE)
    } else {
        Err(Errno::ENOMEM)
    };
    Step {
        what: "locked memory",
        outcome,
        without: "a page that was swapped out or never touched can delay the cycle",
        remedy: "give it the right: LimitMEMLOCK=infinity in the unit, or `ulimit -l unlimited`".into(),
    }
}

/// Keeps the processors out of deep sleep for as long as the file is held.
#[must_use]
pub fn forbid_deep_sleep() -> (Step, Option<File>) {
    let opened = OpenOptions::new()
        .write(true)
        .custom_flags(nix::libc::O_CLOEXEC)
        .open("/dev/cpu_dma_latency")
        .and_then(|mut file| file.write_all(&0_i32.to_ne_bytes()).map(|()| file));
    let outcome = match &opened {
        Ok(_) => Ok(()),
        Err(error) => Err(Errno::from_raw(error.raw_os_error().unwrap_or(nix::libc::EIO))),
    };
    let step = Step {
        what: "processors kept awake",
        outcome,
        without: "waking from deep sleep can delay the cycle by some 100 µs",
        remedy: "let the service write /dev/cpu_dma_latency (the udev rule does)".into(),
    };
    (step, opened.ok())
}

/// Makes timers of this thread fire when they are due, not up to 50 µs later. Has an effect only
/// without `SCHED_FIFO`.
#[must_use]
pub fn tighten_timers() -> Step {
    Step {
        what: "exact timers",
        outcome: nix::sys::prctl::set_timerslack(1),
        without: "timers may fire 50 µs late",
        remedy: "allow prctl(PR_SET_TIMERSLACK)".into(),
    }
}

fn pin(cpu: usize) -> Result<(), Errno> {
    let pinned = core_affinity::set_for_current(core_affinity::CoreId { id: cpu });
    if pinned { Ok(()) } else { Err(Errno::last()) }
}

fn prefault_stack() {
    let stack = [0_u8; STACK_BYTES];
    std::hint::black_box(&stack);
}
