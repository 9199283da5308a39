//! The dead man's switch: a process of its own that damps and stops the motors when the daemon cannot.
//!
//! ```text
//!   motord run                                   motord deadman
//!   cycle ──store──▶ heartbeat (memfd) ◀──read── switch ──▶ its own CAN sockets
//!   registrar ◀───── connection ───────────────▶ server
//! ```
//!
//! The daemon registers with a [will](will::Will), ready-made frames for every motor, and the file of its
//! [heartbeat](crate::deadman::heartbeat). The switch knows no protocol and no configuration. It acts when the connection closes
//! or the heartbeat stands still, unless that is at rest: then the motors are stopped already. It outlives the daemon,
//! and the next one registers again.
//!
//! - [`switch`]: when to act, pure. [`schedule`]: what a bus is told then, and when, pure.
//! - [`server`]: watching. [`executor`]: sending. [`will`]: the frames.
//! - [`channel`]: the connection. [`registrar`]: the daemon's side.

pub mod channel;
pub mod executor;
pub mod heartbeat;
pub mod registrar;
pub mod schedule;
pub mod server;
pub mod switch;
pub mod will;

use crate::config::{self, ConfigError};
use crate::host::rt::{self, Wish};
use crate::host::systemd;
use channel::Listener;
use motord_bus::{Duration, clock};
use motord_shared::instance::{Instance, InstanceError};
use server::Server;
use signal_hook::consts::{SIGINT, SIGTERM};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// How often an idle switch looks whether it was told to end.
const IDLE: Duration = Duration::from_secs(1);
/// What it finishes after that takes at most so much longer than the damping. Less than systemd waits.
const FINISH_MARGIN: Duration = Duration::from_secs(1);

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
    #[error("instance {instance} has a dead man's switch already: stop that first")]
    AlreadyRunning {
        /// The instance.
        instance: String,
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
            Self::Config(_) => 78,
            Self::AlreadyRunning { .. } => 75,
            Self::Instance(_) => 77,
            Self::System(_) => 71,
        }
    }
}

/// Is the dead man's switch of the configuration's instance until a signal ends it. A will that is being carried out is
/// carried out first, but an interface that refuses is not waited for any longer than damping takes.
///
/// # Errors
///
/// Why it could not start.
pub fn run(path: &Path) -> Result<(), DeadmanError> {
    let settings = config::load(path)?.settings;
    let instance = Instance::find(&settings.instance)?;
    let listener = Listener::bind(&instance).map_err(|error| match error.kind() {
        io::ErrorKind::ResourceBusy => DeadmanError::AlreadyRunning { instance: settings.instance.clone() },
        _ => error.into(),
    })?;
    let told_to_end = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&told_to_end))?;
    }
    // Above the cycle, so that a cycle that runs away cannot keep the switch from a processor.
    let wish = Wish { cpu: None, priority: Some(settings.cycle.priority.saturating_add(1)) };
    let mut steps = rt::prepare_thread(wish);
    steps.extend([rt::tighten_timers(), rt::lock_memory()]);
    steps.iter().for_each(|step| step.tell("deadman"));

    let mut server = Server::new(listener, will::expect_interface);
    tracing::info!(instance = instance.name(), "ready");
    systemd::ready();
    while !told_to_end.load(Ordering::Relaxed) {
        server.turn(clock::monotonic() + IDLE);
    }
    systemd::stops(settings.safety.damp);
    let owed = server.finish(clock::monotonic() + settings.safety.damp + FINISH_MARGIN);
    if !owed.is_empty() {
        tracing::error!("told to end before these took their stops: {}", owed.join(", "));
    }
    Ok(())
}
