//! Daemons as processes, each with a separate runtime directory.

use crate::programs::program;
use motord_client::Client;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use std::fs::{self, OpenOptions};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Longest wait for an event on a busy machine.
pub const TIMEOUT: Duration = Duration::from_secs(30);

/// The instance `bench` with the motor `arm` on the bus `desk`: a low rate and long timeouts, so
/// that many daemons run side by side.
pub const BENCH: &str = r#"
[daemon]
instance = "bench"
[cycle]
rate-hz = 100
max-lateness-ms = 1000.0
[safety]
setpoint-timeout-ms = 1000.0
deadman-ms = 2000.0
[[bus]]
name = "desk"
type = "simulated"
[[motor]]
name = "arm"
bus = "desk"
id = 1
protocol = "mit"
model = "GIM8108-8"
"#;

/// Returns [`BENCH`] with another rate.
#[must_use]
pub fn bench_at(rate_hz: u32) -> String {
    BENCH.replace("rate-hz = 100", &format!("rate-hz = {rate_hz}"))
}

/// Returns the simulated bus `can` with a motor for each of the `joints`, ids from 1.
#[must_use]
pub fn simulated_bus(joints: &[&str]) -> String {
    let motor = |(id, name): (usize, &&str)| {
        format!("[[motor]]\nname = '{name}'\nbus = 'can'\nid = {id}\nprotocol = 'mit'\nmodel = 'GIM8108-8'\n")
    };
    let motors: String = (1..).zip(joints).map(motor).collect();
    format!("[[bus]]\nname = 'can'\ntype = 'simulated'\n{motors}")
}

/// The shipped simulated quadruped: the instance `demo` with the group `legs`, at 1 kHz.
///
/// # Panics
///
/// If the file cannot be read.
#[must_use]
pub fn quadruped() -> String {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/quadruped-simulated.toml");
    fs::read_to_string(config).expect("it is shipped")
}

/// The same with a low rate and long timeouts, so that it runs beside other tests.
///
/// # Panics
///
/// If the shipped file has other values.
#[must_use]
pub fn slow_quadruped() -> String {
    [
        ("rate-hz = 1000", "rate-hz = 100"),
        ("max-lateness-ms = 100.0", "max-lateness-ms = 1000.0"),
        ("setpoint-timeout-ms = 200.0", "setpoint-timeout-ms = 1000.0"),
        ("deadman-ms = 250.0", "deadman-ms = 2000.0"),
    ]
    .iter()
    .fold(quadruped(), |config, (shipped, slow)| {
        assert!(config.contains(shipped), "{shipped}");
        config.replace(shipped, slow)
    })
}

/// A running daemon, which is killed when it is dropped. Its log is printed if the test fails.
#[derive(Debug)]
pub struct Daemon {
    /// The process.
    pub process: Child,
    /// The runtime directory, which also holds the configuration `motord.toml`.
    pub directory: Arc<TempDir>,
    instance: String,
}

impl Daemon {
    /// Starts a daemon with this configuration in a new runtime directory.
    ///
    /// # Panics
    ///
    /// If it cannot be started.
    #[must_use]
    pub fn start(config: &str) -> Self {
        Self::start_in(TempDir::new().expect("there is room for a directory"), config, |_| {})
    }

    /// Starts a daemon in `directory`; `adjust` changes the command.
    ///
    /// # Panics
    ///
    /// If it cannot be started.
    #[must_use]
    pub fn start_in(
        directory: impl Into<Arc<TempDir>>,
        config: &str,
        adjust: impl FnOnce(&mut Command),
    ) -> Self {
        Self::launch(directory.into(), program("motord"), config, adjust)
    }

    /// Starts a daemon in `directory` by a shell `script`, which runs its arguments; `adjust`
    /// changes the command.
    ///
    /// # Panics
    ///
    /// If it cannot be started.
    #[must_use]
    pub fn start_by(
        script: &str,
        directory: impl Into<Arc<TempDir>>,
        config: &str,
        adjust: impl FnOnce(&mut Command),
    ) -> Self {
        let mut shell = Command::new("sh");
        shell.args(["-c", script, "sh"]).arg(program("motord").get_program());
        Self::launch(directory.into(), shell, config, adjust)
    }

    fn launch(
        directory: Arc<TempDir>,
        command: Command,
        config: &str,
        adjust: impl FnOnce(&mut Command),
    ) -> Self {
        fs::write(directory.path().join("motord.toml"), config).expect("the directory is writable");
        let instance = config.lines().find_map(|line| line.strip_prefix("instance = "));
        let instance = instance.expect("the configuration names an instance").trim_matches('"').to_owned();
        let process = Self::spawn(&directory, command, adjust);
        Self { process, directory, instance }
    }

    fn spawn(directory: &TempDir, mut command: Command, adjust: impl FnOnce(&mut Command)) -> Child {
        let log = OpenOptions::new().create(true).append(true).open(log_path(directory));
        command.arg("run").arg("--config").arg(directory.path().join("motord.toml"));
        command.env("MOTORD_RUNTIME_DIR", directory.path()).env_remove("MOTORD_INSTANCE");
        command.stderr(log.expect("a log can be created"));
        adjust(&mut command);
        command.spawn().expect("it is built")
    }

    /// Sends a signal to the daemon.
    ///
    /// # Panics
    ///
    /// If the process was waited for.
    pub fn signal(&self, signal: Signal) {
        kill(self.pid(), signal).expect("the process exists");
    }

    /// Returns the process id.
    #[must_use]
    pub fn pid(&self) -> Pid {
        Pid::from_raw(self.process.id().cast_signed())
    }

    /// Kills the daemon, as the kernel does when memory runs out.
    ///
    /// # Panics
    ///
    /// If the process was waited for.
    pub fn kill(&mut self) {
        self.process.kill().expect("the process exists");
        self.process.wait().expect("the process exists");
    }

    /// Starts the next daemon in the same directory.
    ///
    /// # Panics
    ///
    /// If it cannot be started.
    pub fn restart(&mut self) {
        self.restart_as(|_| {});
    }

    /// Starts the next daemon in the same directory; `adjust` changes the command.
    ///
    /// # Panics
    ///
    /// If it cannot be started.
    pub fn restart_as(&mut self, adjust: impl FnOnce(&mut Command)) {
        self.process = Self::spawn(&self.directory, program("motord"), adjust);
    }

    /// Waits until the daemon exits.
    ///
    /// # Panics
    ///
    /// If it does not exit within [`TIMEOUT`].
    pub fn wait(&mut self) -> ExitStatus {
        until("the end of the daemon", || self.process.try_wait().expect("it is a child"))
    }

    /// Ends the daemon as systemd does.
    ///
    /// # Panics
    ///
    /// If it does not exit within [`TIMEOUT`].
    pub fn end(&mut self) -> ExitStatus {
        self.signal(Signal::SIGTERM);
        self.wait()
    }

    /// Returns the log of all daemons in this directory.
    #[must_use]
    pub fn log(&self) -> String {
        fs::read_to_string(log_path(&self.directory)).unwrap_or_default()
    }

    /// Waits until the log contains `text`.
    ///
    /// # Panics
    ///
    /// If it does not within [`TIMEOUT`].
    pub fn await_log(&self, text: &str) {
        until(text, || self.log().contains(text).then_some(()));
    }

    /// `motorctl` for this instance.
    #[must_use]
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = program("motorctl");
        command.args(["--instance", &self.instance]).args(arguments);
        command.env("MOTORD_RUNTIME_DIR", self.directory.path());
        command
    }

    /// Runs `motorctl` for this instance.
    ///
    /// # Panics
    ///
    /// If it cannot be started.
    #[must_use]
    pub fn motorctl(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("it is built")
    }

    /// Returns what `motorctl status --json` prints; `null` without a daemon.
    #[must_use]
    pub fn status(&self) -> Value {
        serde_json::from_slice(&self.motorctl(&["status", "--json"]).stdout).unwrap_or_default()
    }

    /// Waits for a status that is as `wanted`.
    pub fn await_status(&self, wanted: impl Fn(&Value) -> bool) -> Value {
        until("the status", || Some(self.status()).filter(&wanted))
    }

    /// Connects a client, and waits until every motor answers.
    #[must_use]
    pub fn connect(&self) -> Client {
        let client = until("a connection", || Client::connect_in(self.directory.path(), &self.instance).ok());
        until("motors that answer", || {
            let state = client.wait(Duration::from_secs(1)).ok()?;
            state.joints().all(|joint| joint.fresh).then_some(())
        });
        client
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _exited = self.process.kill();
        let _status = self.process.wait();
        if std::thread::panicking() {
            eprintln!("log of motord:\n{}", self.log());
        }
        let _none = fs::remove_file(log_path(&self.directory));
    }
}

/// Returns the file of the log. It is beside the runtime directory, which tests fill and empty.
#[must_use]
pub fn log_path(directory: &TempDir) -> PathBuf {
    directory.path().with_extension("log")
}

/// Polls until `attempt` succeeds.
///
/// # Panics
///
/// If it does not succeed within [`TIMEOUT`].
pub fn until<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + TIMEOUT;
    loop {
        if let Some(found) = attempt() {
            return found;
        }
        assert!(Instant::now() < deadline, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(1));
    }
}
