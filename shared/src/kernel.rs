//! A descriptor that no safe crate lends. All `unsafe` of this crate is in this file.

use crate::service::Service;
use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::FileDescriptorBased;
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;
use std::os::fd::BorrowedFd;
use std::time::Duration;

/// Longest sleep: the kernel refuses one of more than 2⁶³ s.
const SLEEP_MAX: Duration = Duration::from_secs(3600);

/// Sleeps until `listener` has a notification, at most `timeout` or [`SLEEP_MAX`], or until a signal comes. One system call. It leaves
/// the notification where it is.
///
/// # Errors
/// Those of `ppoll`, except `EINTR`.
pub(crate) fn sleep_until_notified(listener: &Listener<Service>, timeout: Duration) -> Result<(), Errno> {
    // SAFETY: the number is not kept beyond this call, and nothing closes it.
    let number = unsafe { listener.file_descriptor().native_handle() };
    // SAFETY: the descriptor is open as long as `listener` lives, which outlives the call.
    let descriptor = unsafe { BorrowedFd::borrow_raw(number) };
    let mut awaited = [PollFd::new(descriptor, PollFlags::POLLIN)];
    match ppoll(&mut awaited, Some(TimeSpec::from_duration(timeout.min(SLEEP_MAX))), None) {
        Ok(_) | Err(Errno::EINTR) => Ok(()),
        Err(error) => Err(error),
    }
}
