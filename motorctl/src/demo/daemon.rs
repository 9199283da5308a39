//! The daemon of a demo.

use crate::demo::child::Child;
use crate::demo::error::{DemoError, READY_MAX};
use crate::demo::work_directory::WorkDirectory;
use motord_client::{Client, Error, RUNTIME_DIR_VARIABLE};
use motord_terminal::Interrupt;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Time between two attempts to connect.
const POLL: Duration = Duration::from_millis(50);
/// The names of the logs.
const DAEMON_LOG: &str = "motord.log";
const CONTROLLER_LOG: &str = "controller.log";

/// A running daemon with simulated motors. Dropping it stops it.
#[derive(Debug)]
pub(crate) struct Daemon<'a> {
    directory: &'a WorkDirectory,
    child: Child,
}

impl<'a> Daemon<'a> {
    /// Starts `motord run` in `directory`.
    ///
    /// # Errors
    ///
    /// When the executable is missing or cannot be started.
    pub(crate) fn start(directory: &'a WorkDirectory) -> Result<Self, DemoError> {
        let mut command = Command::new(executable()?);
        command.arg("run").arg("--config").arg(directory.config());
        command.env(RUNTIME_DIR_VARIABLE, directory.runtime());
        let child =
            directory.log(DAEMON_LOG).and_then(|log| Child::spawn(&command, Stdio::null(), log.into()));
        Ok(Self { directory, child: child.map_err(DemoError::system("start motord"))? })
    }

    /// Connects when the daemon is ready.
    ///
    /// # Errors
    ///
    /// The daemon ends or does not become ready, or a signal arrives.
    pub(crate) fn connect(&mut self, interrupt: &Interrupt) -> Result<Client, DemoError> {
        let deadline = Instant::now() + READY_MAX;
        loop {
            match Client::connect_in(self.directory.runtime(), self.directory.instance()) {
                Ok(client) => return Ok(client),
                // Its services appear one by one. It answers when all exist.
                Err(Error::NotRunning { .. } | Error::NoAnswer { .. }) => {}
                Err(error) => return Err(error.into()),
            }
            self.check()?;
            if Instant::now() > deadline {
                return Err(DemoError::NotReady { log: self.log() });
            }
            interrupt.pause_until(Instant::now() + POLL);
            if interrupt.is_raised() {
                return Err(DemoError::Interrupted);
            }
        }
    }

    /// Starts the controller process.
    ///
    /// # Errors
    ///
    /// When the process cannot be started.
    pub(crate) fn start_controller(&self, seconds: f64) -> Result<Child, DemoError> {
        let start = || {
            let mut command = Command::new(std::env::current_exe()?);
            command.args(["--instance", self.directory.instance(), "demo-controller", &seconds.to_string()]);
            command.env(RUNTIME_DIR_VARIABLE, self.directory.runtime());
            Child::spawn(&command, Stdio::piped(), self.directory.log(CONTROLLER_LOG)?.into())
        };
        start().map_err(DemoError::system("start the controller"))
    }

    /// The last lines of the controller process's log.
    pub(crate) fn controller_log(&self) -> String {
        self.directory.log_end(CONTROLLER_LOG)
    }

    /// Checks whether the daemon still runs.
    ///
    /// # Errors
    ///
    /// The daemon has ended.
    pub(crate) fn check(&mut self) -> Result<(), DemoError> {
        match self.child.ended().map_err(DemoError::system("check motord"))? {
            None => Ok(()),
            Some(status) => Err(DemoError::DaemonEnded { status, log: self.log() }),
        }
    }

    /// Stops it.
    ///
    /// # Errors
    ///
    /// The daemon ended with an error.
    pub(crate) fn stop(mut self) -> Result<(), DemoError> {
        let status = self.child.stop().map_err(DemoError::system("stop motord"))?;
        if status.success() { Ok(()) } else { Err(DemoError::DaemonStop { status, log: self.log() }) }
    }

    fn log(&self) -> String {
        self.directory.log_end(DAEMON_LOG)
    }
}

/// Returns the path of motord, next to motorctl.
fn executable() -> Result<PathBuf, DemoError> {
    let tool = std::env::current_exe().map_err(DemoError::system("find motord"))?;
    let daemon = tool.with_file_name("motord");
    if daemon.is_file() { Ok(daemon) } else { Err(DemoError::NoDaemon(daemon)) }
}
