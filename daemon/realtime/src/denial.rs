//! The reasons why the kernel refuses `SCHED_FIFO`, and the command that changes that.
//!
//! The kernel answers `EPERM` for each of: no right to the priority, a control group without
//! real-time time, a filter of system calls. The reason is in files of `/proc` and `/sys`.

use std::fmt;

/// From capabilities(7): lifts the limit of the priority.
const CAP_SYS_NICE: u64 = 1 << 23;
/// `Seccomp:` of `/proc/PID/status`: a filter checks each system call.
const SECCOMP_FILTER: &str = "2";
/// Time for real-time threads in a control group of cgroup v1, µs in each second.
const SHARE_US: u32 = 400_000;

/// The facts that decide whether a process may use `SCHED_FIFO`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Facts {
    /// Its effective user is root.
    pub is_root: bool,
    /// It has `CAP_SYS_NICE`.
    pub may_nice: bool,
    /// `RLIMIT_RTPRIO`.
    pub limit: u64,
    /// A seccomp filter checks its system calls.
    pub is_filtered: bool,
    /// `kernel.sched_rt_runtime_us`; -1 lifts every bound.
    pub runtime_us: i64,
    /// Its control group.
    pub group: Group,
}

/// The real-time time of a control group (`CONFIG_RT_GROUP_SCHED`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Group {
    /// The group needs none: it is the root, or the kernel does not divide the time.
    Free,
    /// It may have time that its file grants, cgroup v1: µs in a period.
    Share {
        /// The file.
        file: String,
        /// Its number.
        micros: i64,
    },
    /// The kernel divides the time, and cgroup v2 can grant none.
    None,
    /// The group is of cgroup v2, and the kernel's configuration is not readable.
    Unknown,
}

/// The reason for a refusal of `SCHED_FIFO`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Denial {
    /// The priority is above the limit, and the process has no capability.
    Right {
        /// Root without its capability: in a container.
        is_root: bool,
        /// `RLIMIT_RTPRIO`.
        limit: u64,
    },
    /// `kernel.sched_rt_runtime_us` is 0.
    NoTime,
    /// The control group has no time in `file`.
    Group {
        /// The file.
        file: String,
    },
    /// The control group can have no time.
    GroupV2,
    /// A seccomp filter.
    Filter,
    /// None of these.
    Unknown {
        /// The kernel may divide the time by control groups.
        may_divide: bool,
    },
}

impl Facts {
    /// Reads the facts of `process`, a name in `/proc`. `read` returns the text of a file by its
    /// path without the first slash; a file that it cannot read counts as missing. Not for the
    /// real-time path.
    pub fn read(process: &str, read: impl Fn(&str) -> Option<String>) -> Self {
        let status = read(&format!("proc/{process}/status")).unwrap_or_default();
        let field = |name: &str, index: usize| {
            let line = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
            line.and_then(|line| line.split_whitespace().nth(index)).unwrap_or_default()
        };
        let runtime = read("proc/sys/kernel/sched_rt_runtime_us");
        Self {
            is_root: field("Uid", 1) == "0",
            may_nice: u64::from_str_radix(field("CapEff", 0), 16).unwrap_or(0) & CAP_SYS_NICE != 0,
            limit: limit(&read(&format!("proc/{process}/limits")).unwrap_or_default()),
            is_filtered: field("Seccomp", 0) == SECCOMP_FILTER,
            runtime_us: runtime.and_then(|text| text.trim().parse().ok()).unwrap_or(-1),
            group: Group::read(process, read),
        }
    }

    /// Returns the reason why `priority` is refused, or would be. `None` where the facts allow it.
    /// A filter counts only if the priority `was_refused`: most filters allow it.
    #[must_use]
    pub fn denial(&self, priority: u8, was_refused: bool) -> Option<Denial> {
        if !self.may_nice && self.limit < u64::from(priority) {
            return Some(Denial::Right { is_root: self.is_root, limit: self.limit });
        }
        if self.runtime_us == 0 {
            return Some(Denial::NoTime);
        }
        let is_divided = self.runtime_us > 0;
        match &self.group {
            Group::Share { file, micros: 0 } if is_divided => Some(Denial::Group { file: file.clone() }),
            Group::None if is_divided => Some(Denial::GroupV2),
            _ if !was_refused => None,
            _ if self.is_filtered => Some(Denial::Filter),
            group => Some(Denial::Unknown { may_divide: is_divided && *group == Group::Unknown }),
        }
    }
}

impl Group {
    fn read(process: &str, read: impl Fn(&str) -> Option<String>) -> Self {
        let groups = read(&format!("proc/{process}/cgroup")).unwrap_or_default();
        // Each line is number:controllers:path; cgroup v2 has number 0 and no controllers.
        let lines = groups.lines().filter_map(|line| {
            let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
            Some((controllers, path))
        });
        let mut of_v2 = None;
        for (controllers, path) in lines {
            if controllers.split(',').any(|controller| controller == "cpu") {
                return Self::of_v1(controllers, path, &read);
            }
            if controllers.is_empty() {
                of_v2 = Some(path);
            }
        }
        match (of_v2, divides(&read)) {
            (None | Some("/"), _) | (_, Some(false)) => Self::Free,
            (Some(_), Some(true)) => Self::None,
            (Some(_), None) => Self::Unknown,
        }
    }

    fn of_v1(controllers: &str, path: &str, read: impl Fn(&str) -> Option<String>) -> Self {
        let file = format!("sys/fs/cgroup/{controllers}{}/cpu.rt_runtime_us", path.trim_end_matches('/'));
        let micros = read(&file).and_then(|text| text.trim().parse().ok());
        match micros {
            Some(micros) if path != "/" => Self::Share { file: format!("/{file}"), micros },
            _ => Self::Free,
        }
    }
}

/// Returns whether the kernel divides real-time time by control groups; `None` where its
/// configuration is not readable.
fn divides(read: impl Fn(&str) -> Option<String>) -> Option<bool> {
    let command_line = read("proc/cmdline").unwrap_or_default();
    if command_line.split_whitespace().any(|word| word == "rt_group_sched=0") {
        return Some(false);
    }
    let release = read("proc/sys/kernel/osrelease")?;
    let config = read(&format!("boot/config-{}", release.trim()))?;
    Some(config.lines().any(|line| line.trim() == "CONFIG_RT_GROUP_SCHED=y"))
}

/// Reads the soft limit of the priority in `/proc/PID/limits`.
fn limit(limits: &str) -> u64 {
    let line = limits.lines().find_map(|line| line.strip_prefix("Max realtime priority"));
    match line.and_then(|line| line.split_whitespace().next()) {
        Some("unlimited") => u64::MAX,
        number => number.and_then(|number| number.parse().ok()).unwrap_or(0),
    }
}

impl Denial {
    /// Returns the command that ends the refusal, or where it is set.
    #[must_use]
    pub fn remedy(&self) -> String {
        let unbound = "sudo sysctl kernel.sched_rt_runtime_us=-1";
        match self {
            Self::Right { is_root: true, .. } => "docker run --cap-add=SYS_NICE --ulimit rtprio=99, or \
                CAP_SYS_NICE in CapabilityBoundingSet= of the unit"
                .to_owned(),
            Self::Right { is_root: false, .. } => "LimitRTPRIO=90 in the unit, or `ulimit -r 90`".to_owned(),
            Self::NoTime => "sudo sysctl kernel.sched_rt_runtime_us=950000".to_owned(),
            Self::Group { file } => format!(
                "echo {SHARE_US} | sudo tee {file}, after the same in each directory above it; or, for all groups, {unbound}"
            ),
            Self::GroupV2 => {
                format!("{unbound}; or boot with rt_group_sched=0 (Linux 6.16 or later)")
            }
            Self::Filter => {
                "RestrictRealtime=no in the unit, or docker run --security-opt seccomp=unconfined".to_owned()
            }
            Self::Unknown { may_divide: true } => {
                format!("{unbound}, if the kernel has CONFIG_RT_GROUP_SCHED")
            }
            Self::Unknown { may_divide: false } => {
                "look for a security module (AppArmor, SELinux) in `sudo dmesg`".to_owned()
            }
        }
    }
}

impl fmt::Display for Denial {
    /// Writes the reason.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Right { is_root: true, limit } => {
                write!(f, "root has no CAP_SYS_NICE here, as in a container, and RLIMIT_RTPRIO is {limit}")
            }
            Self::Right { is_root: false, limit } => {
                write!(f, "RLIMIT_RTPRIO is {limit}, and CAP_SYS_NICE is missing")
            }
            Self::NoTime => f.write_str("kernel.sched_rt_runtime_us is 0: no thread may be real-time"),
            Self::Group { file } => {
                write!(f, "the control group has no real-time time: {file} is 0")
            }
            Self::GroupV2 => f.write_str(
                "this kernel divides real-time time by control groups (CONFIG_RT_GROUP_SCHED), and cgroup v2 grants none",
            ),
            Self::Filter => f.write_str(
                "rights and time are sufficient: a filter of system calls (seccomp) of the container or the unit refuses it",
            ),
            Self::Unknown { .. } => f.write_str("rights and time are sufficient, and no filter is set"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: &str = "Limit                     Soft Limit           Hard Limit           Units\n\
        Max realtime priority     0                    0                    \n";

    /// The files of root with all capabilities, on a kernel that divides nothing, with changes.
    fn facts(changes: &[(&str, &str)]) -> Facts {
        let files = [
            ("proc/self/status", "Name:\tmotord\nUid:\t0\t0\t0\t0\nCapEff:\t000001ffffffffff\nSeccomp:\t0\n"),
            ("proc/self/limits", LIMITS),
            ("proc/self/cgroup", "0::/system.slice/motord.service\n"),
            ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
            ("proc/sys/kernel/osrelease", "6.1.0\n"),
            ("boot/config-6.1.0", "# CONFIG_RT_GROUP_SCHED is not set\n"),
        ];
        let has = |files: &[(&str, &str)], path: &str| {
            files.iter().find(|(name, _)| *name == path).map(|(_, text)| (*text).to_owned())
        };
        let missing = |text: &String| text != "MISSING";
        Facts::read("self", |path| has(changes, path).or_else(|| has(&files, path)).filter(missing))
    }

    const CONTAINER: (&str, &str) =
        ("proc/self/status", "Uid:\t0\t0\t0\t0\nCapEff:\t00000000a80425fb\nSeccomp:\t2\n");
    const FILTERED: (&str, &str) =
        ("proc/self/status", "Uid:\t0\t0\t0\t0\nCapEff:\t000001ffffffffff\nSeccomp:\t2\n");
    const USER: (&str, &str) = ("proc/self/status", "Uid:\t9\t9\t9\t9\nCapEff:\t0\nSeccomp:\t0\n");
    const DIVIDED: (&str, &str) = ("boot/config-6.1.0", "CONFIG_RT_GROUP_SCHED=y\n");
    const V1: (&str, &str) = ("proc/self/cgroup", "4:cpu,cpuacct:/user.slice\n0::/user.slice\n");
    const SHARE: &str = "sys/fs/cgroup/cpu,cpuacct/user.slice/cpu.rt_runtime_us";

    #[test]
    fn each_refusal_has_reason_and_remedy() {
        let unbound = ("proc/sys/kernel/sched_rt_runtime_us", "-1");
        for (changes, reason, remedy) in [
            (&[][..], "no filter is set", "dmesg"),
            (&[CONTAINER], "root has no CAP_SYS_NICE", "--cap-add=SYS_NICE"),
            (&[USER], "RLIMIT_RTPRIO is 0", "LimitRTPRIO=90"),
            (&[FILTERED], "seccomp", "RestrictRealtime=no"),
            (&[DIVIDED], "cgroup v2 grants none", "sudo sysctl kernel.sched_rt_runtime_us=-1"),
            (
                &[V1, (SHARE, "0")],
                "cpu,cpuacct/user.slice/cpu.rt_runtime_us is 0",
                "echo 400000 | sudo tee /sys/fs/cgroup/cpu",
            ),
            (&[("proc/sys/kernel/sched_rt_runtime_us", "0")], "no thread may be real-time", "=950000"),
            (
                &[("boot/config-6.1.0", "MISSING")],
                "no filter is set",
                "if the kernel has CONFIG_RT_GROUP_SCHED",
            ),
            (&[DIVIDED, unbound, FILTERED], "seccomp", "RestrictRealtime=no"),
            (
                &[DIVIDED, ("proc/cmdline", "quiet rt_group_sched=0"), FILTERED],
                "seccomp",
                "RestrictRealtime=no",
            ),
        ] {
            let denial = facts(changes).denial(80, true).unwrap();
            assert!(denial.to_string().contains(reason), "{changes:?}: {denial}");
            assert!(denial.remedy().contains(remedy), "{changes:?}: {}", denial.remedy());
        }
    }

    #[test]
    fn sufficient_rights_are_no_denial() {
        let limited = ("proc/self/limits", "Max realtime priority     90                   90      \n");
        for changes in [
            &[][..],
            &[FILTERED],
            &[USER, limited],
            &[V1, (SHARE, "400000")],
            &[V1],
            &[DIVIDED, ("proc/self/cgroup", "0::/\n")],
            &[("boot/config-6.1.0", "MISSING")],
        ] {
            assert_eq!(facts(changes).denial(80, false), None, "{changes:?}");
        }
    }

    #[test]
    fn arbitrary_files_never_panic() {
        for text in ["", ":", "0", "::", "0::", "1:cpu:", "1:cpu:/", "Seccomp", "Uid: \nCapEff: zz"] {
            let facts = Facts::read("self", |_| Some(text.to_owned()));
            assert!(facts.denial(80, true).is_some(), "{text}: {facts:?}");
        }
    }
}
