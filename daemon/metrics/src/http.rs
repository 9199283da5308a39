//! The metrics by HTTP, for a Prometheus on this computer.
//!
//! One thread of normal priority serves all connections, each for one request. Number, time and bytes of the
//! connections are bounded ([`Limits`]), so a silent, slow or hostile client delays no other reader of the metrics.

use crate::hosts::Hosts;
use crate::latest::Latest;
use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{ALLOW, CONTENT_TYPE, HOST, HeaderValue};
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode, Version};
use hyper_util::rt::{TokioIo, TokioTimer};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::io;
use std::net::TcpListener as StdListener;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::AbortHandle;

/// Longest head of a request, in bytes. hyper permits no shorter one.
const HEAD_BYTES_MAX: usize = 8 * 1024;
/// Most header fields of a request.
const HEADERS_MAX: usize = 64;
/// Pause after a connection that could not be accepted. If no descriptors are left, an immediate next attempt would
/// fail as well.
const PAUSE: Duration = Duration::from_secs(1);
/// The type of the text format of Prometheus.
const TEXT_FORMAT: HeaderValue = HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");

/// Bounds of the connections.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Most connections. One more closes the oldest.
    pub(crate) connections: usize,
    /// Longest time until the head of the request is complete, also of a connection that sends nothing.
    pub(crate) head: Duration,
    /// Longest time of a connection, also of one that reads no answer.
    pub(crate) connection: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self { connections: 32, head: Duration::from_secs(2), connection: Duration::from_secs(10) }
    }
}

/// Source of the answers.
#[derive(Debug)]
pub(crate) struct Pages {
    /// The metrics.
    pub(crate) latest: Arc<Latest>,
    /// The names of this computer that are answered.
    pub(crate) hosts: Hosts,
}

/// Answers the connections of `listener` within `limits`. Does not return, except with the error of the system that
/// prevents it from starting.
pub(crate) fn run(listener: StdListener, pages: Pages, limits: Limits) -> io::Result<Infallible> {
    listener.set_nonblocking(true)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
    runtime.block_on(async {
        let listener = TcpListener::from_std(listener)?;
        let pages = Arc::new(pages);
        let mut open = VecDeque::with_capacity(limits.connections);
        loop {
            match listener.accept().await {
                Ok((stream, _)) => admit(stream, &pages, limits, &mut open),
                Err(_) => tokio::time::sleep(PAUSE).await,
            }
        }
    })
}

/// Begins to serve `stream`. Closes the oldest of the connections in `open` if these are the most.
fn admit(stream: TcpStream, pages: &Arc<Pages>, limits: Limits, open: &mut VecDeque<AbortHandle>) {
    open.retain(|connection| !connection.is_finished());
    if open.len() >= limits.connections
        && let Some(oldest) = open.pop_front()
    {
        oldest.abort();
    }
    open.push_back(tokio::spawn(serve(stream, Arc::clone(pages), limits)).abort_handle());
}

/// Serves one request.
async fn serve(stream: TcpStream, pages: Arc<Pages>, limits: Limits) {
    let service = service_fn(|request| std::future::ready(Ok::<_, Infallible>(pages.answer(&request))));
    let connection = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.head)
        .keep_alive(false)
        .max_buf_size(HEAD_BYTES_MAX)
        .max_headers(HEADERS_MAX)
        .serve_connection(TokioIo::new(stream), service);
    let _disconnected_or_slow = tokio::time::timeout(limits.connection, connection).await;
}

impl Pages {
    /// Answers the request from its head. A body is not read: no answer depends on it.
    fn answer(&self, request: &Request<Incoming>) -> Response<Full<Bytes>> {
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

    fn check<B>(&self, request: &Request<B>) -> Result<(), Refused> {
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

fn page(status: StatusCode, text: Bytes) -> Response<Full<Bytes>> {
    let mut answer = Response::new(Full::new(text));
    *answer.status_mut() = status;
    answer.headers_mut().insert(CONTENT_TYPE, TEXT_FORMAT);
    answer
}

#[cfg(test)]
mod tests {
    use super::*;
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
        let listener = StdListener::bind("127.0.0.1:0").unwrap();
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
}
