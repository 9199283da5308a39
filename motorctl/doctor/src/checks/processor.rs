//! The processors of the cycle: isolation, clock and idle states.

use crate::change::Change;
use crate::finding::Finding;
use crate::process::{self, RunningDaemon};
use crate::robot::Robot;
use crate::tree::{self, Tree};

const CPU: &str = "sys/devices/system/cpu";
const DMA_LATENCY: &str = "dev/cpu_dma_latency";
/// Longest wake-up time of an idle state, µs, that stays below the spread of a good wake-up.
const LATENCY_MAX_US: i64 = 10;

/// Checks whether the cycle has an isolated processor.
pub(super) fn isolation(tree: &Tree, robot: &Robot) -> Finding {
    const CHECK: &str = "isolated cores";
    let (isolated, online) =
        (tree.processors(&format!("{CPU}/isolated")), tree.processors(&format!("{CPU}/online")));
    let shown = if isolated.is_empty() { "none".to_owned() } else { tree::list(&isolated) };
    match (robot.request.cpu, isolated.last()) {
        (Some(cpu), _) if isolated.contains(&cpu) => {
            Finding::good(CHECK, format!("{shown}; the cycle is pinned to {cpu}"))
        }
        (None, Some(free)) => {
            let why =
                format!("the cycle is pinned to none: set `cpu = {free}` in [cycle] of the configuration");
            Finding::warn(CHECK, shown, why)
        }
        _ if online.len() < 2 => {
            Finding::warn(CHECK, shown, "with one processor every interrupt delays the cycle")
        }
        (pinned, _) => not_isolated(tree, pinned, &online, shown),
    }
}

fn not_isolated(tree: &Tree, pinned: Option<usize>, online: &[usize], shown: String) -> Finding {
    let cpu = pinned.or(online.last().copied()).unwrap_or(0);
    let others: Vec<usize> = online.iter().copied().filter(|&other| other != cpu).collect();
    let parameters = format!(
        "isolcpus=managed_irq,domain,{cpu} nohz_full={cpu} rcu_nocbs={cpu} irqaffinity={}",
        tree::list(&others)
    );
    let set = pinned.map_or_else(|| format!("set `cpu = {cpu}` in [cycle], "), |_| String::new());
    let why = format!(
        "others may run where the cycle does: {set}give the kernel the parameters `{parameters}`, restart the computer, and \
         measure again, since not every computer gains by it"
    );
    let measured =
        pinned.map_or_else(|| shown.clone(), |cpu| format!("{shown}; the cycle is pinned to {cpu}"));
    Finding::warn("isolated cores", measured, why).mended_by(boot_command(tree, &parameters))
}

/// Returns the command that adds kernel parameters for the next boot.
fn boot_command(tree: &Tree, parameters: &str) -> Option<String> {
    if tree.has("etc/default/grub") {
        return Some(format!(
            "sudo sed -i 's/^GRUB_CMDLINE_LINUX=\"/&{parameters} /' /etc/default/grub && sudo update-grub"
        ));
    }
    let line = ["boot/firmware/cmdline.txt", "boot/cmdline.txt"].into_iter().find(|path| tree.has(path))?;
    Some(format!("sudo sed -i '1s/$/ {parameters}/' /{line}"))
}

/// Checks whether the processors of the cycle keep a high clock.
pub(super) fn governor(tree: &Tree, robot: &Robot) -> Finding {
    const CHECK: &str = "governor";
    let read = |cpu: &usize| Some((*cpu, tree.text(&format!("{CPU}/cpu{cpu}/cpufreq/scaling_governor"))?));
    let governors: Vec<(usize, String)> = robot.processors(tree).iter().filter_map(read).collect();
    let Some((_, first)) = governors.first() else {
        return Finding::good(CHECK, "the system does not scale the clock");
    };
    let slow: Vec<usize> =
        governors.iter().filter(|(_, name)| name != "performance").map(|(cpu, _)| *cpu).collect();
    if slow.is_empty() {
        return Finding::good(CHECK, first.clone());
    }
    let name = governors.iter().find(|(cpu, _)| slow.contains(cpu)).map_or("", |(_, name)| name);
    let measured = format!("{name} on processors {}", tree::list(&slow));
    let why = "a cycle that sleeps most of the time is taken for no load, and the clock falls; a new governor counts until the \
        next start of the computer";
    let path = |cpu: &usize| format!("{CPU}/cpu{cpu}/cpufreq/scaling_governor");
    let changes = slow.iter().map(|cpu| Change::write(path(cpu), "performance")).collect();
    let finding = Finding::warn(CHECK, measured, why).tuned_by(changes);
    finding.mended_by(format!("echo performance | sudo tee /{CPU}/cpu*/cpufreq/scaling_governor"))
}

/// Checks the wake-up time of the processors, and whether the daemon may forbid deep idle states.
pub(super) fn idle(tree: &Tree, robot: &Robot, daemon: Option<RunningDaemon>) -> Finding {
    const CHECK: &str = "C-states";
    let states = robot.processors(tree).into_iter().flat_map(|cpu| states(tree, cpu));
    let Some((latency, name)) = states.max() else {
        return Finding::good(CHECK, "the kernel has no choice of them");
    };
    let measured = format!("deepest {name}, {latency} µs to wake up");
    if latency <= LATENCY_MAX_US {
        return Finding::good(CHECK, measured);
    }
    if may_write(tree, daemon) {
        return Finding::good(CHECK, format!("{measured}; motord may forbid it by /{DMA_LATENCY}"));
    }
    let why = format!(
        "motord may not write /{DMA_LATENCY}, which would forbid it; then members of the group motord may"
    );
    let rule = r#"KERNEL=="cpu_dma_latency", SUBSYSTEM=="misc", GROUP="motord", MODE="0660""#;
    let command = format!(
        "echo '{rule}' | sudo tee /etc/udev/rules.d/71-motord-awake.rules && sudo udevadm control --reload && \
         sudo udevadm trigger /{DMA_LATENCY}"
    );
    Finding::warn(CHECK, measured, why).mended_by(command)
}

/// Returns wake-up time, µs, and name of the idle states of a processor.
fn states(tree: &Tree, cpu: usize) -> Vec<(i64, String)> {
    let directory = format!("{CPU}/cpu{cpu}/cpuidle");
    let state = |name: &String| {
        let state = format!("{directory}/{name}");
        let is_used = tree.number(&format!("{state}/disable")).unwrap_or(0) == 0;
        let latency = tree.number(&format!("{state}/latency")).filter(|_| is_used)?;
        Some((latency, tree.text(&format!("{state}/name"))?))
    };
    tree.names(&directory).iter().filter_map(state).collect()
}

/// Returns true if the running daemon may write `/dev/cpu_dma_latency`. Without a daemon: this
/// user, or a group other than root's, of which the service user is a member.
fn may_write(tree: &Tree, daemon: Option<RunningDaemon>) -> bool {
    const OF_USER: u32 = 0o200;
    const OF_GROUP: u32 = 0o020;
    let Some(permissions) = tree.permissions(DMA_LATENCY) else { return false };
    let process = daemon.map_or_else(|| "self".to_owned(), |daemon| daemon.pid.to_string());
    let user = process::user(tree, &process);
    let has = |bit: u32| permissions.mode & bit != 0;
    user == Some(0)
        || has(OF_USER) && user == Some(permissions.user)
        || has(OF_GROUP)
            && (process::groups(tree, &process).contains(&permissions.group)
                || daemon.is_none() && permissions.group != 0)
}
