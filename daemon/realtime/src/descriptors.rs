//! File descriptors: enough for all clients, and a separate table for a thread that needs only one.

pub use crate::kernel::keep_only;
use nix::sys::resource::{Resource, getrlimit, setrlimit};

/// Twice the descriptors of a daemon with all of its clients.
const DESCRIPTORS_LEAST: u64 = 512;
/// The limit is raised to this at most.
const DESCRIPTORS_MOST: u64 = 4096;

/// Too few file descriptors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{limit} file descriptors are too few to serve every client, {DESCRIPTORS_LEAST} are needed: raise LimitNOFILE= in the \
     unit, or `ulimit -n`"
)]
pub struct TooFewDescriptors {
    /// The limit of this process.
    pub limit: u64,
}

/// Raises the limit of open files as far as permitted, so that the last client gets descriptors
/// too. Returns the limit.
///
/// # Errors
///
/// [`TooFewDescriptors`] when clients could not be served.
pub fn raise_descriptors() -> Result<u64, TooFewDescriptors> {
    let (soft, hard) = getrlimit(Resource::RLIMIT_NOFILE).unwrap_or((0, 0));
    let wanted = hard.min(DESCRIPTORS_MOST);
    let raised = wanted > soft && setrlimit(Resource::RLIMIT_NOFILE, wanted, hard).is_ok();
    let limit = if raised { wanted } else { soft };
    if limit < DESCRIPTORS_LEAST { Err(TooFewDescriptors { limit }) } else { Ok(limit) }
}
