//! The limits of the daemon: real-time priority and locked memory.

use crate::finding::Finding;
use crate::process::{self, RunningDaemon};
use crate::robot::Robot;
use crate::tree::Tree;
use motord_realtime::MEMLOCK_LEAST;
use motord_realtime::denial::{Denial, Facts};

/// Paths of the systemd unit. The first existing one counts.
const UNITS: [&str; 3] = [
    "etc/systemd/system/motord.service",
    "usr/lib/systemd/system/motord.service",
    "lib/systemd/system/motord.service",
];

/// The source of the limits: the running daemon, otherwise its unit, otherwise this shell.
enum Source {
    Daemon(u32),
    Unit(String),
    Shell,
}

impl Source {
    fn find(tree: &Tree, daemon: Option<RunningDaemon>) -> Self {
        let unit = || UNITS.iter().find_map(|path| tree.text(path)).map_or(Self::Shell, Self::Unit);
        daemon.map_or_else(unit, |daemon| Self::Daemon(daemon.pid))
    }

    /// Returns its directory in `/proc`.
    fn process(&self) -> Option<String> {
        match self {
            Self::Daemon(pid) => Some(pid.to_string()),
            Self::Shell => Some("self".to_owned()),
            Self::Unit(_) => None,
        }
    }

    fn name(&self) -> String {
        match self {
            Self::Daemon(pid) => format!("motord, process {pid}"),
            Self::Unit(_) => "motord.service".to_owned(),
            Self::Shell => "this shell".to_owned(),
        }
    }

    /// Reads a limit by its name in `/proc/PID/limits` and in a unit. An unreadable one is 0.
    fn limit(&self, tree: &Tree, in_proc: &str, in_unit: &str) -> u64 {
        let text = match self {
            Self::Unit(unit) => unit.lines().find_map(|line| line.strip_prefix(in_unit)?.strip_prefix('=')),
            _ => None,
        };
        let limits = self.process().and_then(|process| tree.text(&format!("proc/{process}/limits")));
        let line =
            limits.as_deref().and_then(|limits| limits.lines().find_map(|line| line.strip_prefix(in_proc)));
        match text.or_else(|| line?.split_whitespace().next()).map(str::trim) {
            Some("unlimited" | "infinity") => u64::MAX,
            Some(number) => number.parse().unwrap_or(0),
            None => 0,
        }
    }

    /// Returns the command that raises a limit, for a unit or for a user.
    fn mend(&self, tree: &Tree, in_unit: &str, unit_value: &str, of_user: &str) -> String {
        match self {
            Self::Daemon(_) | Self::Unit(_) if UNITS.iter().any(|path| tree.has(path)) => {
                let directory = "/etc/systemd/system/motord.service.d";
                format!(
                    "sudo mkdir -p {directory} && printf '[Service]\\n{in_unit}={unit_value}\\n' | \
                     sudo tee {directory}/{in_unit}.conf && sudo systemctl daemon-reload"
                )
            }
            _ => format!("echo \"$USER - {of_user}\" | sudo tee -a /etc/security/limits.d/motord.conf"),
        }
    }
}

/// Checks whether the cycle may have its `SCHED_FIFO` priority: its limit, the time of its control
/// group, and a filter of system calls.
pub(super) fn priority(tree: &Tree, robot: &Robot, daemon: Option<RunningDaemon>) -> Finding {
    const CHECK: &str = "rtprio";
    let source = Source::find(tree, daemon);
    let (name, asked) = (source.name(), robot.priority());
    let facts = facts(tree, &source);
    let measured = match facts.may_nice {
        true => format!("any: {name} has CAP_SYS_NICE"),
        false => format!("{} for {name}; the cycle asks for {asked}", bound(facts.limit)),
    };
    let stat = |daemon: RunningDaemon| format!("proc/{}/task/{}", daemon.pid, daemon.cycle);
    let was_refused = daemon.map(stat).is_some_and(|directory| {
        tree.has(&format!("{directory}/stat")) && process::priority(tree, &directory).is_none()
    });
    match facts.denial(asked, was_refused) {
        None => Finding::good(CHECK, measured),
        Some(Denial::Right { is_root: false, .. }) => {
            let why = "without SCHED_FIFO any other program can delay the cycle by milliseconds; a new limit counts after the \
                next login, or start of the service";
            let most = asked.max(90);
            let mend = source.mend(tree, "LimitRTPRIO", &most.to_string(), &format!("rtprio {most}"));
            Finding::bad(CHECK, measured, why).mended_by(mend)
        }
        Some(denial) => Finding::bad(CHECK, measured, denial.to_string()).mended_by(denial.remedy()),
    }
}

/// Reads the facts that decide over the priority. A unit's limit is in its file.
fn facts(tree: &Tree, source: &Source) -> Facts {
    let process = source.process().unwrap_or_else(|| "self".to_owned());
    let facts = Facts::read(&process, |path| tree.text(path));
    match source {
        Source::Unit(_) => Facts {
            is_root: false,
            may_nice: false,
            is_filtered: false,
            limit: source.limit(tree, "Max realtime priority", "LimitRTPRIO"),
            ..facts
        },
        _ => facts,
    }
}

/// Checks whether the daemon may lock its memory.
pub(super) fn memory(tree: &Tree, daemon: Option<RunningDaemon>) -> Finding {
    const CHECK: &str = "memlock";
    let source = Source::find(tree, daemon);
    let name = source.name();
    if source.process().is_some_and(|process| process::user(tree, &process) == Some(0)) {
        return Finding::good(CHECK, format!("any: {name} is root's"));
    }
    let limit = source.limit(tree, "Max locked memory", "LimitMEMLOCK");
    let measured = match limit {
        u64::MAX => format!("{} for {name}", bound(limit)),
        bytes => format!("{} MiB for {name}", bytes >> 20),
    };
    if limit >= MEMLOCK_LEAST {
        return Finding::good(CHECK, measured);
    }
    let why = "motord locks its memory only where the limit is at least 1024 MiB; a page that was swapped out, or never \
        touched, delays the cycle; a new limit counts after the next login, or start of the service";
    let mend = source.mend(tree, "LimitMEMLOCK", "infinity", "memlock unlimited");
    Finding::bad(CHECK, measured, why).mended_by(mend)
}

fn bound(limit: u64) -> String {
    if limit == u64::MAX { "no limit".to_owned() } else { limit.to_string() }
}
