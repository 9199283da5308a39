//! A CAN interface: its settings, its queue, its interrupts.

use super::system;
use crate::change::Change;
use crate::finding::Finding;
use crate::process;
use crate::robot::{Interface, Robot};
use crate::tree::{self, Tree};
use motord_bus::socketcan::{Coalescing, Link, OpenError, RESTART_MS};
use motord_bus::{BusLock, Holder};
use nix::errno::Errno;
use nix::unistd::geteuid;
use std::collections::BTreeSet;

/// The queue that the shipped udev rule sets, frames.
const QUEUE: usize = 16;
/// Longest queue, frames: a recovering bus sends all of them with old torques. 8 ms of a full bus.
const QUEUE_MAX: i64 = 64;

/// The bit rate of a bus whose configuration names none, bit/s.
const BITRATE: u32 = 1_000_000;

/// Returns the queue length, frames: the commands and requests of two cycles, each with one poll
/// for a fault.
fn queue_length(interface: &Interface) -> usize {
    QUEUE.max(2 * cycle_frames(interface))
}

/// Returns the frames of a cycle: commands, requests to IMUs, and a poll for a fault.
const fn cycle_frames(interface: &Interface) -> usize {
    interface.motors + interface.requests + 1
}

/// Drivers without a restart after a bus-off: they have no `do_set_mode`, and the kernel refuses
/// `restart-ms`. Source: `drivers/net/can/usb/gs_usb.c`; `can_changelink` in
/// `drivers/net/can/dev/netlink.c`.
const WITHOUT_RESTART: [&str; 1] = ["gs_usb"];

/// Returns whether the driver can restart the controller of an interface after a bus-off. An
/// interface without a device is that of a serial line (`slcan`), which cannot.
pub(super) fn can_restart(tree: &Tree, name: &str) -> bool {
    let driver = tree.link(&format!("sys/class/net/{name}/device/driver"));
    driver.is_some_and(|path| path.rsplit('/').next().is_none_or(|driver| !WITHOUT_RESTART.contains(&driver)))
}

/// Checks whether the interface is up with the configured bit rate. `can_restart` tells of its
/// driver.
pub(super) fn link(interface: &Interface, read: Result<Link, OpenError>, can_restart: bool) -> Finding {
    const CHECK: &str = "interface";
    let Interface { name, bitrate, .. } = interface;
    let checked = read.and_then(|link| {
        // Without a configuration the present bit rate is right.
        let bitrate = bitrate.or(link.bitrate).unwrap_or(BITRATE);
        link.check(bitrate, queue_length(interface) as u32).map(|()| link)
    });
    let link = match checked {
        Ok(link) => link,
        Err(error) => return refused(&error, can_restart).of(name),
    };
    let rate = match link.bitrate {
        Some(bitrate) => format!("{bitrate} bit/s"),
        None if link.is_virtual => "virtual".to_owned(),
        None => "unknown bit rate".to_owned(),
    };
    match link.restart_ms {
        Some(0) if !can_restart => {
            let measured = format!(
                "up, {rate}; its driver has no restart after a bus-off: motord takes it down and up where it may"
            );
            Finding::good(CHECK, measured).of(name)
        }
        Some(0) => {
            let why = "after a bus-off it stays off the bus until it is taken down and up, which motord does where it may";
            Finding::warn(CHECK, format!("up, {rate}, no restart"), why)
                .tuned_by(while_down(name, format!("ip link set {name} type can restart-ms {RESTART_MS}")))
                .of(name)
        }
        Some(restart) => {
            Finding::good(CHECK, format!("up, {rate}, restarts {restart} ms after a bus-off")).of(name)
        }
        None => Finding::good(CHECK, format!("up, {rate}")).of(name),
    }
}

fn refused(error: &OpenError, can_restart: bool) -> Finding {
    let sentence = error.to_string();
    let measured = sentence.split("; as root").next().unwrap_or_default();
    let is_useful = |command: &&str| can_restart || !command.contains("restart-ms");
    let remedy = error.remedy().map(ToString::to_string);
    let commands = remedy.map(|remedy| remedy.split("; ").filter(is_useful).collect::<Vec<_>>().join("; "));
    let command = commands.map(|commands| format!("sudo sh -c '{commands}'"));
    Finding::bad("interface", measured, "motord does not reach its motors").mended_by(command)
}

/// Checks the length of the transmit queue.
pub(super) fn queue(tree: &Tree, interface: &Interface) -> Finding {
    const CHECK: &str = "txqueuelen";
    let name = &interface.name;
    let length = tree.number(&format!("sys/class/net/{name}/tx_queue_len"));
    let Some(length) = length else { return Finding::good(CHECK, "not shown").of(name) };
    let measured = format!("{length} frames");
    let changes = vec![Change::run(&format!("ip link set {name} txqueuelen {}", queue_length(interface)))];
    let least = cycle_frames(interface);
    let finding = if length > QUEUE_MAX {
        let why = "after a stall the bus sends all queued frames, with outdated torques";
        Finding::warn(CHECK, measured, why).tuned_by(changes)
    } else if length < least as i64 {
        let why = format!(
            "a cycle sends {least} frames, with requests to IMUs and a poll for a fault: some are dropped"
        );
        Finding::bad(CHECK, measured, why).tuned_by(changes)
    } else {
        Finding::good(CHECK, measured)
    };
    finding.of(name)
}

/// Wraps a change that the kernel accepts only while the interface is down.
fn while_down(name: &str, change: String) -> Vec<Change> {
    [format!("ip link set {name} down"), change, format!("ip link set {name} up")]
        .map(|words| Change::run(&words))
        .into()
}

/// Checks whether the adapter delays received frames.
pub(super) fn coalescing(name: &str, read: Result<Option<Coalescing>, Errno>) -> Finding {
    const CHECK: &str = "coalescing";
    let settings = match read {
        Ok(Some(settings)) => settings,
        Ok(None) => return Finding::good(CHECK, "the driver has no such setting").of(name),
        Err(errno) => {
            let measured = format!("cannot be read ({})", errno.desc());
            let why = "this kernel does not answer ethtool's netlink; read it as the command shows: all of 0 and 1 is good";
            return Finding::warn(CHECK, measured, why).mended_by(format!("ethtool -c {name}")).of(name);
        }
    };
    let Coalescing { rx_usecs, rx_frames, rx_usecs_irq, rx_frames_irq } = settings;
    let known = [
        ("rx-usecs", rx_usecs, 0),
        ("rx-frames", rx_frames, 1),
        ("rx-usecs-irq", rx_usecs_irq, 0),
        ("rx-frames-irq", rx_frames_irq, 1),
    ];
    let known: Vec<_> = known.iter().filter_map(|(key, value, best)| Some((key, (*value)?, best))).collect();
    let words = |values: Vec<String>| values.join(" ");
    let measured = words(known.iter().map(|(key, value, _)| format!("{key} {value}")).collect());
    let best = words(known.iter().map(|(key, _, best)| format!("{key} {best}")).collect());
    let changes = while_down(name, format!("ethtool -C {name} {best}"));
    let pairs = [(rx_usecs, rx_frames), (rx_usecs_irq, rx_frames_irq)];
    let pairs = pairs.map(|(usecs, frames)| (usecs.unwrap_or(0), frames.unwrap_or(0)));
    let finding = if pairs.iter().any(|&(usecs, frames)| usecs == 0 && frames > 1) {
        let why = "without a time limit the adapter delivers nothing until rx-frames frames have arrived";
        Finding::bad(CHECK, measured, why).tuned_by(changes)
    } else if pairs.iter().any(|&(usecs, frames)| usecs > 0 && frames != 1) {
        let why = "the adapter delays replies by up to rx-usecs µs";
        Finding::warn(CHECK, measured, why).tuned_by(changes)
    } else {
        Finding::good(CHECK, measured)
    };
    finding.of(name)
}

/// An interrupt and the processors that it is delivered to.
struct InterruptLine {
    number: u32,
    processors: Vec<usize>,
    /// The thread that serves it, and its real-time priority.
    thread: Option<(u32, Option<u8>)>,
}

impl InterruptLine {
    /// Returns true if it is served on the processor of the cycle.
    fn delays(&self, robot: &Robot) -> bool {
        robot.request.cpu.is_some_and(|cpu| self.processors.contains(&cpu))
    }
}

/// Checks the processors and threads that serve the interrupts of an interface.
pub(super) fn interrupts(tree: &Tree, robot: &Robot, name: &str) -> Finding {
    const CHECK: &str = "interrupts";
    let Some(interrupts) = served(tree, name) else {
        return Finding::good(CHECK, "none: it is virtual").of(name);
    };
    if interrupts.is_empty() {
        let why =
            "no line of the file names the interface or its device: find the line of its adapter by hand";
        return Finding::warn(CHECK, "not found in /proc/interrupts", why)
            .mended_by("cat /proc/interrupts".to_owned())
            .of(name);
    }
    let measured = interrupts.iter().map(describe).collect::<Vec<_>>().join("; ");
    let (mut whys, mut changes) = (Vec::new(), Vec::new());
    let others = others(tree, robot);
    for interrupt in &interrupts {
        if interrupt.delays(robot) && !others.is_empty() {
            whys.push("it interrupts the cycle's processor".to_owned());
            let path = format!("proc/irq/{}/smp_affinity_list", interrupt.number);
            changes.push(Change::write(path, tree::list(&others)));
        }
        if let Some((pid, priority)) = interrupt.thread
            && priority.is_none_or(|priority| priority <= robot.priority())
        {
            let above = (robot.priority() + 1).max(90);
            whys.push(format!(
                "its thread is not above the cycle ({}), whose replies it delivers",
                robot.priority()
            ));
            changes.push(Change::run(&format!("chrt -f -p {above} {pid}")));
        }
    }
    if changes.is_empty() {
        return Finding::good(CHECK, measured).of(name);
    }
    whys.dedup();
    let why = format!("{}; counts until the next start of the interface", whys.join(", and "));
    Finding::warn(CHECK, measured, why).tuned_by(changes).of(name)
}

/// Checks that `ksoftirqd` has a real-time priority on the processors that serve the interfaces of
/// `robot`. A busy kernel leaves received frames to it, and controllers would delay it. A kernel
/// with `PREEMPT_RT` handles the frames in the interrupt's thread.
pub(super) fn ksoftirqd(tree: &Tree, robot: &Robot) -> Finding {
    const CHECK: &str = "ksoftirqd";
    if system::is_realtime(tree) {
        return Finding::good(CHECK, "received frames do not wait for it: PREEMPT_RT");
    }
    let processors: BTreeSet<usize> =
        robot.interfaces.iter().flat_map(|interface| receivers(tree, robot, &interface.name)).collect();
    let names: Vec<String> = processors.iter().map(|processor| format!("ksoftirqd/{processor}")).collect();
    let threads = process::kernel_threads(tree, |name| names.iter().any(|wanted| wanted == name));
    let is_low = |pid: &u32| process::priority(tree, &format!("proc/{pid}")).is_none();
    let low: Vec<u32> = threads.into_iter().filter(is_low).collect();
    if low.is_empty() {
        return Finding::good(CHECK, "no received frame waits for one at a normal priority");
    }
    let measured = format!(
        "at a normal priority on processors {}",
        tree::list(&processors.into_iter().collect::<Vec<_>>())
    );
    let why = "a busy kernel leaves received frames to it: behind a real-time controller that does not sleep for 10 ms all motors are \
        lost";
    let below_the_cycle = robot.priority().saturating_sub(1).max(1);
    let raise = |pid| Change::run(&format!("chrt -f -p {below_the_cycle} {pid}"));
    Finding::warn(CHECK, measured, why).tuned_by(low.into_iter().map(raise).collect())
}

/// Returns the processors that serve an interface once its interrupts have moved from the processor
/// of the cycle.
fn receivers(tree: &Tree, robot: &Robot, name: &str) -> Vec<usize> {
    let served = served(tree, name).unwrap_or_default().into_iter();
    let moved = |interrupt: InterruptLine| match interrupt.delays(robot) {
        true => others(tree, robot),
        false => interrupt.processors,
    };
    served.flat_map(moved).collect()
}

/// Returns all processors but that of the cycle.
fn others(tree: &Tree, robot: &Robot) -> Vec<usize> {
    let online = tree.processors("sys/devices/system/cpu/online").into_iter();
    online.filter(|&processor| Some(processor) != robot.request.cpu).collect()
}

/// Returns the interrupts of an interface; `None` for a virtual one.
fn served(tree: &Tree, name: &str) -> Option<Vec<InterruptLine>> {
    let device = tree.resolved(&format!("sys/class/net/{name}/device"))?;
    Some(numbers(tree, name, &device).into_iter().map(|number| interrupt(tree, number)).collect())
}

fn describe(interrupt: &InterruptLine) -> String {
    let InterruptLine { number, processors, thread } = interrupt;
    let processors = tree::list(processors);
    let thread = match thread {
        None => String::new(),
        Some((pid, Some(priority))) => format!(", thread {pid} at real-time priority {priority}"),
        Some((pid, None)) => format!(", thread {pid} at a normal priority"),
    };
    format!("{number} on processors {processors}{thread}")
}

/// Returns the interrupts that name the interface or its device. Otherwise those of the nearest
/// device above it, such as a USB controller.
fn numbers(tree: &Tree, name: &str, device: &str) -> Vec<u32> {
    let shown = tree.text("proc/interrupts").unwrap_or_default();
    let device_name = device.rsplit('/').next().unwrap_or_default();
    let names_it = |action: &str| {
        action
            .split(|letter: char| letter.is_whitespace() || letter == ',')
            .any(|word| word == name || word == device_name)
    };
    let line = |line: &str| {
        let (number, action) = line.split_once(':')?;
        names_it(action).then(|| number.trim().parse().ok())?
    };
    let named: Vec<u32> = shown.lines().filter_map(line).collect();
    if named.is_empty() { of_device(tree, device) } else { named }
}

fn of_device(tree: &Tree, device: &str) -> Vec<u32> {
    let mut directory = device;
    while !directory.is_empty() {
        let messages = tree.numbers(&format!("{directory}/msi_irqs"));
        let line = tree.number(&format!("{directory}/irq")).and_then(|number| u32::try_from(number).ok());
        let found: Vec<u32> = if messages.is_empty() {
            line.filter(|&number| number > 0).into_iter().collect()
        } else {
            messages
        };
        if !found.is_empty() {
            return found;
        }
        directory = directory.rsplit_once('/').map_or("", |(above, _)| above);
    }
    Vec::new()
}

fn interrupt(tree: &Tree, number: u32) -> InterruptLine {
    let directory = format!("proc/irq/{number}");
    // The kernel delivers an interrupt by its effective affinity, not by the requested one.
    let effective = tree.processors(&format!("{directory}/effective_affinity_list"));
    let processors = if effective.is_empty() {
        tree.processors(&format!("{directory}/smp_affinity_list"))
    } else {
        effective
    };
    let prefix = format!("irq/{number}-");
    let thread = process::kernel_threads(tree, |name| name.starts_with(&prefix)).first().copied();
    let thread = thread.map(|pid| (pid, process::priority(tree, &format!("proc/{pid}"))));
    InterruptLine { number, processors, thread }
}

/// The receiver lists of the kernel.
const LISTS: [&str; 6] = ["all", "fil", "inv", "sff", "eff", "err"];
/// Kinds of receivers: the last word of a line in these lists.
const KINDS: [&str; 5] = ["raw", "bcm", "isotp", "j1939", "gw"];

const CHECK: &str = "owner";

/// Checks whether another program uses the interface. motord and motorctl lock it; other programs
/// show only filters.
pub(super) fn owners(tree: &Tree, name: &str) -> Finding {
    if let Some(holder) = BusLock::holders_of_interface(name, true).into_iter().flatten().next() {
        return locked(tree, holder).of(name);
    }
    let receivers = kinds_of_receivers(tree, name);
    if receivers.is_empty() {
        return Finding::good(CHECK, "nobody").of(name);
    }
    let kinds: BTreeSet<&str> = receivers.iter().copied().collect();
    let kinds = kinds.into_iter().collect::<Vec<_>>().join(", ");
    let measured = format!("{} filters of other programs ({kinds})", receivers.len());
    let why = "one that only listens, as candump does, is harmless; one that sends commands two masters to the motors";
    Finding::warn(CHECK, measured, why).mended_by("sudo lsof -n | grep CAN_".to_owned()).of(name)
}

/// Checks the process that holds the lock of an interface. Any user may hold a free one, and call
/// the program motord.
fn locked(tree: &Tree, holder: Holder) -> Finding {
    let service = tree.permissions("run/motord").map(|directory| directory.user);
    let is_trusted =
        holder.uid.is_some_and(|uid| [Some(0), Some(geteuid().as_raw()), service].contains(&Some(uid)));
    let program = holder.pid.and_then(|pid| process::program(tree, pid));
    let program = program.as_deref().unwrap_or("unknown program");
    let process = holder.pid.map_or_else(|| "another process".to_owned(), |pid| format!("process {pid}"));
    let user = holder.uid.map(|uid| format!(" of user {uid}")).unwrap_or_default();
    let measured = format!("{program}, {process}{user}");
    match program {
        "motord" if is_trusted => Finding::good(CHECK, measured),
        _ => Finding::warn(CHECK, measured, "motord does not start while it runs"),
    }
}

/// Returns the kinds of the filters on an interface.
fn kinds_of_receivers(tree: &Tree, name: &str) -> Vec<&'static str> {
    let lists = LISTS.iter().filter_map(|list| tree.text(&format!("proc/net/can/rcvlist_{list}")));
    let kind = |line: &str| {
        let mut words = line.split_whitespace();
        let is_on_it = words.next() == Some(name);
        let last = words.last().filter(|_| is_on_it)?;
        KINDS.into_iter().find(|kind| *kind == last)
    };
    lists.flat_map(|text| text.lines().filter_map(kind).collect::<Vec<_>>()).collect()
}
