//! The section `[gamepad]`.

use crate::controls::Button;
use serde::Deserialize;

/// A gamepad of this computer.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct Gamepad {
    /// Read a gamepad. Its button B then stops the robot.
    pub(crate) enabled: bool,
    /// Its name, as `motord-bridge gamepad` prints it. `None`: the first gamepad.
    pub(crate) name: Option<String>,
    /// The button without which no group runs. `None`: none.
    pub(crate) dead_man: Option<Button>,
}

impl Gamepad {
    /// Checks the section. The error is a sentence that says what to do.
    pub(crate) fn check(&self) -> Result<(), String> {
        match (self.dead_man, &self.name) {
            (Some(Button::East), _) => {
                Err("gamepad.dead-man is \"east\", the button B that stops the robot; name another button, \
                     such as \"tl\""
                    .to_owned())
            }
            (Some(button), _) if !self.enabled => Err(format!(
                "gamepad.dead-man is {:?}, but gamepad.enabled is false, so that nothing would watch the button: \
                 set enabled = true, or remove dead-man",
                button.name()
            )),
            (_, Some(name)) if name.is_empty() => Err("gamepad.name is empty; remove it for the first \
                 gamepad, or write the name that `motord-bridge gamepad` prints"
                .to_owned()),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(text: &str) -> Result<(), String> {
        toml::from_str::<Gamepad>(text).map_err(|error| error.to_string())?.check()
    }

    #[test]
    fn stop_button_is_no_dead_mans_button() {
        let error = outcome("enabled = true\ndead-man = \"east\"").unwrap_err();
        assert!(error.contains("another button"), "{error}");
        assert_eq!(outcome("enabled = true\ndead-man = \"tl\""), Ok(()));
    }

    #[test]
    fn dead_mans_button_without_gamepad_is_refused() {
        let error = outcome("dead-man = \"tl\"").unwrap_err();
        assert!(error.contains("enabled = true"), "{error}");
    }

    #[test]
    fn unknown_button_is_refused_with_known_ones() {
        let error = outcome("enabled = true\ndead-man = \"lb\"").unwrap_err();
        assert!(error.contains("lb") && error.contains("thumbl"), "{error}");
    }
}
