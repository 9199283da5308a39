//! A gamepad at the kernel's evdev interface.

use crate::controls::{Axis, Button, Values};
use evdev::raw_stream::RawDevice;
use evdev::{AbsoluteAxisCode, EventType, KeyCode};
use nix::fcntl::{OFlag, open};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::stat::Mode;
use std::io;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Directory of the devices.
const DIRECTORY: &str = "/dev/input";
/// Limit on reads in a row: a device that floods does not keep the thread.
const READS_MAX: usize = 64;
/// Limit on the letters of a name.
const NAME_MAX: usize = 80;

/// An open gamepad.
#[derive(Debug)]
pub(crate) struct Device {
    device: RawDevice,
    name: String,
    path: PathBuf,
    /// Those of the last event.
    values: Option<Values>,
}

/// A reading.
#[derive(Debug)]
pub(crate) struct Reading {
    pub(crate) values: Values,
    /// The stop button is pressed, or was since the last reading.
    pub(crate) is_stop_pressed: bool,
}

/// Returns the printable letters of a device's name: a device may have any.
fn printable(name: &str) -> String {
    name.chars().filter(|letter| !letter.is_control()).take(NAME_MAX).collect()
}

impl Device {
    /// Opens the first gamepad, or the first one called `name`. The error is a sentence that says what to
    /// do.
    pub(crate) fn find(name: Option<&str>) -> Result<Self, String> {
        let mut paths = paths()?;
        paths.sort_unstable();
        let (mut others, mut refused) = (Vec::new(), None);
        for (_, path) in paths {
            match Self::open(&path) {
                Ok(Some(device)) if name.is_none_or(|name| name == device.name) => return Ok(device),
                Ok(Some(device)) => others.push(format!("{:?}", device.name)),
                Ok(None) => {}
                Err(error) if error.kind() == io::ErrorKind::PermissionDenied => refused = Some(path),
                // It was unplugged since.
                Err(_) => {}
            }
        }
        Err(match (name, refused) {
            (_, Some(path)) => format!(
                "no permission for {}: join the group `input` (`sudo adduser NAME input`, then log in again); the \
                 unit needs its drop-in: docs/gamepad.md",
                path.display()
            ),
            (Some(name), None) if !others.is_empty() => format!(
                "no gamepad is called {name:?}, but {}: correct gamepad.name, or connect it",
                others.join(", ")
            ),
            (Some(name), None) => format!("no gamepad in {DIRECTORY}: connect {name:?}"),
            (None, None) => format!("no gamepad in {DIRECTORY}: connect one"),
        })
    }

    /// Opens the device at `path`; `None` if it is no gamepad.
    fn open(path: &Path) -> io::Result<Option<Self>> {
        let flags = OFlag::O_RDONLY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
        let device = RawDevice::from_fd(open(path, flags, Mode::empty())?)?;
        let has_buttons = device.supported_keys().is_some_and(|keys| {
            [Button::South, Button::East].iter().all(|button| keys.contains(KeyCode::new(button.code())))
        });
        let has_stick = device.supported_absolute_axes().is_some_and(|axes| {
            axes.contains(AbsoluteAxisCode::ABS_X) && axes.contains(AbsoluteAxisCode::ABS_Y)
        });
        if !(has_buttons && has_stick) {
            return Ok(None);
        }
        let name = printable(device.name().unwrap_or("gamepad without a name"));
        Ok(Some(Self { device, name, path: path.to_owned(), values: None }))
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn has(&self, button: Button) -> bool {
        self.device.supported_keys().is_some_and(|keys| keys.contains(KeyCode::new(button.code())))
    }

    /// Waits for an event, at most for `timeout`, and returns the present values. Fails once the device is
    /// lost.
    pub(crate) fn read(&mut self, timeout: Duration, stop: Button) -> io::Result<Reading> {
        let timeout = PollTimeout::try_from(timeout).unwrap_or(PollTimeout::ZERO);
        let awake = poll(&mut [PollFd::new(self.device.as_fd(), PollFlags::POLLIN)], timeout);
        if let (Ok(0), Some(values)) = (awake, &self.values) {
            return Ok(Reading { is_stop_pressed: values.is_pressed(stop), values: values.clone() });
        }
        let was_pressed = self.drain(stop)?;
        // The values are those of the kernel, not of events: none is missed where events are dropped.
        let keys = self.device.get_key_state()?;
        let states = self.device.get_abs_state()?;
        let supported = self.device.supported_absolute_axes();
        let axis = |code: u16| {
            let state = states.get(usize::from(code))?;
            let (value, minimum, maximum, flat) = (state.value, state.minimum, state.maximum, state.flat);
            let has = supported.is_some_and(|axes| axes.contains(AbsoluteAxisCode(code)));
            has.then_some(Axis { value, minimum, maximum, flat })
        };
        let values = Values::of(&self.name, axis, |code| keys.contains(KeyCode::new(code)));
        self.values = Some(values.clone());
        let is_stop_pressed = was_pressed || values.is_pressed(stop);
        Ok(Reading { values, is_stop_pressed })
    }

    /// Takes all events. Returns `true` if one of them pressed `stop`: it may be released again.
    fn drain(&mut self, stop: Button) -> io::Result<bool> {
        let mut is_pressed = false;
        for _ in 0..READS_MAX {
            match self.device.fetch_events() {
                Ok(events) => {
                    for event in events {
                        is_pressed |= event.event_type() == EventType::KEY
                            && event.code() == stop.code()
                            && event.value() != 0;
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(is_pressed)
    }
}

/// Returns the event devices, each with its number.
fn paths() -> Result<Vec<(u32, PathBuf)>, String> {
    let entries = match std::fs::read_dir(DIRECTORY) {
        Ok(entries) => entries,
        // Created with the first device.
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(format!("cannot read {DIRECTORY}: {error}")),
    };
    let number = |path: &Path| path.file_name()?.to_str()?.strip_prefix("event")?.parse().ok();
    Ok(entries.flatten().filter_map(|entry| Some((number(&entry.path())?, entry.path()))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn name_of_device_cannot_break_the_log() {
        assert_eq!(printable("Pad\n2026 error: \u{1b}[2Jall good"), "Pad2026 error: [2Jall good");
        assert_eq!(printable(&"x".repeat(10_000)).len(), NAME_MAX);
    }

    #[test]
    fn file_that_is_no_device_is_an_error() {
        for path in ["/dev/null", "/etc/passwd", "/nonexistent"] {
            assert!(Device::open(Path::new(path)).is_err(), "{path}");
        }
    }
}
