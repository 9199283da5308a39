//! `motord run`: reads the configuration, starts the daemon, and ends it on a signal so that the robot is damped first.

use crate::buses::{self, BusError};
use crate::config::{self, ConfigError};
use crate::host::rt;
use crate::host::systemd;
use crate::threads::Daemon;
use motord_bus::Duration;
use motord_bus::socketcan::LockError;
use motord_shared::instance::{Instance, InstanceError};
use motord_shared::service::ServiceError;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::io;
use std::path::Path;
use std::sync::Arc;

const SIGNAL_TURN: Duration = Duration::from_millis(20);

/// Why the daemon does not run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The configuration is refused.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// The instance's directory cannot be used, or another daemon holds it.
    #[error("{0}")]
    Instance(#[from] InstanceError),
    /// A bus cannot be opened.
    #[error("{0}")]
    Bus(#[from] BusError),
    /// Clients cannot be served.
    #[error("{0}")]
    Service(#[from] ServiceError),
    /// `require-realtime` is set, and the machine refuses.
    #[error("require-realtime is set, but there is no {what} ({errno}): {remedy}")]
    Realtime {
        /// What was refused.
        what: &'static str,
        /// Why.
        errno: nix::errno::Errno,
        /// What to do.
        remedy: &'static str,
    },
    /// A thread could not be started, or signals not be waited for.
    #[error("the system refused a thread or a signal: {0}")]
    System(#[from] io::Error),
    /// A thread ended that should not.
    #[error("the {0} thread ended unexpectedly: this is a bug, the motors were told to stop")]
    Thread(&'static str),
    /// These motors did not answer their stops, and may hold their last command.
    #[error("told to stop, but not heard since: {}; cut their power before anybody comes near", .0.join(", "))]
    Unstopped(Vec<String>),
}

impl RunError {
    /// The exit status, by `sysexits.h`.
    #[must_use]
    pub fn exit_status(&self) -> u8 {
        match self {
            Self::Config(_) | Self::Realtime { .. } => 78,
            Self::Instance(InstanceError::AlreadyRunning { .. })
            | Self::Bus(BusError::Lock { source: LockError::Held { .. }, .. }) => 75,
            Self::Instance(_) => 77,
            Self::Bus(_) | Self::Service(_) | Self::Unstopped(_) => 69,
            Self::System(_) => 71,
            Self::Thread(_) => 70,
        }
    }
}

/// Runs the daemon until a signal ends it.
///
/// # Errors
///
/// Why it could not start, or why it ended by itself.
pub fn run(path: &Path) -> Result<(), RunError> {
    let config::Loaded { settings, warnings, hash } = config::load(path)?;
    warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    let lock = Arc::new(Instance::find(&settings.instance)?.lock()?);
    let buses = buses::open(&settings, lock.instance().runtime())?;
    #[cfg(feature = "panic-on-request")]
    crate::host::panics::hear_requests()?;
    let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP])?;
    let (deep_sleep, _keeps_awake) = rt::forbid_deep_sleep();
    deep_sleep.log("main");

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
