//! The thread of the page: accepts connections, each for one request, and answers within limits.

use crate::rate_limit::RateLimit;
use crate::shared::Shared;
use crate::stop::StopDesk;
use crate::web::admission::{Connections, Progress, Stage};
use crate::web::answer::{Answers, Content};
use crate::web::guard::{Admitted, Denial, Guard, Route};
use crate::web::report::{self, Newest};
use crate::web::timed::Timed;
use crate::web::tls::TlsAcceptor;
use async_channel::Sender;
use bytes::Bytes;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use std::cell::RefCell;
use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::pin;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, spawn_local};
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

/// Open connections.
const CONNECTIONS_MAX: usize = 64;
/// Pages that receive events.
const STREAMS_MAX: usize = 16;
/// Bytes and fields of a request's head.
const HEAD_MAX: usize = 8 * 1024;
const FIELDS_MAX: usize = 64;
/// Time for the handshake of TLS, and for the head.
const HEAD_TIMEOUT: Duration = Duration::from_secs(3);
/// Time in which a reader takes a byte.
const WRITE_TIMEOUT: Duration = Duration::from_secs(5);
/// Time for a request without events, from its connection to its end.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(12);
/// Time for a receipt. A stop takes little more than two seconds, and may wait for another.
const RECEIPT_TIMEOUT: Duration = Duration::from_secs(6);
/// Interval of events.
const PERIOD: Duration = Duration::from_millis(100);
/// Pause after a connection that could not be accepted.
const PAUSE: Duration = Duration::from_millis(200);

/// The values that all connections share.
pub(crate) struct Server {
    guard: Guard,
    desk: Arc<StopDesk>,
    answers: Answers,
    /// The newest state as JSON.
    newest: RefCell<Bytes>,
    /// One for each page.
    events: RefCell<Vec<Sender<Bytes>>>,
    refusals: RefCell<RateLimit>,
}

/// Serves until the bridge ends.
pub(crate) async fn run(
    server: &Rc<Server>,
    listener: &TcpListener,
    tls: Option<&TlsAcceptor>,
    shared: &Shared,
) {
    let accepting = accept(server, listener, tls);
    futures_lite::future::or(accepting, server.publish(shared)).await;
}

/// Accepts connections. Does not return.
async fn accept(server: &Rc<Server>, listener: &TcpListener, tls: Option<&TlsAcceptor>) {
    let mut connections = Connections::new(CONNECTIONS_MAX);
    loop {
        match listener.accept().await {
            Ok((stream, peer)) if connections.make_space(|task: AbortHandle| task.abort()) => {
                let (server, tls) = (Rc::clone(server), tls.cloned());
                let serve = |progress| {
                    spawn_local(async move { server.serve(stream, peer, tls, progress).await }).abort_handle()
                };
                connections.add(serve);
            }
            Ok(_closed) => {}
            // No descriptors are left, for example: an immediate next attempt would fail as well.
            Err(_) => sleep(PAUSE).await,
        }
        tokio::task::yield_now().await;
    }
}

impl Server {
    pub(crate) fn new(guard: Guard, desk: Arc<StopDesk>) -> Self {
        Self {
            guard,
            desk,
            answers: Answers::new(),
            newest: RefCell::new(Bytes::from_static(b"{}")),
            events: RefCell::default(),
            refusals: RefCell::new(RateLimit::new(1, Duration::from_secs(10))),
        }
    }

    /// Publishes the newest state to every page, until the bridge ends.
    async fn publish(&self, shared: &Shared) {
        let mut ticks = interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut newest = Newest::default();
        while !shared.ends() {
            ticks.tick().await;
            if let Some(report) = shared.page.try_take() {
                newest.update(report);
            }
            let json = newest.json(shared, self.desk.last());
            let event = Bytes::from(format!("data: {json}\n\n"));
            *self.newest.borrow_mut() = json.into();
            // A page that has not taken the event of before gets this one instead.
            self.events.borrow_mut().retain(|page| page.force_send(event.clone()).is_ok());
        }
    }

    async fn serve(
        self: Rc<Self>,
        stream: TcpStream,
        peer: SocketAddr,
        tls: Option<TlsAcceptor>,
        progress: Progress,
    ) {
        // Without it an event may wait for the acknowledgement of the one before.
        let _late = stream.set_nodelay(true);
        let stream = Timed::new(stream, WRITE_TIMEOUT);
        match tls {
            None => self.converse(stream, peer, &progress).await,
            Some(tls) => {
                if let Ok(Ok(stream)) = timeout(HEAD_TIMEOUT, tls.accept(stream)).await {
                    self.converse(stream, peer, &progress).await;
                }
            }
        }
    }

    /// Answers one request.
    async fn converse(
        &self,
        stream: impl AsyncRead + AsyncWrite + Unpin,
        peer: SocketAddr,
        progress: &Progress,
    ) {
        let answer = |request| async move { Ok::<_, Infallible>(self.answer(request, peer, progress).await) };
        let connection = http1::Builder::new()
            .keep_alive(false)
            // Otherwise a stop is dropped whose page has left when its request is read.
            .half_close(true)
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_TIMEOUT)
            .max_buf_size(HEAD_MAX)
            .max_headers(FIELDS_MAX)
            .serve_connection(TokioIo::new(stream), service_fn(answer));
        let mut connection = pin!(connection);
        // A peer's errors are its own.
        if timeout(REQUEST_TIMEOUT, &mut connection).await.is_err() && progress.stage() == Stage::Streaming {
            let _ended = connection.await;
        }
    }

    async fn answer(
        &self,
        request: Request<Incoming>,
        peer: SocketAddr,
        progress: &Progress,
    ) -> Response<Content> {
        progress.set(Stage::Answering);
        let (head, _unread) = request.into_parts();
        let admitted = match self.guard.check(&head) {
            Ok(admitted) => admitted,
            Err(denial) => return self.refuse(denial, peer),
        };
        match admitted.route {
            Route::Page => self.answers.page(),
            Route::State => self.answers.json(StatusCode::OK, self.newest.borrow().clone()),
            Route::Events => self.subscribe(progress),
            Route::Stop => self.stop(source(&admitted, peer)).await,
        }
    }

    fn refuse(&self, denial: Denial, peer: SocketAddr) -> Response<Content> {
        let sentence = denial.sentence();
        if let Some(suppressed) = self.refusals.borrow_mut().permit(Instant::now()) {
            log::warn!("page: a request of {peer} was refused ({suppressed} before): {sentence}");
        }
        match denial {
            Denial::Token => self.answers.unauthorized(sentence),
            Denial::Method(known) => self.answers.other_method(sentence, known),
            _ => self.answers.refusal(denial.status(), sentence),
        }
    }

    fn subscribe(&self, progress: &Progress) -> Response<Content> {
        let mut events = self.events.borrow_mut();
        events.retain(|page| !page.is_closed());
        if events.len() >= STREAMS_MAX {
            let sentence = "Too many pages are open: close one. The stop works without.";
            return self.answers.refusal(StatusCode::SERVICE_UNAVAILABLE, sentence);
        }
        progress.set(Stage::Streaming);
        let (sender, receiver) = async_channel::bounded(1);
        let first = format!("data: {}\n\n", String::from_utf8_lossy(&self.newest.borrow()));
        let _sent = sender.force_send(first.into());
        events.push(sender);
        self.answers.events(receiver)
    }

    /// Stops the robot. Only a stop that each motor confirmed has the status 200.
    async fn stop(&self, source: String) -> Response<Content> {
        let receipt = self.desk.request(source);
        match timeout(RECEIPT_TIMEOUT, receipt.recv()).await {
            Ok(Ok(receipt)) => {
                let status = if receipt.is_confirmed { StatusCode::OK } else { StatusCode::BAD_GATEWAY };
                self.answers.json(status, report::receipt(receipt).into())
            }
            Ok(Err(_)) => {
                let sentence = "A stop runs, and too many others wait for its receipt: cut the power.";
                self.answers.refusal(StatusCode::SERVICE_UNAVAILABLE, sentence)
            }
            Err(_) => {
                let sentence = "No receipt of the stop arrived: cut the power.";
                self.answers.refusal(StatusCode::GATEWAY_TIMEOUT, sentence)
            }
        }
    }
}

/// Returns the source of a stop, for the log and the other pages.
fn source(admitted: &Admitted, peer: SocketAddr) -> String {
    let person = admitted.person.as_deref().map(|person| format!(" by {person}")).unwrap_or_default();
    match admitted.forwarded_for {
        Some(address) => format!("the page{person}, {address} through the proxy {}", peer.ip()),
        None => format!("the page{person}, {peer}"),
    }
}

#[cfg(test)]
mod tests;
