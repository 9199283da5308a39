//! Simulated motors on a bus that motorctl opens: an RS485 line, which is a pseudo terminal here,
//! or a virtual CAN interface.

#![allow(dead_code, reason = "each test program uses a part of it")]

pub(crate) mod terminal;

use motord_bus::transport::SocketCan;
use motord_bus::{Duration, Instant, clock, wait};
use motord_protocol::gim::{Access, CONFIGURATION, ConfigurationItem, Refusal, ValueType};
use motord_simulator::{
    Bridge, BusSettings, Dialect, FaultVerb, Imu, ImuNodeDevice, ImuNodeSettings, ImuPort, ImuVendor, Medium,
    MotorSettings, SerialPort, SerialSlave, SimulatedBus,
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

/// A longer wait would delay a fault.
const GLANCE: Duration = Duration::from_millis(2);

macro_rules! served {
    ($Port:ty, |$port:ident, $now:ident, $verb:ident| $inject:expr) => {
        impl Served for $Port {
            fn serve(&mut self, now: Instant) {
                Self::serve(self, now);
            }
            fn inject(&mut self, $now: Instant, $verb: &FaultVerb) {
                let $port = self;
                $inject.unwrap();
            }
            fn wait(&self, now: Instant) {
                let _ready = wait(&[self.readiness()], now, self.due().min(now + GLANCE));
            }
        }
    };
}

served!(SerialPort, |port, now, verb| Self::inject(port, now, verb));
served!(Bridge, |port, now, verb| Self::inject(port, now, verb));
served!(ImuPort, |port, _now, verb| Self::inject(port, verb));

impl Line {
    /// The line of an IMU `base` that sends 200 samples per second, with 921600 baud.
    pub(crate) fn imu(vendor: ImuVendor) -> Self {
        Self::imu_with(vendor, (200.0, 921_600))
    }

    /// The line of an IMU `base` with this rate, Hz, and baud rate.
    pub(crate) fn imu_with(vendor: ImuVendor, rate_and_baud: (f64, u32)) -> Self {
        let directory = TempDir::new().unwrap();
        let tty = directory.path().join("tty");
        let imu = (Imu::new(0.0, 0.0, Duration::ZERO, 1), vendor);
        let start = clock::monotonic();
        let port = ImuPort::open("base".into(), imu, rate_and_baud, start, Some(tty.clone())).unwrap();
        Self::serve(directory, tty.display().to_string(), Box::new(port))
    }

    /// An RS485 line.
    pub(crate) fn new(motors: Vec<MotorSettings>) -> Self {
        let directory = TempDir::new().unwrap();
        let settings = BusSettings {
            name: "line".into(),
            medium: Medium::Serial,
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
        Self::with_imus(interface, motors, Vec::new())
    }

    /// Such an interface with a HiPNUC `base`, node 8, at 100 Hz.
    pub(crate) fn hipnuc_on_can(interface: &str, motors: Vec<MotorSettings>) -> Self {
        let device = ImuNodeDevice::Hipnuc { node: 8, period: Duration::from_millis(10) };
        let (noise, bias, delay, seed) = (0.0, 0.0, Duration::ZERO, 1);
        let imu = ImuNodeSettings { name: "base".into(), device, noise, bias, delay, seed };
        Self::with_imus(interface, motors, vec![imu])
    }

    fn with_imus(interface: &str, motors: Vec<MotorSettings>, imus: Vec<ImuNodeSettings>) -> Self {
        let settings = BusSettings { name: "line".into(), imus, ..Default::default() };
        let simulated = SimulatedBus::new(settings, motors, 7);
        let end = SocketCan { interface: interface.to_owned(), bitrate: 1_000_000 };
        let bridge = Bridge::open(simulated, &end).unwrap();
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

/// Goal: after a power cut during an application, a file contains the completed steps.
/// Method: the motor loses its power while items are written, and the tool is killed while it
/// waits.
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

/// Returns the writable items that do not change the address of the motor, which have separate
/// tests.
fn writable() -> impl Iterator<Item = &'static ConfigurationItem> {
    let is_link = |name: &str| ["can-id", "host-id", "can-protocol", "can-baud-rate"].contains(&name);
    CONFIGURATION.iter().filter(move |item| item.access == Access::ReadWrite && !is_link(item.name))
}

/// Goal: every writable item of Table 7 is written by its name, reads back, and accepts its old
/// value again.
pub(crate) fn write_every_item(line: &Line) {
    let before = line.good("config list @");
    for item in writable() {
        let value = line.json(&format!("config get {} @", item.name))["value"].clone();
        let (old, new) = match item.value_type {
            ValueType::Integer => (value.to_string(), (value.as_i64().unwrap() + 1).to_string()),
            ValueType::Float => (value.to_string(), (value.as_f64().unwrap() * 1.5).to_string()),
        };
        for value in [new, old] {
            let printed = line.good(&format!("config set {} {value} @ --yes", item.name));
            assert!(printed.contains("reads "), "{}: {printed}", item.name);
            let stored = line.json(&format!("config get {} @", item.name))["value"].as_f64().unwrap();
            let written: f64 = value.parse().unwrap();
            assert!(
                (stored - written).abs() <= f64::from(f32::EPSILON) * written.abs(),
                "{}: {stored}",
                item.name
            );
        }
    }
    assert_eq!(writable().count(), 25);
    assert_eq!(line.good("config list @"), before);
}

/// Goal: the items that change the address of a motor are written by their names, and it answers
/// under the new value. The caller writes the last one: over CAN, a motor cannot leave MIT.
pub(crate) fn write_every_address(line: &Line) {
    line.good("config set host-id 0x77 @ --yes");
    assert_eq!(line.json("ping @")["host_id"], 0x77);
    line.good("config set can-id 9 @ --yes");
    line.bad("ping @", 69);
    assert_eq!(line.json("config get can-id --bus LINE --id 9")["value"], 9);
    line.good("config set can-id 3 --bus LINE --id 9 --yes");
    assert_eq!(line.json("config get can-id @")["value"], 3);
}

/// Goal: every fault of Table 9 is named in the document's words, and cleared.
/// Method: the motor raises each of them, one after the other, and then all of them.
pub(crate) fn read_and_clear_every_fault(line: &Line, protocol: &str) {
    let get = format!("fault get @ --protocol {protocol}");
    assert!(line.good(&get).contains("no fault"));
    for (bits, words) in [
        (0x01, ["foc frequency too high"].as_slice()),
        (0x02, &["over voltage"]),
        (0x04, &["under voltage"]),
        (0x08, &["over temperature"]),
        (0x10, &["start failure"]),
        (0x40, &["over current"]),
        (0x80, &["software exception"]),
        (0xDF, &["foc frequency too high", "under voltage", "start failure", "software exception"]),
    ] {
        line.inject(&format!("knee fault {bits}"));
        let printed = line.good(&get).to_lowercase().replace('-', " ");
        assert!(words.iter().all(|word| printed.contains(word)), "{bits:#04X}: {printed}");
        let fault = line.json(&get);
        assert_eq!(fault["bits"], bits);
        assert_eq!(fault["faults"].as_array().unwrap().len() as u32, u32::count_ones(bits));
        assert!(line.good(&format!("fault clear @ --protocol {protocol}")).contains("the fault is cleared"));
        assert!(line.good(&get).contains("no fault"));
    }
}

/// Goal: every result code of Table 5 reaches the user with the document's words, from each kind of
/// write, without a change.
/// Method: the motor refuses with each of them, one after the other. The last one is in no
/// document.
pub(crate) fn refuse_with_every_result_code(line: &Line) {
    let before = line.good("config list @");
    for code in [0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x0B, 0x42] {
        let refusal = Refusal::check(code).unwrap_err();
        line.inject(&format!("knee refuse {code}"));
        for (write, name) in [
            ("config set over-voltage 51 @ --yes", "modify configuration"),
            ("config reset @ --yes", "reset configuration"),
            ("parameter set position-kp 1 @ --yes", "modify parameter"),
            ("calibrate phase @ --yes", "calibration"),
        ] {
            let refused = line.bad(write, 1);
            assert!(refused.contains(&format!("{name}: {refusal}")), "{write}: {refused}");
        }
    }
    line.inject("knee ok");
    assert_eq!(line.good("config list @"), before);
    // 0x00, success.
    line.good("config set over-voltage 51 @ --yes");
}

/// Goal: the change of a write persists after a loss of power.
/// Method: a motor that forgets everything that no refresh configuration (GIM document 3.2.2) has
/// stored.
pub(crate) fn lose_power_after_every_write(line: &Line) {
    let restart = || {
        line.inject("knee power-cycle");
        std::thread::sleep(Duration::from_millis(600));
    };
    line.good("config set rated-current 33 @ --yes");
    restart();
    assert_eq!(line.json("config get rated-current @")["value"], 33);
    line.good("zero @ --at 0.5 --yes");
    restart();
    let at = line.json("indicator shaft-angle @")[0]["value"].as_f64().unwrap();
    assert!((at - 0.5).abs() < 0.01, "{at}");
    line.good("id @ --set-id 5 --set-host-id 0x155 --yes");
    restart();
    assert_eq!(line.json("id --bus LINE --id 5")["host_id"], 0x155);
    line.good("config dump knee.toml --bus LINE --id 5");
    line.good("config reset --bus LINE --id 5 --yes");
    restart();
    line.bad("config diff knee.toml --bus LINE --id 1", 1);
    line.good("config apply knee.toml --bus LINE --id 1 --yes");
    restart();
    line.good("config diff knee.toml --bus LINE --id 5");
}

/// Goal: a motor is stopped if it did not confirm its start. Method: every answer is late, beyond
/// the time limit of one request. A read is repeated, a start is not. A motor that is still running
/// would refuse the calibration.
pub(crate) fn lose_the_answer_to_a_start(line: &Line, delay: &str) {
    for start in ["start @", "jog @ --seconds 0.3", "speed 0.3 --seconds 0.3 @"] {
        line.inject(&format!("knee delayed {delay}"));
        let silent = line.bad(&format!("{start} --protocol gim --yes"), 69);
        assert!(silent.contains("does not answer `start motor`"), "{start}: {silent}");
        line.inject("knee ok");
        std::thread::sleep(Duration::from_millis(600));
        if start.starts_with("start") {
            let refused = line.bad("calibrate phase @ --yes", 1);
            assert!(refused.contains("failure (RES 0x01)"), "{refused}");
            line.good("stop @");
        } else {
            line.good("calibrate phase @ --yes");
        }
    }
}

/// Kills motorctl during a motion. Returns the rotation until then, and that in the second that
/// begins half a second later, rad.
pub(crate) fn kill_in_motion(line: &Line, motion: &str) -> [f64; 2] {
    let angle = || line.json("indicator shaft-angle @")[0]["value"].as_f64().unwrap();
    let begin = angle();
    let mut child = line.command(motion).stdout(Stdio::null()).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    assert!(child.try_wait().unwrap().is_none(), "{motion}");
    child.kill().unwrap();
    child.wait().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    let (at, second) = (angle(), std::time::Instant::now());
    std::thread::sleep(Duration::from_secs(1));
    let after = angle();
    [at - begin, (after - at) / second.elapsed().as_secs_f64()]
}
