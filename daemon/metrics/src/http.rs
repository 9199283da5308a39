//! The metrics by HTTP, for a Prometheus on this computer.
//!
//! One thread of normal priority serves all connections, each for one request. Number, time and
//! bytes of the connections are bounded ([`Limits`]), so a silent, slow or hostile client delays no
//! other reader of the metrics.

use crate::connection::{Connection, Limits};
use crate::latest::Latest;
use bytes::Bytes;
use http::header::{ALLOW, CONTENT_TYPE, HOST, HeaderValue};
use http::uri::Authority;
use http::{Method, Request, Response, StatusCode, Version};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::io::{self, ErrorKind};
use std::net::{IpAddr, Ipv6Addr, TcpListener};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Pause after a connection that could not be accepted. If no descriptors are left, an immediate
/// next attempt would fail as well.
const PAUSE: Duration = Duration::from_secs(1);
/// The type of the text format of Prometheus.
const TEXT_FORMAT: HeaderValue = HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");

/// Source of the answers.
#[derive(Debug)]
pub(crate) struct Pages {
    /// The metrics.
    pub(crate) latest: Arc<Latest>,
    /// The names of this computer that are answered.
    pub(crate) hosts: Hosts,
}

/// Answers the connections of `listener` within `limits`. Does not return, except with the error of
/// the system that prevents it from starting.
pub(crate) fn run(listener: TcpListener, pages: Pages, limits: Limits) -> io::Result<Infallible> {
    listener.set_nonblocking(true)?;
    let mut open = VecDeque::with_capacity(limits.connections);
    let mut accepts_from = Instant::now();
    loop {
        wait(&listener, accepts_from, &open);
        if Instant::now() >= accepts_from && admit(&listener, limits, &mut open).is_err() {
            accepts_from = Instant::now() + PAUSE;
        }
        let now = Instant::now();
        open.retain_mut(|connection| {
            now < connection.deadline() && connection.advance(|request| pages.answer(request))
        });
    }
}

/// Waits until a connection arrives or can advance, or the time of one is over. Does not wait for
/// new connections before `accepts_from`.
fn wait(listener: &TcpListener, accepts_from: Instant, open: &VecDeque<Connection>) {
    let now = Instant::now();
    let accepts = now >= accepts_from;
    let listening = accepts.then(|| PollFd::new(listener.as_fd(), PollFlags::POLLIN));
    let mut waiting: Vec<_> = listening.into_iter().chain(open.iter().map(Connection::poll)).collect();
    let deadlines = open.iter().map(Connection::deadline).chain((!accepts).then_some(accepts_from));
    let timeout = deadlines.min().map_or(PollTimeout::NONE, |deadline| {
        // A millisecond more, so that the deadline has passed afterwards.
        let left = deadline.saturating_duration_since(now) + Duration::from_millis(1);
        PollTimeout::try_from(left).unwrap_or(PollTimeout::MAX)
    });
    if let Err(error) = poll(&mut waiting, timeout)
        && error != Errno::EINTR
    {
        // The system lacks memory.
        std::thread::sleep(PAUSE);
    }
}

/// Accepts a connection if there is one. Closes the oldest of those in `open` if these are the
/// most.
fn admit(listener: &TcpListener, limits: Limits, open: &mut VecDeque<Connection>) -> io::Result<()> {
    let stream = match listener.accept() {
        Ok((stream, _)) => stream,
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => return Ok(()),
        Err(error) => return Err(error),
    };
    stream.set_nonblocking(true)?;
    if open.len() >= limits.connections {
        open.pop_front();
    }
    open.push_back(Connection::new(stream, limits));
    Ok(())
}

impl Pages {
    /// Answers the request from its head. A body is not read: no answer depends on it.
    fn answer(&self, request: &Request<()>) -> Response<Bytes> {
        let refusal = |status, sentence: &'static str| page(status, Bytes::from_static(sentence.as_bytes()));
        match self.check(request) {
            Ok(()) => page(StatusCode::OK, self.latest.text()),
            Err(Refused::NoHost) => {
                refusal(StatusCode::BAD_REQUEST, "The request names no host, or several.\n")
            }
            Err(Refused::Host) => refusal(
                StatusCode::MISDIRECTED_REQUEST,
                "This host name is not served: use localhost, or add the name to prometheus-hosts.\n",
            ),
            Err(Refused::Method) => {
                let mut answer = refusal(StatusCode::METHOD_NOT_ALLOWED, "Only GET is known.\n");
                answer.headers_mut().insert(ALLOW, HeaderValue::from_static("GET"));
                answer
            }
            Err(Refused::Path) => refusal(StatusCode::NOT_FOUND, "The metrics are at /metrics.\n"),
        }
    }

    fn check(&self, request: &Request<()>) -> Result<(), Refused> {
        let mut fields = request.headers().get_all(HOST).iter();
        let names = match (fields.next(), fields.next()) {
            (Some(host), None) => host.to_str().is_ok_and(|host| self.hosts.has(host)),
            (None, None) if request.version() == Version::HTTP_10 => true,
            _ => return Err(Refused::NoHost),
        };
        // A request to a proxy names the host a second time.
        let target = request.uri().authority().is_none_or(|target| self.hosts.has(target.as_str()));
        match (names && target, request.method(), request.uri().path()) {
            (false, _, _) => Err(Refused::Host),
            (_, &Method::GET, "/metrics") => Ok(()),
            (_, &Method::GET, _) => Err(Refused::Path),
            _ => Err(Refused::Method),
        }
    }
}

/// Why a request is refused.
#[derive(Debug, PartialEq, Eq)]
enum Refused {
    NoHost,
    Host,
    Method,
    Path,
}

fn page(status: StatusCode, text: Bytes) -> Response<Bytes> {
    let mut answer = Response::new(text);
    *answer.status_mut() = status;
    answer.headers_mut().insert(CONTENT_TYPE, TEXT_FORMAT);
    answer
}

/// The host names under which the metrics are served: those of the loopback interface, and
/// configured ones.
///
/// A page of another site can direct its own name to a loopback address (DNS rebinding), and read
/// the answers that a browser on this computer gets from there. The browser sends that name, so only
/// known names are answered.
#[derive(Debug, Clone, Default)]
pub(crate) struct Hosts(Vec<String>);

impl Hosts {
    /// Serves the `names` too.
    pub(crate) fn new(names: Vec<String>) -> Self {
        Self(names)
    }

    /// Returns whether `authority`, a name with or without a port, is served. The port is not
    /// checked.
    pub(crate) fn has(&self, authority: &str) -> bool {
        // RFC 9110 permits no user in the field.
        let Some(authority) = authority.parse::<Authority>().ok().filter(|_| !authority.contains('@')) else {
            return false;
        };
        let host = authority.host();
        let is = |name: &str| host.eq_ignore_ascii_case(name);
        is("localhost") || is_loopback(host) || self.0.iter().any(|name| is(name))
    }
}

fn is_loopback(host: &str) -> bool {
    let version6 = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    match version6 {
        Some(address) => address.parse() == Ok(Ipv6Addr::LOCALHOST),
        None => host.parse().is_ok_and(|address: IpAddr| address.is_loopback()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::connection::{HEAD_BYTES_MAX, HEADERS_MAX};
    use std::io::{Read, Write};
    use std::net::{SocketAddr, TcpStream as Client};

    fn checked(request: Request<()>) -> Result<(), Refused> {
        Pages { latest: Arc::default(), hosts: Hosts::default() }.check(&request)
    }

    fn to_localhost(method: &str, target: &str) -> Result<(), Refused> {
        checked(Request::builder().method(method).uri(target).header(HOST, "localhost").body(()).unwrap())
    }

    #[test]
    fn http_serves_only_metrics_and_only_get() {
        assert_eq!(to_localhost("GET", "/metrics?name=a"), Ok(()));
        assert_eq!(to_localhost("GET", "http://127.0.0.1:9464/metrics"), Ok(()));
        assert_eq!(to_localhost("GET", "http://attacker.example/metrics"), Err(Refused::Host));
        assert_eq!(to_localhost("GET", "/."), Err(Refused::Path));
        assert_eq!(to_localhost("POST", "/metrics"), Err(Refused::Method));
        assert_eq!(to_localhost("CONNECT", "localhost:80"), Err(Refused::Method));
    }

    #[test]
    fn request_names_exactly_one_host() {
        let request = || Request::builder().uri("/metrics");
        assert_eq!(checked(request().body(()).unwrap()), Err(Refused::NoHost));
        assert_eq!(checked(request().version(Version::HTTP_10).body(()).unwrap()), Ok(()));
        let both = request().header(HOST, "localhost").header(HOST, "localhost");
        assert_eq!(checked(both.body(()).unwrap()), Err(Refused::NoHost));
    }

    fn serve(text: &str, limits: Limits) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let latest = Arc::new(Latest::default());
        latest.put(text.into());
        std::thread::spawn(move || run(listener, Pages { latest, hosts: Hosts::default() }, limits));
        address
    }

    fn answered(request: &[u8], limits: Limits) -> String {
        let mut client = Client::connect(serve("", limits)).unwrap();
        // The server may close before it has read everything.
        let _closed = client.write_all(request);
        let mut answer = Vec::new();
        let _reset = client.read_to_end(&mut answer);
        String::from_utf8(answer).unwrap()
    }

    #[test]
    fn hostile_requests_are_refused_within_bounds() {
        let status =
            |request: &[u8]| answered(request, Limits::default()).get(..12).unwrap_or_default().to_owned();
        assert_eq!(status(b"\x16\x03\x01\x02\x00\x01\r\n\r\n"), "HTTP/1.1 400", "TLS");
        let long = [&b"GET /"[..], &[b'a'; 2 * HEAD_BYTES_MAX]].concat();
        assert!(["HTTP/1.1 414", "HTTP/1.1 431", ""].contains(&status(&long).as_str()));
        let fields = "A: b\r\n".repeat(HEADERS_MAX + 1);
        let many = format!("GET /metrics HTTP/1.1\r\n{fields}\r\n");
        assert_eq!(status(many.as_bytes()), "HTTP/1.1 431");
    }

    #[test]
    fn client_that_reads_nothing_is_closed() {
        let limits = Limits { connection: Duration::from_millis(200), ..Limits::default() };
        // More than the kernel buffers.
        let text = "a".repeat(64 << 20);
        let mut client = Client::connect(serve(&text, limits)).unwrap();
        client.write_all(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        std::thread::sleep(5 * limits.connection);
        let mut answer = Vec::new();
        let _reset = client.read_to_end(&mut answer);
        assert!(answer.len() < text.len(), "the server waited");
    }

    #[test]
    fn only_loopback_and_configured_names_are_served() {
        let hosts = Hosts::new(vec!["robot.lan".into()]);
        for served in
            ["localhost", "LocalHost:80", "127.0.0.1:9464", "127.255.0.1", "[::1]", "Robot.LAN:9464"]
        {
            assert!(hosts.has(served), "{served}");
        }
        let others = [
            "",
            ":80",
            "attacker.example",
            "localhost.attacker.example",
            "x@localhost",
            "10.0.0.1",
            "[::2]",
            "::1",
            "a b",
        ];
        for other in others {
            assert!(!hosts.has(other), "{other}");
        }
    }
}
