//! Each check on fixture trees of `/proc` and `/sys`: good, and each way in which it is not.

use super::*;
use crate::finding::Level;
use crate::process::RunningDaemon;
use crate::robot::ImuLine;
use motord_bus::BusLock;
use motord_bus::socketcan::OpenError;
use motord_realtime::SchedulingRequest;
use nix::errno::Errno;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use tempfile::TempDir;

/// A tree of files that a test writes.
pub(super) struct Fixture(TempDir);

impl Fixture {
    pub(super) fn new(files: &[(&str, &str)]) -> Self {
        let fixture = Self(TempDir::new().unwrap());
        files.iter().for_each(|(path, text)| fixture.write(path, text));
        fixture
    }

    fn write(&self, path: &str, text: &str) {
        let path = self.0.path().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, format!("{text}\n")).unwrap();
    }

    fn link(&self, path: &str, target: &str) {
        let path = self.0.path().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        symlink(target, path).unwrap();
    }

    pub(super) fn tree(&self) -> Tree {
        Tree::below(self.0.path())
    }
}

pub(super) fn robot(cpu: Option<usize>) -> Robot {
    let request = SchedulingRequest { cpu, priority: Some(80) };
    Robot { request, daemon: Some(812), ..Robot::default() }
}

pub(super) fn can0() -> Interface {
    Interface { name: "can0".to_owned(), bitrate: Some(1_000_000), motors: 3, requests: 0 }
}

/// `stat` of a thread with a policy and a priority, whose name has brackets.
pub(super) fn stat(policy: u8, priority: u8) -> String {
    stat_of(1, policy, priority)
}

/// The same with the process that made it. Process 2 makes the threads of the kernel, and nothing
/// else.
fn stat_of(parent: u32, policy: u8, priority: u8) -> String {
    let zeros = "0 ".repeat(35);
    format!("812 (a) b) S {parent} {zeros}{priority} {policy} 0 0")
}

#[track_caller]
pub(super) fn assert_finding(finding: &Finding, level: Level, measured: &str, command: Option<&str>) {
    assert_eq!((finding.level, finding.measured.as_str()), (level, measured), "{finding:?}");
    match (command, &finding.command) {
        (None, None) => {}
        (Some(part), Some(whole)) => assert!(whole.contains(part), "{finding:?}"),
        _ => panic!("{finding:?}"),
    }
    assert_eq!(level == Level::Good, finding.why.is_none(), "{finding:?}");
}

#[test]
fn preempt_rt_is_known_by_file_or_version() {
    let release = ("proc/sys/kernel/osrelease", "6.1.0-28-rt-amd64");
    let version = |text| ("proc/sys/kernel/version", text);
    let rt = Fixture::new(&[release, version("#1 SMP PREEMPT_RT Debian 6.1.119-1")]);
    assert_finding(&system::kernel(&rt.tree()), Level::Good, "6.1.0-28-rt-amd64, PREEMPT_RT", None);
    let rt = Fixture::new(&[release, version("#1 SMP"), ("sys/kernel/realtime", "1")]);
    assert_eq!(system::kernel(&rt.tree()).level, Level::Good);
}

#[test]
fn other_kernel_is_warning_with_distribution_package() {
    let kernel = |id, arch| {
        let fixture = Fixture::new(&[
            ("proc/sys/kernel/osrelease", "6.1.0"),
            ("proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC Debian"),
            ("proc/sys/kernel/arch", arch),
            ("etc/os-release", id),
        ]);
        system::kernel(&fixture.tree())
    };
    let measured = "6.1.0, PREEMPT_DYNAMIC";
    for (id, arch, command) in [
        ("NAME=x\nID=debian", "x86_64", Some("linux-image-rt-amd64")),
        ("ID=debian", "aarch64", Some("linux-image-rt-arm64")),
        ("ID=ubuntu", "x86_64", Some("sudo pro enable realtime-kernel")),
        ("ID=\"arch\"", "x86_64", None),
    ] {
        assert_finding(&kernel(id, arch), Level::Warn, measured, command);
    }
}

#[test]
fn realtime_threads_must_get_most_time() {
    let runtime = |runtime, spins_at| {
        let fixture = Fixture::new(&[
            ("proc/sys/kernel/sched_rt_runtime_us", runtime),
            ("proc/sys/kernel/sched_rt_period_us", "1000000"),
        ]);
        system::runtime(&fixture.tree(), &Robot { spins_at, ..robot(None) })
    };
    let default = "950000 of 1000000 µs";
    assert_finding(&runtime("950000", None), Level::Good, default, None);
    assert_finding(&runtime("-1", Some(70)), Level::Good, "no bound", None);
    assert_finding(&runtime("950000", Some(70)), Level::Warn, default, Some("us=-1"));
    assert_finding(&runtime("100000", None), Level::Warn, "100000 of 1000000 µs", Some("us=950000"));
    assert_finding(&runtime("0", None), Level::Bad, "0 of 1000000 µs", Some("us=950000"));
    assert_eq!(system::runtime(&Fixture::new(&[]).tree(), &robot(None)).level, Level::Good);
}

#[test]
fn slow_clock_is_replaced_by_a_fast_one() {
    let directory = "sys/devices/system/clocksource/clocksource0";
    let clock = |current, available| {
        let path = |name| format!("{directory}/{name}");
        let fixture = Fixture::new(&[
            (&path("current_clocksource"), current),
            (&path("available_clocksource"), available),
        ]);
        system::clock_source(&fixture.tree())
    };
    assert_finding(&clock("tsc", "tsc hpet"), Level::Good, "tsc", None);
    assert_finding(&clock("hpet", "tsc hpet"), Level::Warn, "hpet (available: tsc hpet)", Some("echo tsc |"));
    assert_finding(&clock("acpi_pm", "acpi_pm"), Level::Warn, "acpi_pm (available: acpi_pm)", None);
}

#[test]
fn running_daemon_must_have_its_priority() {
    let with = |policy, priority, slack| {
        let fixture = Fixture::new(&[
            ("proc/700/comm", "motord"),
            ("proc/700/task/700/comm", "motord"),
            ("proc/812/comm", "motord"),
            ("proc/812/task/813/comm", "motord-cycle"),
            ("proc/812/task/813/stat", &stat(policy, priority)),
            ("proc/813/timerslack_ns", slack),
        ]);
        let daemon = process::daemon(&fixture.tree(), None);
        assert_eq!(daemon, Some(process::RunningDaemon { pid: 812, cycle: 813 }));
        (system::daemon(&fixture.tree(), &robot(None), daemon), system::timer_slack(&fixture.tree(), daemon))
    };
    let (running, slack) = with(1, 80, "0");
    assert_finding(&running, Level::Good, "process 812: its cycle has the real-time priority 80", None);
    assert_finding(&slack, Level::Good, "0 ns for the cycle of process 812", None);
    let (running, slack) = with(0, 0, "50000");
    assert_finding(&running, Level::Bad, "process 812: its cycle has a normal priority", None);
    assert_finding(&slack, Level::Warn, "50000 ns for the cycle of process 812", None);
    let none = Fixture::new(&[("proc/self/timerslack_ns", "50000")]);
    assert_finding(&system::daemon(&none.tree(), &robot(None), None), Level::Good, "none runs", None);
    let slack = system::timer_slack(&none.tree(), None);
    assert_finding(&slack, Level::Good, "50000 ns here; motord sets 1 ns for its cycle", None);
}

#[test]
fn rights_are_read_from_daemon_unit_or_shell() {
    let limits = |priority: &str, memory: &str| {
        format!(
            "Limit                     Soft Limit           Hard Limit           Units\n\
             Max locked memory         {memory}              {memory}              bytes\n\
             Max realtime priority     {priority}                    {priority}"
        )
    };
    let shell = Fixture::new(&[
        ("proc/self/limits", &limits("0", "8388608")),
        ("proc/self/status", "Uid:\t1000\t1000\t1000\t1000\nCapEff:\t0000000000000000"),
    ]);
    let (tree, wanting) = (shell.tree(), robot(None));
    let measured = "0 for this shell; the cycle asks for 80";
    assert_finding(&limits::priority(&tree, &wanting, None), Level::Bad, measured, Some("rtprio 90\" |"));
    assert_finding(
        &limits::memory(&tree, None),
        Level::Bad,
        "8 MiB for this shell",
        Some("memlock unlimited"),
    );

    shell.write("lib/systemd/system/motord.service", "[Service]\nLimitRTPRIO=90\nLimitMEMLOCK=infinity");
    let measured = "90 for motord.service; the cycle asks for 80";
    assert_finding(&limits::priority(&tree, &wanting, None), Level::Good, measured, None);
    assert_finding(&limits::memory(&tree, None), Level::Good, "no limit for motord.service", None);

    let daemon = Some(process::RunningDaemon { pid: 812, cycle: 813 });
    shell.write("proc/812/limits", &limits("70", "unlimited"));
    let measured = "70 for motord, process 812; the cycle asks for 80";
    let finding = limits::priority(&tree, &wanting, daemon);
    assert_finding(&finding, Level::Bad, measured, Some("motord.service.d/LimitRTPRIO.conf"));
    assert_eq!(limits::memory(&tree, daemon).level, Level::Good);
}

#[test]
fn root_may_have_any_priority_and_memory() {
    let root = Fixture::new(&[("proc/self/status", "Uid:\t0\t0\t0\t0\nCapEff:\t000001ffffffffff")]);
    assert_eq!(limits::priority(&root.tree(), &robot(None), None).level, Level::Good);
    assert_eq!(limits::memory(&root.tree(), None).level, Level::Good);
}

const ROOT: &str = "Uid:\t0\t0\t0\t0\nCapEff:\t000001ffffffffff\nSeccomp:\t2";

#[test]
fn control_group_without_time_is_reported_to_root() {
    let root = Fixture::new(&[
        ("proc/self/status", ROOT),
        ("proc/self/cgroup", "0::/user.slice/session-1.scope"),
        ("proc/sys/kernel/sched_rt_runtime_us", "950000"),
        ("proc/sys/kernel/osrelease", "6.1.0"),
        ("boot/config-6.1.0", "CONFIG_RT_GROUP_SCHED=y"),
    ]);
    let (measured, command) = ("any: this shell has CAP_SYS_NICE", "sysctl kernel.sched_rt_runtime_us=-1");
    let check = || limits::priority(&root.tree(), &robot(None), None);
    assert_finding(&check(), Level::Bad, measured, Some(command));
    root.write("proc/self/cgroup", "4:cpu,cpuacct:/user.slice");
    let share = "sys/fs/cgroup/cpu,cpuacct/user.slice/cpu.rt_runtime_us";
    root.write(share, "0");
    assert_finding(&check(), Level::Bad, measured, Some(&format!("sudo tee /{share}")));
    root.write(share, "400000");
    assert_finding(&check(), Level::Good, measured, None);
}

#[test]
fn filter_of_running_daemon_is_named() {
    let daemon = Some(process::RunningDaemon { pid: 812, cycle: 813 });
    let stat_path = "proc/812/task/813/stat";
    let fixture = Fixture::new(&[("proc/812/status", ROOT), (stat_path, &stat(0, 0))]);
    let check = || limits::priority(&fixture.tree(), &robot(None), daemon);
    let measured = "any: motord, process 812 has CAP_SYS_NICE";
    assert_finding(&check(), Level::Bad, measured, Some("RestrictRealtime=no"));
    fixture.write(stat_path, &stat(1, 80));
    assert_finding(&check(), Level::Good, measured, None);
}

#[test]
fn unpinned_cycle_names_isolating_parameters() {
    let isolation = |isolated, online, cpu| {
        let fixture = Fixture::new(&[
            ("sys/devices/system/cpu/isolated", isolated),
            ("sys/devices/system/cpu/online", online),
            ("etc/default/grub", "GRUB_CMDLINE_LINUX=\"quiet\""),
        ]);
        processor::isolation(&fixture.tree(), &robot(cpu))
    };
    assert_finding(&isolation("2-3", "0-3", Some(3)), Level::Good, "2-3; the cycle is pinned to 3", None);
    assert_finding(&isolation("2-3", "0-3", None), Level::Warn, "2-3", None);
    let parameters =
        "isolcpus=managed_irq,domain,2 nohz_full=2 rcu_nocbs=2 irqaffinity=0-1,3 /' /etc/default/grub";
    let measured = "none; the cycle is pinned to 2";
    assert_finding(&isolation("", "0-3", Some(2)), Level::Warn, measured, Some(parameters));
    assert_finding(&isolation("", "0-3", None), Level::Warn, "none", Some("isolcpus=managed_irq,domain,3"));
    assert_finding(&isolation("", "0", None), Level::Warn, "none", None);
}

#[test]
fn governor_matters_on_cycle_processors_only() {
    let cpu = |number: usize| format!("sys/devices/system/cpu/cpu{number}/cpufreq/scaling_governor");
    let fixture = Fixture::new(&[
        (&cpu(0), "powersave"),
        (&cpu(1), "powersave"),
        (&cpu(2), "performance"),
        ("sys/devices/system/cpu/online", "0-2"),
    ]);
    let tree = fixture.tree();
    assert_finding(&processor::governor(&tree, &robot(Some(2))), Level::Good, "performance", None);
    let all = processor::governor(&tree, &robot(None));
    assert_finding(
        &all,
        Level::Warn,
        "powersave on processors 0-1",
        Some("echo performance | sudo tee /sys/"),
    );
    let none = Fixture::new(&[("sys/devices/system/cpu/online", "0")]);
    assert_eq!(processor::governor(&none.tree(), &robot(None)).level, Level::Good);
}

#[test]
fn deep_sleep_must_be_shallow_off_or_forbidden() {
    let state =
        |number: usize, file: &str| format!("sys/devices/system/cpu/cpu1/cpuidle/state{number}/{file}");
    let fixture = Fixture::new(&[
        (&state(0, "name"), "POLL"),
        (&state(0, "latency"), "0"),
        (&state(0, "disable"), "0"),
        (&state(1, "name"), "C6"),
        (&state(1, "latency"), "133"),
        (&state(1, "disable"), "0"),
        ("proc/self/status", "Uid:\t1\t77777\t1\t1\nGid:\t77777\t77777\t1\t1\nGroups:\t77778"),
        ("dev/cpu_dma_latency", ""),
    ]);
    let (tree, robot) = (fixture.tree(), robot(Some(1)));
    let set_mode = |mode| {
        let path = fixture.0.path().join("dev/cpu_dma_latency");
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    };
    set_mode(0o600);
    let deepest = "deepest C6, 133 µs to wake up";
    let finding = processor::idle(&tree, &robot, None);
    assert_finding(&finding, Level::Warn, deepest, Some("udevadm trigger /dev/cpu_dma_latency"));
    fixture.write("proc/self/status", "Uid:\t0\t0\t0\t0");
    let allowed = format!("{deepest}; motord may forbid it by /dev/cpu_dma_latency");
    assert_finding(&processor::idle(&tree, &robot, None), Level::Good, &allowed, None);
    fixture.write("proc/self/status", "Uid:\t1\t77777\t1\t1");
    fixture.write(&state(1, "disable"), "1");
    let shallow = "deepest POLL, 0 µs to wake up";
    assert_finding(&processor::idle(&tree, &robot, None), Level::Good, shallow, None);
}

#[test]
fn unusable_interface_is_bad_and_names_commands() {
    let good = Link {
        interface: "can0".parse().unwrap(),
        index: 3,
        up: true,
        bitrate: Some(1_000_000),
        restart_ms: Some(100),
        state: None,
        is_virtual: false,
        listen_only: false,
        loopback: false,
    };
    let link = |link| interface::link(&can0(), Ok(link), true);
    assert_finding(&link(good), Level::Good, "up, 1000000 bit/s, restarts 100 ms after a bus-off", None);
    assert_finding(
        &link(Link { restart_ms: Some(0), ..good }),
        Level::Warn,
        "up, 1000000 bit/s, no restart",
        Some("type can restart-ms 100; sudo ip link set can0 up"),
    );
    let down = link(Link { up: false, ..good });
    assert_finding(&down, Level::Bad, "can0 is down", Some("sudo sh -c 'ip link set can0 down; "));
    let slow = link(Link { bitrate: Some(500_000), ..good });
    let measured = "can0 is set to 500000 bit/s, 1000000 are configured";
    assert_finding(&slow, Level::Bad, measured, Some("bitrate 1000000"));
    let missing = interface::link(&can0(), Err(OpenError::Missing("can0".parse().unwrap())), true);
    assert_eq!((missing.level, missing.command), (Level::Bad, None));
    let any = Interface { bitrate: None, ..can0() };
    let new = interface::link(&any, Ok(Link { up: false, bitrate: None, ..good }), true);
    assert_finding(&new, Level::Bad, "can0 is down", Some("bitrate 1000000"));
    let unknown = interface::link(&any, Ok(Link { bitrate: None, restart_ms: Some(0), ..good }), true);
    assert_finding(&unknown, Level::Warn, "up, unknown bit rate, no restart", Some("restart-ms 100"));
    let vcan = Link { is_virtual: true, bitrate: None, restart_ms: None, ..good };
    assert_finding(&link(vcan), Level::Good, "up, virtual", None);
}

#[test]
fn queue_holds_one_cycle_not_old_commands() {
    let queue = |length| {
        let fixture = Fixture::new(&[("sys/class/net/can0/tx_queue_len", length)]);
        interface::queue(&fixture.tree(), &can0())
    };
    assert_finding(&queue("16"), Level::Good, "16 frames", None);
    assert_finding(&queue("1000"), Level::Warn, "1000 frames", Some("txqueuelen 16"));
    assert_finding(&queue("3"), Level::Bad, "3 frames", Some("txqueuelen 16"));
}

/// Two IMUs of Damiao: six requests beside the commands of three motors and a poll.
#[test]
fn queue_holds_requests_to_imus() {
    let queue = |length| {
        let fixture = Fixture::new(&[("sys/class/net/can0/tx_queue_len", length)]);
        interface::queue(&fixture.tree(), &Interface { requests: 6, ..can0() })
    };
    assert_finding(&queue("20"), Level::Good, "20 frames", None);
    assert_finding(&queue("9"), Level::Bad, "9 frames", Some("txqueuelen 20"));
}

#[test]
fn frame_coalescing_is_bad_and_time_coalescing_warns() {
    let check = |settings| interface::coalescing("can0", Ok(Some(settings)));
    let none = Coalescing { rx_usecs_irq: Some(0), rx_frames_irq: Some(1), ..Coalescing::default() };
    assert_finding(&check(none), Level::Good, "rx-usecs-irq 0 rx-frames-irq 1", None);
    let endless = Coalescing { rx_frames_irq: Some(8), ..none };
    let command = "ethtool -C can0 rx-usecs-irq 0 rx-frames-irq 1;";
    assert_finding(&check(endless), Level::Bad, "rx-usecs-irq 0 rx-frames-irq 8", Some(command));
    let timed = Coalescing { rx_usecs: Some(100), ..Coalescing::default() };
    assert_finding(&check(timed), Level::Warn, "rx-usecs 100", Some("rx-usecs 0"));
    assert_eq!(interface::coalescing("can0", Ok(None)).level, Level::Good);
    assert_eq!(interface::coalescing("can0", Err(Errno::ENOENT)).level, Level::Warn);
}

/// A controller on SPI, whose interrupt 54 has a thread.
fn on_spi(affinity: &str, priority: u8) -> Fixture {
    let fixture = Fixture::new(&[
        ("sys/devices/system/cpu/online", "0-3"),
        ("sys/devices/platform/spi0.0/uevent", ""),
        (
            "proc/interrupts",
            "      CPU0 CPU1\n 53:  7 0 GIC uart\n 54:  9 0 GIC-2 Level spi0.0\nIPI0: 5 spi0.0",
        ),
        ("proc/irq/54/smp_affinity_list", "0-3"),
        ("proc/irq/54/effective_affinity_list", affinity),
        ("proc/90/comm", "irq/54-spi0.0"),
        ("proc/90/stat", &stat_of(2, 1, priority)),
        ("proc/13/comm", "ksoftirqd/0"),
        ("proc/13/stat", &stat_of(2, 0, 0)),
    ]);
    fixture.link("sys/class/net/can0/device", "../../../devices/platform/spi0.0");
    fixture
}

#[test]
fn interrupt_runs_beside_and_above_the_cycle() {
    let interrupts = |fixture: &Fixture| interface::interrupts(&fixture.tree(), &robot(Some(3)), "can0");
    let good = interrupts(&on_spi("0", 90));
    assert_finding(&good, Level::Good, "54 on processors 0, thread 90 at real-time priority 90", None);
    let low = interrupts(&on_spi("0", 50));
    let measured = "54 on processors 0, thread 90 at real-time priority 50";
    assert_finding(&low, Level::Warn, measured, Some("sudo chrt -f -p 90 90"));
    let shared = interrupts(&on_spi("3", 90));
    let measured = "54 on processors 3, thread 90 at real-time priority 90";
    let command = Some("echo 0-2 | sudo tee /proc/irq/54/smp_affinity_list");
    assert_finding(&shared, Level::Warn, measured, command);
}

#[test]
fn program_named_like_kernel_thread_gets_no_priority() {
    let fixture = on_spi("0", 90);
    let robot = Robot { interfaces: vec![can0()], ..robot(Some(3)) };
    for pid in ["13", "90"] {
        fixture.write(&format!("proc/{pid}/stat"), &stat_of(1, 0, 0));
    }
    let interrupts = interface::interrupts(&fixture.tree(), &robot, "can0");
    assert_finding(&interrupts, Level::Good, "54 on processors 0", None);
    assert_eq!(interface::ksoftirqd(&fixture.tree(), &robot).changes, []);
}

#[test]
fn received_frames_wait_behind_no_controller() {
    let robot = Robot { interfaces: vec![can0()], ..robot(Some(3)) };
    let check = |fixture: &Fixture| interface::ksoftirqd(&fixture.tree(), &robot);
    let low = "at a normal priority on processors ";
    let raise = Some("sudo chrt -f -p 79 13");
    assert_finding(&check(&on_spi("0", 90)), Level::Warn, &format!("{low}0"), raise);
    // To where the interrupt is moved from the cycle's processor.
    assert_finding(&check(&on_spi("3", 90)), Level::Warn, &format!("{low}0-2"), raise);
    let none_waits = "no received frame waits for one at a normal priority";
    assert_finding(&check(&on_spi("1", 90)), Level::Good, none_waits, None);
    let raised = on_spi("0", 90);
    raised.write("proc/13/stat", &stat_of(2, 1, 79));
    assert_finding(&check(&raised), Level::Good, none_waits, None);
    let realtime = on_spi("0", 90);
    realtime.write("sys/kernel/realtime", "1");
    assert_finding(&check(&realtime), Level::Good, "received frames do not wait for it: PREEMPT_RT", None);
}

#[test]
fn usb_adapter_has_interrupts_of_its_controller() {
    let fixture = Fixture::new(&[
        ("sys/devices/pci0000:00/0000:00:14.0/irq", "0"),
        ("sys/devices/pci0000:00/0000:00:14.0/msi_irqs/124", "msi"),
        ("sys/devices/pci0000:00/0000:00:14.0/usb1/1-1/1-1:1.0/uevent", ""),
        ("proc/interrupts", "124:  7 0 PCI-MSI xhci_hcd"),
        ("proc/irq/124/smp_affinity_list", "0-1"),
    ]);
    fixture.link("sys/class/net/can0/device", "../../../devices/pci0000:00/0000:00:14.0/usb1/1-1/1-1:1.0");
    let found = interface::interrupts(&fixture.tree(), &robot(None), "can0");
    assert_finding(&found, Level::Good, "124 on processors 0-1", None);
    let virtual_one = interface::interrupts(&fixture.tree(), &robot(None), "vcan0");
    assert_eq!(virtual_one.level, Level::Good);
    fixture.write("sys/devices/platform/plain/uevent", "");
    fixture.link("sys/class/net/can1/device", "../../../devices/platform/plain");
    let unknown = interface::interrupts(&fixture.tree(), &robot(None), "can1");
    assert_finding(&unknown, Level::Warn, "not found in /proc/interrupts", Some("cat /proc/interrupts"));
}

#[test]
fn interface_owner_is_known_by_lock_and_filters() {
    // A lock holds on all of this computer: no interface and no other test has the names. One stays
    // free: the child of another test may hold a lock for a moment after it was released.
    let pid = std::process::id();
    let [driven, free] = ["d", "f"].map(|letter| format!("{letter}{pid}"));
    let fixture = Fixture::new(&[(&format!("proc/{pid}/comm"), "motord")]);
    let tree = fixture.tree();
    let owner = |name: &str| interface::owners(&tree, name);
    let _lock = BusLock::interface(driven.parse().unwrap()).unwrap();
    let user = nix::unistd::geteuid();
    assert_finding(&owner(&driven), Level::Good, &format!("motord, process {pid} of user {user}"), None);
    fixture.write(&format!("proc/{pid}/comm"), "motorctl");
    assert_finding(&owner(&driven), Level::Warn, &format!("motorctl, process {pid} of user {user}"), None);
    assert_finding(&owner(&free), Level::Good, "nobody", None);
    let list = "receive list 'rx_all':\n  (can1: no entry)\n  device   can_id   can_mask  function  userdata   matches  ident\n\
         \x20  NAME     000    00000000  f88e6370  f6c6f400         0  raw\n   NAME1    000    00000000  0  0  0  raw";
    fixture.write("proc/net/can/rcvlist_all", &list.replace("NAME", &free));
    let measured = "1 filters of other programs (raw)";
    assert_finding(&owner(&free), Level::Warn, measured, Some("lsof"));
}

#[test]
fn serial_port_is_present_fast_and_unshared() {
    let timer = "sys/bus/usb-serial/devices/ttyUSB0/latency_timer";
    let root = ("proc/self/status", "Uid:\t0\t0\t0\t0");
    let fixture = Fixture::new(&[("dev/ttyUSB0", ""), (timer, "1"), root]);
    fixture.link("dev/serial/by-id/arm", "../../ttyUSB0");
    let check = || serial::device(&fixture.tree(), "/dev/serial/by-id/arm", None);
    assert_eq!(check().iter().map(|finding| finding.level).max(), Some(Level::Good));
    fixture.write(timer, "16");
    assert_finding(&check()[0], Level::Warn, "16 ms", Some("echo 1 | sudo tee /sys/bus/usb-serial"));
    fixture.link("proc/900/fd/3", "/dev/ttyUSB0");
    fixture.write("proc/900/comm", "ModemManager");
    assert_finding(&check()[1], Level::Bad, "ModemManager, process 900", Some("disable --now ModemManager"));
    fixture.write("proc/900/comm", "motord");
    assert_finding(&check()[1], Level::Good, "motord, process 900", None);
    fixture.link("proc/901/fd/4", "/dev/ttyUSB0");
    fixture.write("proc/901/comm", "minicom");
    fixture.link("proc/902/fd/4", "/dev/ttyUSB0");
    fixture.write("proc/902/comm", "ModemManager");
    let all = "motord, process 900; minicom, process 901; ModemManager, process 902";
    assert_finding(&check()[1], Level::Bad, all, Some("kill 901; sudo systemctl disable --now ModemManager"));
    let missing = serial::device(&fixture.tree(), "/dev/ttyUSB9", None);
    assert_finding(&missing[0], Level::Bad, "is not there", Some("ls -l"));
}

#[test]
fn port_of_another_group_is_not_permitted() {
    let status = "Uid:\t77\t77777\t1\t1\nGid:\t77777\t77777\t1\t1\nGroups:\t77778";
    let fixture =
        Fixture::new(&[("dev/ttyUSB0", ""), ("proc/self/status", status), ("proc/812/status", status)]);
    let set_mode = |mode| {
        let path = fixture.0.path().join("dev/ttyUSB0");
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    };
    let check = |daemon| serial::device(&fixture.tree(), "/dev/ttyUSB0", daemon).remove(2);
    set_mode(0o660);
    let cure = Some("sudo usermod -aG dialout");
    assert_finding(&check(None), Level::Warn, "this user may not open it", cure);
    let daemon = Some(RunningDaemon { pid: 812, cycle: 813 });
    assert_finding(&check(daemon), Level::Bad, "motord may not open it", cure);
    set_mode(0o666);
    assert_finding(&check(daemon), Level::Good, "may be read and written", None);
}

#[test]
fn full_line_of_an_imu_is_doubtful() {
    let line = |utilisation| ImuLine { device: "/dev/ttyUSB0".to_owned(), baud: 115_200, utilisation };
    assert_finding(&serial::imu(&line(0.712)), Level::Good, "71 % of 115200 baud", None);
    assert_finding(&serial::imu(&line(0.95)), Level::Warn, "95 % of 115200 baud", None);
}

#[test]
fn arbitrary_file_contents_never_panic_a_check() {
    for text in [
        "",
        "-1",
        "99999999999999999999",
        "\u{0}\u{fffd}",
        "a:b:c (",
        "Uid:\nCapEff: zz\nMax realtime priority",
    ] {
        let paths = [
            "proc/sys/kernel/sched_rt_runtime_us",
            "proc/sys/kernel/sched_rt_period_us",
            "proc/self/status",
            "proc/self/limits",
            "proc/812/comm",
            "proc/812/stat",
            "proc/interrupts",
            "proc/net/can/rcvlist_all",
            "sys/devices/system/cpu/online",
            "sys/devices/system/cpu/isolated",
            "sys/devices/system/cpu/cpu0/cpuidle/state0/latency",
            "etc/os-release",
            "dev/ttyS0",
            "sys/class/tty/ttyS0/dev",
            "proc/devices",
            "etc/systemd/system/motord.service",
        ];
        let fixture = Fixture::new(&paths.map(|path| (path, text)));
        let everything = Robot {
            interfaces: vec![can0()],
            devices: vec!["/dev/x".to_owned(), "/dev/ttyS0".to_owned()],
            units: vec!["motord.service".to_owned()],
            ..robot(None)
        };
        assert!(all(&fixture.tree(), &everything).len() > 10);
    }
}
