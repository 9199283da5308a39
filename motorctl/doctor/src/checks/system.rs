//! The kernel, its clocks, and the running daemon.

use crate::finding::Finding;
use crate::process::{self, RunningDaemon};
use crate::robot::Robot;
use crate::tree::Tree;

/// Clocks that are read without a system call, in a few ns.
const FAST_CLOCKS: [&str; 7] = [
    "tsc",
    "arch_sys_counter",
    "kvm-clock",
    "hyperv_clocksource_tsc_page",
    "xen",
    "timebase",
    "riscv_clocksource",
];
/// Largest good timer slack, ns. The daemon requests 1 ns.
const SLACK_MAX_NS: i64 = 1000;
/// Smallest share of real-time threads. The cycle takes less than 20 %; the rest is for the
/// interrupt threads.
const RUNTIME_LEAST: f64 = 0.5;

/// Checks whether the kernel has `PREEMPT_RT`.
pub(super) fn kernel(tree: &Tree) -> Finding {
    let read = |name: &str| tree.text(&format!("proc/sys/kernel/{name}")).unwrap_or_default();
    let (release, version) = (read("osrelease"), read("version"));
    if is_realtime(tree) {
        return Finding::good("kernel", format!("{release}, PREEMPT_RT"));
    }
    let kind = ["PREEMPT_DYNAMIC", "PREEMPT"].into_iter().find(|kind| version.contains(kind));
    let kind = kind.unwrap_or("no preemption");
    let why = "without PREEMPT_RT a driver can hold the cycle up for milliseconds; use a kernel with CONFIG_PREEMPT_RT, \
        then restart the computer";
    Finding::warn("kernel", format!("{release}, {kind}"), why).mended_by(realtime_kernel(tree, &read("arch")))
}

pub(super) fn is_realtime(tree: &Tree) -> bool {
    let version = tree.text("proc/sys/kernel/version").unwrap_or_default();
    tree.number("sys/kernel/realtime") == Some(1)
        || ["PREEMPT_RT", "PREEMPT RT"].iter().any(|mark| version.contains(mark))
}

/// Returns the command that installs a real-time kernel, for distributions with such a package.
fn realtime_kernel(tree: &Tree, architecture: &str) -> Option<String> {
    let release = tree.text("etc/os-release")?;
    let id = release.lines().find_map(|line| line.strip_prefix("ID="))?.trim_matches('"').to_owned();
    match (id.as_str(), architecture) {
        ("debian", "x86_64") => Some("sudo apt-get install linux-image-rt-amd64".to_owned()),
        ("debian", "aarch64") => Some("sudo apt-get install linux-image-rt-arm64".to_owned()),
        ("ubuntu", _) => Some("sudo pro enable realtime-kernel".to_owned()),
        _ => None,
    }
}

/// Checks the share of time for real-time threads.
pub(super) fn runtime(tree: &Tree, robot: &Robot) -> Finding {
    const CHECK: &str = "sched_rt_runtime";
    let read = |name: &str| tree.number(&format!("proc/sys/kernel/{name}"));
    let (Some(runtime), Some(period)) = (read("sched_rt_runtime_us"), read("sched_rt_period_us")) else {
        return Finding::good(CHECK, "this kernel has no such bound");
    };
    if runtime < 0 {
        return Finding::good(CHECK, "no bound");
    }
    let measured = format!("{runtime} of {period} µs");
    let share = runtime as f64 / period.max(1) as f64;
    let mend =
        |finding: Finding| finding.mended_by("sudo sysctl kernel.sched_rt_runtime_us=950000".to_owned());
    match robot.spins_at {
        _ if runtime == 0 => mend(Finding::bad(CHECK, measured, "no thread may be real-time")),
        _ if share < RUNTIME_LEAST => mend(Finding::warn(
            CHECK,
            measured,
            "the kernel holds real-time threads up for the rest of each period",
        )),
        Some(priority) if share < 1.0 => {
            let why = format!(
                "the ipc thread polls with SCHED_FIFO {priority} and never sleeps: the kernel holds it up for the rest of each period"
            );
            Finding::warn(CHECK, measured, why)
                .mended_by("sudo sysctl kernel.sched_rt_runtime_us=-1".to_owned())
        }
        _ => Finding::good(CHECK, measured),
    }
}

/// Checks whether reading the clock is cheap.
pub(super) fn clock_source(tree: &Tree) -> Finding {
    const CHECK: &str = "clock source";
    let directory = "sys/devices/system/clocksource/clocksource0";
    let read = |name: &str| tree.text(&format!("{directory}/{name}")).unwrap_or_default();
    let (current, available) = (read("current_clocksource"), read("available_clocksource"));
    if current.is_empty() || FAST_CLOCKS.contains(&current.as_str()) {
        return Finding::good(CHECK, if current.is_empty() { "not shown".to_owned() } else { current });
    }
    let better = available.split_whitespace().find(|clock| FAST_CLOCKS.contains(clock));
    let command = better.map(|clock| format!("echo {clock} | sudo tee /{directory}/current_clocksource"));
    let why = "each reading of this clock may cost a microsecond, and a cycle reads it 8 times";
    Finding::warn(CHECK, format!("{current} (available: {available})"), why).mended_by(command)
}

/// Checks the slack of timers, which a thread without `SCHED_FIFO` has.
pub(super) fn timer_slack(tree: &Tree, daemon: Option<RunningDaemon>) -> Finding {
    const CHECK: &str = "timer slack";
    let of_cycle = daemon.and_then(|daemon| tree.number(&format!("proc/{}/timerslack_ns", daemon.cycle)));
    if let Some(slack) = of_cycle {
        let measured =
            format!("{slack} ns for the cycle of process {}", daemon.map_or(0, |daemon| daemon.pid));
        // A thread under SCHED_FIFO reports 0.
        return match slack <= SLACK_MAX_NS {
            true => Finding::good(CHECK, measured),
            false => {
                let why =
                    "without SCHED_FIFO its timers fire so much later; allow it prctl(PR_SET_TIMERSLACK)";
                Finding::warn(CHECK, measured, why)
            }
        };
    }
    let here = tree.number("proc/self/timerslack_ns");
    let here = here.map_or_else(|| "not shown here".to_owned(), |slack| format!("{slack} ns here"));
    Finding::good(CHECK, format!("{here}; motord sets 1 ns for its cycle"))
}

/// Checks whether the running daemon has its real-time priority.
pub(super) fn daemon(tree: &Tree, robot: &Robot, daemon: Option<RunningDaemon>) -> Finding {
    const CHECK: &str = "daemon";
    let Some(RunningDaemon { pid, cycle }) = daemon else { return Finding::good(CHECK, "none runs") };
    let process = match robot.daemon == Some(pid) {
        true => format!("process {pid}"),
        false => format!("process {pid}, not of instance {}, which does not run", robot.instance),
    };
    match process::priority(tree, &format!("proc/{pid}/task/{cycle}")) {
        Some(priority) => {
            Finding::good(CHECK, format!("{process}: its cycle has the real-time priority {priority}"))
        }
        None => Finding::bad(
            CHECK,
            format!("{process}: its cycle has a normal priority"),
            "any other program can delay it by milliseconds: mend rtprio, then restart motord",
        ),
    }
}
