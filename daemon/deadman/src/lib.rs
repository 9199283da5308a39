//! The dead man's switch: a separate process that damps and stops the motors when the daemon
//! cannot.
//!
//! ```text
//!   motord run                                   motord deadman
//!   cycle ──store──▶ heartbeat (memfd) ◀──read── switch ──▶ separate CAN sockets and serial ports
//!   registrar ◀───── connection ───────────────▶ server
//! ```
//!
//! The daemon registers its [safe frames](safe_frames::SafeFrames), built in advance for every
//! motor, and the file of its [heartbeat]. The switch knows no protocol. It uses three values of
//! the configuration: instance, priority, and the time of damping, which bounds its exit. It acts
//! when the connection closes or the heartbeat stalls, unless the heartbeat is at rest: the motors
//! are stopped then. The switch outlives the daemon, and the next daemon registers again.
//!
//! - [`switch`]: decides when to act, without I/O. [`server`]: supervises a daemon, and acts.
//! - [`safe_frames`]: the frames. [`interfaces`]: sends them, by the
//!   [`Stopper`](motord_core::stopper::Stopper).
//! - [`channel`]: the connection. [`registrar`]: the daemon's side.
//! - [`answers`]: whether the motors answer that command. [`safe_stop`]: the command that stops the
//!   motors once, when neither the daemon nor its switch did.

pub mod answers;
pub mod channel;
pub mod heartbeat;
pub mod interfaces;
#[allow(unsafe_code, reason = "system calls that no safe crate offers")]
mod kernel;
mod port;
pub mod registrar;
pub mod safe_frames;
pub mod safe_stop;
pub mod server;
pub mod switch;

use channel::{BindError, Listener};
use motord_bus::{Duration, clock};
use motord_configuration::{self as config, ConfigError};
use motord_core::stopper::REFUSAL_TIMEOUT;
use motord_ports::instance::{Instance, InstanceError};
use motord_realtime::{SchedulingRequest, lock_memory, prepare_thread, systemd, tighten_timers};
use motord_terminal::exit_status;
use server::Server;
use signal_hook::consts::{SIGINT, SIGTERM};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Period in which systemd's watchdog is fed.
const FEEDING: Duration = Duration::from_millis(500);
/// Period in which an idle switch checks for a signal.
const IDLE: Duration = Duration::from_secs(1);

/// Why there is no dead man's switch.
#[derive(Debug, thiserror::Error)]
pub enum DeadmanError {
    /// The configuration is refused.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// The instance's directory cannot be used.
    #[error("{0}")]
    Instance(#[from] InstanceError),
    /// Another process is the switch of this instance.
    #[error("instance {instance} has a dead man's switch already, process {pid}: stop that first")]
    AlreadyRunning {
        /// The instance.
        instance: String,
        /// The process; 0 before it wrote its id.
        pid: u32,
    },
    /// The system refused something else.
    #[error("the system refused a socket or a signal: {0}")]
    System(#[from] io::Error),
}

impl DeadmanError {
    /// The exit status, by `sysexits.h`.
    #[must_use]
    pub fn exit_status(&self) -> u8 {
        match self {
            Self::Config(_) => exit_status::CONFIG,
            Self::Instance(error) if error.is_a_setting() => exit_status::CONFIG,
            Self::AlreadyRunning { .. } => exit_status::BUSY,
            Self::Instance(_) => exit_status::PERMISSION,
            Self::System(_) => exit_status::OS,
        }
    }
}

/// Runs the dead man's switch of the configuration's instance until a signal ends it. A switch that
/// acts finishes first. It waits for an interface that refuses frames at most one second longer
/// than damping takes.
///
/// # Errors
///
/// Why it could not start.
pub fn run(path: &Path) -> Result<(), DeadmanError> {
    let settings = config::load(path)?.settings;
    let instance = Instance::find(&settings.instance)?;
    let listener = Listener::bind(&instance).map_err(|error| match error {
        BindError::Instance(InstanceError::AlreadyRunning { pid, .. }) => {
            DeadmanError::AlreadyRunning { instance: settings.instance.clone(), pid }
        }
        BindError::Instance(error) => error.into(),
        BindError::System(errno) => io::Error::from(errno).into(),
    })?;
    let ending = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&ending))?;
    }
    // Above the cycle: a cycle that never yields must not keep the switch from a processor.
    let request = SchedulingRequest { cpu: None, priority: Some(settings.cycle.priority.saturating_add(1)) };
    let mut steps = prepare_thread(request);
    steps.extend([tighten_timers(), lock_memory()]);
    steps.iter().for_each(|step| step.log("deadman"));

    let mut server = Server::new(listener, interfaces::expect_interface);
    tracing::info!(instance = instance.name(), "ready");
    systemd::ready();
    let mut fed = clock::monotonic();
    while !ending.load(Ordering::Relaxed) {
        server.turn(clock::monotonic() + IDLE);
        if clock::monotonic().since(fed) >= FEEDING {
            fed = clock::monotonic();
            systemd::feed_watchdog();
        }
    }
    systemd::stopping(settings.safety.damp);
    let unserved = server.finish(clock::monotonic() + settings.safety.damp + REFUSAL_TIMEOUT);
    if !unserved.is_empty() {
        tracing::error!(
            see = "stops-owed",
            "exits before these interfaces accepted their stop frames: {}",
            unserved.join(", ")
        );
    }
    Ok(())
}
