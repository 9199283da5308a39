//! `motorctl replay`: a recording in the monitor. No key reaches a robot.

use super::draw;
use super::events::Event;
use super::picture::{Picture, Reading};
use super::request::Notice;
use super::terminal::{Screen, is_there};
use super::view::{Action, STOP_KEY, View};
use crate::failure::Failure;
use crossterm::event::{KeyCode, KeyEvent, KeyEventKind};
use motord_client::{RobotDescription, State, Telemetry};
use motord_record::{RecorderFailure, Recording};
use motord_terminal::{Interrupt, within};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// Time between two pictures while the recording plays.
const FRAME: Duration = Duration::from_millis(100);
/// Time between two pictures while it is paused.
const PAUSED: Duration = Duration::from_millis(250);

/// The arguments of the command.
#[derive(Debug, clap::Args)]
pub(crate) struct ReplayArguments {
    /// The recording.
    file: PathBuf,
    /// Factor of the speed, 0.001 to 1000.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = parse_speed)]
    speed: f64,
    /// Begin this time after the first cycle, s.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = parse_time)]
    from: f64,
}

fn parse_speed(text: &str) -> Result<f64, String> {
    within(text, 0.001, 1000.0)
}

fn parse_time(text: &str) -> Result<f64, String> {
    within(text, 0.0, 1e6)
}

/// Shows the recording until a key or a signal ends it.
///
/// # Errors
///
/// The recording cannot be read, or there is no terminal.
pub(crate) fn run(arguments: &ReplayArguments) -> Result<(), Failure> {
    let interrupt = Interrupt::register();
    let mut replay = Replay::open(arguments)?;
    if !is_there() {
        return Err(Failure::NoTerminal);
    }
    let (sender, events) = mpsc::channel();
    let mut screen = Screen::open(|| {}, &sender)?;
    while !interrupt.is_raised() {
        let pause = replay.play();
        let Replay { picture, view, .. } = &mut replay;
        screen.terminal.draw(|frame| draw::draw(frame, picture, view, &Notice::default()))?;
        let mut message = events.recv_timeout(pause).ok();
        while let Some(event) = message {
            match event {
                Event::Key(key) if !replay.press(&key) => return Ok(()),
                Event::Ended(reason) => return Err(std::io::Error::other(reason).into()),
                _ => {}
            }
            message = events.try_recv().ok();
        }
    }
    Ok(())
}

/// A playing recording.
struct Replay {
    recording: Recording,
    robot: Arc<RobotDescription>,
    picture: Picture,
    view: View,
    speed: f64,
    /// Ticks of the first and of the shown cycle.
    ticks: Option<(u64, u64)>,
    /// Start of the present run, and the tick shown then; `None` while paused.
    running: Option<(Instant, u64)>,
    has_ended: bool,
}

impl Replay {
    fn open(arguments: &ReplayArguments) -> Result<Self, RecorderFailure> {
        let recording = Recording::open(&arguments.file)?;
        let robot = Arc::new(recording.robot().clone());
        let mut view = View::of_stdout();
        view.know_groups(robot.groups.len());
        let mut replay = Self {
            recording,
            robot,
            picture: Picture::default(),
            view,
            speed: arguments.speed,
            ticks: None,
            running: None,
            has_ended: false,
        };
        replay.show(|first, tick| tick.saturating_sub(first) as f64 / 1e9 >= arguments.from);
        replay.resume();
        Ok(replay)
    }

    fn resume(&mut self) {
        self.running = self.ticks.filter(|_| !self.has_ended).map(|(_, shown)| (Instant::now(), shown));
        self.name();
    }

    /// Shows the cycle that is due. Returns the wait until the next one.
    fn play(&mut self) -> Duration {
        let Some((since, from_tick)) = self.running else { return PAUSED };
        let due = from_tick.saturating_add((since.elapsed().as_nanos() as f64 * self.speed) as u64);
        if self.ticks.is_some_and(|(_, shown)| shown < due) {
            self.show(|_, tick| tick >= due);
        }
        if self.has_ended {
            self.running = None;
            self.name();
        }
        FRAME
    }

    /// Reads until `is_due` is true for the first tick and the tick of a cycle. Shows the last
    /// cycle.
    fn show(&mut self, is_due: impl Fn(u64, u64) -> bool) {
        let mut shown = None;
        while let Some(record) = self.recording.next_cycle() {
            let tick = record.state.tick_ns;
            let first = self.ticks.map_or(tick, |(first, _)| first);
            self.ticks = Some((first, tick));
            let state = State::from(&record.state);
            self.picture.trends.take(&state, &self.robot);
            shown = Some(state);
            if is_due(first, tick) {
                break;
            }
        }
        match shown {
            Some(state) => self.picture.take(Reading::new(&self.robot, &state, &Telemetry::default())),
            None => self.has_ended = true,
        }
        self.name();
    }

    /// Sets the line about the shown cycle.
    fn name(&mut self) {
        let (first, shown) = self.ticks.unwrap_or_default();
        let seconds = shown.saturating_sub(first) as f64 / 1e9;
        let condition = match (self.has_ended, self.running.is_some(), self.recording.damage()) {
            (true, _, Some(_)) => "the end, where the file is cut off".to_owned(),
            (true, _, None) => "the end".to_owned(),
            (false, true, _) => format!("speed {}", self.speed),
            (false, false, _) => "paused".to_owned(),
        };
        let name = self.recording.name();
        self.picture.replay =
            Some(format!("RECORDING {name}, {seconds:.3} s, {condition}: no key reaches a robot"));
    }

    /// Handles a key. Returns false when the user quits.
    fn press(&mut self, key: &KeyEvent) -> bool {
        if key.kind == KeyEventKind::Press && !self.view.is_filtering {
            match key.code {
                STOP_KEY if self.running.is_some() => {
                    self.running = None;
                    self.name();
                }
                STOP_KEY => self.resume(),
                KeyCode::Char('n') => {
                    self.running = None;
                    self.show(|_, _| true);
                }
                _ => {}
            }
        }
        self.view.press(key) != Some(Action::Quit)
    }
}
