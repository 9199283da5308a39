//! The errors of the program.

use std::io;
use std::path::PathBuf;

/// Why a recording, or all of them, is not uploaded.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// A file or a folder cannot be used.
    #[error("{}: {error}", path.display())]
    File {
        path: PathBuf,
        #[source]
        error: io::Error,
    },
    /// Another process uploads from the folder.
    #[error("{}: another motord-upload uses this folder", .0.display())]
    InUse(PathBuf),
    /// The command line contradicts itself or the store.
    #[error("{0}")]
    Usage(String),
    /// The store has another object under the name of a recording.
    #[error(
        "{0}: the store has another object with this key, which stays: rename the recording, or give another --prefix"
    )]
    Conflict(String),
    /// The recording was removed or changed before its upload was complete.
    #[error("{0}: it was removed or changed before it was uploaded")]
    Changed(String),
    /// The store does not answer, or refused the request. The upload continues later.
    #[error("{name}: {}", chain(error))]
    Store {
        name: String,
        #[source]
        error: object_store::Error,
    },
}

impl Failure {
    /// Returns true if a later attempt may succeed.
    pub(crate) fn is_transient(&self) -> bool {
        matches!(self, Self::Store { .. })
    }

    /// Returns the exit status, from sysexits(3) where it has one.
    pub(crate) const fn status(&self) -> u8 {
        match self {
            Self::Usage(_) => 64,
            Self::File { .. } => 74,
            Self::InUse(_) => 75,
            Self::Conflict(_) | Self::Changed(_) | Self::Store { .. } => 1,
        }
    }
}

/// Returns an error with its sources, each once.
fn chain(error: &object_store::Error) -> String {
    let mut text = error.to_string();
    let mut source = std::error::Error::source(error);
    while let Some(cause) = source {
        let cause_text = cause.to_string();
        if !text.contains(&cause_text) {
            text = format!("{text}: {cause_text}");
        }
        source = cause.source();
    }
    text
}
