//! The threads that serve the newest text of the metrics. None is real-time or delays another
//! thread, and a panic in one ends that output only.

use crate::connection::Limits;
use crate::http::Hosts;
use crate::http::{self, Pages};
use crate::latest::Latest;
use crate::textfile;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::Builder;

/// Stack of each thread. The memory of the process is locked, so all of it is resident. The server
/// needs 18 KiB in a debug build.
const STACK_BYTES: usize = 96 * 1024;

/// The configured outputs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Absolute path of a file for the textfile collector of Prometheus' node exporter.
    pub file: Option<PathBuf>,
    /// Loopback address where Prometheus fetches them by HTTP.
    pub listen: Option<SocketAddr>,
    /// Host names that are served at `listen`, besides those of the loopback interface.
    pub hosts: Vec<String>,
}

/// The running outputs.
#[derive(Debug)]
pub struct Outputs(Arc<Latest>);

impl Outputs {
    /// Starts the configured outputs. Returns `None` without any. An output that cannot be started
    /// is logged, and the daemon runs without it.
    #[must_use]
    pub fn start(wanted: &Wanted) -> Option<Self> {
        if wanted.file.is_none() && wanted.listen.is_none() {
            return None;
        }
        let latest = Arc::new(Latest::default());
        if let Some(file) = wanted.file.clone() {
            let latest = Arc::clone(&latest);
            log("the file of the metrics", spawn("motord-textfile", move || textfile::run(&file, &latest)));
        }
        if let Some(address) = wanted.listen {
            let pages = Pages { latest: Arc::clone(&latest), hosts: Hosts::new(wanted.hosts.clone()) };
            let listening = TcpListener::bind(address)
                .and_then(|listener| spawn("motord-http", move || serve(listener, pages)));
            log("the metrics by HTTP", listening);
        }
        Some(Self(latest))
    }

    /// Hands `text` to the outputs. Does not wait for them.
    pub fn publish(&self, text: String) {
        self.0.put(text);
    }
}

/// Serves until the process ends.
fn serve(listener: TcpListener, pages: Pages) {
    let Err(error) = http::run(listener, pages, Limits::default());
    log("the metrics by HTTP", Err(error));
}

/// Starts a detached thread, which ends with the process.
fn spawn(name: &str, run: impl FnOnce() + Send + 'static) -> io::Result<()> {
    Builder::new().name(name.into()).stack_size(STACK_BYTES).spawn(run).map(drop)
}

fn log(output: &str, started: io::Result<()>) {
    if let Err(error) = started {
        tracing::warn!(see = "no-metrics", "{output} cannot be started: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::net::TcpStream;

    #[test]
    fn no_thread_is_started_unasked() {
        assert!(Outputs::start(&Wanted::default()).is_none());
    }

    #[test]
    fn address_in_use_does_not_stop_textfile() {
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("motord.prom");
        let wanted =
            Wanted { file: Some(file.clone()), listen: taken.local_addr().ok(), ..Wanted::default() };
        let outputs = Outputs::start(&wanted).unwrap();
        outputs.publish("motord_cycles_total 1\n".into());
        let ends = std::time::Instant::now() + std::time::Duration::from_secs(60);
        while !file.exists() {
            assert!(std::time::Instant::now() < ends, "no file");
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "motord_cycles_total 1\n");
    }

    #[test]
    fn the_newest_text_is_fetched_by_http() {
        let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let outputs = Outputs::start(&Wanted { listen: Some(free), ..Wanted::default() }).unwrap();
        for text in ["first\n", "second\n"] {
            outputs.publish(text.into());
            let mut client = TcpStream::connect(free).unwrap();
            client.write_all(b"GET /metrics HTTP/1.0\r\n\r\n").unwrap();
            let answer = io::read_to_string(client).unwrap();
            assert!(answer.ends_with(&format!("\r\n\r\n{text}")), "{answer}");
        }
    }
}
