//! The answers.

use crate::web::policy::protect;
use async_channel::Receiver;
use bytes::Bytes;
use futures_lite::Stream;
use hyper::body::{Body, Frame, SizeHint};
use hyper::header::{ALLOW, CONTENT_TYPE, HeaderName, HeaderValue, WWW_AUTHENTICATE};
use hyper::{Response, StatusCode};
use std::convert::Infallible;
use std::pin::Pin;
use std::task::{Context, Poll};

const HTML: HeaderValue = HeaderValue::from_static("text/html; charset=utf-8");
const JSON: HeaderValue = HeaderValue::from_static("application/json");
const EVENTS: HeaderValue = HeaderValue::from_static("text/event-stream");
/// Keeps nginx from collecting events.
const BUFFERING: HeaderName = HeaderName::from_static("x-accel-buffering");

/// The body of an answer.
pub(crate) enum Content {
    Whole(Option<Bytes>),
    /// The newest event each time the reader can take one. Events between are dropped.
    Events(Pin<Box<Receiver<Bytes>>>),
}

impl Body for Content {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let next = match &mut *self {
            Self::Whole(bytes) => Poll::Ready(bytes.take()),
            Self::Events(events) => events.as_mut().poll_next(context),
        };
        next.map(|bytes| bytes.map(|bytes| Ok(Frame::data(bytes))))
    }

    fn is_end_stream(&self) -> bool {
        matches!(self, Self::Whole(None))
    }

    fn size_hint(&self) -> SizeHint {
        match self {
            Self::Whole(bytes) => SizeHint::with_exact(bytes.as_ref().map_or(0, |bytes| bytes.len() as u64)),
            Self::Events(_) => SizeHint::default(),
        }
    }
}

/// Creates answers with the fields of every answer.
pub(crate) struct Answers {
    policy: HeaderValue,
}

impl Answers {
    pub(crate) fn new() -> Self {
        let policy = HeaderValue::from_str(&crate::web::policy::content_security_policy());
        // Letters, digits and punctuation only.
        Self { policy: policy.unwrap_or(HeaderValue::from_static("default-src 'none'")) }
    }

    fn answer(&self, status: StatusCode, kind: HeaderValue, content: Content) -> Response<Content> {
        let mut answer = Response::new(content);
        *answer.status_mut() = status;
        protect(answer.headers_mut(), &self.policy);
        answer.headers_mut().insert(CONTENT_TYPE, kind);
        answer
    }

    pub(crate) fn page(&self) -> Response<Content> {
        let page = Bytes::from_static(crate::web::policy::PAGE.as_bytes());
        self.answer(StatusCode::OK, HTML, Content::Whole(Some(page)))
    }

    pub(crate) fn json(&self, status: StatusCode, text: Bytes) -> Response<Content> {
        self.answer(status, JSON, Content::Whole(Some(text)))
    }

    pub(crate) fn events(&self, events: Receiver<Bytes>) -> Response<Content> {
        let mut answer = self.answer(StatusCode::OK, EVENTS, Content::Events(Box::pin(events)));
        answer.headers_mut().insert(BUFFERING, HeaderValue::from_static("no"));
        answer
    }

    /// Returns an answer with a sentence.
    pub(crate) fn refusal(&self, status: StatusCode, sentence: &str) -> Response<Content> {
        let text = serde_json::json!({ "confirmed": false, "message": sentence }).to_string();
        self.json(status, text.into())
    }

    /// As [`refusal`](Self::refusal), with the field that HTTP demands.
    pub(crate) fn unauthorized(&self, sentence: &str) -> Response<Content> {
        let mut answer = self.refusal(StatusCode::UNAUTHORIZED, sentence);
        answer.headers_mut().insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        answer
    }

    /// As [`refusal`](Self::refusal), with the method that is known.
    pub(crate) fn other_method(&self, sentence: &str, known: &'static str) -> Response<Content> {
        let mut answer = self.refusal(StatusCode::METHOD_NOT_ALLOWED, sentence);
        answer.headers_mut().insert(ALLOW, HeaderValue::from_static(known));
        answer
    }
}
