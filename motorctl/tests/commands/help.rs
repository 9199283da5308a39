//! Every example of every `--help` works as printed.
//!
//! Method: a shell runs the examples of the printed help, in a directory with what they name. That
//! is a `robot.toml`, a robot with a controller, a second robot `arm`, a `candump` and a motor on a
//! bus. All are simulated. `motord-sim` runs only up to its CAN interfaces, which are missing.

use crate::line::Line;
use crate::programs::help;
use crate::text;
use motord_client::{Client, Setpoint};
use motord_harness::daemon::until;
use motord_harness::programs::{directory, lacks, program};
use motord_simulator::ImuVendor;
use serde_json::Value;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tempfile::TempDir;

/// Returns the examples in the help of a program and of its commands.
fn examples(program: &str, command: &[String]) -> Vec<String> {
    let help = help(program, command);
    let mut examples: Vec<String> = Vec::new();
    let section = |name: &'static str| help.lines().skip_while(move |line| !line.starts_with(name)).skip(1);
    let lines = section("Example").take_while(|line| line.starts_with("  "));
    for line in lines {
        match examples.last_mut().filter(|example| example.ends_with('\\')) {
            Some(example) => *example = format!("{}{}", example.trim_end_matches('\\'), line.trim()),
            None => examples.push(line.trim().to_owned()),
        }
    }
    // Examples may have an explanation on the same line.
    let command_of = |example: &String| example.split("  ").next().unwrap().trim().to_owned();
    let mut examples: Vec<String> = examples.iter().map(command_of).collect();
    let commands = section("Commands:").take_while(|line| line.starts_with("  "));
    for name in
        commands.filter(|line| !line.starts_with("   ")).filter_map(|line| line.split_whitespace().next())
    {
        if name != "help" {
            let below: Vec<String> = command.iter().cloned().chain([name.to_owned()]).collect();
            examples.extend(self::examples(program, &below));
        }
    }
    examples
}

/// A directory with everything that the examples name.
struct Scene {
    directory: TempDir,
    daemons: Vec<Child>,
}

impl Drop for Scene {
    fn drop(&mut self) {
        for daemon in &mut self.daemons {
            let _exited = daemon.kill();
            let _status = daemon.wait();
        }
    }
}

impl Scene {
    /// `None` on a computer that cannot run the examples.
    fn new() -> Option<Self> {
        if lacks(&["bash", "timeout"]) {
            return None;
        }
        let mut scene = Self { directory: TempDir::new().unwrap(), daemons: Vec::new() };
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/quadruped-simulated.toml");
        // Slow, so that two of them run beside other tests.
        let robot = std::fs::read_to_string(config).unwrap().replace("rate-hz = 1000", "rate-hz = 100");
        let named = |name: &str| robot.replace("instance = \"demo\"", &format!("instance = \"{name}\""));
        let can = "[[bus]]\nname = \"can\"\ntype = \"socketcan\"\ninterface = \"can0\"\n\
            [[motor]]\nname = \"hip\"\nbus = \"can\"\nid = 1\nprotocol = \"mit\"\nmodel = \"GIM8108-8\"\n";
        scene.write("robot.toml", &named("third"));
        scene.write("motord.toml", can);
        scene.write("candump", "#!/bin/sh\necho '(1436509052.249713) can0 001#FFFFFFFFFFFFFFFC'\n");
        scene.shell("chmod +x candump && mkdir run");
        scene.write_logs();
        for instance in ["robot", "arm"] {
            scene.write(&format!("{instance}-daemon.toml"), &named(instance));
            scene.start(instance);
        }
        Some(scene)
    }

    fn path(&self) -> &Path {
        self.directory.path()
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path().join(name), text).unwrap();
    }

    /// Writes the logs of a stop, as other tools have them.
    fn write_logs(&self) {
        self.write("candump-2026-03-01_101500.log", "(1772360100.000000) can0 001#FFFFFFFFFFFFFFFD\n");
        self.write("trace.trc", ";$FILEVERSION=1.1\n  1)  0.5  Tx  0001  8  FF FF FF FF FF FF FF FD\n");
        self.write(
            "vector.asc",
            "base hex  timestamps absolute\n 0.000500 1  1  Tx  d 8 FF FF FF FF FF FF FF FD\n",
        );
    }

    fn start(&mut self, instance: &str) {
        let mut command = program("motord");
        command.arg("run").arg("--config").arg(self.path().join(format!("{instance}-daemon.toml")));
        command.env("MOTORD_RUNTIME_DIR", self.path().join("run")).stderr(Stdio::null());
        self.daemons.push(command.spawn().unwrap());
        let line = format!("motorctl --instance {instance} status");
        until("a ready daemon", || self.shell(&line).status.success().then_some(()));
    }

    /// Runs a line in this directory like a person. A pipeline fails when any part of it fails.
    fn shell(&self, line: &str) -> Output {
        let path =
            format!("{}:{}:{}", self.path().display(), directory().display(), std::env::var("PATH").unwrap());
        Command::new("bash")
            .args(["-o", "pipefail", "-c", line])
            .current_dir(self.path())
            .env("PATH", path)
            .env("MOTORD_RUNTIME_DIR", self.path().join("run"))
            .env_remove("MOTORD_INSTANCE")
            .output()
            .unwrap()
    }

    /// Stops the motors; they may be enabled again unless the stop stays `latched`.
    fn stop_robot(&self, latched: bool) {
        self.shell("motorctl estop");
        until("the stop", || is_at_rest(&self.shell("motorctl status --json").stdout).then_some(()));
        assert!(latched || self.shell("motorctl reset").status.success());
    }

    /// Runs an example; endless commands run for a short time. An example with a bus has a separate
    /// line, with a motor 3.
    fn example(&self, example: &str) {
        let example = without_missing_jq(example);
        if ends_by_hand(example) && lacks(&["script"]) {
            return;
        }
        // They need a CAN interface: `hipnuc_beside_a_motor_is_found` and `hipnuc_on_can_is_set`
        // run them.
        if example.contains(" imu find --bus") || example.contains(" imu set --bus") {
            return;
        }
        let is_imu = example.contains(" imu find") || example.contains(" imu set");
        let imu = is_imu.then(|| Line::imu(ImuVendor::Xsens));
        let wire = imu.or_else(|| needs_bus(example).then(Line::knee));
        let device = wire.as_ref().map_or_else(|| "can0".to_owned(), Line::device);
        let config = format!("line-{}.toml", device.replace('/', "-"));
        let line = runnable(example, &device).replace("line.toml", &config);
        self.write(
            &config,
            &format!(
                "[[bus]]\nname = 'line'\ntype = 'serial'\ndevice = '{device}'\nevery = 5\n[[motor]]\nname = 'fl-knee'\n\
                 bus = 'line'\nid = 3\nhost-id = 0x43\nprotocol = 'gim'\nmodel = 'GIM8108-8'\n"
            ),
        );
        // A demo also assesses the machine, and may need a second attempt on a busy one.
        let tries = if line.contains("demo") { 5 } else { 1 };
        let mut outputs = (0..tries).map(|_| self.shell(&line));
        let first = outputs.next().unwrap();
        let output = if first.status.success() {
            first
        } else {
            outputs.find(|output| output.status.success()).unwrap_or(first)
        };
        let (printed, complaint) = (text(&output.stdout), text(&output.stderr));
        assert!(output.status.success(), "{example}: {} {printed} {complaint}", output.status);
        let is_empty = printed.lines().all(|line| line.contains("null") || line.trim().is_empty());
        assert!(
            !example.contains("jq") || !printed.contains("null") && !is_empty,
            "{example} finds nothing: {printed}"
        );
    }

    /// Ends the fault of an example: the next one starts without faults.
    fn heal(&self, example: &str) {
        if let Some(fault) = example.strip_prefix("motorctl sim ") {
            let target = fault.split(' ').next().unwrap();
            self.shell(&format!("motorctl sim {target} ok; motorctl fault clear {target}"));
        }
    }
}

/// Returns the example for this machine, with `device` as its bus; endless commands run for a short
/// time.
fn runnable(example: &str, device: &str) -> String {
    // A whole scan of a serial line takes a quarter of a minute.
    let ids = if example.contains("motorctl scan") && !example.contains("--ids") { " --ids 1-4" } else { "" };
    let line = format!("{example}{ids}")
        .replace("--bus can0", &format!("--bus {device}"))
        .replace("--bus /dev/ttyUSB0", &format!("--bus {device}"))
        // Without it the command tries every port of the test machine.
        .replace("imu find --device /dev/ttyUSB0", "imu find")
        .replace("imu find", &format!("imu find --device {device}"))
        .replace("imu set --device /dev/ttyUSB0", &format!("imu set --device {device}"))
        .replace("/etc/motord/motord.toml", "motord.toml")
        .replace("motorctl setup --config motord.toml", "motorctl setup --config line.toml")
        .replace("motord init", "cd $(mktemp -d) && motord init")
        .replace("sudo motorctl doctor", "motorctl doctor")
        // It would stop the robots of other tests.
        .replace(" estop --all", " estop")
        // This option changes the test machine.
        .replace(" --tune", "")
        .replace("--seconds 600", "--seconds 1")
        .replace("imu level base --seconds 10", "imu level base --seconds 1")
        .replace("--seconds 5", "--seconds 1")
        .replace("motorctl demo", "motorctl demo --seconds 2")
        .replace("--seconds 2 --seconds 60", "--seconds 2")
        .replace("motorctl watch", "timeout --preserve-status -s INT 1 motorctl watch")
        .replace(
            "motorctl --instance arm watch",
            "timeout --preserve-status -s INT 1 motorctl --instance arm watch",
        )
        .replace("motord run", "timeout --preserve-status -s TERM 2 motord run")
        .replace("motord deadman", "timeout --preserve-status -s TERM 1 motord deadman");
    // Its result depends on the test machine.
    let line = match line.split_once(" | ") {
        Some((doctor, rest)) if doctor.contains(" doctor") => {
            format!("({doctor} || [ $? = 1 ]) | {rest}")
        }
        // The simulated robot sways.
        None if line.contains(" doctor") || line.contains(" imu level") => format!("{line} || [ $? = 1 ]"),
        _ => line,
    };
    if ends_by_hand(&line) { on_a_terminal(&line) } else { line }
}

/// Returns `true` if an example needs a terminal, and runs until Ctrl-C.
fn ends_by_hand(example: &str) -> bool {
    [" monitor", " replay", " flight"].iter().any(|command| example.contains(command))
}

/// Returns `true` if an example uses a bus, without a daemon.
fn needs_bus(example: &str) -> bool {
    example.contains("--bus") || example.contains("motorctl setup")
}

/// Returns `true` if all motors in a status are stopped.
fn is_at_rest(status: &[u8]) -> bool {
    let status: Value = serde_json::from_slice(status).unwrap_or_default();
    let is_stopped = |joint: &Value| joint["mode"] == "idle" || joint["mode"] == "excluded";
    status["groups"][0]["phase"] == "disarmed"
        && status["joints"].as_array().is_some_and(|joints| joints.iter().all(is_stopped))
}

/// Returns the example without its filter on a machine without `jq`, with a note.
fn without_missing_jq(example: &str) -> &str {
    match example.split_once(" | jq ") {
        Some((command, _)) if lacks(&["jq"]) => {
            println!("run without its filter: {example}");
            command
        }
        _ => example,
    }
}

/// Runs the line on a separate terminal, until Ctrl-C a second later.
fn on_a_terminal(line: &str) -> String {
    let line = format!("timeout --foreground --preserve-status -s INT 1 {line}");
    format!("TERM=xterm script -qec '{line}' /dev/null </dev/null")
}

/// Claims the legs and holds them in position, until `end`.
fn hold(runtime: &Path, end: &AtomicBool) {
    let client = Client::connect_in(runtime, "robot").unwrap();
    let mut claim = client.claim("legs").unwrap();
    while !end.load(Ordering::Relaxed) {
        let Ok(state) = client.wait(Duration::from_secs(1)) else { continue };
        let hold: Vec<_> = state
            .joints()
            .map(|joint| Setpoint::impedance(joint.position().unwrap_or(0.0), 0.0, 5.0, 0.5, 0.0))
            .collect();
        let _taken_away = claim.send(&hold);
    }
}

#[test]
fn every_example_of_motord_works() {
    let Some(scene) = Scene::new() else { return };
    let examples = examples("motord", &[]);
    assert!(examples.len() >= 3, "{examples:?}");
    examples.iter().for_each(|example| scene.example(example));
}

/// A test must send nothing on a real CAN interface: the interface of its configuration is missing.
/// `motord-sim` reports that after it has parsed the arguments and the configuration.
#[test]
fn motord_sim_examples_parse_up_to_missing_interface() {
    const EXIT_UNAVAILABLE: i32 = 69;
    let Some(scene) = Scene::new() else { return };
    scene.shell("sed -i s/can0/nocan0/ motord.toml");
    let examples = examples("motord-sim", &[]);
    assert!(!examples.is_empty());
    for example in examples {
        let output = scene.shell(&example.replace("/etc/motord/motord.toml", "motord.toml"));
        let printed = text(&output.stderr);
        assert_eq!(output.status.code(), Some(EXIT_UNAVAILABLE), "{example}: {printed}");
        assert!(printed.contains("nocan0"), "{example}: {printed}");
    }
}

#[test]
fn every_bus_example_of_motorctl_works() {
    let Some(scene) = Scene::new() else { return };
    let mut examples = examples("motorctl", &[]);
    // The tests in guide.rs answer the questions of the guide.
    examples.retain(|example| needs_bus(example) && !example.contains("--guide"));
    assert!(examples.len() >= 10, "{examples:?}");
    in_shares(&examples, |share| share.iter().for_each(|example| scene.example(example)));
}

#[test]
fn every_other_example_of_motorctl_works() {
    let mut examples = examples("motorctl", &[]);
    // `verify/rigs/test-guide` replaces a motor: that takes a bus with a new one. Tests on virtual time
    // change the protocol of a motor. `verify/rigs/test-fleet` has robots in a network.
    let elsewhere = ["replace", "protocol", "fleet"];
    examples.retain(|example| {
        let command = command_of(example);
        !needs_bus(example) && !elsewhere.contains(&command) && !CONTROLLERS.contains(&command)
    });
    assert!(examples.len() >= 20, "{examples:?}");
    // `release` ends the claim of the controller, so it is the last.
    examples.sort_by_key(|example| example.contains(" release "));
    in_shares(&examples, |share| {
        let Some(scene) = Scene::new() else { return };
        let end = AtomicBool::new(false);
        let runtime = scene.path().join("run");
        std::thread::scope(|scope| {
            let _holder = scope.spawn(|| hold(&runtime, &end));
            let all = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                for example in share {
                    scene.stop_robot(example.contains("status"));
                    scene.example(example);
                    scene.heal(example);
                }
            }));
            end.store(true, Ordering::Relaxed);
            all.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        });
    });
}

#[test]
fn every_example_of_a_controller_works() {
    let mut examples = examples("motorctl", &[]);
    examples.retain(|example| CONTROLLERS.contains(&command_of(example)));
    assert!(examples.len() >= 4, "{examples:?}");
    in_shares(&examples, |share| {
        let Some(scene) = Scene::new() else { return };
        share.iter().for_each(|example| scene.example(example));
    });
}

/// Commands that need a group without an owner.
const CONTROLLERS: [&str; 3] = ["hold", "identify", "tune"];
/// Commands whose examples need the files of others.
const TOGETHER: [&[&str]; 2] = [&["record", "replay", "plot"], &["dump", "apply"]];

/// Returns the command of an example, or the first of those that it needs.
fn command_of(example: &str) -> &str {
    let after = example.split_once("motorctl ").map_or("", |(_, rest)| rest);
    let command = after.trim_start_matches("--instance arm ").split(' ').next().unwrap_or_default();
    TOGETHER.iter().find(|commands| commands.contains(&command)).map_or(command, |commands| commands[0])
}

/// Divides the examples by commands, in their order, among threads: most of their time is waiting.
fn in_shares(examples: &[String], run: impl Fn(&[String]) + Sync) {
    const SHARES: usize = 5;
    let mut commands: Vec<&str> = Vec::new();
    let mut shares: [Vec<String>; SHARES] = Default::default();
    for example in examples {
        let command = command_of(example);
        if !commands.contains(&command) {
            commands.push(command);
        }
        let scene = commands.iter().position(|known| *known == command).unwrap();
        shares[scene % SHARES].push(example.clone());
    }
    let run = &run;
    std::thread::scope(|scope| {
        for share in shares.iter().filter(|share| !share.is_empty()) {
            scope.spawn(move || run(share));
        }
    });
}
