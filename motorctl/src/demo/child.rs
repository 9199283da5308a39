//! Child processes of the demo. They never outlive it.

use crate::demo::error::DemoError;
use nix::sys::prctl::set_pdeathsig;
use nix::sys::signal::{Signal, kill};
use nix::unistd::{Pid, getppid};
use std::ffi::{OsStr, OsString};
use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Longest wait for the exit of a child. The daemon damps for up to 2 s before it stops the motors.
const TIMEOUT: Duration = Duration::from_secs(6);
/// Time between two checks of a child that exits.
const GLANCE: Duration = Duration::from_millis(10);

/// A child process. Dropping it terminates the process, and kills it after [`TIMEOUT`].
#[derive(Debug)]
pub(crate) struct Child {
    process: std::process::Child,
}

impl Child {
    /// Starts `command` through `motorctl child-guard`, in a separate process group. Ctrl-C reaches
    /// only the demo, which ends its children in order.
    ///
    /// Call this on the main thread: the kernel ends the child when the thread that started it
    /// ends.
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

    /// Returns its standard output if it was started with a pipe. Only the first call returns it.
    pub(crate) fn output(&mut self) -> Option<std::process::ChildStdout> {
        self.process.stdout.take()
    }

    /// Returns its exit status after its exit.
    ///
    /// # Errors
    ///
    /// The kernel does not return the state.
    pub(crate) fn ended(&mut self) -> io::Result<Option<ExitStatus>> {
        self.process.try_wait()
    }

    /// Sends SIGTERM and waits. Kills the process after [`TIMEOUT`], which its status shows.
    ///
    /// # Errors
    ///
    /// The kernel does not return the exit status.
    pub(crate) fn stop(&mut self) -> io::Result<ExitStatus> {
        if let Some(status) = self.process.try_wait()? {
            return Ok(status);
        }
        // The child is not reaped yet, so the number is valid. An error means that it has just
        // exited.
        let _ = kill(Pid::from_raw(self.process.id().cast_signed()), Signal::SIGTERM);
        self.wait(TIMEOUT)
    }

    /// Waits for its exit. Kills it after `timeout`.
    ///
    /// # Errors
    ///
    /// The kernel does not return the exit status.
    pub(crate) fn wait(&mut self, timeout: Duration) -> io::Result<ExitStatus> {
        let deadline = Instant::now() + timeout;
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
        // A drop cannot report an error. The kernel's parent-death signal remains.
        let _ = self.stop();
    }
}

/// Replaces this process by `program`, which receives SIGTERM when `parent` ends.
///
/// # Errors
///
/// Returns only on failure.
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
    fn dropped_child_has_exited() {
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
        assert_eq!(child.wait(TIMEOUT).unwrap().code(), Some(3));
        assert_eq!(child.stop().unwrap().code(), Some(3));
    }
}
