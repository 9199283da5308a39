//! The monitor as a person uses it: the real program in a terminal of tmux, keys pressed, with a real daemon of simulated
//! motors and a controller. The pictures themselves are judged beside the code that draws them.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

mod tmux;

use motord_client::{Claim, Client, Error, Phase, Setpoint, State};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tmux::Tmux;

const PATIENCE: Duration = Duration::from_secs(30);

/// The shipped simulated quadruped, slow, so that it runs beside other tests.
struct Daemon {
    process: Child,
    directory: TempDir,
}

impl Daemon {
    fn start() -> Self {
        let directory = TempDir::new().unwrap();
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/quadruped-simulated.toml");
        let robot = std::fs::read_to_string(config).unwrap().replace("rate-hz = 1000", "rate-hz = 100");
        std::fs::write(directory.path().join("robot.toml"), robot).unwrap();
        Self { process: Self::spawn(&directory), directory }
    }

    fn spawn(directory: &TempDir) -> Child {
        let motord = Path::new(env!("CARGO_BIN_EXE_motorctl")).with_file_name("motord");
        assert!(motord.is_file(), "{} is missing: run `cargo build --workspace` first", motord.display());
        let mut command = Command::new(motord);
        command.arg("run").arg("--config").arg(directory.path().join("robot.toml"));
        command.env("MOTORD_RUNTIME_DIR", directory.path()).stderr(Stdio::null()).spawn().unwrap()
    }

    fn kill(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }

    fn connect(&self) -> Client {
        let client = until("a connection", || Client::connect_in(self.directory.path(), "demo").ok());
        until("a standing robot", || {
            let state = client.wait(Duration::from_secs(1)).ok()?;
            state.joints().all(|joint| joint.fresh).then_some(())
        });
        client
    }

    fn terminal(&self) -> Option<Tmux> {
        let programs = Path::new(env!("CARGO_BIN_EXE_motorctl")).parent().unwrap();
        let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
        let runtime = self.directory.path().to_str().unwrap();
        Tmux::start(&[("PATH", &path), ("MOTORD_RUNTIME_DIR", runtime)])
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _status = self.process.wait();
    }
}

fn until<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = attempt() {
            return found;
        }
        assert!(Instant::now() < deadline, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Holds the legs where they are, until `end`; enables them when `enable` says so.
fn hold(client: &Client, end: &AtomicBool, enable: &AtomicBool, newest: &Mutex<Option<State>>) {
    let mut claim: Option<Claim> = None;
    while !end.load(Ordering::Relaxed) {
        let Ok(state) = client.wait(Duration::from_secs(1)) else { continue };
        *newest.lock().unwrap() = Some(state);
        let positions = state.joints().map(|joint| joint.position().unwrap_or_default());
        let hold: Vec<_> =
            positions.map(|position| Setpoint::impedance(position, 0.0, 5.0, 0.5, 0.0)).collect();
        if claim.is_none() {
            claim = client.claim("legs").ok();
        }
        let Some(claim) = &mut claim else { continue };
        let sent: Result<(), Error> = claim.send(&hold);
        if sent.is_ok() && enable.load(Ordering::Relaxed) && claim.enable().is_ok() {
            enable.store(false, Ordering::Relaxed);
        }
    }
}

/// Goal: from one screen a person sees who moves the robot, stops it with one key, learns the cause and the way back, and goes
/// it. Method: keys of tmux; the screen and the daemon's states are judged.
#[test]
fn keys_stop_reset_and_disable_a_robot_and_the_screen_tells_it() {
    let daemon = Daemon::start();
    let Some(tmux) = daemon.terminal() else { return };
    let client = daemon.connect();
    let (end, enable, newest) = (AtomicBool::new(false), AtomicBool::new(true), Mutex::new(None));
    let phase = || newest.lock().unwrap().and_then(|state: State| state.group(0)?.phase);
    let is_stopped = || newest.lock().unwrap().is_some_and(|state: State| state.emergency_stop());
    std::thread::scope(|scope| {
        scope.spawn(|| hold(&client, &end, &enable, &newest));
        let all = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            until("motion", || (phase() == Some(Phase::Active)).then_some(()));
            tmux.enter("motorctl --instance demo monitor");
            let owner = format!("({})", std::process::id());
            let screen =
                tmux.until("the owner", |screen| screen.contains(&owner) && screen.contains("legs  active"));
            assert!(screen.contains("owner ") && !screen.contains("owner lease"), "{screen}");
            assert!(screen.contains("rr-knee") && screen.contains("front-left active"), "{screen}");

            tmux.press(&["Space"]);
            let screen = tmux.until("the stop", |screen| screen.contains("emergency stop confirmed"));
            assert!(is_stopped() && screen.contains(&owner), "{screen}");
            tmux.until("the cause", |screen| {
                screen.contains("STOPPED 0 s ago, legs: An emergency stop was requested.")
                    && screen.contains("motorctl --instance demo reset legs")
            });
            until("rest", || (phase() == Some(Phase::Disarmed)).then_some(()));
            tmux.press(&["r"]);
            tmux.until("the reset", |screen| screen.contains("legs: reset") && !screen.contains("STOPPED"));
            assert!(!is_stopped());

            enable.store(true, Ordering::Relaxed);
            until("motion", || (phase() == Some(Phase::Active)).then_some(()));
            tmux.press(&["d"]);
            tmux.until("the disabling", |screen| screen.contains("legs: being damped, then stopped"));
            until("rest", || (phase() == Some(Phase::Disarmed)).then_some(()));
        }));
        end.store(true, Ordering::Relaxed);
        all.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    });
    tmux.press(&["q"]);
    tmux.until("the shell", |screen| screen.trim_end().ends_with('$'));
    tmux.assert_given_back();
}

#[test]
fn pages_filters_and_sizes_follow_the_keys_and_the_terminal() {
    let daemon = Daemon::start();
    let Some(tmux) = daemon.terminal() else { return };
    let _client = daemon.connect();
    // On a terminal the watch is the monitor.
    tmux.enter("motorctl --instance demo watch");
    tmux.until("the joints", |screen| screen.contains("fl-hip"));
    tmux.press(&["/"]);
    tmux.press(&["-l", "knee"]);
    tmux.press(&["Enter"]);
    tmux.until("the knees", |screen| screen.contains("rr-knee") && !screen.contains("hip"));
    tmux.press(&["Escape"]);
    tmux.until("every joint", |screen| screen.contains("fl-hip"));
    tmux.press(&["Tab"]);
    tmux.until("the buses", |screen| screen.contains("malformed") && !screen.contains("fl-hip"));
    tmux.press(&["?"]);
    tmux.until("the help", |screen| screen.contains("SPACE     emergency stop"));
    tmux.press(&["1"]);
    tmux.resize(60, 20);
    tmux.until("the narrow joints", |screen| screen.contains("fl-hip") && !screen.contains("N·m"));
}

#[test]
fn a_signal_gives_the_terminal_back_and_a_restarted_daemon_is_found() {
    let mut daemon = Daemon::start();
    let Some(tmux) = daemon.terminal() else { return };
    drop(daemon.connect());
    tmux.enter("motorctl --instance demo monitor & echo $! >$MOTORD_RUNTIME_DIR/pid; fg");
    tmux.until("the joints", |screen| screen.contains("rr-knee"));
    daemon.kill();
    tmux.until("the loss", |screen| screen.contains("NO CONTACT for") && screen.contains("rr-knee"));
    daemon.process = Daemon::spawn(&daemon.directory);
    tmux.until("the next daemon", |screen| {
        screen.contains(&format!("({})", daemon.process.id())) && !screen.contains("NO CONTACT")
    });
    let pid = std::fs::read_to_string(daemon.directory.path().join("pid")).unwrap();
    let pid = nix::unistd::Pid::from_raw(pid.trim().parse().unwrap());
    nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGTERM).unwrap();
    tmux.until("the shell", |screen| !screen.contains("rr-knee"));
    tmux.assert_given_back();
}
