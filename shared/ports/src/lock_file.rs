//! A locked file that holds the id of the process which locked it.

use crate::directory::{Directory, Displaced};
use crate::instance_error::{InstanceError, refused};
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use std::fs::File;
use std::io::{self, Read, Write};
use std::str::FromStr;

/// Locks the file `name` in `runtime`, and writes the id of this process into it.
pub(crate) fn hold(
    runtime: &Directory,
    name: &str,
    displaced: &mut Vec<Displaced>,
) -> Result<Flock<File>, InstanceError> {
    let path = runtime.path.join(name);
    let mut file = runtime.make_lock(name, displaced)?;
    let holder = read_number(&mut file);
    let mut lock = Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(_, errno)| match errno {
        Errno::EWOULDBLOCK => InstanceError::AlreadyRunning { pid: holder, path: path.clone() },
        errno => InstanceError::System { path: path.clone(), errno },
    })?;
    write_pid(&mut lock)
        .map_err(|error| refused(&path, Errno::from_raw(error.raw_os_error().unwrap_or(0))))?;
    Ok(lock)
}

/// Returns the number at the start of the file, or 0.
pub(crate) fn read_number<N: FromStr + Default>(file: &mut File) -> N {
    let mut text = [0; 32];
    let bytes = file.read(&mut text).unwrap_or(0);
    str::from_utf8(&text[..bytes]).ok().and_then(|text| text.trim().parse().ok()).unwrap_or_default()
}

fn write_pid(file: &mut File) -> io::Result<()> {
    io::Seek::rewind(file)?;
    file.set_len(0)?;
    writeln!(file, "{}", std::process::id())
}
