//! The processors and the priority that this machine allows the daemon: a configuration can ask for both.

use std::fs;

use nix::sched::{CpuSet, sched_getaffinity};
use nix::sys::resource::{Resource, getrlimit};
use nix::unistd::Pid;

/// The highest `SCHED_FIFO` priority the daemon asks for: 99 belongs to the kernel's own threads.
const PRIORITY_MAX: u8 = 98;

/// `CAP_SYS_NICE` in the capability sets of `/proc`, `capabilities(7)`: it lifts the limit of the priority.
const CAP_SYS_NICE: u64 = 1 << 23;

/// The resources that a process gets which starts on this machine now.
#[derive(Debug, Clone)]
pub struct Machine {
    /// The processors that are online and that the process may use, rising.
    pub processors: Vec<usize>,
    /// The highest `SCHED_FIFO` priority it may take; 0 when none.
    pub priority_max: u8,
}

impl Machine {
    /// Asks the kernel about the calling process.
    #[must_use]
    pub fn here() -> Self {
        let allowed = sched_getaffinity(Pid::from_raw(0)).unwrap_or_default();
        let processors = (0..CpuSet::count()).filter(|&cpu| allowed.is_set(cpu) == Ok(true)).collect();
        Self { processors, priority_max: priority_max() }
    }
}

fn priority_max() -> u8 {
    if has_sys_nice() {
        return PRIORITY_MAX;
    }
    let (soft, _) = getrlimit(Resource::RLIMIT_RTPRIO).unwrap_or_default();
    soft.min(PRIORITY_MAX.into()) as u8
}

fn has_sys_nice() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    effective
        .and_then(|set| u64::from_str_radix(set.trim(), 16).ok())
        .is_some_and(|set| set & CAP_SYS_NICE != 0)
}
