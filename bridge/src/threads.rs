//! Starts a thread of the bridge.

use std::thread::{Builder, JoinHandle};

/// Starts the thread `name`. The error is a sentence.
pub(crate) fn spawn(name: &str, run: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, String> {
    let thread = Builder::new().name(name.to_owned()).spawn(run);
    thread.map_err(|error| format!("cannot start the thread {name}: {error}"))
}
