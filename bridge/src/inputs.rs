//! The stop inputs at devices of this computer: a gamepad and a GPIO line. Each has threads of its own.

use crate::config::Config;
use crate::hold;
use crate::shared::Shared;
use crate::stop::StopDesk;
use crate::{gamepad, gpio};
use std::sync::Arc;
use std::thread::JoinHandle;

/// Starts the configured inputs.
pub(crate) fn start(
    config: &Config,
    shared: &Arc<Shared>,
    desk: &Arc<StopDesk>,
) -> Result<Vec<JoinHandle<()>>, String> {
    let gamepad = gamepad::start(&config.gamepad, shared, desk)?;
    let gpio = gpio::start(&config.gpio, shared, desk)?;
    Ok([gamepad, gpio].into_iter().flatten().collect())
}

/// Returns the number of cycles after which an input needs a state; `None` without an input.
pub(crate) fn cycles_between_states(config: &Config, cycle_hz: f64) -> Option<u32> {
    let has_input = config.gamepad.enabled || config.gpio.enabled;
    has_input.then(|| hold::cycles_between_states(cycle_hz))
}

/// Returns a sentence for `check` and the log.
pub(crate) fn summary(config: &Config) -> String {
    let gamepad = match (&config.gamepad, config.gamepad.name.as_deref().unwrap_or("the first one")) {
        (gamepad, _) if !gamepad.enabled => "gamepad off".to_owned(),
        (gamepad, name) => match gamepad.dead_man {
            Some(button) => format!("gamepad {name}, no motion without its button {}", button.name()),
            None => format!("gamepad {name}"),
        },
    };
    let gpio = match (&config.gpio, config.gpio.line) {
        (gpio, Some(line)) if gpio.enabled => {
            format!("stop circuit at line {line} of {}", gpio.chip.display())
        }
        _ => "GPIO off".to_owned(),
    };
    format!("{gamepad}, {gpio}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_configured_inputs_need_states() {
        let with = |text: &str| -> Config { toml::from_str(text).unwrap() };
        assert_eq!(cycles_between_states(&with(""), 1000.0), None);
        assert_eq!(cycles_between_states(&with("[gpio]\nenabled = true"), 1000.0), Some(10));
        assert_eq!(cycles_between_states(&with("[gamepad]\nenabled = true"), 200.0), Some(2));
        assert_eq!(summary(&with("")), "gamepad off, GPIO off");
    }
}
