//! The command `gamepad`: prints the values for a person, or for a controller as lines of JSON.

use crate::controls::{AXES, Button, Values};
use crate::gamepad::Finder;
use std::io::{self, Write};
use std::time::{Duration, Instant};

/// Longest time between two lines of JSON: a reader notices a frozen program.
const SILENCE: Duration = Duration::from_millis(100);

/// Prints the values of the gamepad, or of the one called `name`, at each change, until the reader of the
/// output exits. It stops nothing.
pub(crate) fn show(name: Option<String>, json: bool) -> io::Result<()> {
    let mut finder = Finder::new(name);
    let mut printed: Option<(Values, Instant)> = None;
    loop {
        let values = finder.read().map(|reading| reading.values).unwrap_or_default();
        let is_due =
            printed.as_ref().is_none_or(|(before, at)| *before != values || json && at.elapsed() >= SILENCE);
        if !is_due {
            continue;
        }
        let line =
            if json { serde_json::to_string(&values).map_err(io::Error::other)? } else { sentence(&values) };
        match writeln!(io::stdout(), "{line}") {
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => return Ok(()),
            written => written?,
        }
        printed = Some((values, Instant::now()));
    }
}

/// Returns a line for a person: the axes that are not 0, and the pressed buttons.
fn sentence(values: &Values) -> String {
    let Some(name) = &values.name else { return "no gamepad: everything counts as released".to_owned() };
    let axes = AXES.iter().zip(values.axes).filter(|(_, value)| *value != 0.0);
    let axes = axes.map(|(name, value)| format!("{name} {value:+.2}"));
    let pressed = Button::ALL.into_iter().filter(|button| values.is_pressed(*button));
    let all: Vec<String> = axes.chain(pressed.map(|button| button.name().to_owned())).collect();
    format!("{name}: {}", if all.is_empty() { "released".to_owned() } else { all.join(", ") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_names_what_is_moved_and_pressed() {
        let mut values = Values::of("pad", |_| None, |code| code == Button::Tl.code());
        values.axes[1] = 0.5;
        assert_eq!(sentence(&values), "pad: left-y +0.50, tl");
        assert_eq!(sentence(&Values::of("pad", |_| None, |_| false)), "pad: released");
        assert!(sentence(&Values::default()).contains("counts as released"));
    }
}
