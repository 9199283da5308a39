//! A terminal of tmux with a shell, for programs that draw on the whole screen.

use crate::programs::lacks;
use std::process::{Command, Output};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Longest wait for a screen on a busy machine.
const TIMEOUT: Duration = Duration::from_secs(30);
const GLANCE: Duration = Duration::from_millis(50);

/// A server of tmux with one terminal of 80x24, which ends when it is dropped.
#[derive(Debug)]
pub struct Tmux {
    socket: String,
}

impl Tmux {
    /// Starts a shell with `environment`. Prints a note and returns `None` on a machine without
    /// tmux.
    ///
    /// # Panics
    ///
    /// If tmux fails.
    #[must_use]
    pub fn start(environment: &[(&str, &str)]) -> Option<Self> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        if lacks(&["tmux", "bash"]) {
            return None;
        }
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let tmux = Self { socket: format!("motorctl-test-{}-{number}", std::process::id()) };
        let variables = environment.iter().map(|(name, value)| format!("{name}='{value}' "));
        let shell = format!("exec env {} PS1='$ ' bash --norc --noprofile", variables.collect::<String>());
        let arguments = ["new-session", "-d", "-x80", "-y24", &shell];
        let started = tmux.run(&arguments);
        assert!(started.status.success(), "{started:?}");
        tmux.until("a shell", |screen| screen.contains('$'));
        Some(tmux)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new("tmux");
        command.args(["-u", "-f", "/dev/null", "-L", &self.socket]).args(arguments);
        command.env_remove("TMUX").env("LC_ALL", "C.UTF-8").output().expect("tmux is installed")
    }

    /// Returns the text on the screen.
    #[must_use]
    pub fn screen(&self) -> String {
        String::from_utf8_lossy(&self.run(&["capture-pane", "-p"]).stdout).into_owned()
    }

    /// Presses keys, which have the names of tmux.
    pub fn press(&self, keys: &[&str]) {
        self.run(&[&["send-keys"], keys].concat());
    }

    /// Types a line for the shell.
    pub fn enter(&self, line: &str) {
        self.press(&["-l", line]);
        self.press(&["Enter"]);
    }

    /// Sends bytes as they are.
    pub fn send(&self, bytes: &[u8]) {
        let bytes: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        let bytes: Vec<&str> = bytes.iter().map(String::as_str).collect();
        self.run(&[&["send-keys", "-H"], bytes.as_slice()].concat());
    }

    /// Pastes text, as bracketed paste if the program has asked for it.
    pub fn paste(&self, text: &str) {
        self.run(&["set-buffer", text]);
        self.run(&["paste-buffer", "-p"]);
    }

    /// Resizes the terminal.
    pub fn resize(&self, width: u16, height: u16) {
        self.run(&["resize-window", "-x", &width.to_string(), "-y", &height.to_string()]);
    }

    /// Waits until the screen is as it should be, and returns it.
    ///
    /// # Panics
    ///
    /// If that takes longer than 30 s.
    pub fn until(&self, what: &str, mut is_so: impl FnMut(&str) -> bool) -> String {
        let deadline = Instant::now() + TIMEOUT;
        loop {
            let screen = self.screen();
            if is_so(&screen) {
                return screen;
            }
            assert!(Instant::now() < deadline, "{what} did not appear:\n{screen}");
            std::thread::sleep(GLANCE);
        }
    }

    /// Asserts that the terminal is restored: the shell's screen, line mode, echo and the cursor.
    ///
    /// # Panics
    ///
    /// If it is not.
    pub fn assert_given_back(&self) {
        self.press(&["C-l"]);
        self.enter("stty -a | grep -ow -e '-*icanon' -e '-*echo' | tr '\\n' ' '; echo =");
        self.until("the shell's modes", |screen| screen.contains("icanon echo ="));
        let flags = self.run(&["display-message", "-p", "#{alternate_on} #{cursor_flag}"]);
        assert_eq!(String::from_utf8_lossy(&flags.stdout).trim(), "0 1", "alternate screen, cursor");
    }
}

impl Drop for Tmux {
    fn drop(&mut self) {
        self.run(&["kill-server"]);
    }
}
