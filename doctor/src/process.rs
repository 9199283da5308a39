//! Processes and their threads, as `/proc` shows them.

use crate::tree::Tree;

/// The thread of a daemon that runs its cycle.
const CYCLE: &str = "motord-cycle";
/// `SCHED_FIFO` and `SCHED_RR` of sched(7).
const REALTIME_POLICIES: [&str; 2] = ["1", "2"];
/// The fields of `/proc/PID/stat` that follow the name of the program begin with the third of proc(5).
const FIRST_FIELD: usize = 3;
const RT_PRIORITY: usize = 40;
const POLICY: usize = 41;

/// A daemon that runs its cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Daemon {
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
pub(crate) fn daemon(tree: &Tree) -> Option<Daemon> {
    let programs = tree.numbers("proc").into_iter();
    programs.filter(|&pid| program(tree, pid).as_deref() == Some("motord")).find_map(|pid| {
        let threads = tree.numbers(&format!("proc/{pid}/task"));
        let is_cycle = |thread: &u32| {
            tree.text(&format!("proc/{pid}/task/{thread}/comm")).is_some_and(|name| name == CYCLE)
        };
        threads.into_iter().find(is_cycle).map(|cycle| Daemon { pid, cycle })
    })
}

/// The real-time priority of a thread or process; `None` where it has a normal one.
pub(crate) fn priority(tree: &Tree, directory: &str) -> Option<u8> {
    let stat = tree.text(&format!("{directory}/stat"))?;
    // A program may have any name, also one with brackets.
    let (_, fields) = stat.rsplit_once(')')?;
    let fields: Vec<&str> = fields.split_whitespace().collect();
    let field = |number: usize| fields.get(number - FIRST_FIELD).copied();
    let priority = field(RT_PRIORITY)?.parse().ok()?;
    field(POLICY).filter(|policy| REALTIME_POLICIES.contains(policy)).map(|_| priority)
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
