//! Processes and their threads, from `/proc`.

use crate::tree::Tree;

/// The name of a daemon's cycle thread.
const CYCLE: &str = "motord-cycle";
/// `SCHED_FIFO` and `SCHED_RR` of sched(7).
const REALTIME_POLICIES: [&str; 2] = ["1", "2"];
/// The parent of all kernel threads, which has no other children.
const MAKER_OF_KERNEL_THREADS: &str = "2";
/// The fields of `/proc/PID/stat` that follow the name of the program begin with the third of
/// proc(5).
const FIRST_FIELD: usize = 3;
const PARENT: usize = 4;
const RT_PRIORITY: usize = 40;
const POLICY: usize = 41;

/// A daemon with a running cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunningDaemon {
    /// Its process.
    pub pid: u32,
    /// Its cycle thread.
    pub cycle: u32,
}

/// Returns the name of a program.
pub(crate) fn program(tree: &Tree, pid: u32) -> Option<String> {
    tree.text(&format!("proc/{pid}/comm"))
}

/// Returns the daemon with a running cycle that was `asked` for, by its process id; otherwise the
/// first one that this user can see.
pub(crate) fn daemon(tree: &Tree, asked: Option<u32>) -> Option<RunningDaemon> {
    let programs = asked.into_iter().chain(tree.numbers("proc"));
    programs.filter(|&pid| program(tree, pid).as_deref() == Some("motord")).find_map(|pid| {
        let threads = tree.numbers(&format!("proc/{pid}/task"));
        let is_cycle = |thread: &u32| {
            tree.text(&format!("proc/{pid}/task/{thread}/comm")).is_some_and(|name| name == CYCLE)
        };
        threads.into_iter().find(is_cycle).map(|cycle| RunningDaemon { pid, cycle })
    })
}

/// Returns the kernel threads whose name matches. Programs with such a name are left out.
pub(crate) fn kernel_threads(tree: &Tree, is_asked_for: impl Fn(&str) -> bool) -> Vec<u32> {
    let is_one = |pid: &u32| {
        program(tree, *pid).is_some_and(|name| is_asked_for(&name))
            && stat(tree, &format!("proc/{pid}"), PARENT).as_deref() == Some(MAKER_OF_KERNEL_THREADS)
    };
    tree.numbers("proc").into_iter().filter(is_one).collect()
}

/// Returns the real-time priority of a thread or process; `None` for a normal one.
pub(crate) fn priority(tree: &Tree, directory: &str) -> Option<u8> {
    let policy = stat(tree, directory, POLICY)?;
    let priority = stat(tree, directory, RT_PRIORITY)?.parse().ok()?;
    REALTIME_POLICIES.contains(&policy.as_str()).then_some(priority)
}

/// A field of `stat`, by its number in proc(5).
fn stat(tree: &Tree, directory: &str, field: usize) -> Option<String> {
    let stat = tree.text(&format!("{directory}/stat"))?;
    // The name of a program may contain brackets.
    let (_, fields) = stat.rsplit_once(')')?;
    fields.split_whitespace().nth(field - FIRST_FIELD).map(str::to_owned)
}

/// Returns the fields of a line of `/proc/PID/status`.
fn status(tree: &Tree, process: &str, line: &str) -> Vec<String> {
    let status = tree.text(&format!("proc/{process}/status")).unwrap_or_default();
    let fields = status.lines().find_map(|text| text.strip_prefix(line)?.strip_prefix(':'));
    fields.unwrap_or_default().split_whitespace().map(str::to_owned).collect()
}

/// Returns the effective user of a process.
pub(crate) fn user(tree: &Tree, process: &str) -> Option<u32> {
    status(tree, process, "Uid").get(1)?.parse().ok()
}

/// Returns the groups of a process, with its effective one.
pub(crate) fn groups(tree: &Tree, process: &str) -> Vec<u32> {
    let effective = status(tree, process, "Gid").into_iter().nth(1);
    let others = status(tree, process, "Groups");
    effective.into_iter().chain(others).filter_map(|group| group.parse().ok()).collect()
}
