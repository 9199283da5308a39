//! The metrics by HTTP, for a Prometheus on this computer.
//!
//! One connection at a time with one request each, both bounded: a slow or hostile client delays other readers of
//! the metrics by one second, and no other thread.

use crate::latest::Latest;
use httparse::{EMPTY_HEADER, Request, Status};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Longest head of a request.
const HEAD_BYTES_MAX: usize = 8 * 1024;
/// Most header fields of a request.
const HEADERS_MAX: usize = 64;
/// Longest time of a connection.
const CONNECTION: Duration = Duration::from_secs(1);
/// The type of the text format of Prometheus.
const TEXT_FORMAT: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Answers the connections of `listener`, one after the other.
pub(crate) fn run(listener: &TcpListener, latest: &Latest) {
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                let _client_is_gone_or_slow = serve(stream, latest);
            }
            // If no descriptors are left, an immediate next attempt would fail as well.
            Err(_) => std::thread::sleep(CONNECTION),
        }
    }
}

/// Answers one request, within [`CONNECTION`].
fn serve(stream: TcpStream, latest: &Latest) -> io::Result<()> {
    let mut stream = Timed { stream, ends: Instant::now() + CONNECTION };
    let (status, body) = match target(&mut stream)? {
        Target::Metrics => ("200 OK", latest.text()),
        Target::Other => ("404 Not Found", "The metrics are at /metrics.\n".into()),
        Target::Method => ("405 Method Not Allowed", "Only GET is known.\n".into()),
        Target::Malformed => ("400 Bad Request", "This is no HTTP request.\n".into()),
    };
    let length = body.len();
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {TEXT_FORMAT}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body.as_bytes())
}

/// Returns the requested page.
#[derive(Debug, PartialEq, Eq)]
enum Target {
    Metrics,
    Other,
    Method,
    Malformed,
}

/// Reads the head of a request. A body is not read: no answer depends on it.
fn target(stream: &mut impl Read) -> io::Result<Target> {
    let (mut head, mut length) = ([0; HEAD_BYTES_MAX], 0);
    while length < head.len() {
        let read = stream.read(&mut head[length..])?;
        if read == 0 {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        length += read;
        let mut headers = [EMPTY_HEADER; HEADERS_MAX];
        let mut request = Request::new(&mut headers);
        match request.parse(&head[..length]) {
            Ok(Status::Partial) => {}
            Ok(Status::Complete(_)) => return Ok(judge(&request)),
            Err(_) => return Ok(Target::Malformed),
        }
    }
    Ok(Target::Malformed)
}

fn judge(request: &Request<'_, '_>) -> Target {
    let path = request.path.and_then(|path| path.split('?').next());
    match (request.method, path) {
        (Some("GET"), Some("/metrics")) => Target::Metrics,
        (Some("GET"), _) => Target::Other,
        _ => Target::Method,
    }
}

/// A connection whose reads and writes fail after a time, however little each of them waits.
struct Timed {
    stream: TcpStream,
    ends: Instant,
}

impl Timed {
    /// The time that is left.
    fn left(&self) -> io::Result<Duration> {
        let left = self.ends.saturating_duration_since(Instant::now());
        if left.is_zero() { Err(ErrorKind::TimedOut.into()) } else { Ok(left) }
    }
}

impl Read for Timed {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.stream.set_read_timeout(Some(self.left()?))?;
        self.stream.read(bytes)
    }
}

impl Write for Timed {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.stream.set_write_timeout(Some(self.left()?))?;
        self.stream.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns its bytes one by one.
    struct Slow<'a>(&'a [u8]);

    impl Read for Slow<'_> {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            let count = bytes.len().min(1);
            self.0.read(&mut bytes[..count])
        }
    }

    fn asked(request: &[u8]) -> Option<Target> {
        let at_once = target(&mut &request[..]).ok();
        assert_eq!(target(&mut Slow(request)).ok(), at_once);
        at_once
    }

    #[test]
    fn http_serves_only_metrics_and_only_get() {
        assert_eq!(asked(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n"), Some(Target::Metrics));
        assert_eq!(asked(b"GET /metrics?name=a HTTP/1.0\r\n\r\n"), Some(Target::Metrics));
        assert_eq!(asked(b"GET /. HTTP/1.1\r\n\r\n"), Some(Target::Other));
        assert_eq!(asked(b"POST /metrics HTTP/1.1\r\nContent-Length: 9\r\n\r\n"), Some(Target::Method));
    }

    #[test]
    fn hostile_requests_are_refused_within_bounds() {
        assert_eq!(asked(b"\x16\x03\x01\x02\x00\x01"), Some(Target::Malformed), "TLS");
        assert_eq!(asked(b"GET /metrics HTTP/1.1\r\nHost"), None, "the connection ended");
        let long = [&b"GET /"[..], &[b'a'; 2 * HEAD_BYTES_MAX]].concat();
        assert_eq!(target(&mut &long[..]).unwrap(), Target::Malformed);
        let fields = "A: b\r\n".repeat(HEADERS_MAX + 1);
        assert_eq!(
            asked(format!("GET /metrics HTTP/1.1\r\n{fields}\r\n").as_bytes()),
            Some(Target::Malformed)
        );
    }

    #[test]
    fn silent_http_client_delays_others_boundedly() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || run(&listener, &Latest::default()));
        let _silent = TcpStream::connect(address).unwrap();
        let mut client = TcpStream::connect(address).unwrap();
        client.write_all(b"GET /metrics HTTP/1.1\r\n\r\n").unwrap();
        let answer = io::read_to_string(client).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
    }
}
