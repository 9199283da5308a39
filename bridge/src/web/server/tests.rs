//! The server on loopback, with raw requests.

use super::*;
use crate::config::Web;
use crate::fixtures::shared;
use crate::stop::StopDesk;
use crate::web::token::Tokens;
use std::io::{Read, Write};
use std::net::TcpStream as Peer;
use std::sync::atomic::{AtomicBool, Ordering};

const SECRET: &str = "0123456789abcdef";

/// A port of loopback, and the configuration of a page there.
fn listening() -> (tokio::runtime::Runtime, TcpListener, SocketAddr, Web) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build().unwrap();
    let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
    let address = listener.local_addr().unwrap();
    (runtime, listener, address, Web { port: address.port(), ..Web::default() })
}

/// A server, and a thread that answers stops.
struct Running {
    address: SocketAddr,
    ends: Arc<AtomicBool>,
    desk: Arc<StopDesk>,
    threads: Vec<std::thread::JoinHandle<()>>,
}

impl Running {
    fn start(needs_token: bool) -> Self {
        let (shared, desk) = (shared(), Arc::new(StopDesk::default()));
        let ends = Arc::clone(&shared.ends);
        let (runtime, listener, address, web) = listening();
        let tokens = needs_token.then(|| Tokens::parse(&format!("anna {SECRET}")).unwrap());
        let [stopping, closing] = [&desk; 2].map(Arc::clone);
        let serve = move || {
            let server = Rc::new(Server::new(Guard::new(&web, tokens), desk));
            tokio::task::LocalSet::new().block_on(&runtime, run(&server, &listener, None, &shared));
        };
        let stop = move || {
            // No motord runs this instance: each stop is unconfirmed.
            crate::stop::run("no-such-robot", &stopping);
        };
        let threads = vec![std::thread::spawn(serve), std::thread::spawn(stop)];
        Self { address, ends, desk: closing, threads }
    }

    fn open(&self) -> Peer {
        let peer = Peer::connect(self.address).unwrap();
        peer.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        peer
    }

    /// Sends `bytes`, and returns the answer.
    fn send(&self, bytes: &[u8]) -> String {
        let mut peer = self.open();
        // The server may close before it has read everything.
        let _closed = peer.write_all(bytes);
        let mut answer = Vec::new();
        let _reset = peer.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn request(&self, line: &str, fields: &str) -> String {
        self.send(format!("{line} HTTP/1.1\r\nHost: {}\r\n{fields}\r\n", self.address).as_bytes())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        self.desk.close();
        for thread in self.threads.drain(..) {
            assert!(thread.join().is_ok());
        }
    }
}

fn status(answer: &str) -> &str {
    answer.get(9..12).unwrap_or("none")
}

#[test]
fn page_and_state_are_served_with_protection() {
    let server = Running::start(false);
    let page = server.request("GET /", "");
    assert!(page.starts_with("HTTP/1.1 200") && page.ends_with("</html>\n"));
    assert!(page.contains("content-security-policy: default-src 'none'") && page.contains("nosniff"));
    let state = server.request("GET /api/state", "");
    assert!(state.starts_with("HTTP/1.1 200") && state.contains("x-frame-options: DENY"), "{state}");
    assert!(!state.contains("access-control"), "{state}");
}

#[test]
fn stop_answers_401_then_403_then_receipt() {
    let server = Running::start(true);
    assert_eq!(status(&server.request("POST /api/stop", "")), "401");
    let bearer = format!("Authorization: Bearer {SECRET}\r\n");
    let foreign = format!("{bearer}Origin: http://evil.example\r\n");
    assert_eq!(status(&server.request("POST /api/stop", &foreign)), "403");
    let host = format!("POST /api/stop HTTP/1.1\r\nHost: evil.example\r\n{bearer}\r\n");
    assert_eq!(status(&server.send(host.as_bytes())), "403");
    let answer = server.request("POST /api/stop", &bearer);
    assert_eq!(status(&answer), "502", "{answer}");
    assert!(answer.contains("\"confirmed\":false") && answer.contains("no-such-robot"), "{answer}");
}

#[test]
fn stop_of_page_that_has_left_counts() {
    let (shared, desk) = (shared(), Arc::new(StopDesk::default()));
    let (runtime, listener, address, web) = listening();
    let mut peer = Peer::connect(address).unwrap();
    let server = Rc::new(Server::new(Guard::new(&web, None), Arc::clone(&desk)));
    let requested = async {
        // The server waits for the request, which arrives together with the end of the page.
        sleep(Duration::from_millis(20)).await;
        peer.write_all(format!("POST /api/stop HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).unwrap();
        drop(peer);
        for _ in 0..2000 {
            if !desk.waiting().is_empty() {
                break;
            }
            sleep(Duration::from_millis(1)).await;
        }
    };
    let serving = futures_lite::future::or(run(&server, &listener, None, &shared), requested);
    tokio::task::LocalSet::new().block_on(&runtime, serving);
    assert_eq!(desk.waiting().len(), 1);
}

#[test]
fn damaged_requests_are_refused_within_bounds() {
    let server = Running::start(false);
    assert_eq!(status(&server.send(b"\x16\x03\x01\x02\x00\x01\r\n\r\n")), "400");
    let long = [&b"GET /"[..], &[b'a'; 4 * HEAD_MAX]].concat();
    assert!(["414", "431", "none"].contains(&status(&server.send(&long))));
    let fields = "A: b\r\n".repeat(FIELDS_MAX + 1);
    assert_eq!(status(&server.request("GET /", &fields)), "431");
    assert_eq!(status(&server.request("POST /api/stop", "Content-Length: 5000\r\n")), "413");
    assert_eq!(status(&server.request("GET /", "")), "200");
}

#[test]
fn silent_connections_keep_nobody_out() {
    let server = Running::start(false);
    let silent: Vec<_> = (0..3 * CONNECTIONS_MAX).map(|_| server.open()).collect();
    assert_eq!(status(&server.request("GET /api/state", "")), "200");
    drop(silent);
}

#[test]
fn slow_head_is_ended() {
    let server = Running::start(false);
    let mut slow = server.open();
    slow.write_all(b"GET / HTTP/1.1\r\nHo").unwrap();
    let mut rest = Vec::new();
    // Ends by the server, long before the timeout of this reader.
    slow.read_to_end(&mut rest).unwrap();
    assert!(status(&String::from_utf8_lossy(&rest)) != "200");
}

#[test]
fn number_of_streams_is_bounded() {
    let server = Running::start(false);
    let open = || {
        let mut peer = server.open();
        write!(peer, "GET /api/events HTTP/1.1\r\nHost: {}\r\n\r\n", server.address).unwrap();
        let mut begin = [0; 12];
        peer.read_exact(&mut begin).unwrap();
        (peer, String::from_utf8_lossy(&begin).into_owned())
    };
    let streams: Vec<_> = (0..STREAMS_MAX).map(|_| open()).collect();
    assert!(streams.iter().all(|(_, begin)| begin == "HTTP/1.1 200"));
    assert_eq!(open().1, "HTTP/1.1 503");
    assert_eq!(status(&server.request("POST /api/stop", "")), "502", "the stop still works");
}
