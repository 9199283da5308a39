//! Processes and their threads, as `/proc` shows them.

use crate::tree::Tree;

/// The thread of a daemon that runs its cycle.
const CYCLE: &str = "motord-cycle";
/// `SCHED_FIFO` and `SCHED_RR` of sched(7).
const REALTIME_POLICIES: [&str; 2] = ["1", "2"];
/// The process that makes the threads of the kernel, and nothing else.
const MAKER_OF_KERNEL_THREADS: &str = "2";
/// The fields of `/proc/PID/stat` that follow the name of the program begin with the third of proc(5).
const FIRST_FIELD: usize = 3;
const PARENT: usize = 4;
const RT_PRIORITY: usize = 40;
const POLICY: usize = 41;

/// A daemon that runs its cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunningDaemon {
    /// Its process.
    pub pid: u32,
    /// The thread of its cycle.
    pub cycle: u32,
}

/// The name of the program or thread in a directory of `/proc`.
pub(crate) fn program(tree: &Tree, pid: u32) -> Option<String> {
    tree.text(&format!("proc/{pid}/comm"))
}

/// The first daemon that runs its cycle on this computer, as far as this user may know.
pub(crate) fn daemon(tree: &Tree) -> Option<RunningDaemon> {
    let programs = tree.numbers("proc").into_iter();
    programs.filter(|&pid| program(tree, pid).as_deref() == Some("motord")).find_map(|pid| {
        let threads = tree.numbers(&format!("proc/{pid}/task"));
        let is_cycle = |thread: &u32| {
            tree.text(&format!("proc/{pid}/task/{thread}/comm")).is_some_and(|name| name == CYCLE)
        };
        threads.into_iter().find(is_cycle).map(|cycle| RunningDaemon { pid, cycle })
    })
}

/// The threads of the kernel whose name is asked for. A program may bear such a name, and is none of them.
pub(crate) fn kernel_threads(tree: &Tree, is_asked_for: impl Fn(&str) -> bool) -> Vec<u32> {
    let is_one = |pid: &u32| {
        program(tree, *pid).is_some_and(|name| is_asked_for(&name))
            && stat(tree, &format!("proc/{pid}"), PARENT).as_deref() == Some(MAKER_OF_KERNEL_THREADS)
    };
    tree.numbers("proc").into_iter().filter(is_one).collect()
}

/// The real-time priority of a thread or process; `None` where it has a normal one.
pub(crate) fn priority(tree: &Tree, directory: &str) -> Option<u8> {
    let policy = stat(tree, directory, POLICY)?;
    let priority = stat(tree, directory, RT_PRIORITY)?.parse().ok()?;
    REALTIME_POLICIES.contains(&policy.as_str()).then_some(priority)
}

/// A field of `stat`, by its number in proc(5).
fn stat(tree: &Tree, directory: &str, field: usize) -> Option<String> {
    let stat = tree.text(&format!("{directory}/stat"))?;
    // A program may have any name, also one with brackets.
    let (_, fields) = stat.rsplit_once(')')?;
    fields.split_whitespace().nth(field - FIRST_FIELD).map(str::to_owned)
}

/// The fields of a line of `/proc/PID/status`.
fn status(tree: &Tree, process: &str, line: &str) -> Vec<String> {
    let status = tree.text(&format!("proc/{process}/status")).unwrap_or_default();
    let fields = status.lines().find_map(|text| text.strip_prefix(line)?.strip_prefix(':'));
    fields.unwrap_or_default().split_whitespace().map(str::to_owned).collect()
}

/// The effective user of a process.
pub(crate) fn user(tree: &Tree, process: &str) -> Option<u32> {
    status(tree, process, "Uid").get(1)?.parse().ok()
}

/// The groups of a process, its effective one among them.
pub(crate) fn groups(tree: &Tree, process: &str) -> Vec<u32> {
    let effective = status(tree, process, "Gid").into_iter().nth(1);
    let others = status(tree, process, "Groups");
    effective.into_iter().chain(others).filter_map(|group| group.parse().ok()).collect()
}

/// The effective capabilities of a process, a bit each.
pub(crate) fn capabilities(tree: &Tree, process: &str) -> u64 {
    let set = status(tree, process, "CapEff").into_iter().next();
    set.and_then(|set| u64::from_str_radix(&set, 16).ok()).unwrap_or(0)
}
