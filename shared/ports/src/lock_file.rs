//! A locked file that holds the id of the process which locked it.

use crate::directory::{Directory, Displaced};
use crate::instance_error::{InstanceError, refused};
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::sys::stat::stat;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;
use std::str::FromStr;

/// Readings of the list of locks before a lock counts as free.
const READS: u32 = 5;
/// More than the kernel passes at a time.
const PIECE_BYTES: usize = 64 * 1024;

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

/// The exclusive locks of a file, as far as this process may know them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Locks {
    /// No process in this namespace of processes holds one.
    Free,
    /// This process holds one.
    Held {
        /// Its id.
        pid: u32,
    },
    /// The file or the list of locks cannot be read.
    Unknown,
}

/// Returns who holds an exclusive lock of `path` (`flock`), without opening the file: its mode may
/// forbid that. Reads the list of all locks of the computer, several times before it reports none.
/// A lock of another file with the same number counts too.
pub(crate) fn exclusive(path: &Path) -> Locks {
    let Ok(found) = stat(path) else { return Locks::Unknown };
    (0..READS).map(|_| listed(found.st_ino)).find(|locks| *locks != Locks::Free).unwrap_or(Locks::Free)
}

/// Returns who holds an exclusive lock of the file with this number in one reading of the list. The
/// kernel passes it in pieces, and a piece lacks a lock when locks before it ended meanwhile.
fn listed(file_number: u64) -> Locks {
    let Ok(table) = locks() else { return Locks::Unknown };
    let of_line = |line: &str| match line.split_whitespace().collect::<Vec<_>>()[..] {
        [_, "FLOCK", _, "WRITE", pid, file, ..] => {
            let number: u64 = file.rsplit(':').next()?.parse().ok()?;
            (number == file_number).then(|| pid.parse().ok())?
        }
        _ => None,
    };
    table.lines().find_map(of_line).map_or(Locks::Free, |pid| Locks::Held { pid })
}

/// Reads the list in the largest pieces that the kernel passes.
fn locks() -> io::Result<String> {
    let mut table = String::with_capacity(PIECE_BYTES);
    File::open("/proc/locks")?.read_to_string(&mut table)?;
    Ok(table)
}

/// Returns the process that died with the lock of `path`: its id is still in the file, and neither
/// lock nor process exist. `None` also where the file cannot be read.
pub(crate) fn dead_holder(path: &Path) -> Option<u32> {
    let pid: u32 = File::open(path).ok().map(|mut file| read_number(&mut file)).filter(|pid| *pid > 0)?;
    let is_free = exclusive(path) == Locks::Free && !Path::new(&format!("/proc/{pid}")).exists();
    is_free.then_some(pid)
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// A client would take a living daemon for dead.
    #[test]
    fn held_lock_is_seen_while_others_end() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("held");
        let _held = Flock::lock(File::create(&path).unwrap(), FlockArg::LockExclusiveNonblock).unwrap();
        let end = AtomicBool::new(false);
        let churn = |thread: usize| {
            let names: Vec<_> =
                (0..200).map(|name| directory.path().join(format!("{thread}-{name}"))).collect();
            while !end.load(Ordering::Relaxed) {
                let files = names.iter().map(|name| File::create(name).unwrap());
                let locks = files.map(|file| Flock::lock(file, FlockArg::LockExclusiveNonblock).unwrap());
                locks.collect::<Vec<_>>().into_iter().for_each(drop);
            }
        };
        std::thread::scope(|scope| {
            (0..2).for_each(|thread| drop(scope.spawn(move || churn(thread))));
            let seen = (0..300).filter(|_| exclusive(&path) == Locks::Held { pid: std::process::id() });
            let seen = seen.count();
            end.store(true, Ordering::Relaxed);
            assert_eq!(seen, 300);
        });
    }
}
