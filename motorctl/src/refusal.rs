//! A command line that is refused. It never costs an emergency stop without a word.

use crate::operate::ESTOP_ALIASES;
use crate::outcome::exit_status_of;
use crate::{estop, exit_status};
use clap::error::ErrorKind;
use motord_client::DEFAULT_INSTANCE;
use motord_terminal::printable;
use std::env;
use std::ffi::OsString;
use std::process::ExitCode;

/// The variable with the name of the instance.
pub(crate) const INSTANCE: &str = "MOTORD_INSTANCE";

/// Prints `error`. If a word or the name of the instance is not UTF-8 and the command is an
/// emergency stop, the stop is carried out: the other words say what to stop.
pub(crate) fn exit(error: &clap::Error) -> ExitCode {
    // Help and version also arrive here, and go to standard output. A closed pipe is not an error.
    if !error.use_stderr() {
        let _closed = error.print();
        return ExitCode::SUCCESS;
    }
    let words: Vec<OsString> = env::args_os().skip(1).collect();
    let variable = env::var_os(INSTANCE);
    print(error, words.iter().chain(&variable));
    let readable: Vec<&str> = words.iter().filter_map(|word| word.to_str()).collect();
    let is_readable = readable.len() == words.len() && variable.iter().all(|name| name.to_str().is_some());
    if !is_readable && readable.iter().any(|word| is_stop(word)) {
        let instance = instance(&words).or(variable.and_then(|name| name.into_string().ok()));
        let is_all = readable.contains(&"--all");
        return exit_status_of(estop::run(instance.as_deref().unwrap_or(DEFAULT_INSTANCE), is_all));
    }
    if words.iter().any(|word| means_emergency_stop(&word.to_string_lossy())) {
        eprintln!("motorctl: NOTHING WAS STOPPED: type `motorctl estop`");
    }
    ExitCode::from(exit_status::USAGE)
}

/// Prints `error`, and the first text that is not UTF-8: clap does not say which it is.
fn print<'w>(error: &clap::Error, mut texts: impl Iterator<Item = &'w OsString>) {
    let _closed = error.print();
    if error.kind() == ErrorKind::InvalidUtf8
        && let Some(text) = texts.find(|text| text.to_str().is_none())
    {
        eprintln!("motorctl: {} is not UTF-8", printable(&format!("{text:?}")));
    }
}

fn is_stop(word: &str) -> bool {
    word == "estop" || ESTOP_ALIASES.contains(&word)
}

/// Returns the value of `--instance`, if it is UTF-8.
fn instance(words: &[OsString]) -> Option<String> {
    let mut words = words.iter().map(|word| word.to_str());
    while let Some(word) = words.next() {
        match word {
            Some("--instance") => return words.next().flatten().map(str::to_owned),
            Some(word) if word.starts_with("--instance=") => {
                return word.split_once('=').map(|(_, name)| name.to_owned());
            }
            _ => {}
        }
    }
    None
}

/// Returns whether a word of a command line that is refused was meant to stop the robot.
fn means_emergency_stop(word: &str) -> bool {
    let letters: String = word.chars().filter(char::is_ascii_alphabetic).collect();
    matches!(letters.to_ascii_lowercase().as_str(), "stop" | "estop" | "emergencystop" | "halt" | "stopp")
}
