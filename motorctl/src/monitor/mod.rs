//! `motorctl monitor`: the robot on the whole terminal, with keys for stops.
//!
//! ```text
//! reader ── states, telemetry ──┐
//! keys ──── keys ───────────────┼──▶ the thread that draws ──▶ terminal
//!   └─ emergency stop ─▶ stop ──┤            │
//!                        ask ◀──┴── disable, reset
//! ```

mod draw;
mod events;
mod keys;
mod picture;
mod replay;
mod request;
mod selection;
mod terminal;
#[cfg(test)]
mod tests;
mod trends;
mod view;

pub(crate) use replay::{ReplayArguments, run as replay};
pub(crate) use terminal::is_there;

use crate::failure::Failure;
use crate::status::{self, TIMEOUT};
use events::Event;
use motord_client::Client;
use motord_terminal::Interrupt;
use picture::{Loss, Picture};
use request::{Notice, Question, Requests, Tone};
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::{Duration, Instant};
use terminal::Screen;
use view::{Action, View};

/// Time between two pictures without messages. They show how long the daemon has been unavailable.
const TURN: Duration = Duration::from_millis(250);

/// Shows the robot until a key or a signal ends it.
///
/// # Errors
///
/// No daemon runs at the start, there is no terminal, or the terminal is closed. Later the daemon
/// may restart.
pub(crate) fn run(instance: &str, hz: f64) -> Result<(), Failure> {
    let interrupt = Interrupt::register();
    let client = Arc::new(status::connect(instance)?);
    if !is_there() {
        return Err(Failure::NoTerminal);
    }
    let mut monitor = Monitor::open(client, Some(instance), hz)?;
    while !interrupt.is_raised() {
        match monitor.turn(TURN) {
            Ok(true) => {}
            Ok(false) => break,
            // The terminal was closed: end by its signal.
            Err(_) if interrupt.is_raised() => break,
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// The monitor on the terminal. Dropping it restores the terminal.
pub(crate) struct Monitor {
    screen: Screen,
    requests: Requests,
    events: Receiver<Event>,
    picture: Picture,
    view: View,
    notice: Notice,
    lost_since: Option<Instant>,
}

impl Monitor {
    /// Takes the terminal, and reads the state `hz` times a second. If an emergency stop over
    /// `client` fails, it is sent again over a new connection to `instance`.
    ///
    /// # Errors
    ///
    /// The terminal cannot be set, or a thread cannot be started.
    pub(crate) fn open(client: Arc<Client>, instance: Option<&str>, hz: f64) -> io::Result<Self> {
        client.set_silence(TIMEOUT);
        let (sender, events): (Sender<Event>, _) = mpsc::channel();
        let requests = Requests::start(&client, instance, &sender)?;
        let stopping = requests.clone();
        let screen = Screen::open(move || stopping.stop(), &sender)?;
        let period = Duration::from_secs_f64(1.0 / hz);
        events::start("motorctl-read", &sender, move |events| events::read(&client, period, events))?;
        Ok(Self {
            screen,
            requests,
            events,
            picture: Picture::default(),
            view: View::of_stdout(),
            notice: Notice::default(),
            lost_since: None,
        })
    }

    /// Shows the progress of the program that opened the monitor.
    pub(crate) fn show_progress(&mut self, progress: String) {
        self.notice.progress = Some(progress);
    }

    /// Draws, and handles messages for at most `at_most`. Returns false when the user quits.
    ///
    /// # Errors
    ///
    /// The terminal cannot be written or read.
    pub(crate) fn turn(&mut self, at_most: Duration) -> io::Result<bool> {
        if let (Some(loss), Some(since)) = (&mut self.picture.loss, self.lost_since) {
            loss.lasting = since.elapsed();
        }
        let Self { screen, picture, view, notice, .. } = self;
        screen.terminal.draw(|frame| draw::draw(frame, picture, view, notice))?;
        let mut events = self.events.recv_timeout(at_most).ok();
        while let Some(message) = events {
            if !self.take(message)? {
                return Ok(false);
            }
            events = self.events.try_recv().ok();
        }
        Ok(true)
    }

    fn take(&mut self, events: Event) -> io::Result<bool> {
        match events {
            Event::Reading(reading) => {
                self.view.know_groups(reading.robot.groups.len());
                self.lost_since = None;
                if self.picture.is_restart(&reading) {
                    self.notice.forget_daemon();
                }
                self.picture.take(*reading);
            }
            Event::Lost(reason) => {
                let since = *self.lost_since.get_or_insert_with(Instant::now);
                self.picture.loss = Some(Loss { lasting: since.elapsed(), reason });
            }
            Event::Key(key) => return Ok(self.press(&key)),
            Event::Pasted => self.notice.show(Tone::Warning, "Pasted text was ignored."),
            Event::Resized => {}
            Event::Stop(outcome) => self.notice.stop_done(outcome),
            Event::Done(action, outcomes) => self.notice.done(action, &outcomes),
            Event::Ended(reason) => return Err(io::Error::other(reason)),
        }
        Ok(true)
    }

    fn press(&mut self, key: &crossterm::event::KeyEvent) -> bool {
        let question = self.notice.question.take();
        self.notice.forget();
        if view::is_stop(key) {
            // The key thread has sent the stop already.
            self.notice.stop_asked();
            return true;
        }
        if let Some(question) = question {
            if question.is_agreed(key, Instant::now()) {
                self.ask(Action::Reset, question.groups);
                return true;
            }
            self.notice.show(Tone::Warning, "The stop was not cleared.");
        }
        match self.view.press(key) {
            Some(Action::Quit) => return false,
            Some(Action::Reset) => self.ask_to_clear(),
            Some(action) => self.ask(action, self.chosen()),
            None => {}
        }
        true
    }

    fn ask(&mut self, action: Action, groups: Vec<String>) {
        if !self.requests.ask(action, groups) {
            self.notice.show(Tone::Warning, "the last request is still under way");
        }
    }

    fn ask_to_clear(&mut self) {
        let Some(reading) = &self.picture.reading else { return };
        self.notice.question = Question::about(&reading.report, &self.chosen(), Instant::now());
        if self.notice.question.is_none() {
            self.notice.show(Tone::Plain, "No chosen group has a stop to clear.");
        }
    }

    /// Returns the names of the groups that keys act on.
    fn chosen(&self) -> Vec<String> {
        let Some(reading) = &self.picture.reading else { return Vec::new() };
        let is_chosen = |index: usize| self.view.group.is_none_or(|group| group == index);
        let groups = reading.robot.groups.iter().enumerate();
        groups.filter(|(index, _)| is_chosen(*index)).map(|(_, group)| group.name.clone()).collect()
    }
}
