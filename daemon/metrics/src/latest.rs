//! The newest text of the metrics, which the threads share.

use bytes::Bytes;
use std::sync::{Mutex, PoisonError};

/// The newest text; empty before the first.
#[derive(Debug, Default)]
pub(crate) struct Latest(Mutex<Bytes>);

impl Latest {
    /// Replaces the text.
    pub(crate) fn put(&self, text: String) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = text.into();
    }

    /// The text. Does not copy it.
    pub(crate) fn text(&self) -> Bytes {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
