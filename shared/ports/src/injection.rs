//! Faults for the simulated buses of a running daemon: lines of text on the socket
//! `<runtime>/<instance>.sim`.
//!
//! A connection carries one line, such as `fl-knee off`, and one line as the answer: `ok`, or
//! `error: ` and the reason. The socket exists only if every bus of the configuration is simulated.
//! Every process that may enter the runtime directory may connect.

use crate::instance::{Instance, InstanceLock};
use nix::sys::socket::{getsockopt, sockopt};
use std::fs::{self, Permissions};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::time::Duration;

/// Limit on the bytes of a line. A longer line is truncated.
const LINE_BYTES_MAX: u64 = 1024;
/// Timeout of each side for each part of a line. The daemon's cycle executes a fault within a
/// second.
const TIMEOUT: Duration = Duration::from_secs(3);

/// The reason why a fault was not injected.
#[derive(Debug, thiserror::Error)]
pub enum InjectionError {
    /// The instance has no such socket: no daemon runs it, or some of its buses are real.
    #[error("does not support faults")]
    NotSimulated,
    /// The daemon refused, with this reason.
    #[error("{0}")]
    Refused(String),
    /// The connection failed.
    #[error(transparent)]
    System(#[from] io::Error),
}

/// Requests the fault in `line` from the daemon of `instance`. Waits for the answer.
///
/// # Errors
/// See [`InjectionError`]. After [`InjectionError::System`] the state of the fault is unknown.
pub fn inject(instance: &Instance, line: &str) -> Result<(), InjectionError> {
    let stream = UnixStream::connect(path(instance)).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused => InjectionError::NotSimulated,
        _ => InjectionError::System(error),
    })?;
    let one_line: String = line.split_whitespace().collect::<Vec<_>>().join(" ");
    send(&stream, &one_line)?;
    match receive(&stream)?.as_str() {
        "ok" => Ok(()),
        "" => Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()),
        refusal => Err(InjectionError::Refused(refusal.trim_start_matches("error: ").to_owned())),
    }
}

/// The daemon's side: serves one client after the other.
#[derive(Debug)]
pub struct InjectionListener(UnixListener);

impl InjectionListener {
    /// Opens the socket of the locked instance, for users who may enter its runtime directory.
    ///
    /// # Errors
    /// Those of the system.
    pub fn bind(lock: &InstanceLock) -> io::Result<Self> {
        lock.clear_socket("sim").map_err(io::Error::other)?;
        let path = path(lock.instance());
        let listener = UnixListener::bind(&path)?;
        // The umask of a service must not exclude its group.
        let mode = fs::metadata(lock.instance().runtime())?.mode();
        fs::set_permissions(&path, Permissions::from_mode(mode & 0o777))?;
        Ok(Self(listener))
    }

    /// Waits for the next line, passes it to `obey` with the requester's process id, and answers
    /// with the outcome. Drops a requester that sends nothing for some seconds.
    ///
    /// # Errors
    /// Those of the system: the client has disconnected, or no descriptors are left.
    pub fn serve(&self, obey: impl FnOnce(&str, u32) -> Result<(), String>) -> io::Result<()> {
        let (stream, _) = self.0.accept()?;
        let pid = getsockopt(&stream, sockopt::PeerCredentials)?.pid();
        let line = receive(&stream)?;
        let answer = obey(&line, u32::try_from(pid).unwrap_or(0));
        send(&stream, &answer.map_or_else(|refusal| format!("error: {refusal}"), |()| "ok".to_owned()))
    }
}

fn path(instance: &Instance) -> PathBuf {
    instance.runtime().join(format!("{}.sim", instance.name()))
}

fn send(mut stream: &UnixStream, line: &str) -> io::Result<()> {
    stream.set_write_timeout(Some(TIMEOUT))?;
    stream.write_all(format!("{line}\n").as_bytes())
}

fn receive(stream: &UnixStream) -> io::Result<String> {
    stream.set_read_timeout(Some(TIMEOUT))?;
    let mut line = Vec::new();
    BufReader::new(stream.take(LINE_BYTES_MAX)).read_until(b'\n', &mut line)?;
    Ok(String::from_utf8_lossy(&line).trim_end().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_listener(test: impl FnOnce(&Instance, &InjectionListener)) {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let lock = instance.lock().unwrap();
        let listener = InjectionListener::bind(&lock).unwrap();
        test(&instance, &listener);
    }

    #[test]
    fn line_reaches_daemon_with_requester_and_refusal_returns() {
        with_listener(|instance, listener| {
            std::thread::scope(|scope| {
                let requester = scope.spawn(|| inject(instance, "fl-knee  off\nfl-hip off"));
                let served = listener.serve(|line, pid| {
                    assert_eq!((line, pid), ("fl-knee off fl-hip off", std::process::id()));
                    Err("no".into())
                });
                served.unwrap();
                assert!(
                    matches!(requester.join().unwrap(), Err(InjectionError::Refused(why)) if why == "no")
                );
                let requester = scope.spawn(|| inject(instance, "fl-knee off"));
                listener.serve(|_, _| Ok(())).unwrap();
                assert!(requester.join().unwrap().is_ok());
            });
        });
    }

    #[test]
    fn endless_line_is_cut_and_departed_requester_ignored() {
        with_listener(|instance, listener| {
            let mut endless = UnixStream::connect(path(instance)).unwrap();
            endless.write_all(&[b'x'; 4096]).unwrap();
            listener
                .serve(|line, _| {
                    assert_eq!(line.len() as u64, LINE_BYTES_MAX);
                    Ok(())
                })
                .ok();
            drop(UnixStream::connect(path(instance)).unwrap());
            listener
                .serve(|line, _| {
                    assert_eq!(line, "");
                    Ok(())
                })
                .ok();
        });
    }

    #[test]
    fn instance_without_live_socket_is_not_simulated() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        assert!(matches!(inject(&instance, "fl-knee off"), Err(InjectionError::NotSimulated)));
        drop(InjectionListener::bind(&instance.lock().unwrap()).unwrap());
        assert!(matches!(inject(&instance, "fl-knee off"), Err(InjectionError::NotSimulated)));
        drop(InjectionListener::bind(&instance.lock().unwrap()).unwrap());
    }
}
