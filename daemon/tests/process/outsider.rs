//! Many kills beside a hostile user, who has 1000 names of daemons and takes the locks of the buses
//! as soon as they are free. Needs root.
//!
//! The switch and `safe-stop` are the programs; the motors are the other end of a terminal. The
//! daemon only registers, and is killed. `MOTORD_OUTSIDER_RUNS` is the number of kills.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::deadman::{beating, safe_frames};
use crate::player::{Player, become_user};
use crate::safe_stop::{motord, text};
use motord_bus::BusLock;
use motord_deadman::channel::{Answer, Channel, Request, TIMEOUT as SWITCH_TIMEOUT};
use motord_deadman::safe_frames::InterfaceFrames;
use motord_ports::instance::Instance;
use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::pty::{OpenptyResult, openpty};
use nix::sys::signal::{Signal, kill};
use nix::sys::socket::{AddressFamily, Backlog, SockFlag, SockType, UnixAddr, bind, listen, socket};
use nix::unistd::Pid;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::Child;
use std::sync::mpsc::{Receiver, channel};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const RUNS: &str = "MOTORD_OUTSIDER_RUNS";
/// Runs without that variable: one for each delay of the switch.
const RUNS_DEFAULT: usize = 6;
/// Variables of the processes that play: the terminal, and the runtime directory.
const DEVICE: &str = "MOTORD_TEST_OUTSIDER_DEVICE";
const RUNTIME: &str = "MOTORD_TEST_OUTSIDER_RUNTIME";
/// Names of daemons that the outsider takes.
const NAMES: usize = 1000;
const OUTSIDER: u32 = 65_534;
/// Times for which the switch is frozen at the kill, ms.
const FREEZES: [u64; 6] = [0, 5, 10, 20, 35, 50];
/// Frames to one motor: ten rounds that damp, three that stop, of 12 bytes each.
const DAMP: f64 = 0.1;
const STOP_BYTES: usize = 13 * 12;
/// Longer than a busy machine stalls.
const TIMEOUT: Duration = Duration::from_secs(10);
/// A line without frames for this long has no further frames of a stop.
const QUIET: Duration = Duration::from_millis(50);
const STOP: &str = "001#9200800000000800";

/// A terminal, by its device and by the bytes that arrive at the motors.
struct Line {
    device: String,
    arrivals: Receiver<(Instant, usize)>,
}

fn line() -> Line {
    let OpenptyResult { master, slave } = openpty(None, None).unwrap();
    for end in [&master, &slave] {
        fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).unwrap();
    }
    let device = nix::unistd::ttyname(&slave).unwrap().to_str().unwrap().to_owned();
    let (arrives, arrivals) = channel();
    spawn(move || {
        let (mut motors, _host, mut bytes) = (File::from(master), slave, [0; 4096]);
        while let Ok(length) = motors.read(&mut bytes) {
            if arrives.send((Instant::now(), length)).is_err() {
                return;
            }
        }
    });
    Line { device, arrivals }
}

impl Line {
    /// Returns when the first of all frames of a stop arrived; `None` if they do not arrive.
    fn stopped(&self) -> Option<Instant> {
        let (first, mut bytes) = self.arrivals.recv_timeout(TIMEOUT).ok()?;
        while bytes < STOP_BYTES {
            bytes += self.arrivals.recv_timeout(TIMEOUT).ok()?.1;
        }
        while self.arrivals.recv_timeout(QUIET).is_ok() {}
        Some(first)
    }
}

fn configuration(directory: &Path, instance: &str, device: &str) -> PathBuf {
    let path = directory.join(format!("{instance}.toml"));
    let text = format!(
        "[daemon]\ninstance = '{instance}'\n[safety]\ndamp-seconds = {DAMP}\n\
         [[bus]]\nname = 'front'\ntype = 'serial'\ndevice = '{device}'\nevery = 5\n\
         [[motor]]\nname = 'jaw'\nbus = 'front'\nid = 1\nprotocol = 'gim'\nmodel = 'GIM3505-8'\n"
    );
    fs::write(&path, text).unwrap();
    path
}

/// The switch, as a process.
pub(crate) struct Switch(Child);

impl Switch {
    pub(crate) fn start(runtime: &Path, config: &Path) -> Self {
        let mut switch = motord(runtime, &["deadman"], config).spawn().unwrap();
        let mut log = BufReader::new(switch.stderr.take().unwrap()).lines().map_while(Result::ok);
        assert!(log.any(|line| line.contains("ready")));
        spawn(move || log.for_each(drop));
        Self(switch)
    }

    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.0.id().cast_signed()), signal).unwrap();
    }
}

impl Drop for Switch {
    fn drop(&mut self) {
        let _dead_already = self.0.kill();
        let _reaped = self.0.wait();
    }
}

fn play(role: &str, runtime: &Path, device: &str, ready: &str) -> Player {
    let variables = [(RUNTIME, runtime.as_os_str()), (DEVICE, device.as_ref())];
    Player::start(&format!("outsider::{role}"), &variables, ready)
}

/// Runs in a process of its own: a daemon that drives the terminal. Not a test of its own.
#[test]
fn plays_the_driver() {
    let (Ok(device), Ok(runtime)) = (std::env::var(DEVICE), std::env::var(RUNTIME)) else { return };
    let instance = Instance::below(Path::new(&runtime), "test").unwrap();
    let _lock = BusLock::device(&device).unwrap();
    let (heartbeat, pulse) = beating();
    let mut frames = safe_frames();
    frames.damp = motord_bus::Duration::from_millis((DAMP * 1000.0) as u64);
    frames.buses = vec![InterfaceFrames {
        interface: device,
        baud: Some(921_600),
        damp: [vec![STOP.into()], vec![STOP.into()]],
        stop: vec![STOP.into()],
    }];
    let switch = Channel::connect(&instance, SWITCH_TIMEOUT).unwrap();
    switch.send(&Request::Register(frames), Some(&pulse)).unwrap();
    assert_eq!(switch.receive::<Answer>().unwrap().0, Answer::Registered);
    println!("registered");
    for cycle in 2..u64::MAX {
        heartbeat.beat(cycle);
        sleep(Duration::from_millis(1));
    }
}

/// Runs in a process of its own: an outsider that has the names of 1000 daemons, and takes the
/// locks of the terminal as soon as they are free. Not a test of its own.
#[test]
fn plays_the_outsider() {
    let (Ok(device), Ok(_)) = (std::env::var(DEVICE), std::env::var(RUNTIME)) else { return };
    become_user(OUTSIDER);
    let named = |number| {
        let name = UnixAddr::new_abstract(format!("motord-stop:x{number}:/run/motord").as_bytes()).unwrap();
        let socket = socket(AddressFamily::Unix, SockType::SeqPacket, SockFlag::SOCK_CLOEXEC, None).unwrap();
        bind(socket.as_raw_fd(), &name).and_then(|()| listen(&socket, Backlog::new(0)?)).map(|()| socket)
    };
    let _names: Vec<_> = (0..NAMES).map(named).collect();
    println!("begun");
    loop {
        if let Ok(_lock) = BusLock::device(&device) {
            let _closed = writeln!(std::io::stdout(), "holds");
            sleep(3 * TIMEOUT);
        }
        sleep(Duration::from_micros(50));
    }
}

/// Kills a daemon while the switch is frozen for `freeze`. Returns the time from its continuation
/// to the first frame at the motors.
fn kill_one(
    switch: &Switch,
    line: &Line,
    runtime: &Path,
    freeze: Duration,
    hostile: bool,
) -> Option<Duration> {
    let daemon = play("plays_the_driver", runtime, &line.device, "registered");
    let _outsider = hostile.then(|| play("plays_the_outsider", runtime, &line.device, "begun"));
    if !freeze.is_zero() {
        switch.signal(Signal::SIGSTOP);
    }
    drop(daemon);
    let killed = Instant::now();
    sleep(freeze);
    if !freeze.is_zero() {
        switch.signal(Signal::SIGCONT);
    }
    let first = line.stopped()?;
    Some(first.saturating_duration_since(killed + freeze))
}

/// Returns median and maximum of the times, in ms.
fn summary(mut times: Vec<Duration>) -> String {
    times.sort();
    let ms = |time: Option<&Duration>| time.map_or(0.0, |time| time.as_secs_f64() * 1e3);
    format!("median {:.2} ms, maximum {:.2} ms", ms(times.get(times.len() / 2)), ms(times.last()))
}

fn runs() -> usize {
    std::env::var(RUNS).ok().and_then(|runs| runs.parse().ok()).unwrap_or(RUNS_DEFAULT)
}

/// Goal: whatever an outsider holds, the switch damps and stops the motors after each kill, on time
/// and frozen.
#[test]
fn every_kill_is_damped_beside_outsider() {
    if !nix::unistd::geteuid().is_root() {
        return println!("NOT TESTED: only root can become another user");
    }
    let (directory, line) = (TempDir::new().unwrap(), line());
    let switch = Switch::start(directory.path(), &configuration(directory.path(), "test", &line.device));
    let of = |hostile: bool| -> Vec<Duration> {
        let kill = |run: usize| {
            let freeze = Duration::from_millis(FREEZES[run % FREEZES.len()]);
            let damped = kill_one(&switch, &line, directory.path(), freeze, hostile);
            damped.unwrap_or_else(|| panic!("kill {run}, frozen for {freeze:?}: the motors were not damped"))
        };
        (0..runs()).map(kill).collect()
    };
    let alone = summary(of(false));
    let beside = summary(of(true));
    println!(
        "{} kills beside an outsider, each damped: first frame {beside}; as many without: {alone}",
        runs()
    );
}

/// Goal: the same for `motord safe-stop` where no switch runs. It exits with 80, for these motors
/// do not answer.
#[test]
fn every_safe_stop_is_sent_beside_outsider() {
    if !nix::unistd::geteuid().is_root() {
        return println!("NOT TESTED: only root can become another user");
    }
    let (directory, line) = (TempDir::new().unwrap(), line());
    let config = configuration(directory.path(), "alone", &line.device);
    let stop = |run: usize| {
        let begun = Instant::now();
        let output = motord(directory.path(), &["safe-stop"], &config).output().unwrap();
        assert_eq!(output.status.code(), Some(80), "safe-stop {run}: {}", text(&output));
        line.stopped().unwrap().saturating_duration_since(begun)
    };
    let count = runs().div_ceil(FREEZES.len());
    let alone = summary((0..count).map(stop).collect());
    let _outsider = play("plays_the_outsider", directory.path(), &line.device, "holds");
    let beside = summary((0..count).map(stop).collect());
    println!(
        "{count} safe stops beside an outsider, each sent: first frame {beside}; as many without: {alone}"
    );
}
