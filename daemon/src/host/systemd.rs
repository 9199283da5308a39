//! What systemd is told (`sd_notify(3)`), where it runs this process; elsewhere nothing.

use motord_bus::Duration;
use sd_notify::NotifyState;

/// What a stop may take longer than the damping.
const STOP_MARGIN: Duration = Duration::from_secs(3);

/// The start is over.
pub fn ready() {
    tell(&[NotifyState::Ready]);
}

/// The process does what it is for.
pub fn lives() {
    tell(&[NotifyState::Watchdog]);
}

/// The process ends once its motors are stopped, which takes as long as they are damped: `damp` at most. The unit's
/// `TimeoutStopSec=` knows nothing of that, and must not end it.
pub fn stops(damp: Duration) {
    let micros = u32::try_from((damp + STOP_MARGIN).as_micros()).unwrap_or(u32::MAX);
    let patience = NotifyState::ExtendTimeoutUsec(micros);
    tell(&[NotifyState::Stopping, patience]);
}

fn tell(states: &[NotifyState<'_>]) {
    let _not_there = sd_notify::notify(states);
}
