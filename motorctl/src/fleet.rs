//! `motorctl fleet`: many robots. motord-remote does it, the one program with a network.

use crate::exit_status;
use crate::failure::{CommandFailure, Failure};
use std::ffi::OsString;
use std::io;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

const PROGRAM: &str = "motord-remote";

/// The program is not there, or cannot be executed.
#[derive(Debug, thiserror::Error)]
#[error("cannot execute {PROGRAM}: {0}. It is in the package motord-remote; docs/remote.md has the build")]
struct FleetFailure(io::Error);

impl CommandFailure for FleetFailure {
    fn status(&self) -> u8 {
        exit_status::UNAVAILABLE
    }
}

/// Becomes `motord-remote fleet` with these arguments. Returns only an error.
pub(crate) fn run(arguments: &[OsString]) -> Result<(), Failure> {
    let program = beside_this_one().unwrap_or_else(|| PROGRAM.into());
    let error = Command::new(program).arg("fleet").args(arguments).exec();
    Err(Failure::Command(Box::new(FleetFailure(error))))
}

/// Returns the program in the folder of this one, if it is there.
fn beside_this_one() -> Option<PathBuf> {
    let path = std::env::current_exe().ok()?.with_file_name(PROGRAM);
    path.is_file().then_some(path)
}
