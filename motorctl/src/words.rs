//! `motorctl complete-words`: the names of the running daemon for the completions of a shell.
//!
//! A shell runs it at each press of TAB. It ends within [`TIMEOUT`] whatever the daemon does, and
//! prints nothing but words.

use crate::explain;
use clap::{Arg, Command};
use motord_client::{Client, running_instances};
use std::io::{self, Write};
use std::sync::mpsc::channel;
use std::time::Duration;

/// Longest time to wait for the daemon.
const TIMEOUT: Duration = Duration::from_millis(300);
/// The option that names the daemon.
const INSTANCE: &str = "instance";

/// The names that an argument takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Groups,
    Joints,
    /// Joints, buses and IMUs.
    Targets,
    Imus,
    Instances,
    Pages,
}

/// A begun command line: the command of its last word, and the argument that the word is.
#[derive(Debug, PartialEq, Eq)]
struct Begun<'l> {
    kind: Option<Kind>,
    instance: Option<&'l str>,
    word: &'l str,
}

/// Prints the names that may follow `line`, one in a line.
pub(crate) fn print(program: &Command, instance: &str, line: &[String]) {
    let line: Vec<&str> = line.iter().map(String::as_str).filter(|word| *word != "=").collect();
    let begun = begun(program, &line);
    let Some(kind) = begun.kind else { return };
    let instance = begun.instance.unwrap_or(instance).to_owned();
    let (found, names) = channel();
    // A frozen daemon may block the thread. The process does not wait for it.
    let _refused = std::thread::Builder::new().spawn(move || found.send(known(kind, &instance)));
    let names = names.recv_timeout(TIMEOUT).unwrap_or_default();
    let mut out = io::stdout().lock();
    for name in names.iter().filter(|name| is_plain(name) && name.starts_with(begun.word)) {
        let _closed = writeln!(out, "{name}");
    }
}

/// A shell expands every other letter.
fn is_plain(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|letter| letter.is_ascii_alphanumeric() || "-_.".contains(letter))
}

fn known(kind: Kind, instance: &str) -> Vec<String> {
    match kind {
        Kind::Pages => explain::names(),
        Kind::Instances => running_instances().into_iter().map(|running| running.name).collect(),
        Kind::Groups | Kind::Joints | Kind::Targets | Kind::Imus => {
            let Ok(client) = Client::connect(instance) else { return Vec::new() };
            let robot = client.description();
            let joints = robot.joints.iter().map(|joint| joint.name.clone());
            let imus = robot.imus.iter().map(|imu| imu.name.clone());
            match kind {
                Kind::Groups => robot.groups.iter().map(|group| group.name.clone()).collect(),
                Kind::Targets => joints.chain(robot.buses.iter().cloned()).chain(imus).collect(),
                Kind::Imus => imus.collect(),
                _ => joints.collect(),
            }
        }
    }
}

/// Follows the words of a command line through the commands of `program`.
fn begun<'l>(program: &Command, line: &[&'l str]) -> Begun<'l> {
    let Some((word, before)) = line.split_last() else {
        return Begun { kind: None, instance: None, word: "" };
    };
    let (mut command, mut position, mut value_of, mut instance) = (program, 0, None, None);
    for word in before {
        if let Some(option) = value_of.take() {
            if is_instance(option) {
                instance = Some(*word);
            }
        } else if let Some(name) = word.strip_prefix("--") {
            let (name, value) =
                name.split_once('=').map_or((name, None), |(name, value)| (name, Some(value)));
            let option = option(program, command, name);
            match (option, value) {
                (Some(option), Some(value)) if is_instance(option) => instance = Some(value),
                (Some(option), None) => {
                    value_of = Some(option).filter(|option| option.get_action().takes_values());
                }
                _ => {}
            }
        } else if let Some(below) = command.find_subcommand(word) {
            (command, position) = (below, 0);
        } else if !word.starts_with('-') {
            position += 1;
        }
    }
    let argument = value_of.or_else(|| command.get_positionals().nth(position));
    let kind = argument.filter(|_| value_of.is_some() || !word.starts_with('-'));
    Begun { kind: kind.and_then(|argument| self::kind(command, argument)), instance, word }
}

fn is_instance(option: &Arg) -> bool {
    option.get_id() == INSTANCE
}

/// The option of this name of the command, or of every command.
fn option<'c>(program: &'c Command, command: &'c Command, name: &str) -> Option<&'c Arg> {
    let named = |option: &&Arg| option.get_long() == Some(name);
    command.get_opts().find(named).or_else(|| program.get_opts().find(named))
}

/// The names that an argument takes, by its name in the help.
fn kind(command: &Command, argument: &Arg) -> Option<Kind> {
    let id = argument.get_id().as_str();
    let shown = argument.get_value_names().and_then(|names| names.first());
    match (command.get_name(), id, shown.map(clap::builder::Str::as_str)) {
        (_, INSTANCE, _) => Some(Kind::Instances),
        ("explain", "name", _) => Some(Kind::Pages),
        ("sim", "target", _) => Some(Kind::Targets),
        // No page, but a recording, knows the joints of `plot`.
        ("plot" | "replay", ..) => None,
        (_, "group", _) | (_, _, Some("GROUP")) => Some(Kind::Groups),
        (_, _, Some("IMU")) => Some(Kind::Imus),
        (_, "joint", _) | (_, _, Some("JOINT")) => Some(Kind::Joints),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    fn of(line: &str) -> (Option<Kind>, Option<String>) {
        let program = crate::Arguments::command();
        let words: Vec<&str> = line.split(' ').collect();
        let begun = begun(&program, &words);
        (begun.kind, begun.instance.map(str::to_owned))
    }

    #[test]
    fn each_position_of_a_line_has_its_names() {
        for (line, kind) in [
            ("enable ", Some(Kind::Groups)),
            ("release le", Some(Kind::Groups)),
            ("exclude ", Some(Kind::Joints)),
            ("fault get ", Some(Kind::Joints)),
            ("fault clear f", Some(Kind::Joints)),
            ("zero ", Some(Kind::Joints)),
            ("imu level ", Some(Kind::Imus)),
            ("imu ", None),
            ("sim ", Some(Kind::Targets)),
            ("explain m", Some(Kind::Pages)),
            ("--instance ", Some(Kind::Instances)),
            ("status --instance a", Some(Kind::Instances)),
            ("enable legs ", None),
            ("enable --", None),
            ("sim fl-knee ", None),
            ("status ", None),
            ("", None),
        ] {
            assert_eq!(of(line), (kind, None), "{line}");
        }
        assert_eq!(of("--instance demo enable "), (Some(Kind::Groups), Some("demo".to_owned())));
        assert_eq!(of("enable --instance=demo "), (Some(Kind::Groups), Some("demo".to_owned())));
    }

    #[test]
    fn no_name_is_expanded_by_a_shell() {
        for name in ["$(reboot)", "a b", "`x`", "", "a;b", "*"] {
            assert!(!is_plain(name), "{name}");
        }
        assert!(is_plain("fl-knee_2"));
    }
}
