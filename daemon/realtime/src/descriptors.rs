//! File descriptors: as many as all clients together need, and a table of its own for a thread that needs only one.

pub use crate::kernel::keep_only;
use nix::sys::resource::{Resource, getrlimit, setrlimit};

/// Descriptors that a daemon takes with every client that it may have, and as many again.
const DESCRIPTORS_LEAST: u64 = 512;
/// More are of no use.
const DESCRIPTORS_MOST: u64 = 4096;

/// Too few file descriptors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{limit} file descriptors are too few to serve every client, {DESCRIPTORS_LEAST} are needed: raise LimitNOFILE= in the \
     unit, or `ulimit -n`"
)]
pub struct TooFewDescriptors {
    /// Most that this process may have open.
    pub limit: u64,
}

/// Raises the limit of open files as far as permitted, so that a client which comes late is served like the first. Returns
/// the limit.
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
