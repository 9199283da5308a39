//! Processes that the demo starts, and that never outlive it.

use crate::demo::error::DemoError;
use nix::sys::prctl::set_pdeathsig;
use nix::sys::signal::{Signal, kill};
use nix::unistd::{Pid, getppid};
use std::ffi::{OsStr, OsString};
use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// How long a child may take to end by itself: the daemon damps for up to 2 s before it stops the motors.
const PATIENCE: Duration = Duration::from_secs(6);
/// How often a child is looked at while it ends.
const GLANCE: Duration = Duration::from_millis(10);

/// A child process. Dropping it ends the process, gently first.
#[derive(Debug)]
pub(crate) struct Child {
    process: std::process::Child,
}

impl Child {
    /// Starts `command` through `motorctl child-guard`, in a process group of its own: Ctrl-C reaches the demo alone, which
    /// then ends its children in order.
    ///
    /// Must be called on the main thread: the kernel ends the child when the thread that started it ends.
    ///
    /// # Errors
    ///
    /// When the process cannot be started.
    pub(crate) fn spawn(command: &Command, output: Stdio, errors: Stdio) -> io::Result<Self> {
        let mut guard = Command::new(std::env::current_exe()?);
        guard.args(["child-guard", &std::process::id().to_string(), "--"]);
        guard.arg(command.get_program()).args(command.get_args());
        let environment = command.get_envs().filter_map(|(key, value)| Some((key, value?)));
        guard.envs(environment).process_group(0);
        let process = guard.stdin(Stdio::null()).stdout(output).stderr(errors).spawn()?;
        Ok(Self { process })
    }

    /// Its standard output, when it was started with a pipe. Only the first call returns it.
    pub(crate) fn output(&mut self) -> Option<std::process::ChildStdout> {
        self.process.stdout.take()
    }

    /// Its exit status, when it has ended.
    ///
    /// # Errors
    ///
    /// When the kernel cannot tell.
    pub(crate) fn ended(&mut self) -> io::Result<Option<ExitStatus>> {
        self.process.try_wait()
    }

    /// Asks it to end, and waits. After [`PATIENCE`] it is killed, which its status then tells.
    ///
    /// # Errors
    ///
    /// When the kernel cannot tell how it ended.
    pub(crate) fn stop(&mut self) -> io::Result<ExitStatus> {
        if let Some(status) = self.process.try_wait()? {
            return Ok(status);
        }
        // Not reaped yet, so that the number is still this child's. An error would mean that it has just ended.
        let _ = kill(Pid::from_raw(self.process.id().cast_signed()), Signal::SIGTERM);
        self.wait(PATIENCE)
    }

    /// Waits until it ends by itself; after `patience` it is killed.
    ///
    /// # Errors
    ///
    /// When the kernel cannot tell how it ended.
    pub(crate) fn wait(&mut self, patience: Duration) -> io::Result<ExitStatus> {
        let deadline = Instant::now() + patience;
        while Instant::now() < deadline {
            if let Some(status) = self.process.try_wait()? {
                return Ok(status);
            }
            std::thread::sleep(GLANCE);
        }
        self.process.kill()?;
        self.process.wait()
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // Nobody is left to hear of a failure, and the kernel's own guard holds.
        let _ = self.stop();
    }
}

/// Becomes `program`, and dies with `parent`: SIGTERM comes when it ends, however it ends.
///
/// # Errors
///
/// Returns only when that is not possible.
pub(crate) fn guard(parent: u32, program: &OsStr, arguments: &[OsString]) -> DemoError {
    let doing = "start a process of the demo";
    if let Err(error) = set_pdeathsig(Signal::SIGTERM) {
        return DemoError::System { doing, source: error.into() };
    }
    // The parent may have died before the line above.
    if getppid() != Pid::from_raw(parent.cast_signed()) {
        return DemoError::Interrupted;
    }
    DemoError::System { doing, source: Command::new(program).args(arguments).exec() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bare(program: &str, arguments: &[&str]) -> Child {
        Child { process: Command::new(program).args(arguments).spawn().unwrap() }
    }

    #[test]
    fn a_dropped_child_is_gone() {
        let child = bare("sleep", &["60"]);
        let pid = Pid::from_raw(child.process.id().cast_signed());
        drop(child);
        assert_eq!(kill(pid, None), Err(nix::errno::Errno::ESRCH));
    }

    #[test]
    fn a_child_that_does_not_end_is_killed() {
        let mut child = bare("sleep", &["60"]);
        let status = child.wait(Duration::from_millis(50)).unwrap();
        assert!(!status.success());
    }

    #[test]
    fn a_child_that_ended_keeps_its_status() {
        let mut child = bare("sh", &["-c", "exit 3"]);
        assert_eq!(child.wait(PATIENCE).unwrap().code(), Some(3));
        assert_eq!(child.stop().unwrap().code(), Some(3));
    }
}
