//! A gamepad: its button B stops the robot, a dead man's button permits motion, and controllers read its
//! sticks and buttons. In a thread of its own.

mod device;
mod show;

pub(crate) use show::show;

use crate::config::Gamepad;
use crate::controls::{Button, Values};
use crate::hold::{Demand, Hold, View};
use crate::shared::Shared;
use crate::stop::StopDesk;
use crate::threads::spawn;
use device::{Device, Reading};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// B of an Xbox gamepad, the circle of a PlayStation one.
const STOP: Button = Button::East;
/// Longest time from one check to the next.
const TURN: Duration = Duration::from_millis(10);
/// Between two searches for a gamepad.
const SEARCH: Duration = Duration::from_millis(500);

/// Starts the thread; `None` where no gamepad is configured.
pub(crate) fn start(
    config: &Gamepad,
    shared: &Arc<Shared>,
    desk: &Arc<StopDesk>,
) -> Result<Option<JoinHandle<()>>, String> {
    if !config.enabled {
        return Ok(None);
    }
    let (shared, desk) = (Arc::clone(shared), Arc::clone(desk));
    let (finder, dead_man) = (Finder::new(config.name.clone()), config.dead_man);
    spawn("gamepad", move || Watcher::new(finder, dead_man, desk).run(&shared)).map(Some)
}

/// Finds the gamepad, and finds it again.
#[derive(Debug)]
struct Finder {
    name: Option<String>,
    device: Option<Device>,
    searched: Option<Instant>,
    /// The last reason why there is none, which is logged once.
    reason: String,
}

impl Finder {
    fn new(name: Option<String>) -> Self {
        Self { name, device: None, searched: None, reason: String::new() }
    }

    /// Returns a reading, at most a turn later; `None` without a gamepad.
    fn read(&mut self) -> Option<Reading> {
        if self.device.is_none() && self.searched.is_none_or(|searched| searched.elapsed() >= SEARCH) {
            self.search();
        }
        let Some(device) = &mut self.device else {
            std::thread::sleep(TURN);
            return None;
        };
        match device.read(TURN, STOP) {
            Ok(reading) => Some(reading),
            Err(error) => {
                log::warn!("gamepad {} is lost: {error}; searching for it", device.name());
                self.device = None;
                None
            }
        }
    }

    fn search(&mut self) {
        self.searched = Some(Instant::now());
        match Device::find(self.name.as_deref()) {
            Ok(device) => {
                log::info!("gamepad {} at {}", device.name(), device.path().display());
                self.device = Some(device);
                self.reason.clear();
            }
            Err(reason) if reason != self.reason => {
                log::warn!("gamepad: {reason}; waiting for it");
                self.reason = reason;
            }
            Err(_) => {}
        }
    }
}

/// Requests the stops of a gamepad.
struct Watcher {
    finder: Finder,
    dead_man: Option<Button>,
    desk: Arc<StopDesk>,
    pressed: Hold,
    released: Hold,
    begun: Instant,
}

impl Watcher {
    fn new(finder: Finder, dead_man: Option<Button>, desk: Arc<StopDesk>) -> Self {
        let (pressed, released) = (Hold::default(), Hold::default());
        Self { finder, dead_man, desk, pressed, released, begun: Instant::now() }
    }

    fn run(mut self, shared: &Shared) {
        let mut last = Values::default();
        let mut is_connected = false;
        while !shared.ends() {
            let reading = self.finder.read();
            let is_new = reading.is_some() && !is_connected;
            is_connected = reading.is_some();
            if is_new {
                self.warn_of_missing_button();
            }
            let now = Instant::now();
            let view = View::of(shared.latest.newest().as_ref(), self.begun, now);
            self.serve(reading.as_ref(), view, now);
            let values = reading.map(|reading| reading.values).unwrap_or_default();
            if values != last {
                shared.gamepad.put(values.clone());
                last = values;
            }
        }
    }

    fn warn_of_missing_button(&self) {
        let Some((device, button)) = self.finder.device.as_ref().zip(self.dead_man) else { return };
        if !device.has(button) {
            log::error!(
                "gamepad {} has no button {}, which gamepad.dead-man names: it counts as released, and no group can \
                 run; name a button that `motord-bridge gamepad` shows",
                device.name(),
                button.name()
            );
        }
    }

    fn serve(&mut self, reading: Option<&Reading>, view: View, now: Instant) {
        let is_pressed = reading.is_some_and(|reading| reading.is_stop_pressed);
        let demand = if is_pressed { Demand::Latch } else { Demand::Nothing };
        let name = reading.and_then(|reading| reading.values.name.as_deref());
        let desk = &self.desk;
        self.pressed.serve(demand, view, now, || {
            desk.request(format!("the gamepad {}, button B", name.unwrap_or_default()))
        });
        let Some(button) = self.dead_man else { return };
        let is_held = reading.is_some_and(|reading| reading.values.is_pressed(button));
        let demand = if is_held { Demand::Nothing } else { Demand::NoMotion };
        self.released.serve(demand, view, now, || {
            desk.request(match name {
                Some(name) => format!("the gamepad {name}, dead man's button {} released", button.name()),
                None => "the gamepad, which is unplugged".to_owned(),
            })
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watcher(dead_man: Option<Button>) -> Watcher {
        Watcher::new(Finder::new(None), dead_man, Arc::new(StopDesk::default()))
    }

    fn reading(pressed: &[Button]) -> Reading {
        let codes: Vec<u16> = pressed.iter().map(|button| button.code()).collect();
        let values = Values::of("pad", |_| None, |code| codes.contains(&code));
        Reading { is_stop_pressed: values.is_pressed(STOP), values }
    }

    fn running(published: Instant) -> View {
        View::Known { is_running: true, is_latched: false, published }
    }

    /// The sources that request a stop in one turn.
    fn sources(watcher: &mut Watcher, reading: Option<&Reading>) -> Vec<String> {
        let now = Instant::now();
        watcher.serve(reading, running(now), now);
        watcher.desk.waiting()
    }

    #[test]
    fn button_b_stops_and_others_do_not() {
        let mut watcher = watcher(None);
        for button in Button::ALL.into_iter().filter(|button| *button != STOP) {
            assert_eq!(sources(&mut watcher, Some(&reading(&[button]))), [""; 0], "{button:?}");
        }
        assert_eq!(sources(&mut watcher, Some(&reading(&[STOP]))), ["the gamepad pad, button B"]);
    }

    #[test]
    fn press_that_is_over_stops_too() {
        let mut watcher = watcher(None);
        let short = Reading { is_stop_pressed: true, ..reading(&[]) };
        assert_eq!(sources(&mut watcher, Some(&short)).len(), 1);
    }

    #[test]
    fn release_of_dead_mans_button_stops_motion() {
        let mut watcher = watcher(Some(Button::Tl));
        assert_eq!(sources(&mut watcher, Some(&reading(&[Button::Tl]))), [""; 0]);
        let source = ["the gamepad pad, dead man's button tl released"];
        assert_eq!(sources(&mut watcher, Some(&reading(&[Button::Tr]))), source);
    }

    #[test]
    fn unplugging_releases_dead_mans_button() {
        let mut holding = watcher(Some(Button::Tl));
        assert_eq!(sources(&mut holding, Some(&reading(&[Button::Tl]))), [""; 0]);
        assert_eq!(sources(&mut holding, None), ["the gamepad, which is unplugged"]);
        assert_eq!(sources(&mut watcher(None), None), [""; 0], "no dead man's button is configured");
    }

    #[test]
    fn disabled_gamepad_starts_no_thread() {
        let shared = crate::fixtures::shared();
        assert!(start(&Gamepad::default(), &shared, &Arc::default()).unwrap().is_none());
    }
}
