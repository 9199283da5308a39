//! The system call that no safe crate offers. All `unsafe` of this crate is in this file.

use nix::errno::Errno;

/// Puts the calling thread under `SCHED_FIFO`.
///
/// # Errors
///
/// `EPERM` without `CAP_SYS_NICE` or a high enough `RLIMIT_RTPRIO`.
pub(crate) fn schedule_fifo(priority: u8) -> Result<(), Errno> {
    let param = libc::sched_param { sched_priority: i32::from(priority) };
    // SAFETY: pid 0 names the calling thread, and `param` is a fully initialised `sched_param` that outlives the call;
    // the kernel only reads it.
    let status = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const param) };
    Errno::result(status).map(drop)
}
