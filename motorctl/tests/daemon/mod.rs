//! A daemon of a test, as the program that was built beside it, in a directory of its own.

#![allow(dead_code, reason = "each test program uses a part of it")]

use motord_client::Client;
use serde_json::Value;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// How long something may take on a busy machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// An instance `bench` with the motor `arm` on the bus `desk`. Slow and patient, so that many of them run side by side.
pub(crate) const BENCH: &str = r#"
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

/// The shipped simulated quadruped: the instance `demo` with the group `legs`, at 1 kHz.
pub(crate) fn quadruped() -> String {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/quadruped-simulated.toml");
    std::fs::read_to_string(config).unwrap()
}

/// The same, slow and patient, so that it runs beside other tests.
pub(crate) fn slow_quadruped() -> String {
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

/// A running daemon, which ends with the test.
pub(crate) struct Daemon {
    pub(crate) process: Child,
    pub(crate) directory: TempDir,
    instance: String,
}

impl Daemon {
    /// Starts a daemon with this configuration, `motord.toml` in its directory, which is its runtime directory, too.
    pub(crate) fn start(config: &str) -> Self {
        let directory = TempDir::new().unwrap();
        std::fs::write(directory.path().join("motord.toml"), config).unwrap();
        let instance = config.lines().find_map(|line| line.strip_prefix("instance = ")).unwrap();
        Self { process: Self::spawn(&directory), directory, instance: instance.trim_matches('"').to_owned() }
    }

    fn spawn(directory: &TempDir) -> Child {
        let motord = Path::new(env!("CARGO_BIN_EXE_motorctl")).with_file_name("motord");
        assert!(motord.is_file(), "{} is missing: run `cargo build --workspace` first", motord.display());
        let mut command = Command::new(motord);
        command.arg("run").arg("--config").arg(directory.path().join("motord.toml"));
        command.env("MOTORD_RUNTIME_DIR", directory.path()).stderr(Stdio::null()).spawn().unwrap()
    }

    /// Kills it, as a lack of memory does.
    pub(crate) fn kill(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }

    /// Starts the next one, after a kill.
    pub(crate) fn restart(&mut self) {
        self.process = Self::spawn(&self.directory);
    }

    /// `motorctl` for this instance.
    pub(crate) fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_motorctl"));
        command.args(["--instance", &self.instance]).args(arguments);
        command.env("MOTORD_RUNTIME_DIR", self.directory.path());
        command
    }

    pub(crate) fn motorctl(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    pub(crate) fn status(&self) -> Value {
        serde_json::from_slice(&self.motorctl(&["status", "--json"]).stdout).unwrap_or_default()
    }

    /// The first status that is as `wanted`.
    pub(crate) fn await_status(&self, wanted: impl Fn(&Value) -> bool) -> Value {
        until("the status", || Some(self.status()).filter(&wanted))
    }

    /// A client of the daemon, once every motor answers.
    pub(crate) fn connect(&self) -> Client {
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
        let _gone = self.process.kill();
        let _status = self.process.wait();
    }
}

/// Tries until the attempt succeeds.
pub(crate) fn until<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = attempt() {
            return found;
        }
        assert!(Instant::now() < deadline, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(1));
    }
}
