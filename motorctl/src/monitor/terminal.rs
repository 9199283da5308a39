//! The terminal, as a resource that is given back: at the end, on an error, on a signal and on a
//! panic.

use super::events::Event;
use super::keys::{Input, Keys, SILENCE};
use super::view::is_stop;
use crossterm::event::{DisableBracketedPaste, EnableBracketedPaste};
use crossterm::{execute, terminal};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use ratatui::DefaultTerminal;
use std::io::{self, IsTerminal};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;

/// Returns true if input and output are a terminal that can place text.
pub(crate) fn is_there() -> bool {
    let is_dumb = std::env::var_os("TERM").is_none_or(|term| term == "dumb");
    !is_dumb && io::stdin().is_terminal() && io::stdout().is_terminal()
}

/// The terminal in raw mode, with its alternate screen. Dropping it gives it back as it was.
pub(super) struct Screen {
    /// To draw on.
    pub(super) terminal: DefaultTerminal,
    closed: Arc<AtomicBool>,
}

impl Screen {
    /// Takes the terminal; a panic gives it back before it is reported. From now on keys go to
    /// `events`. The key of the emergency stop calls `stop` at once: it does not wait until a slow
    /// terminal has taken the next picture.
    ///
    /// # Errors
    ///
    /// When the terminal cannot be set.
    pub(super) fn open(stop: impl Fn() + Send + 'static, events: &Sender<Event>) -> io::Result<Self> {
        let screen = Self { terminal: ratatui::try_init()?, closed: Arc::default() };
        // Without it a terminal passes pasted text as keys.
        execute!(io::stdout(), EnableBracketedPaste)?;
        let closed = Arc::clone(&screen.closed);
        super::events::start("motorctl-keys", events, move |events| {
            if let Err(error) = read_keys(&stop, &closed, events) {
                let _left = events.send(Event::Ended(format!("cannot read the keys: {error}")));
            }
        })?;
        Ok(screen)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.closed.store(true, Ordering::Relaxed);
        // A closed terminal needs no restoring.
        let _closed = execute!(io::stdout(), DisableBracketedPaste);
        let _closed = self.terminal.show_cursor();
        let _closed = ratatui::try_restore();
    }
}

/// Reads the terminal's bytes here: the reader of crossterm waits without a limit for the end mark
/// of a paste, and passes no key before it.
fn read_keys(stop: &impl Fn(), closed: &AtomicBool, events: &Sender<Event>) -> io::Result<()> {
    let mut keys = Keys::default();
    let (mut inputs, mut size) = (Vec::new(), terminal::size()?);
    while !closed.load(Ordering::Relaxed) {
        read(&mut keys, |input| inputs.push(input))?;
        if !inputs.drain(..).all(|input| pass_on(input, stop, events)) {
            break;
        }
        let now = terminal::size()?;
        if std::mem::replace(&mut size, now) != now && events.send(Event::Resized).is_err() {
            break;
        }
    }
    Ok(())
}

/// Passes the keys in the bytes that arrive within [`SILENCE`] to `done`.
fn read(keys: &mut Keys, mut done: impl FnMut(Input)) -> io::Result<()> {
    let stdin = io::stdin();
    let mut ready = [PollFd::new(stdin.as_fd(), PollFlags::POLLIN)];
    match poll(&mut ready, PollTimeout::from(SILENCE)) {
        Ok(0) => {
            keys.silent(done);
            return Ok(());
        }
        Ok(_) => {}
        Err(Errno::EINTR) => return Ok(()),
        Err(error) => return Err(error.into()),
    }
    let mut bytes = [0; 256];
    match nix::unistd::read(&stdin, &mut bytes) {
        Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
        Ok(count) => bytes[..count].iter().for_each(|byte| keys.read(*byte, &mut done)),
        Err(Errno::EINTR | Errno::EAGAIN) => {}
        Err(error) => return Err(error.into()),
    }
    Ok(())
}

/// Sends an input to the drawing thread without blocking. Returns false if that thread has ended.
/// Sends the key of a stop before the stop: otherwise the outcome could arrive first, and the
/// screen would wait for another one.
fn pass_on(input: Input, stop: &impl Fn(), events: &Sender<Event>) -> bool {
    match input {
        Input::Key(key) => {
            let listens = events.send(Event::Key(key)).is_ok();
            if is_stop(&key) {
                stop();
            }
            listens
        }
        Input::Pasted => events.send(Event::Pasted).is_ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::events::StopOutcome;
    use super::*;
    use crossterm::event::KeyCode;
    use motord_harness::tmux::Tmux;
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;

    #[test]
    fn confirmed_stop_is_shown_and_unseen_one_made() {
        let space = Input::Key(KeyCode::Char(' ').into());
        let (events, received) = std::sync::mpsc::channel();
        let confirmed = events.clone();
        assert!(pass_on(space, &|| confirmed.send(Event::Stop(StopOutcome::Confirmed)).unwrap(), &events));
        let shown: Vec<_> = received.try_iter().collect();
        assert!(matches!(shown[..], [Event::Key(_), Event::Stop(StopOutcome::Confirmed)]), "{shown:?}");
        drop(received);
        let stopped = AtomicBool::new(false);
        assert!(!pass_on(space, &|| stopped.store(true, Ordering::Relaxed), &events));
        assert!(stopped.into_inner());
    }

    /// Counts what it hears until `q`.
    #[test]
    #[ignore = "the process that another test runs in a terminal"]
    fn counting_process() {
        let (events, received) = std::sync::mpsc::channel();
        let mut screen = Screen::open(|| {}, &events).unwrap();
        let (pid, mut keys, mut sizes) = (std::process::id(), 0, 0);
        loop {
            let counted = format!("pid {pid} keys {keys} sizes {sizes} .");
            screen.terminal.draw(|frame| frame.render_widget(counted, frame.area())).unwrap();
            match received.recv().unwrap() {
                Event::Key(key) if key.code == KeyCode::Char('q') => break,
                Event::Key(_) => keys += 1,
                Event::Resized => sizes += 1,
                _ => {}
            }
        }
    }

    /// The key may be that of the emergency stop.
    #[test]
    fn simultaneous_key_and_resize_are_both_read() {
        let Some(tmux) = Tmux::start(&[]) else { return };
        let program = std::env::current_exe().unwrap();
        let line = "--ignored --exact --nocapture monitor::terminal::tests::counting_process";
        // Without `exec` the shell would take the terminal while the test holds the program with
        // SIGSTOP.
        tmux.enter(&format!("exec {} {line}", program.display()));
        let screen = tmux.until("the program", |screen| screen.contains("keys 0 sizes 0 ."));
        let pid = screen.split_whitespace().skip_while(|word| *word != "pid").nth(1).unwrap();
        let pid = Pid::from_raw(pid.parse().unwrap());
        let signal = |signal| kill(pid, signal).unwrap();
        for count in 1..=3 {
            signal(Signal::SIGSTOP);
            tmux.resize(80 + count, 24);
            tmux.press(&["x"]);
            signal(Signal::SIGCONT);
            tmux.until("both", |screen| screen.contains(&format!("keys {count} sizes {count} .")));
        }
        tmux.press(&["q"]);
    }

    /// Takes the terminal and panics.
    #[test]
    #[ignore = "the process that another test runs in a terminal"]
    fn panicking_process() {
        let (events, _kept) = std::sync::mpsc::channel();
        let _screen = Screen::open(|| {}, &events).unwrap();
        panic!("on purpose");
    }

    #[test]
    fn a_panic_gives_the_terminal_back() {
        let Some(tmux) = Tmux::start(&[]) else { return };
        let program = std::env::current_exe().unwrap();
        let line =
            "--ignored --exact --nocapture monitor::terminal::tests::panicking_process; echo status $?";
        tmux.enter(&format!("{} {line}", program.display()));
        tmux.until("the end", |screen| screen.contains("status 101"));
        assert!(tmux.screen().contains("on purpose"), "{}", tmux.screen());
        tmux.assert_given_back();
    }
}
