//! Motors on a serial line, and the programs that stop them: the daemon, its dead man's switch,
//! `motord safe-stop`.
//!
//! Method: the real programs; simulated motors on a pseudo terminal. A running motor was started by
//! another sender after the death of the daemon.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::outsider::Switch;
use crate::port::Motors;
use crate::safe_stop::{motord, text};
use motord_bus::serial::SerialSender;
use motord_bus::{Frame, FrameId, Refusal};
use motord_harness::daemon::{Daemon, TIMEOUT, until};
use motord_harness::robot;
use motord_simulator::Mode;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::thread::sleep;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The command that starts a motor, neutral for one in MIT mode.
const START: [u8; 8] = [0x91, 0, 0x80, 0, 0, 0, 0x08, 0];

/// Two native motors on a line, and a directory for everything.
struct Arm {
    directory: Arc<TempDir>,
    motors: Motors,
    device: String,
}

impl Arm {
    fn new() -> Self {
        Self::of(|device| ["one", "two"].map(|instance| (instance, config(instance, device))).to_vec())
    }

    /// Starts the motors of the first of these configurations, each with its instance; all use the
    /// device.
    fn of(configurations: impl Fn(&str) -> Vec<(&'static str, String)>) -> Self {
        let directory = Arc::new(TempDir::new().unwrap());
        let link = directory.path().join("ttyUSB0");
        let device = link.to_str().unwrap().to_owned();
        let configurations = configurations(&device);
        let motors = Motors::start(&robot::settings(&configurations[0].1), 0, link);
        let arm = Self { directory, motors, device };
        for (instance, text) in configurations {
            fs::write(arm.file(instance), text).unwrap();
        }
        arm
    }

    fn file(&self, instance: &str) -> std::path::PathBuf {
        self.directory.path().join(format!("{instance}.toml"))
    }

    fn motord(&self, command: &str, instance: &str) -> Command {
        motord(self.directory.path(), &[command], &self.file(instance))
    }

    /// Starts the daemon of the first configuration, and waits until its log contains `text`.
    fn run(&self, text: &str, adjust: impl FnOnce(&mut Command)) -> Daemon {
        let config = fs::read_to_string(self.file("one")).unwrap();
        let daemon = Daemon::start_in(Arc::clone(&self.directory), &config, adjust);
        daemon.await_log(text);
        daemon
    }

    /// Starts both motors.
    fn start_motors(&self) {
        let sender = SerialSender::open(&self.device, 921_600).unwrap();
        let begun = Instant::now();
        while self.modes().contains(&Mode::Stopped) {
            for id in [1, 2] {
                let sent = sender.send(&Frame::classic(FrameId::from(id), START));
                assert!(matches!(sent, Ok(()) | Err(Refusal::Full)), "{sent:?}");
                sleep(Duration::from_millis(3));
            }
            assert!(begun.elapsed() < TIMEOUT, "{:?}", self.modes());
        }
    }

    fn modes(&self) -> Vec<Mode> {
        self.motors.each(motord_simulator::Motor::mode)
    }

    fn must_stop(&self) {
        let begun = Instant::now();
        while self.modes() != [Mode::Stopped; 2] {
            assert!(begun.elapsed() < TIMEOUT, "{:?}", self.modes());
            sleep(Duration::from_millis(5));
        }
    }
}

fn config(instance: &str, device: &str) -> String {
    let mut text = format!(
        "[daemon]\ninstance = \"{instance}\"\n[cycle]\nmax-lateness-ms = 500.0\n[safety]\ndamp-seconds = 10.0\n\
         [[bus]]\nname = \"arm\"\ntype = \"serial\"\ndevice = \"{device}\"\nevery = 5\n"
    );
    for (id, name) in [(1, "wrist"), (2, "jaw")] {
        text += &robot::motor(id, name, "arm", "").replace("\"mit\"", "\"gim\"");
    }
    text
}

#[test]
fn the_shipped_arm_runs_on_a_line() {
    let shipped = include_str!("../../../config/arm-native.toml");
    assert!(shipped.contains("device = \"/dev/ttyUSB0\""));
    let arm = Arm::of(|device| vec![("one", shipped.replace("/dev/ttyUSB0", device))]);
    let mut daemon = arm.run("", |command| {
        command.env("MOTORD_LOG", "debug");
    });
    for joint in ["shoulder", "elbow", "wrist", "gripper"] {
        until(joint, || {
            let has_answered = |line: &str| {
                line.contains("The motor answers and is stopped")
                    && line.contains(&format!("motor=\"{joint}\""))
            };
            daemon.log().lines().any(has_answered).then_some(())
        });
    }
    assert!(daemon.end().success(), "its motors were stopped");
}

#[test]
fn switch_stops_motors_of_killed_daemons_line() {
    let arm = Arm::new();
    let _switch = Switch::start(arm.directory.path(), &arm.file("one"));
    let daemon = arm.run("dead man's switch: yes", |_| {});
    drop(daemon);
    arm.start_motors();
    arm.must_stop();
}

#[test]
fn safe_stop_stops_motors_of_a_line() {
    let arm = Arm::new();
    arm.start_motors();
    let output = arm.motord("safe-stop", "one").output().unwrap();
    assert!(output.status.success(), "{}", text(&output));
    assert!(
        text(&output).contains("every motor was commanded to damp and stop, and answered"),
        "{}",
        text(&output)
    );
    assert_eq!(arm.modes(), [Mode::Stopped; 2]);
}

/// An answer on a line does not name its motor.
#[test]
fn safe_stop_names_silent_motors_of_line() {
    let arm = Arm::new();
    arm.start_motors();
    arm.motors.inject("jaw power-off");
    let output = arm.motord("safe-stop", "one").output().unwrap();
    assert_eq!(output.status.code(), Some(80), "{}", text(&output));
    assert!(text(&output).ends_with("may still move, so cut the power: jaw\n"), "{}", text(&output));
    assert_eq!(arm.modes()[0], Mode::Stopped);
}

#[test]
fn safe_stop_reports_an_unreachable_line() {
    for (misfortune, complaint) in
        [("arm gone", "there is no such device"), ("arm blocked", "refuses frames")]
    {
        let arm = Arm::new();
        arm.motors.inject(misfortune);
        let output = arm.motord("safe-stop", "one").output().unwrap();
        assert_eq!(output.status.code(), Some(69), "{misfortune}: {}", text(&output));
        assert!(text(&output).contains(complaint), "{misfortune}: {}", text(&output));
    }
}

#[test]
fn driven_line_refuses_second_daemon_and_safe_stop() {
    let arm = Arm::new();
    let daemon = arm.run("ready", |_| {});
    let holder = format!("is in use by process {}", daemon.process.id());
    for (command, status) in [("run", 75), ("safe-stop", 69)] {
        let output = arm.motord(command, "two").output().unwrap();
        assert_eq!(output.status.code(), Some(status), "{command}: {}", text(&output));
        assert!(text(&output).contains(&holder), "{command}: {}", text(&output));
    }
}

#[test]
fn daemon_waits_for_adapter_that_comes_later() {
    let arm = Arm::new();
    let unplugged = format!("{}.unplugged", arm.device);
    fs::rename(&arm.device, &unplugged).unwrap();
    let impatient = arm.motord("run", "one").output().unwrap();
    assert_eq!(impatient.status.code(), Some(69), "{impatient:?}");
    let daemon = arm.run("waiting for it, at most 60 s", |command| {
        command.args(["--wait-for-buses", "60"]);
    });
    fs::rename(&unplugged, &arm.device).unwrap();
    daemon.await_log(" ready ");
}

/// A port that returned once is opened once: the substitute that the cycle has meanwhile is no
/// further loss. Method: the motors are another process, since a child of this one would keep its
/// terminal open.
#[test]
fn returned_port_is_opened_once() {
    let directory = TempDir::new().unwrap();
    let file = directory.path().join("one.toml");
    fs::write(&file, config("one", directory.path().join("ttyUSB0").to_str().unwrap())).unwrap();
    let mut simulator = Command::new(env!("CARGO_BIN_EXE_motord-sim"));
    simulator.arg("--config").arg(&file).arg("--link").arg(directory.path());
    let mut simulator = simulator.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut verbs = simulator.stdin.take().unwrap();
    assert!(BufReader::new(simulator.stdout.take().unwrap()).lines().any(|line| line.unwrap() == "ready"));
    let daemon = Daemon::start_in(directory, &fs::read_to_string(&file).unwrap(), |_| {});
    daemon.await_log(" ready ");
    writeln!(verbs, "arm gone").unwrap();
    daemon.await_log("trying again");
    writeln!(verbs, "arm ok").unwrap();
    daemon.await_log("opened again");
    sleep(Duration::from_secs(3));
    simulator.kill().unwrap();
    simulator.wait().unwrap();
    assert_eq!(daemon.log().matches("opened again").count(), 1);
}
