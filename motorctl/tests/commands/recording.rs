//! Recordings with the real programs and a daemon of simulated motors. Recorded cycles are counted
//! and read by the other commands. Failures to read or write are reported.

use motord_harness::daemon;
use motord_harness::daemon::{Daemon, slow_quadruped};
use motord_harness::tmux::Tmux;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Output};
use std::time::Duration;

fn printed(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn status(output: &Output) -> i32 {
    output.status.code().unwrap()
}

#[test]
fn recording_holds_every_cycle_and_is_drawn() {
    let daemon = Daemon::start(&slow_quadruped());
    drop(daemon.connect());
    let file = daemon.directory.path().join("run.mcap");
    let path = file.to_str().unwrap();
    let output = daemon.motorctl(&["record", path, "--seconds", "2", "--json"]);
    assert!(output.status.success(), "{}", printed(&output));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let count = |name: &str| report[name].as_u64().unwrap();
    let counted =
        count("recorded") + count("missed_ticks") + count("unpublished") + count("lost") + count("dropped");
    assert_eq!(counted, count("last_cycle") - count("first_cycle") + 1, "{report}");
    assert!(count("recorded") > 10 && report["ended"] == "seconds", "{report}");

    let again = daemon.motorctl(&["record", path, "--seconds", "1"]);
    assert_eq!(status(&again), 74, "an old recording is kept: {}", printed(&again));
    let picture = daemon.motorctl(&["plot", path, "fl-knee"]);
    assert!(
        String::from_utf8_lossy(&picture.stdout).contains("fl-knee: position, rad"),
        "{}",
        printed(&picture)
    );
    let picture = daemon.motorctl(&["plot", path, "fl-knee", "fl-hip", "--with", path, "--png", "-"]);
    assert!(picture.stdout.starts_with(b"\x89PNG") && picture.status.success(), "{}", printed(&picture));
    let picture = daemon.motorctl(&["plot", path, "base"]);
    let svg = String::from_utf8_lossy(&picture.stdout).into_owned();
    assert!(svg.contains("base: angular velocity, rad/s"), "{}", printed(&picture));
    let unknown = daemon.motorctl(&["plot", path, "elbow"]);
    assert!(status(&unknown) == 64 && printed(&unknown).contains("fl-knee"), "{}", printed(&unknown));

    let programs = Path::new(env!("CARGO_BIN_EXE_motorctl")).parent().unwrap();
    let search = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let Some(tmux) = Tmux::start(&[("PATH", &search)]) else { return };
    tmux.enter(&format!("motorctl replay {path}"));
    tmux.until("the recording", |screen| screen.contains("RECORDING") && screen.contains("fl-knee"));
    assert!(!tmux.screen().contains("e-stop"), "{}", tmux.screen());
    // Room for the path of the recording.
    tmux.resize(160, 40);
    tmux.until("its end", |screen| screen.contains("the end: no key reaches a robot"));
    tmux.press(&["?"]);
    tmux.until("the help", |screen| screen.contains("no key reaches a robot.") && !screen.contains("e-stop"));
    tmux.press(&["q"]);
    tmux.assert_given_back();
}

#[test]
fn exiting_daemon_ends_recording_with_complete_file() {
    let mut daemon = Daemon::start(&slow_quadruped());
    drop(daemon.connect());
    let file = daemon.directory.path().join("run.mcap");
    let recorder = daemon.command(&["record", file.to_str().unwrap(), "--json"]);
    let mut recorder = recorder;
    let recorder = recorder.stdout(std::process::Stdio::piped()).spawn().unwrap();
    daemon::until("the file", || std::fs::metadata(&file).ok().filter(|file| file.len() > 0));
    daemon.kill();
    let output = recorder.wait_with_output().unwrap();
    assert_eq!(status(&output), 69);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&report["ended"], &report["dropped"]), (&"daemon".into(), &0.into()), "{report}");
    let picture = daemon.motorctl(&["plot", file.to_str().unwrap(), "fl-hip"]);
    assert!(picture.status.success() && printed(&picture).is_empty(), "{}", printed(&picture));
}

#[test]
fn renamed_recording_has_its_name_when_complete() {
    let daemon = Daemon::start(&slow_quadruped());
    drop(daemon.connect());
    let file = daemon.directory.path().join("run.mcap");
    let (path, growing) = (file.to_str().unwrap(), daemon.directory.path().join("run.mcap.unfinished"));
    let recorder = daemon.command(&["record", path, "--rename"]).spawn().unwrap();
    daemon::until("the growing file", || growing.is_file().then_some(()));
    assert!(!file.exists());
    kill(Pid::from_raw(recorder.id().cast_signed()), Signal::SIGINT).unwrap();
    assert!(recorder.wait_with_output().unwrap().status.success());
    assert!(file.is_file() && !growing.exists());
    let again = daemon.motorctl(&["record", path, "--seconds", "1", "--rename"]);
    assert!(status(&again) == 74 && !growing.exists(), "an old recording is kept: {}", printed(&again));
}

#[test]
fn file_without_recording_is_refused_by_name() {
    let daemon = Daemon::start(&slow_quadruped());
    let directory = daemon.directory.path();
    std::fs::write(directory.join("text.mcap"), "not a recording").unwrap();
    for command in [&["plot", "text.mcap", "fl-hip"][..], &["replay", "text.mcap"]] {
        let output = daemon.command(command).current_dir(directory).output().unwrap();
        assert!(status(&output) == 65 && printed(&output).contains("text.mcap"), "{}", printed(&output));
    }
    let output = daemon.motorctl(&["replay", "/nowhere/run.mcap"]);
    assert_eq!(status(&output), 65, "{}", printed(&output));
}

/// `motorctl flight`, which writes its lines to a file, until the end of the test.
struct FlightRecorder {
    process: Child,
    directory: PathBuf,
    log: PathBuf,
}

impl FlightRecorder {
    fn start(daemon: &Daemon) -> Self {
        let directory = daemon.directory.path().join("flight");
        let log = daemon.directory.path().join("flight.log");
        std::fs::create_dir(&directory).unwrap();
        let mut command = daemon.command(&["flight", "--seconds", "5", "--after", "0.2", "--files", "2"]);
        let process = command.arg(&directory).stderr(File::create(&log).unwrap()).spawn().unwrap();
        let recorder = Self { process, directory, log };
        recorder.until("a stop is written to", 1);
        recorder
    }

    /// Waits until its lines contain `text` this often.
    fn until(&self, text: &str, times: usize) {
        daemon::until(text, || {
            let log = std::fs::read_to_string(&self.log).unwrap();
            (log.matches(text).count() >= times).then_some(())
        });
    }

    /// The names of its files, oldest first.
    fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(&self.directory).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort_unstable();
        names
    }
}

impl Drop for FlightRecorder {
    fn drop(&mut self) {
        let _exited = self.process.kill();
        let _status = self.process.wait();
    }
}

fn stop_and_reset(daemon: &Daemon) {
    assert!(daemon.motorctl(&["estop"]).status.success());
    daemon.await_status(|status| status["groups"][0]["stop"]["cause"] == "emergency-stop");
    daemon::until("a reset", || daemon.motorctl(&["reset", "legs"]).status.success().then_some(()));
}

#[test]
fn each_stop_is_written_and_file_count_limited() {
    let mut daemon = Daemon::start(&slow_quadruped());
    drop(daemon.connect());
    let recorder = FlightRecorder::start(&daemon);
    std::fs::write(recorder.directory.join("notes.mcap"), "").unwrap();
    for stops in 1..=3 {
        stop_and_reset(&daemon);
        recorder.until(" cycles", stops);
        // The names have a resolution of a second.
        std::thread::sleep(Duration::from_secs(1));
    }
    daemon.kill();
    recorder.until("daemon-gone", 1);
    recorder.until(" cycles", 4);
    let files = daemon::until("the removal of the oldest", || {
        Some(recorder.files()).filter(|files| files.len() == 3)
    });
    assert!(
        files[0].ends_with("-emergency-stop.mcap") && files[1].ends_with("-daemon-gone.mcap"),
        "{files:?}"
    );
    assert_eq!(files[2], "notes.mcap", "no file of its own");
    let stop = recorder.directory.join(&files[0]);
    let picture = daemon.motorctl(&["plot", stop.to_str().unwrap(), "fl-knee"]);
    assert!(picture.status.success() && printed(&picture).is_empty(), "{}", printed(&picture));
}

#[test]
fn failing_disk_loses_only_that_file() {
    let daemon = Daemon::start(&slow_quadruped());
    drop(daemon.connect());
    let recorder = FlightRecorder::start(&daemon);
    std::fs::remove_dir(&recorder.directory).unwrap();
    stop_and_reset(&daemon);
    recorder.until("is not written", 1);
    std::fs::create_dir(&recorder.directory).unwrap();
    stop_and_reset(&daemon);
    recorder.until(" cycles", 1);
    let files = daemon::until("the file", || Some(recorder.files()).filter(|files| files.len() == 1));
    assert!(files[0].ends_with("-emergency-stop.mcap"), "{files:?}");
}

/// A pipe may never get a writer, and a device may have no end.
#[test]
fn pipes_and_devices_are_no_recordings() {
    let directory = tempfile::tempdir().unwrap();
    let pipe = directory.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for path in [pipe.to_str().unwrap(), "/dev/zero"] {
        for command in [&["plot", path, "hip"][..], &["replay", path], &["latency", path]] {
            let output =
                std::process::Command::new(env!("CARGO_BIN_EXE_motorctl")).args(command).output().unwrap();
            let is_named = printed(&output).contains("name a regular file");
            assert!(is_named && status(&output) != 0, "{command:?}: {}", printed(&output));
        }
    }
}
