//! Simulated motors on a bus that motorctl opens: an RS485 line, which is a pseudo terminal here, or a virtual CAN interface.

#![allow(dead_code, reason = "each test program uses a part of it")]

use motord_bus::{Duration, Instant, clock, wait};
use motord_protocol::gim::CONFIGURATION;
use motord_simulator::{
    Bridge, BusKind, BusSettings, Dialect, FaultVerb, MotorSettings, SerialPort, SerialSlave, SimulatedBus,
};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::mpsc::{Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use tempfile::TempDir;

/// A bus with motors, served until it is dropped.
pub(crate) struct Line {
    directory: TempDir,
    device: String,
    verbs: Option<Sender<String>>,
    served: Option<JoinHandle<()>>,
}

/// A native motor that calibrates quickly.
pub(crate) fn motor(name: &str, id: u16) -> MotorSettings {
    let calibration_time = Duration::from_millis(1200);
    MotorSettings {
        name: name.into(),
        id,
        host_id: 0x40 + id,
        dialect: Dialect::Gim,
        calibration_time,
        ..Default::default()
    }
}

/// The motors' side of a bus.
trait Served: Send {
    fn serve(&mut self, now: Instant);
    fn inject(&mut self, now: Instant, verb: &FaultVerb);
    fn wait(&self, now: Instant);
}

/// A longer wait would hold up a fault.
const GLANCE: Duration = Duration::from_millis(2);

impl Served for SerialPort {
    fn serve(&mut self, now: Instant) {
        Self::serve(self, now);
    }
    fn inject(&mut self, now: Instant, verb: &FaultVerb) {
        Self::inject(self, now, verb).unwrap();
    }
    fn wait(&self, now: Instant) {
        let _ready = wait(&[self.readiness()], now, self.due().min(now + GLANCE));
    }
}

impl Served for Bridge {
    fn serve(&mut self, now: Instant) {
        Self::serve(self, now);
    }
    fn inject(&mut self, now: Instant, verb: &FaultVerb) {
        Self::inject(self, now, verb).unwrap();
    }
    fn wait(&self, now: Instant) {
        let _ready = wait(&[self.readiness()], now, self.due().min(now + GLANCE));
    }
}

impl Line {
    /// An RS485 line.
    pub(crate) fn new(motors: Vec<MotorSettings>) -> Self {
        let directory = TempDir::new().unwrap();
        let settings = BusSettings {
            name: "line".into(),
            kind: BusKind::Serial,
            bitrate: 921_600,
            ..Default::default()
        };
        let slave = SerialSlave::new(SimulatedBus::new(settings, motors, 7), 7);
        let tty = directory.path().join("tty");
        let port = SerialPort::open(slave, Some(tty.clone())).unwrap();
        Self::serve(directory, tty.display().to_string(), Box::new(port))
    }

    /// The virtual CAN interface of this name, with 1 Mbit/s on the simulated wire.
    pub(crate) fn on_can(interface: &str, motors: Vec<MotorSettings>) -> Self {
        let settings = BusSettings { name: "line".into(), ..Default::default() };
        let simulated = SimulatedBus::new(settings, motors, 7);
        let bridge = Bridge::open(simulated, interface.parse().unwrap(), 1_000_000).unwrap();
        Self::serve(TempDir::new().unwrap(), interface.to_owned(), Box::new(bridge))
    }

    fn serve(directory: TempDir, device: String, mut bus: Box<dyn Served>) -> Self {
        let (verbs, received) = channel::<String>();
        let served = std::thread::spawn(move || {
            loop {
                bus.serve(clock::monotonic());
                match received.try_recv() {
                    Ok(verb) => bus.inject(clock::monotonic(), &verb.parse().unwrap()),
                    Err(TryRecvError::Disconnected) => return,
                    Err(TryRecvError::Empty) => {}
                }
                bus.wait(clock::monotonic());
            }
        });
        Self { directory, device, verbs: Some(verbs), served: Some(served) }
    }

    /// One motor with id 3.
    pub(crate) fn knee() -> Self {
        Self::new(vec![motor("knee", 3)])
    }

    /// Applies a fault verb, and lets it take effect.
    pub(crate) fn inject(&self, verb: &str) {
        self.verbs.as_ref().unwrap().send(verb.to_owned()).unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }

    /// A file in the directory of the line.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// The device to open.
    pub(crate) fn device(&self) -> String {
        self.device.clone()
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        drop(self.verbs.take());
        let _ended = self.served.take().map(JoinHandle::join);
    }
}

/// Calls of motorctl from the directory of a line.
pub(crate) trait Calls {
    fn command(&self, line: &str) -> Command;
    fn motorctl(&self, line: &str) -> Output;
    fn good(&self, line: &str) -> String;
    fn json(&self, line: &str) -> Value;
    fn bad(&self, line: &str, status: i32) -> String;
}

impl Calls for Line {
    /// Runs motorctl without a terminal. `@` is the bus and the knee.
    fn command(&self, line: &str) -> Command {
        let line =
            line.replace('@', &format!("--bus {} --id 3", self.device())).replace("LINE", &self.device());
        let runtime = self.path("run");
        std::fs::create_dir_all(&runtime).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_motorctl"));
        command.args(line.split_whitespace()).current_dir(self.path(".")).stdin(Stdio::null());
        command.env("MOTORD_RUNTIME_DIR", runtime).env_remove("MOTORD_INSTANCE");
        command
    }

    fn motorctl(&self, line: &str) -> Output {
        self.command(line).output().unwrap()
    }

    /// Standard output of a call that succeeds.
    fn good(&self, line: &str) -> String {
        let output = self.motorctl(line);
        assert!(output.status.success(), "{line}: {} {}", output.status, text(&output.stderr));
        text(&output.stdout)
    }

    fn json(&self, line: &str) -> Value {
        serde_json::from_str(&self.good(&format!("{line} --json"))).unwrap()
    }

    /// Standard error of a call that fails with this status.
    fn bad(&self, line: &str, status: i32) -> String {
        let output = self.motorctl(line);
        assert_eq!(
            output.status.code(),
            Some(status),
            "{line}: {} {}",
            text(&output.stdout),
            text(&output.stderr)
        );
        text(&output.stderr)
    }
}

/// Output as text.
pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Goal: after a power cut in the middle of an application, a file tells what was done. Method: the motor loses its power while
/// items are written, and the tool is killed while it waits.
pub(crate) fn cut_the_power_during_an_application(line: &Line) {
    let items: Vec<String> = CONFIGURATION
        .iter()
        .filter(|item| item.name.ends_with("-kp") || item.name.ends_with("-ki"))
        .map(|item| format!("{} = 777\n", item.name))
        .collect();
    std::fs::write(line.path("knee.toml"), format!("[configuration]\n{}", items.concat())).unwrap();
    line.inject("knee delayed 16ms");
    let mut child = line
        .command("config apply knee.toml @ --yes")
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let journal = line.path("knee.toml.journal");
    let read = |path: &Path| std::fs::read_to_string(path).unwrap_or_default();
    while read(&journal).matches("\"written\"").count() < 2 {
        assert!(child.try_wait().unwrap().is_none(), "{}", read(&journal));
    }
    line.inject("knee off");
    child.kill().unwrap();
    child.wait().unwrap();
    let noted = read(&journal);
    let written = noted.lines().filter(|line| line.contains("\"written\"")).count();
    assert!((2..items.len()).contains(&written) && !noted.contains("\"end\""), "{noted}");

    line.inject("knee ok");
    let output = line.motorctl("config apply knee.toml @ --yes");
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("an earlier application was cut off"), "{}", text(&output.stderr));
    line.good("config diff knee.toml @");
}
