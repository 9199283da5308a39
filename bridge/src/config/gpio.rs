//! The section `[gpio]`.

use serde::Deserialize;
use std::path::PathBuf;
use std::time::Duration;

/// The level of a line while its stop circuit is closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum RunLevel {
    /// The circuit connects the line with ground. The line is pulled up.
    Low,
    /// The circuit connects the line with the supply. The line is pulled down.
    High,
}

/// A normally closed stop circuit on one line of a GPIO chip.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct Gpio {
    /// Read the line.
    pub(crate) enabled: bool,
    /// The character device of the chip.
    pub(crate) chip: PathBuf,
    /// Number of the line on the chip.
    pub(crate) line: Option<u32>,
    pub(crate) run_level: RunLevel,
    /// Time for which the line must have a new level until it counts.
    pub(crate) debounce_ms: f64,
}

impl Default for Gpio {
    fn default() -> Self {
        Self {
            enabled: false,
            chip: "/dev/gpiochip0".into(),
            line: None,
            run_level: RunLevel::Low,
            debounce_ms: 10.0,
        }
    }
}

impl Gpio {
    pub(crate) fn debounce(&self) -> Duration {
        Duration::from_secs_f64(self.debounce_ms / 1e3)
    }

    /// Checks the section. The error is a sentence that says what to do.
    pub(crate) fn check(&self) -> Result<(), String> {
        if !(0.0..=100.0).contains(&self.debounce_ms) {
            return Err(format!("gpio.debounce-ms is {}; it must be from 0 to 100", self.debounce_ms));
        }
        match (self.enabled, self.line) {
            (true, None) => {
                Err("gpio.line is missing: set the number of the line, which `gpioinfo` of the package \
                                 gpiod prints"
                    .to_owned())
            }
            (false, Some(line)) => Err(format!(
                "gpio.line is {line}, but gpio.enabled is false, so that nothing would read the line: set \
                 enabled = true, or remove line"
            )),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(text: &str) -> Result<(), String> {
        toml::from_str::<Gpio>(text).map_err(|error| error.to_string())?.check()
    }

    #[test]
    fn line_and_enabled_need_each_other() {
        assert!(outcome("enabled = true").unwrap_err().contains("gpio.line"));
        assert!(outcome("line = 17").unwrap_err().contains("enabled = true"));
        assert_eq!(outcome("enabled = true\nline = 17"), Ok(()));
    }

    #[test]
    fn debounce_has_a_range() {
        for time in ["-1.0", "101.0", "nan", "inf"] {
            let error = outcome(&format!("enabled = true\nline = 1\ndebounce-ms = {time}")).unwrap_err();
            assert!(error.contains("gpio.debounce-ms") && error.contains("from 0 to 100"), "{error}");
        }
    }
}
