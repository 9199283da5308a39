//! The words of a stop that the daemon has confirmed: whether the motors answer.

use std::fmt::Display;

/// Returns `done` as the outcome of a confirmed stop. `offline` are the joints that do not answer,
/// or the reason why that was not checked.
///
/// # Errors
///
/// The joints that do not answer: they may still move.
pub(crate) fn outcome(done: &str, offline: Result<Vec<String>, impl Display>) -> Result<String, Vec<String>> {
    match offline {
        Ok(offline) if offline.is_empty() => Ok(done.to_owned()),
        Ok(offline) => Err(offline),
        Err(error) => Ok(not_checked(done, &error)),
    }
}

/// Returns `done`, and that the answers of the motors were not checked.
pub(crate) fn not_checked(done: &str, error: &impl Display) -> String {
    format!("{done}; whether each motor answers was not checked: {error}")
}

/// Describes motors that do not answer, after the words that confirm the stop.
pub(crate) fn motors_silent(motors: &str) -> String {
    format!("but these motors do not answer and may still move, so cut the power: {motors}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_never_success() {
        let offline = |joints: &[&str]| Ok::<_, String>(joints.iter().map(ToString::to_string).collect());
        assert_eq!(outcome("stopped", offline(&[])), Ok("stopped".to_owned()));
        assert_eq!(outcome("stopped", offline(&["hip"])), Err(vec!["hip".to_owned()]));
        let unchecked = outcome("stopped", Err("no state"));
        assert_eq!(unchecked.unwrap(), "stopped; whether each motor answers was not checked: no state");
    }
}
