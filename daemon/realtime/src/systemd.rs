//! Messages to systemd (`sd_notify(3)`). They have no effect where systemd does not run this
//! process.

use core::time::Duration;
use sd_notify::NotifyState;

/// The time that a stop may take beyond the damping.
const STOP_MARGIN: Duration = Duration::from_secs(3);

/// Reports that the start is over.
pub fn ready() {
    send(&[NotifyState::Ready, NotifyState::Status("")]);
}

/// Reports what the start waits for, and requests `time` until the next report.
pub fn waiting(reason: &str, time: Duration) {
    let micros = u32::try_from(time.as_micros()).unwrap_or(u32::MAX);
    send(&[NotifyState::Status(reason), NotifyState::ExtendTimeoutUsec(micros)]);
}

/// Feeds the watchdog.
pub fn feed_watchdog() {
    send(&[NotifyState::Watchdog]);
}

/// Reports that the process stops its motors and then ends. Requests `damp` plus `STOP_MARGIN` for
/// that, which may be longer than `TimeoutStopSec=` of the unit.
pub fn stopping(damp: Duration) {
    let micros = u32::try_from((damp + STOP_MARGIN).as_micros()).unwrap_or(u32::MAX);
    let time = NotifyState::ExtendTimeoutUsec(micros);
    send(&[NotifyState::Stopping, time]);
}

fn send(states: &[NotifyState<'_>]) {
    let _no_systemd = sd_notify::notify(states);
}
