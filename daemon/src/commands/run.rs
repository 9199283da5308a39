//! `motord run`: reads the configuration, starts the daemon, and ends it on a signal so that the
//! robot is damped first.

use crate::arming;
use crate::buses::other_senders::{self, Listened};
use crate::buses::{self, BusError, Buses};
use crate::host::Watchdog;
use crate::run_error::RunError;
use crate::threads::Daemon;
use motord_bus::{Duration, Monotonic, clock};
use motord_configuration as config;
use motord_metrics::{Outputs, Wanted};
use motord_ports::instance::{Instance, InstanceLock};
use motord_realtime::descriptors::raise_descriptors;
use motord_realtime::process::program;
use motord_realtime::{forbid_deep_sleep, granted, systemd};
use motord_settings::settings::Settings;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::SignalsInfo;
use signal_hook::iterator::exfiltrator::origin::{Origin, WithOrigin};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const SIGNAL_TURN: Duration = Duration::from_millis(20);
/// Interval of looking for a missing bus.
const WAIT_TURN: Duration = Duration::from_millis(500);

/// The choices for a run that its configuration does not make.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Waits at most this long for buses that are missing or down.
    pub bus_timeout: Duration,
    /// No bus is opened: the plant on this socket moves the joints of the simulated robot.
    pub plant: Option<PathBuf>,
}

/// Runs the daemon until a signal ends it.
///
/// # Errors
///
/// Why it could not start, or why it ended by itself.
pub fn run(path: &Path, options: &Options) -> Result<(), RunError> {
    let loaded = config::load(path)?;
    loaded.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    let descriptors = raise_descriptors()?;
    tracing::debug!("file descriptors: {descriptors}");
    let lock = Arc::new(Instance::find(&loaded.settings.instance)?.lock()?);
    lock.displaced().iter().for_each(|displaced| tracing::warn!("{displaced}"));
    let outcome = drive(path, options, loaded, &lock);
    if !matches!(outcome, Err(RunError::Unstopped(_))) {
        lock.rest();
    }
    outcome
}

/// Opens the buses and drives their motors until a signal, or until the daemon ends by itself.
fn drive(
    path: &Path,
    options: &Options,
    loaded: config::Loaded,
    lock: &Arc<InstanceLock>,
) -> Result<(), RunError> {
    let config::Loaded { mut settings, telemetry, hash, .. } = loaded;
    let mut buses = match &options.plant {
        Some(plant) => buses::open_planted(&mut settings, plant)?,
        None => await_buses(&settings, options.bus_timeout)?,
    };
    #[cfg(feature = "panic-on-request")]
    crate::host::panics::register_requests()?;
    let mut signals = SignalsInfo::<WithOrigin>::new([SIGTERM, SIGINT, SIGHUP])?;
    let (deep_sleep, _keeps_awake) = forbid_deep_sleep();
    deep_sleep.log("main");

    let is_ended = || signals.pending().any(|origin| handle_signal_before_start(&origin));
    if other_senders::listen(&settings, &mut buses.buses, &mut Monotonic, is_ended)? == Listened::Interruption
    {
        return Ok(());
    }
    (buses.buses, buses.mismatched) = arming::check(&settings, path, buses.buses)?;
    let damp = settings.safety.damp;
    let size = (settings.buses.len(), settings.motors.len(), settings.cycle.rate_hz);
    let outputs = Outputs::start(&Wanted {
        file: telemetry.prometheus_file,
        listen: telemetry.prometheus_listen,
        hosts: telemetry.prometheus_hosts,
    });
    let daemon = Daemon::start(settings, Some((path, hash)), buses, lock, outputs)?;
    let realtime = granted(&[daemon.realtime(), &[deep_sleep]].concat());
    if let Some(plant) = &options.plant {
        tracing::info!("every bus is simulated: the plant on {} moves the joints", plant.display());
    }
    serve(&daemon, &mut signals, damp, || {
        log_start(lock.instance().name(), (path, hash), size, &realtime);
        systemd::ready();
    });
    daemon.end()
}

/// Feeds the watchdog and handles signals until the daemon has ended. Calls `ready` once the first
/// state is published.
fn serve(daemon: &Daemon, signals: &mut SignalsInfo<WithOrigin>, damp: Duration, ready: impl Fn()) {
    let mut watchdog = Watchdog::new();
    let mut is_ready = false;
    while !daemon.has_ended() {
        watchdog.feed(daemon.cycle());
        for origin in signals.pending() {
            handle_signal(daemon, &origin, damp);
        }
        if is_ready {
            std::thread::sleep(SIGNAL_TURN);
        } else if daemon.await_first_state(SIGNAL_TURN) {
            is_ready = true;
            ready();
        }
    }
}

/// Opens the buses. For at most `bus_timeout`, waits for those that are missing or down, and
/// reports each once.
fn await_buses(settings: &Settings, bus_timeout: Duration) -> Result<Buses, BusError> {
    let end = clock::monotonic() + bus_timeout;
    let mut reported = String::new();
    loop {
        let error = match buses::open(settings) {
            Err(error) if error.may_pass() && clock::monotonic() < end => error.to_string(),
            outcome => return outcome,
        };
        systemd::waiting(&error, 4 * WAIT_TURN);
        if error != reported {
            let seconds = bus_timeout.as_secs_f64();
            tracing::warn!(see = "gone", "{error}; waiting for it, at most {seconds:.0} s");
            reported = error;
        }
        std::thread::sleep(WAIT_TURN);
    }
}

/// The one line of a start. `size` is the number of buses and of motors, and the rate in Hz.
fn log_start(
    instance: &str,
    (path, hash): (&Path, u64),
    (buses, motors, rate_hz): (usize, usize, f64),
    realtime: &str,
) {
    let (version, config, hash) = (env!("CARGO_PKG_VERSION"), path.display(), format!("{hash:016x}"));
    tracing::info!(instance, version, %config, hash, buses, motors, rate_hz, realtime, "ready");
}

/// Returns the name of a signal, and the program and the process that sent it.
fn sender(origin: &Origin) -> (&'static str, Option<String>, Option<u32>) {
    let signal = signal_hook::low_level::signal_name(origin.signal).unwrap_or("a signal");
    // A signal from the terminal (Ctrl-C) names no process.
    let pid = origin.process.as_ref().and_then(|process| u32::try_from(process.pid).ok());
    (signal, pid.and_then(program), pid)
}

fn ignore_hangup() {
    tracing::info!("SIGHUP is ignored: the configuration is read once, at the start");
}

/// Handles a signal before the first frame. Returns whether it ends the program.
fn handle_signal_before_start(origin: &Origin) -> bool {
    let (signal, program, pid) = sender(origin);
    if origin.signal == SIGHUP {
        ignore_hangup();
        return false;
    }
    tracing::info!(signal, program, pid, "leaving before the start: no frame was sent");
    true
}

/// Handles a signal while the daemon runs. `damp` is how long the motors may have to be damped.
fn handle_signal(daemon: &Daemon, origin: &Origin, damp: Duration) {
    let (signal, program, pid) = sender(origin);
    match origin.signal {
        SIGHUP => ignore_hangup(),
        _ if daemon.is_stopping() => {
            tracing::warn!(signal, program, pid, "second signal: stopping the motors at once");
            daemon.stop_now();
        }
        _ => {
            tracing::info!(signal, program, pid, "damping and stopping the motors, then leaving");
            systemd::stopping(damp);
            daemon.stop();
        }
    }
}
