//! The programs of the workspace.

use std::path::PathBuf;
use std::process::{Child, Command};

/// A process that is killed with its test.
#[derive(Debug)]
pub struct Process(pub Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _exited = self.0.kill();
        let _status = self.0.wait();
    }
}

/// Returns the directory in which cargo builds the programs.
///
/// # Panics
///
/// If the test program is not in a directory of cargo.
#[must_use]
pub fn directory() -> PathBuf {
    let test = std::env::current_exe().expect("a program has a path");
    let built = test.parent().and_then(std::path::Path::parent).expect("tests are in target/PROFILE/deps");
    built.to_owned()
}

/// A program that was built beside the test.
///
/// # Panics
///
/// If the program is missing: `cargo test -p CRATE` builds the programs of that crate only.
#[must_use]
pub fn program(name: &str) -> Command {
    let path = directory().join(name);
    assert!(path.is_file(), "{} is missing: run `cargo build --workspace` first", path.display());
    Command::new(path)
}

/// Returns `true`, and prints a note, if this computer lacks one of these programs, which the
/// caller then does not test with. The tests need Rust, a C compiler, and what POSIX requires
/// (`sh`, `sleep`, `mkfifo`); every other program may be missing.
#[must_use]
pub fn lacks(programs: &[&str]) -> bool {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let is_here = |program: &str| std::env::split_paths(&path).any(|folder| folder.join(program).is_file());
    let missing: Vec<&str> = programs.iter().copied().filter(|program| !is_here(program)).collect();
    if !missing.is_empty() {
        println!("NOT TESTED: this computer has no {}", missing.join(", "));
    }
    !missing.is_empty()
}
