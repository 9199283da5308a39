//! The programs of the workspace, and the commands that their `--help` shows.

#![allow(dead_code, reason = "each test program uses a part of it")]

use std::path::{Path, PathBuf};
use std::process::Command;

/// The three programs.
pub(crate) const PROGRAMS: [&str; 3] = ["motord", "motorctl", "motord-sim"];

/// The directory of the programs.
pub(crate) fn directory() -> PathBuf {
    Path::new(env!("CARGO_BIN_EXE_motorctl")).parent().unwrap().to_owned()
}

/// A program that was built beside this test.
pub(crate) fn program(name: &str) -> Command {
    let path = directory().join(name);
    assert!(path.is_file(), "{} is missing: run `cargo build --workspace` first", path.display());
    Command::new(path)
}

/// The help of a command, as it is printed.
pub(crate) fn help(name: &str, command: &[String]) -> String {
    let output = program(name).args(command).arg("--help").output().unwrap();
    assert!(output.status.success(), "{name} {command:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// The words of every command of a program, those of its commands' commands included; the program
/// itself has none.
pub(crate) fn commands(name: &str) -> Vec<Vec<String>> {
    let mut found = vec![Vec::new()];
    let mut next = 0;
    while let Some(command) = found.get(next).cloned() {
        let help = help(name, &command);
        for below in below(&help) {
            found.push([&command[..], &[below]].concat());
        }
        next += 1;
    }
    found
}

/// The commands that a help lists.
pub(crate) fn below(help: &str) -> Vec<String> {
    let section = help.lines().skip_while(|line| !line.starts_with("Commands:")).skip(1);
    let lines = section.take_while(|line| line.starts_with("  ")).filter(|line| !line.starts_with("   "));
    let names = lines.filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

/// The long options that a help lists.
pub(crate) fn options(help: &str) -> Vec<String> {
    let lines = help.lines().map(str::trim_start).filter(|line| line.starts_with('-'));
    let words = lines.filter_map(|line| line.split([' ', ',']).find(|word| word.starts_with("--")));
    words.map(str::to_owned).collect()
}
