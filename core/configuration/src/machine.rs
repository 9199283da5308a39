//! The processors and the priority that this machine allows the daemon.

use std::fs;

use nix::sched::{CpuSet, sched_setaffinity};
use nix::sys::resource::{Resource, getrlimit};
use nix::unistd::Pid;
use std::thread::Builder;

/// Highest `SCHED_FIFO` priority that the daemon requests: kernel threads use 99.
const PRIORITY_MAX: u8 = 98;

/// `CAP_SYS_NICE` in the capability sets of `/proc`, `capabilities(7)`: it lifts the limit of the
/// priority.
const CAP_SYS_NICE: u64 = 1 << 23;

/// The resources that this machine allows a new process.
#[derive(Debug, Clone)]
pub struct Machine {
    /// The processors that are online and that the process may use, rising.
    pub processors: Vec<usize>,
    /// The highest `SCHED_FIFO` priority it may take; 0 when none.
    pub priority_max: u8,
}

impl Machine {
    /// Queries the kernel for the calling process.
    #[must_use]
    pub fn here() -> Self {
        Self { processors: processors(), priority_max: priority_max() }
    }
}

/// Stack of the temporary thread. libc keeps it for later threads, and the daemon locks all of its
/// memory.
const STACK_BYTES: usize = 64 * 1024;

/// Tests each processor in a temporary thread. The affinity of this process is not sufficient: it
/// does not contain isolated processors (`isolcpus`), which may be used.
fn processors() -> Vec<usize> {
    let is_allowed = |&cpu: &usize| {
        let mut one = CpuSet::new();
        one.set(cpu).is_ok() && sched_setaffinity(Pid::from_raw(0), &one).is_ok()
    };
    let thread = Builder::new().stack_size(STACK_BYTES);
    let tried = thread.spawn(move || (0..CpuSet::count()).filter(is_allowed).collect());
    tried.ok().and_then(|tried| tried.join().ok()).unwrap_or_default()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn process_may_use_processors_outside_its_affinity() {
        let all = processors();
        let mut first = CpuSet::new();
        first.set(all[0]).unwrap();
        sched_setaffinity(Pid::from_raw(0), &first).unwrap();
        assert_eq!(processors(), all);
    }
}
