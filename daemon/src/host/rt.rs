//! What makes a thread real-time, and what the machine refused of it.

use crate::host::kernel;
use nix::errno::Errno;
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::sys::resource::{Resource, getrlimit};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;

/// Locking less memory than this would make later allocations of other threads fail.
const MEMLOCK_LEAST: u64 = 1 << 30;
/// Stack that the cycle may need: touched once, so that it never faults later.
const STACK_BYTES: usize = 256 * 1024;

/// What was asked of the machine for one thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wish {
    /// Processor to run on alone.
    pub cpu: Option<usize>,
    /// `SCHED_FIFO` priority.
    pub priority: Option<u8>,
}

/// One thing that was asked for, and what became of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// What.
    pub what: &'static str,
    /// Granted, or why not.
    pub outcome: Result<(), Errno>,
    /// What it means to go without.
    pub without: &'static str,
    /// What to do about it.
    pub remedy: &'static str,
}

impl Step {
    /// Logs it for `thread`.
    pub fn tell(&self, thread: &str) {
        let Self { what, outcome, without, remedy } = *self;
        match outcome {
            Ok(()) => tracing::info!(thread, "{what}: yes"),
            Err(errno) => {
                tracing::warn!(thread, "{what}: no ({}). Without it {without}. {remedy}.", errno.desc());
            }
        }
    }
}

/// Puts the calling thread under `SCHED_FIFO` on its processor, with a stack that is in memory.
#[must_use]
pub fn prepare_thread(wish: Wish) -> Vec<Step> {
    prefault_stack();
    let mut steps = Vec::new();
    if let Some(cpu) = wish.cpu {
        steps.push(Step {
            what: "processor of its own",
            outcome: pin(cpu),
            without: "the scheduler may move the cycle, with cold caches each time",
            remedy: "set `cpu` in [cycle] to a processor that `taskset -p $$` allows",
        });
    }
    if let Some(priority) = wish.priority {
        steps.push(Step {
            what: "SCHED_FIFO",
            outcome: kernel::schedule_fifo(priority),
            without: "any other program can delay the cycle by milliseconds",
            remedy: "give it the right: LimitRTPRIO=90 in the unit, or `ulimit -r 90`",
        });
    }
    steps
}

/// Locks all memory of the process, now and later. Refused beforehand where the limit would make later allocations
/// fail instead.
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
        remedy: "give it the right: LimitMEMLOCK=infinity in the unit, or `ulimit -l unlimited`",
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
        remedy: "let the service write /dev/cpu_dma_latency (the udev rule does)",
    };
    (step, opened.ok())
}

/// Timers of this thread fire when they are due, not up to 50 µs later. Only matters without `SCHED_FIFO`.
#[must_use]
pub fn tighten_timers() -> Step {
    Step {
        what: "exact timers",
        outcome: nix::sys::prctl::set_timerslack(1),
        without: "timers may fire 50 µs late",
        remedy: "allow prctl(PR_SET_TIMERSLACK)",
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
