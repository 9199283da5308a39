//! `motord run`: puts everything together, and takes it apart again so that the robot is damped first.
//!
//! | thread | what it does |
//! |---|---|
//! | `motord` | waits for signals |
//! | `motord-cycle` | the cycle; real-time where the machine allows it |
//! | `motord-exchange` | clients |
//! | `motord-telemetry` | histograms, log, watchdog |
//! | `motord-registrar` | leaves the daemon's will with its dead man's switch |
//! | `motord-reopen` | opens buses again that went away |

use crate::buses::{self, BusError, Buses};
use crate::clock::Monotonic;
use crate::config::settings::Settings;
use crate::config::{self, ConfigError};
use crate::cycle::{self, Cycle, Place};
use crate::deadman::registrar::Registrar;
use crate::deadman::will::Will;
use crate::exchange::{self, Exchange};
use crate::heartbeat::{Heartbeat, Pulse};
use crate::plan::BusPlan;
use crate::reopen::{self, Workshop};
use crate::rt::{self, Wish};
use crate::telemetry::{self, Recorder};
use motord_bus::socketcan::LockError;
use motord_bus::{Duration, clock};
use motord_shared::instance::{Instance, InstanceError, InstanceLock};
use motord_shared::ports::{DaemonPorts, Housekeeper};
use motord_shared::roster::{GroupDescription, JointDescription, Roster};
use motord_shared::service::ServiceError;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Builder, JoinHandle};

/// Cycles with stop frames before the daemon leaves a stopped robot.
const LAST_CYCLES: u32 = 3;
/// A robot that is not still by then is left with what it was told last: stop.
const SHUTDOWN_MAX: Duration = Duration::from_secs(3);
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
            Self::Bus(_) | Self::Service(_) => 69,
            Self::System(_) => 71,
            Self::Thread(_) => 70,
        }
    }
}

/// What the threads are told: run, stop with damping, stop now, or end.
#[derive(Debug, Default)]
struct Orders(AtomicU32);

impl Orders {
    const STOP: u32 = 1;
    const STOP_NOW: u32 = 2;
    const END: u32 = 3;

    fn give(&self, order: u32) {
        self.0.fetch_max(order, Ordering::Relaxed);
    }

    fn are(&self, order: u32) -> bool {
        self.0.load(Ordering::Relaxed) >= order
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
    let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP])?;
    let (_deep_sleep, _keeps_awake) = rt::forbid_deep_sleep();

    let daemon = Daemon::start(settings, (path, hash), buses, &lock)?;
    tracing::info!(instance = lock.instance().name(), "ready");
    let _no_systemd = sd_notify::notify(&[sd_notify::NotifyState::Ready]);
    while !daemon.has_ended() {
        for signal in signals.pending() {
            daemon.signalled(signal);
        }
        std::thread::sleep(SIGNAL_TURN);
    }
    daemon.end()
}

/// The running threads.
struct Daemon {
    orders: Arc<Orders>,
    cycle: JoinHandle<()>,
    exchange: JoinHandle<()>,
    telemetry: JoinHandle<()>,
}

impl Daemon {
    fn start(
        settings: Settings,
        (config, hash): (&Path, u64),
        buses: Buses,
        lock: &Arc<InstanceLock>,
    ) -> Result<Self, RunError> {
        let orders = Arc::new(Orders::default());
        let boot_id = boot_id();
        let (mut link, ends) = cycle::link(settings.groups.len());
        let (exchange_end, telemetry_end) = exchange::CycleEnd::split(ends);
        let (questions, answers) = telemetry::questions();

        let exchange = start_exchange(&settings, lock, &orders, exchange_end, questions, boot_id)?;
        link.wakes(exchange.thread().clone());
        let mut recorder = Recorder::new(&settings, telemetry_end, answers);
        recorder.wakes(exchange.thread().clone());
        recorder.watches(config.to_owned(), hash);
        let (replacements, workshop) = reopen::ends();
        link.repairs(replacements);
        let (broken, hears_broken) = channel();
        recorder.reports_broken(broken);
        start_workshop(&settings, &orders, workshop, hears_broken)?;
        let telemetry = start_telemetry(lock, &orders, recorder)?;

        let plans = BusPlan::of(&settings);
        let (heartbeat, pulse) = Heartbeat::create().map_err(io::Error::from)?;
        link.beats(heartbeat);
        let cycle = Cycle::new(&settings, &plans, buses.buses, Monotonic, link, boot_id);
        let cycle = start_cycle(&settings, &orders, cycle, heartbeat, buses.locks)?;
        start_registrar(&settings, lock.instance(), &orders, pulse)?;
        Ok(Self { orders, cycle, exchange, telemetry })
    }

    fn has_ended(&self) -> bool {
        self.cycle.is_finished() || self.exchange.is_finished() || self.telemetry.is_finished()
    }

    fn signalled(&self, signal: i32) {
        match signal {
            SIGHUP => tracing::info!("SIGHUP is ignored: the configuration is read once, at the start"),
            _ if self.orders.are(Orders::STOP) => {
                tracing::warn!("second signal: stopping the motors at once");
                self.orders.give(Orders::STOP_NOW);
            }
            _ => {
                tracing::info!("damping and stopping the motors, then leaving");
                let _no_systemd = sd_notify::notify(&[sd_notify::NotifyState::Stopping]);
                self.orders.give(Orders::STOP);
            }
        }
    }

    fn end(self) -> Result<(), RunError> {
        let asked = self.orders.are(Orders::STOP);
        self.orders.give(Orders::STOP);
        let cycle = self.cycle.join();
        self.orders.give(Orders::END);
        self.exchange.thread().unpark();
        let exchange = self.exchange.join();
        let telemetry = self.telemetry.join();
        cycle.map_err(|_| RunError::Thread("cycle"))?;
        exchange.map_err(|_| RunError::Thread("exchange"))?;
        telemetry.map_err(|_| RunError::Thread("telemetry"))?;
        if !asked {
            return Err(RunError::Thread("cycle, exchange or telemetry"));
        }
        tracing::info!("the motors are stopped");
        Ok(())
    }
}

fn start_exchange(
    settings: &Settings,
    lock: &Arc<InstanceLock>,
    orders: &Arc<Orders>,
    end: exchange::CycleEnd,
    questions: telemetry::Questions,
    boot_id: u64,
) -> Result<JoinHandle<()>, RunError> {
    let (opened, ready) = channel();
    let (lock, orders) = (Arc::clone(lock), Arc::clone(orders));
    let exchange = settings.exchange.clone();
    let period = settings.cycle.period;
    let roster = serde_json::to_string(&roster(settings, boot_id)).expect("names and numbers are JSON");
    let thread = Builder::new().name("motord-exchange".into()).spawn(move || {
        // The ports cannot be sent to another thread.
        let ports = match DaemonPorts::open(&lock) {
            Ok(ports) => ports,
            Err(error) => return report(&opened, Err(error)),
        };
        let wish = Wish { cpu: exchange.cpu, priority: exchange.priority };
        rt::prepare_thread(wish).iter().for_each(|step| step.tell("exchange"));
        report(&opened, Ok(()));
        Exchange::new(ports, end, questions, roster, &exchange, period).run(|| orders.are(Orders::END));
    })?;
    await_report(&ready, "exchange")??;
    Ok(thread)
}

fn start_telemetry(
    lock: &Arc<InstanceLock>,
    orders: &Arc<Orders>,
    mut recorder: Recorder,
) -> Result<JoinHandle<()>, RunError> {
    let (lock, orders) = (Arc::clone(lock), Arc::clone(orders));
    let thread = Builder::new().name("motord-telemetry".into()).spawn(move || {
        let housekeeper = Housekeeper::open(&lock);
        if let Err(error) = &housekeeper {
            tracing::warn!("dead clients will keep their places: {error}");
        }
        recorder.run(housekeeper.ok().as_ref(), || orders.are(Orders::END));
    })?;
    Ok(thread)
}

/// Nobody waits for this thread: opening a bus may take as long as the kernel likes, and it ends with the process.
fn start_workshop(
    settings: &Settings,
    orders: &Arc<Orders>,
    mut workshop: Workshop,
    broken: Receiver<usize>,
) -> Result<(), RunError> {
    let (settings, orders) = (settings.clone(), Arc::clone(orders));
    let run = move || workshop.run(&settings, &broken, || orders.are(Orders::STOP));
    let _detached = Builder::new().name("motord-reopen".into()).spawn(run)?;
    Ok(())
}

fn start_cycle(
    settings: &Settings,
    orders: &Arc<Orders>,
    mut cycle: Cycle<Monotonic>,
    heartbeat: Heartbeat,
    locks: Vec<motord_bus::socketcan::InterfaceLock>,
) -> Result<JoinHandle<()>, RunError> {
    let orders = Arc::clone(orders);
    let wish = Wish { cpu: settings.cycle.cpu, priority: Some(settings.cycle.priority) };
    let required = settings.cycle.require_realtime;
    let period = settings.cycle.period;
    let (prepared, ready) = channel();
    let thread = Builder::new().name("motord-cycle".into()).spawn(move || {
        let _held = locks;
        let mut steps = rt::prepare_thread(wish);
        steps.push(rt::tighten_timers());
        steps.push(rt::lock_memory());
        let refused = steps.iter().find_map(|step| step.outcome.err().map(|errno| (*step, errno)));
        steps.iter().for_each(|step| step.tell("cycle"));
        if let Some((step, errno)) = refused.filter(|_| required) {
            return report(
                &prepared,
                Err(RunError::Realtime { what: step.what, errno, remedy: step.remedy }),
            );
        }
        cycle.set_realtime(refused.is_none());
        report(&prepared, Ok(()));
        drop(prepared);
        let ran = catch_unwind(AssertUnwindSafe(|| run_cycles(&mut cycle, &orders, period)));
        if let Err(panic) = ran {
            cycle.carry_out_will();
            resume_unwind(panic);
        }
        // Without it the dead man's switch acts: on motors that would not come to rest it should.
        if cycle.is_still() {
            heartbeat.rest();
        }
    })?;
    await_report(&ready, "cycle")??;
    Ok(thread)
}

/// Nobody waits for this thread: it may wait for the switch, and ends with the process.
fn start_registrar(
    settings: &Settings,
    instance: &Instance,
    orders: &Arc<Orders>,
    pulse: Pulse,
) -> Result<(), RunError> {
    let will = Will::of(settings);
    if will.buses.is_empty() {
        tracing::info!("no dead man's switch: it serves CAN interfaces, and there is none");
        return Ok(());
    }
    let mut registrar = Registrar::new(instance.clone(), will, pulse);
    let orders = Arc::clone(orders);
    let run = move || registrar.run(|| orders.are(Orders::END));
    let _detached = Builder::new().name("motord-registrar".into()).spawn(run)?;
    Ok(())
}

/// The real-time loop. Ends when it was told to stop and every motor has been stopped for [`LAST_CYCLES`].
fn run_cycles(cycle: &mut Cycle<Monotonic>, orders: &Orders, period: Duration) {
    let mut place = Place { cycle: 1, at: clock::monotonic() + period };
    while !orders.are(Orders::STOP) {
        place = cycle.run(place);
    }
    cycle.shut_down();
    let end = place.at + SHUTDOWN_MAX;
    let mut last = LAST_CYCLES;
    while last > 0 && place.at < end {
        place = cycle.run(place);
        if orders.are(Orders::STOP_NOW) {
            cycle.stop_now();
        }
        if cycle.is_still() {
            last -= 1;
        }
    }
}

/// The starting thread waits for the report: nobody else can miss it.
fn report<T>(sender: &Sender<T>, outcome: T) {
    let _gone = sender.send(outcome);
}

fn await_report<T>(receiver: &Receiver<T>, thread: &'static str) -> Result<T, RunError> {
    receiver.recv().map_err(|_| RunError::Thread(thread))
}

/// Differs from that of every daemon before: the standard library's seed for hash maps is random.
fn boot_id() -> u64 {
    RandomState::new().build_hasher().finish()
}

fn roster(settings: &Settings, boot_id: u64) -> Roster {
    let joints = settings.motors.iter().map(|motor| JointDescription {
        name: motor.name.clone(),
        bus: settings.buses[motor.bus].name.clone(),
        protocol: motor.protocol.name().to_owned(),
        model: motor.model.clone(),
        position: motor.limits.position,
        velocity: motor.limits.velocity,
        torque: motor.limits.torque,
        kp: motor.limits.kp,
        kd: motor.limits.kd,
    });
    let groups = settings
        .groups
        .iter()
        .map(|group| GroupDescription { name: group.name.clone(), joints: group.motors.clone() });
    Roster {
        instance: settings.instance.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        pid: std::process::id(),
        boot_id,
        rate_hz: settings.cycle.rate_hz,
        setpoint_timeout: settings.safety.setpoint_timeout.as_secs_f64(),
        joints: joints.collect(),
        groups: groups.collect(),
        buses: settings.buses.iter().map(|bus| bus.name.clone()).collect(),
    }
}
