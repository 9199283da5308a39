//! `motord run`: reads the configuration, starts the daemon, and ends it on a signal so that the robot is damped first.

use crate::arming;
use crate::buses::{self, Buses};
use crate::host::rt;
use crate::host::systemd;
use crate::run_error::RunError;
use crate::threads::Daemon;
use motord_bus::Duration;
use motord_configuration as config;
use motord_shared::instance::Instance;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::path::Path;
use std::sync::Arc;

const SIGNAL_TURN: Duration = Duration::from_millis(20);

/// Runs the daemon until a signal ends it.
///
/// # Errors
///
/// Why it could not start, or why it ended by itself.
pub fn run(path: &Path) -> Result<(), RunError> {
    let config::Loaded { mut settings, warnings, hash } = config::load(path)?;
    warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    let lock = Arc::new(Instance::find(&settings.instance)?.lock()?);
    let Buses { buses, locks, injectors } = buses::open(&settings, lock.instance().runtime())?;
    #[cfg(feature = "panic-on-request")]
    crate::host::panics::hear_requests()?;
    let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP])?;
    let (deep_sleep, _keeps_awake) = rt::forbid_deep_sleep();
    rt::log(&deep_sleep, "main");

    let buses = Buses { buses: arming::judge(&mut settings, path, buses)?, locks, injectors };
    let damp = settings.safety.damp;
    let daemon = Daemon::start(settings, Some((path, hash)), buses, &lock)?;
    tracing::info!(instance = lock.instance().name(), "ready");
    systemd::ready();
    while !daemon.has_ended() {
        for signal in signals.pending() {
            heed(&daemon, signal, damp);
        }
        std::thread::sleep(SIGNAL_TURN);
    }
    daemon.end()
}

/// `damp` is how long the motors may have to be damped.
fn heed(daemon: &Daemon, signal: i32, damp: Duration) {
    match signal {
        SIGHUP => tracing::info!("SIGHUP is ignored: the configuration is read once, at the start"),
        _ if daemon.is_stopping() => {
            tracing::warn!("second signal: stopping the motors at once");
            daemon.stop_now();
        }
        _ => {
            tracing::info!("damping and stopping the motors, then leaving");
            systemd::stopping(damp);
            daemon.stop();
        }
    }
}
