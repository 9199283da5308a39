//! A call of motorctl at a pseudo terminal, and its output.

use super::{Calls, Line};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::openpty;
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

/// Longest wait for a text on a busy machine.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A process whose input and output are a pseudo terminal. It is killed when this is dropped.
pub(crate) struct Terminal {
    screen: File,
    child: Child,
    /// Printed text that was not yet expected.
    text: String,
}

impl Terminal {
    /// Runs motorctl with the arguments of `call`, as [`Calls::command`] does.
    pub(crate) fn start(line: &Line, call: &str) -> Self {
        let pty = openpty(None, None).unwrap();
        let end = || pty.slave.try_clone().unwrap();
        let child = line.command(call).stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
        Self { screen: pty.master.into(), child, text: String::new() }
    }

    /// Waits until `wanted` is printed, and returns what was printed up to there.
    pub(crate) fn expect(&mut self, wanted: &str) -> String {
        let deadline = Instant::now() + TIMEOUT;
        loop {
            if let Some(at) = self.text.find(wanted) {
                let rest = self.text.split_off(at + wanted.len());
                return std::mem::replace(&mut self.text, rest);
            }
            assert!(Instant::now() < deadline, "not printed: {wanted}\n{}", self.text);
            assert!(self.read(), "ended without {wanted}\n{}", self.text);
        }
    }

    /// Reads what is printed within a moment. Returns `false` when the process has ended.
    fn read(&mut self) -> bool {
        let timeout = PollTimeout::from(50_u8);
        if poll(&mut [PollFd::new(self.screen.as_fd(), PollFlags::POLLIN)], timeout) != Ok(1) {
            return true;
        }
        let mut bytes = [0; 4096];
        let Ok(count) = self.screen.read(&mut bytes) else { return false };
        self.text += &String::from_utf8_lossy(&bytes[..count]);
        true
    }

    /// Types a line. The program drops what was typed before its question.
    pub(crate) fn enter(&mut self, line: &str) {
        std::thread::sleep(Duration::from_millis(100));
        self.screen.write_all(format!("{line}\n").as_bytes()).unwrap();
    }

    /// Waits for `question`, and answers.
    pub(crate) fn answer(&mut self, question: &str, line: &str) {
        self.expect(question);
        self.enter(line);
    }

    /// Waits until the number after `label` is one that `fits`.
    pub(crate) fn until(&mut self, label: &str, fits: impl Fn(f64) -> bool) {
        loop {
            self.expect(label);
            let number = self.expect("°");
            if number.trim_end_matches('°').parse().is_ok_and(&fits) {
                return;
            }
        }
    }

    /// Kills the process as a power cut would.
    pub(crate) fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    pub(crate) fn process(&self) -> u32 {
        self.child.id()
    }

    /// Waits for the end of the process. Returns its status and the rest that it printed.
    pub(crate) fn end(mut self) -> (ExitStatus, String) {
        let deadline = Instant::now() + TIMEOUT;
        loop {
            self.read();
            if let Some(status) = self.child.try_wait().unwrap() {
                self.read();
                return (status, std::mem::take(&mut self.text));
            }
            assert!(Instant::now() < deadline, "does not end\n{}", self.text);
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ended = self.child.kill();
        let _status = self.child.wait();
    }
}
