//! Processes of this test program that play other processes.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use nix::unistd::{Gid, Uid, setgid, setgroups, setuid};
use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

/// A process that plays a role. It is killed when the value is dropped.
pub(crate) struct Player(Child);

impl Player {
    /// Runs the test `role` of this program with `variables`, and waits until it prints `ready`.
    pub(crate) fn start(role: &str, variables: &[(&str, &OsStr)], ready: &str) -> Self {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", role, "--nocapture"]).envs(variables.iter().copied());
        let mut player = Self(command.stdout(Stdio::piped()).spawn().unwrap());
        let lines = BufReader::new(player.0.stdout.take().unwrap()).lines();
        assert!(lines.map_while(Result::ok).any(|line| line.contains(ready)), "{role} is not {ready}");
        player
    }

    /// Returns its process id.
    pub(crate) fn id(&self) -> u32 {
        self.0.id()
    }
}

impl Drop for Player {
    fn drop(&mut self) {
        let _dead_already = self.0.kill();
        let _reaped = self.0.wait();
    }
}

/// Makes this process one of the user and the group `id`. Needs root.
pub(crate) fn become_user(id: u32) {
    let (user, group) = (Uid::from_raw(id), Gid::from_raw(id));
    setgroups(&[group]).and_then(|()| setgid(group)).and_then(|()| setuid(user)).unwrap();
}
