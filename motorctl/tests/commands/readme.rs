//! The README's "Now you", line by line, in terminals of tmux: a robot, its monitor, a killed
//! controller, a damped robot. Then the first program of the client's documentation, on the same
//! robot.
//!
//! A release build (`cargo test --release`) runs the lines word for word. Other builds run their
//! own programs instead.

use motord_harness::tmux::Tmux;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

fn programs() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_motorctl")).parent().unwrap()
}

/// The blocks of commands of a section.
fn commands(section: &str) -> Vec<String> {
    let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
    let text = readme.split("\n## ").find(|text| text.starts_with(section)).unwrap();
    text.split("```sh\n").skip(1).map(|block| block.split("```").next().unwrap().trim().to_owned()).collect()
}

/// The line for the programs of this test. `cargo test --workspace` has built the examples, with
/// the features of the workspace.
fn here(line: &str) -> String {
    let line = line.replace("target/release", programs().to_str().unwrap());
    let is_release = programs().ends_with("release");
    if is_release { line } else { line.replace("build --release", "build --workspace") }
}

/// Three terminals of one robot, in the repository.
struct Desk {
    robot: Tmux,
    watcher: Tmux,
    controller: Tmux,
    _runtime: TempDir,
}

impl Desk {
    fn new() -> Option<Self> {
        let runtime = TempDir::new().unwrap();
        let terminal = || {
            let tmux = Tmux::start(&[("MOTORD_RUNTIME_DIR", runtime.path().to_str().unwrap())])?;
            tmux.resize(120, 40);
            tmux.enter(&format!("cd {}", root().display()));
            Some(tmux)
        };
        let (robot, watcher, controller) = (terminal()?, terminal()?, terminal()?);
        Some(Self { robot, watcher, controller, _runtime: runtime })
    }

    /// Waits for the daemon, as a person does.
    fn await_robot(&self) {
        self.watcher.enter(&here(
            "until target/release/motorctl --instance demo status; do sleep 0.1; done >/dev/null 2>&1; echo ready",
        ));
        self.watcher.until("a started daemon", |screen| screen.lines().any(|line| line == "ready"));
    }

    /// The process that moves the robot.
    fn owner(&self, program: &str) -> String {
        let owned = format!("legs  active  owner {program} (");
        let screen = self.watcher.until("motion", |screen| screen.contains(&owned));
        screen.split(&owned).nth(1).unwrap().split(')').next().unwrap().to_owned()
    }
}

/// Builds an example of the client. `cargo test -p motorctl` does not build it, and an old one uses
/// another version of the messages.
fn build(example: &str) {
    let line = here(&format!("cargo build --release --example {example}"));
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let built = Command::new(cargo).current_dir(root()).args(line.split(' ').skip(1)).status().unwrap();
    assert!(built.success(), "{line}");
}

#[test]
fn its_commands_move_kill_and_damp_robot() {
    let blocks = commands("Now you");
    let [run, monitor, controller, reset] = &blocks[..] else { panic!("{blocks:?}") };
    assert!(blocks.iter().all(|block| !block.contains('\n')), "one line each: {blocks:?}");
    ["sine", "start"].into_iter().for_each(build);
    let Some(desk) = Desk::new() else { return };

    desk.robot.enter(&here(run));
    desk.await_robot();
    desk.watcher.enter(&here(monitor));
    desk.watcher.until("the monitor", |screen| screen.contains("rr-knee"));

    desk.controller.enter(&here(controller));
    let pid = desk.owner("sine");
    let is_damped = |screen: &str| screen.contains("STOPPED") && screen.contains("disarmed");
    let screen = desk.watcher.until("the damped robot", is_damped);
    assert!(screen.contains("The owner's process ended while its group was active."), "{screen}");
    assert!(screen.contains(&format!("sine ({pid})")), "{screen}");
    let line = reset.trim_start_matches("target/release/").trim_end_matches(" --wait");
    assert!(screen.contains(line), "{line} in\n{screen}");
    desk.controller.until("the killed controller", |screen| screen.contains("Killed"));
    desk.controller.enter(&here(reset));
    desk.watcher.until("the reset", |screen| !screen.contains("STOPPED"));

    // The front page of the client's documentation.
    desk.controller.enter(&here("target/release/examples/start"));
    desk.owner("start");
    desk.controller.press(&["C-c"]);
    desk.watcher.until("the damped robot", is_damped);

    desk.watcher.press(&["q"]);
    desk.watcher.assert_given_back();
    desk.robot.press(&["C-c"]);
    desk.robot.until("the end of the daemon", |screen| screen.trim_end().ends_with('$'));
}
