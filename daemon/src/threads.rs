//! The daemon's threads: starts them, and ends them so that the motors are stopped first.
//!
//! | thread | what it does |
//! |---|---|
//! | `motord-cycle` | the cycle; real-time where the machine allows it |
//! | `motord-ipc` | clients |
//! | `motord-telemetry` | histograms, log, housekeeping |
//! | `motord-owners` | detects the deaths of the groups' owners |
//! | `motord-registrar` | registers the daemon's safe frames with its dead man's switch |
//! | `motord-stop` | receives emergency stops on their socket |
//! | `motord-plant` | asks the plant for its steps; only with `--plant` |
//! | `motord-imus` | simulated IMUs; only where there is one |
//! | `motord-imu-line` | an IMU on a serial line; one for each |
//! | `motord-reconnector` | reopens buses that disconnected |
//! | `motord-simulation` | receives faults for simulated buses; only where no bus is real |
//!
//! A panic in any of them stops the robot and ends the daemon, because the work of that thread is missing. The main
//! thread waits for signals and feeds the watchdog of systemd; a panic there ends the process, and the dead man's switch acts.

use crate::buses::Buses;
use crate::buses::claims::SharedClaims;
use crate::buses::injection::Injectors;
use crate::buses::reconnector::Reconnector;
use crate::buses::watch::BusWatch;
use crate::emergency_stop;
use crate::housekeeping::{ConfigWatch, DeadClients, DirectoryGuard};
use crate::imus::{ExternalImus, Sources, World};
use crate::ipc::owners::{Deaths, Owners, owners};
use crate::ipc::{self, IpcThread, Records, Schedule};
use crate::plant::{Plant, PlantError};
use crate::run_error::RunError;
use crate::simulation;
use crate::telemetry::askers::Askers;
use crate::telemetry::{self, Housekeeping, Recorder};
use motord_bus::{Duration, Monotonic, clock};
use motord_configuration::describe;
use motord_core::control::ImuReading;
use motord_core::cycle::{Counters, Cycle, EmergencyStops, Order, assemble};
use motord_deadman::heartbeat::{Heartbeat, Pulse};
use motord_deadman::registrar::Registrar;
use motord_deadman::safe_frames::SafeFrames;
use motord_metrics::Outputs;
use motord_ports::injection::InjectionListener;
use motord_ports::instance::{Instance, InstanceLock};
use motord_ports::{DaemonPorts, Presence};
use motord_realtime::{SchedulingRequest, Step, lock_memory, prepare_thread, tighten_timers};
use motord_settings::settings::Settings;
use motord_shared::Cause;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::{Builder, JoinHandle};
use triple_buffer::Input;

/// The stack of each thread. The memory of the process is locked, so every byte of it is resident. In a debug build the ipc thread
/// needs most, 300 KiB; 256 KiB of that are touched in advance by [`prepare_thread`].
const STACK_BYTES: usize = 384 * 1024;
/// Period in which the thread that waits for the deaths of owners checks whether the daemon ends.
const OWNERS_TURN: Duration = Duration::from_secs(1);
/// Period in which a thread that panicked checks whether the last cycle is over.
const END_TURN: Duration = Duration::from_millis(50);

/// The orders to the threads: run, stop with damping, stop now, or end.
#[derive(Debug, Default)]
struct Orders {
    order: AtomicU32,
    /// The first thread that panicked.
    panicked: OnceLock<&'static str>,
    /// The motors that may still run after the last cycle, if there are any.
    unstopped: OnceLock<Vec<String>>,
}

impl Orders {
    const STOP: u32 = 1;
    const STOP_NOW: u32 = 2;
    const END: u32 = 3;

    fn give(&self, order: u32) {
        self.order.fetch_max(order, Ordering::Relaxed);
    }

    /// Returns true when `order` or a stronger one was given. Each thread that orders can end checks this in every turn of its
    /// loop.
    fn are(&self, order: u32) -> bool {
        #[cfg(feature = "panic-on-request")]
        crate::host::panics::panic_if_asked();
        self.order.load(Ordering::Relaxed) >= order
    }

    /// The order for the cycle, for which the end of the daemon is the same as to stop now.
    fn cycle_order(&self) -> Order {
        match (self.are(Self::STOP_NOW), self.are(Self::STOP)) {
            (true, _) => Order::StopNow,
            (false, true) => Order::Stop,
            (false, false) => Order::Run,
        }
    }

    /// Stops the robot because `thread` panicked.
    fn stop_without(&self, thread: &'static str) {
        let _not_the_first = self.panicked.set(thread);
        self.give(Self::STOP);
    }
}

/// Gives the order to stop when its thread panics.
struct StopsOnPanic {
    orders: Arc<Orders>,
    thread: &'static str,
}

impl Drop for StopsOnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.orders.stop_without(self.thread);
        }
    }
}

/// The running threads.
pub struct Daemon {
    orders: Arc<Orders>,
    cycle: JoinHandle<()>,
    ipc: JoinHandle<()>,
    telemetry: JoinHandle<()>,
    counters: Arc<Counters>,
    first_state: Receiver<()>,
    realtime: Vec<Step>,
    /// The first file of the runtime directory that was lost.
    lost: Arc<OnceLock<PathBuf>>,
    /// Why the plant ended, if there was one.
    unplanted: Arc<OnceLock<PlantError>>,
}

impl Daemon {
    /// Starts everything on `buses`, for the instance that `lock` holds. The file of the configuration and its hash are
    /// watched for changes, if there is one. The metrics go to `outputs`.
    ///
    /// # Errors
    ///
    /// The part that could not be started. Nothing has moved then.
    pub fn start(
        settings: Settings,
        config: Option<(&Path, u64)>,
        buses: Buses,
        lock: &Arc<InstanceLock>,
        outputs: Option<Outputs>,
    ) -> Result<Self, RunError> {
        let orders = Arc::new(Orders::default());
        let boot_id = boot_id();
        let (mut cycle, mut ends) = assemble(&settings, buses.buses, Monotonic, boot_id);
        buses.mismatched.into_iter().for_each(|joint| cycle.mark_mismatch(joint));
        let (unplanted, world) = start_plant(&settings, &orders, buses.plant, Arc::clone(&ends.counters))?;
        let Sources { simulated, external, .. } =
            start_imus(&settings, &orders, (std::mem::take(&mut ends.imus), world), boot_id)?;
        let stops = Arc::clone(&ends.stops);
        let counters = Arc::clone(&ends.counters);
        let (owners, deaths) = owners().map_err(io::Error::from)?;
        let (ipc_end, telemetry_end, supply) = ipc::CycleEnd::split(ends);
        let (questions, answers) = telemetry::questions();
        let askers = questions.askers.clone();

        let clients = (ipc_end, owners, external);
        let (ipc, first_state) = start_ipc(&settings, lock, &orders, clients, questions, boot_id)?;
        start_owners(&settings, &orders, deaths, Arc::clone(&counters))?;
        let wakes = ipc.thread().clone();
        cycle.on_publish(move || wakes.unpark());
        let (broken, hears_broken) = channel();
        let claims = Arc::new(Mutex::new(buses.claims));
        let reconnector = Reconnector::new(supply, Arc::downgrade(&claims));
        start_reconnector(&settings, &orders, reconnector, hears_broken)?;
        let directory = DirectoryGuard::new(Presence::of(lock), Arc::clone(&counters));
        let lost = directory.lost();
        let config = ConfigWatch::new(config, Arc::clone(&counters));
        let housekeeping = Housekeeping { directory, config, buses: BusWatch::new(&settings, broken) };
        let answers = (answers, ipc.thread().clone());
        let recorder = Recorder::new(&settings, telemetry_end, answers, housekeeping, outputs);
        let telemetry = start_telemetry(lock, &orders, recorder)?;

        let (heartbeat, pulse) = Heartbeat::create().map_err(io::Error::from)?;
        cycle.on_begin(move |cycle| heartbeat.beat(cycle));
        let (cycle, realtime) = start_cycle(&settings, &orders, cycle, heartbeat, claims)?;
        start_registrar(&settings, lock.instance(), &orders, pulse, Arc::clone(&counters))?;
        start_stop(&settings, lock.instance(), &orders, stops, askers)?;
        if let Some(injectors) = buses.injectors {
            start_simulation(lock, &orders, injectors.with_imus(simulated))?;
        }
        Ok(Self { orders, cycle, ipc, telemetry, counters, first_state, realtime, lost, unplanted })
    }

    /// Waits at most `timeout` for the first state, and returns true once it is published.
    #[must_use]
    pub fn await_first_state(&self, timeout: Duration) -> bool {
        self.first_state.recv_timeout(timeout).is_ok()
    }

    /// The steps by which the cycle thread became real-time, and their outcomes.
    #[must_use]
    pub fn realtime(&self) -> &[Step] {
        &self.realtime
    }

    /// Number of the newest cycle.
    #[must_use]
    pub fn cycle(&self) -> u64 {
        self.counters.cycle.load(Ordering::Acquire)
    }

    /// Returns true when the last cycle is over, by request or because a thread panicked. Orders the stop itself when no new
    /// client can reach the daemon, or when the plant has ended.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        if self.lost.get().is_some() || self.unplanted.get().is_some() {
            self.stop();
        }
        self.orders.are(Orders::STOP) && self.cycle.is_finished()
    }

    /// Damps and stops the motors; the cycle ends when they are stopped.
    pub fn stop(&self) {
        self.orders.give(Orders::STOP);
    }

    /// Stops the motors without damping them first.
    pub fn stop_now(&self) {
        self.orders.give(Orders::STOP_NOW);
    }

    /// It was ordered to stop.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.orders.are(Orders::STOP)
    }

    /// Stops, and waits for the threads.
    ///
    /// # Errors
    ///
    /// When a thread has panicked, or a motor that was started did not answer its stops.
    pub fn end(self) -> Result<(), RunError> {
        self.stop();
        let _seen_in_orders = self.cycle.join();
        self.orders.give(Orders::END);
        self.ipc.thread().unpark();
        for thread in [self.ipc, self.telemetry] {
            let _seen_in_orders = thread.join();
        }
        if let Some(thread) = self.orders.panicked.get() {
            return Err(RunError::Thread(thread));
        }
        if let Some(motors) = self.orders.unstopped.get() {
            return Err(RunError::Unstopped(motors.clone()));
        }
        if let Some(path) = self.lost.get() {
            return Err(RunError::DirectoryLost(path.clone()));
        }
        if let Some(error) = self.unplanted.get() {
            return Err(RunError::PlantEnded(error.to_string()));
        }
        tracing::info!("the motors are stopped");
        Ok(())
    }
}

/// Runs `body` of `thread`. When it panics, the order to stop the robot is given at once, and this returns after the last
/// cycle: what `body` uses lives on until then.
fn outlive_the_cycle(thread: &'static str, orders: &Orders, body: impl FnOnce()) {
    if catch_unwind(AssertUnwindSafe(body)).is_err() {
        orders.stop_without(thread);
        while !orders.are(Orders::END) {
            std::thread::sleep(END_TURN);
        }
    }
}

/// Starts a thread whose panic stops the robot.
fn start(
    thread: &'static str,
    orders: &Arc<Orders>,
    body: impl FnOnce() + Send + 'static,
) -> Result<JoinHandle<()>, RunError> {
    let stops = StopsOnPanic { orders: Arc::clone(orders), thread };
    let run = move || {
        let _stops = stops;
        body();
    };
    Ok(Builder::new().name(format!("motord-{thread}")).stack_size(STACK_BYTES).spawn(run)?)
}

/// Returns the thread, and the receiver of one message once the first state is published.
fn start_ipc(
    settings: &Settings,
    lock: &Arc<InstanceLock>,
    orders: &Arc<Orders>,
    (end, owners, imus): (ipc::CycleEnd, Owners, Option<ExternalImus>),
    questions: telemetry::Questions,
    boot_id: u64,
) -> Result<(JoinHandle<()>, Receiver<()>), RunError> {
    let (opened, ready) = channel();
    let (published, first_state) = channel();
    let (lock, given) = (Arc::clone(lock), Arc::clone(orders));
    let ipc = settings.ipc.clone();
    let schedule = Schedule::new(settings.cycle.period, ipc.lead, ipc.busy_poll);
    let description =
        serde_json::to_string(&describe(settings, boot_id)).expect("names and numbers are JSON");
    let joints = settings.groups.iter().map(|group| group.motors.clone()).collect();
    let thread = start("ipc", orders, move || {
        // The ports cannot be sent to another thread.
        let ports = DaemonPorts::open(&lock).and_then(|ports| {
            let receiver = imus.is_some().then(|| ports.open_imus(&lock)).transpose()?;
            Ok((ports, receiver.zip(imus)))
        });
        let (ports, imus) = match ports {
            Ok(opened) => opened,
            Err(error) => return report(&opened, Err(error)),
        };
        if let Some(damage) = ports.damage() {
            tracing::warn!("begins with new files, and clients from before must connect again: {damage}");
        }
        let mut steps = prepare_thread(SchedulingRequest { cpu: ipc.cpu, priority: None });
        steps.push(tighten_timers());
        let scheduled = prepare_thread(SchedulingRequest { cpu: None, priority: ipc.priority });
        // This thread is refused real-time priority for the same reason as the cycle; the cycle's log line says so.
        steps.extend(scheduled.into_iter().filter(|step| step.outcome.is_ok()));
        steps.iter().for_each(|step| step.log("ipc"));
        report(&opened, Ok(()));
        let records = Records::new(joints);
        let cycle = (end, Some(owners));
        let mut thread = IpcThread::new(ports, cycle, questions, description, ipc.mode, schedule, records)
            .announcing(published);
        if let Some((receiver, imus)) = imus {
            thread = thread.with_imus(receiver, imus);
        }
        // The files of the ports are closed after the last cycle: to give back their memory takes longer than the robot may be
        // without damping.
        outlive_the_cycle("ipc", &given, || thread.run(|| given.are(Orders::END)));
    })?;
    await_report(&ready, "ipc")??;
    Ok((thread, first_state))
}

/// Detached: the thread holds nothing, and ends with the process.
fn start_owners(
    settings: &Settings,
    orders: &Arc<Orders>,
    deaths: Deaths,
    counters: Arc<Counters>,
) -> Result<(), RunError> {
    let given = Arc::clone(orders);
    let request = below_the_cycle(settings);
    let run = move || {
        let _refused_like_the_cycle = prepare_thread(request);
        while !given.are(Orders::END) {
            if let Some(lease) = deaths.next(OWNERS_TURN) {
                counters.alarms.owner_ended(lease);
            }
        }
    };
    let _detached = start("owners", orders, run)?;
    Ok(())
}

fn start_telemetry(
    lock: &Arc<InstanceLock>,
    orders: &Arc<Orders>,
    mut recorder: Recorder,
) -> Result<JoinHandle<()>, RunError> {
    let (lock, given) = (Arc::clone(lock), Arc::clone(orders));
    start("telemetry", orders, move || {
        recorder.run(DeadClients::open(&lock), || given.are(Orders::END));
    })
}

/// Detached: opening a bus has no time limit. The thread ends with the process.
fn start_reconnector(
    settings: &Settings,
    orders: &Arc<Orders>,
    mut reconnector: Reconnector,
    broken: Receiver<usize>,
) -> Result<(), RunError> {
    let (settings, given) = (settings.clone(), Arc::clone(orders));
    let run = move || reconnector.run(&settings, &broken, || given.are(Orders::STOP));
    let _detached = start("reconnector", orders, run)?;
    Ok(())
}

fn start_cycle(
    settings: &Settings,
    orders: &Arc<Orders>,
    mut cycle: Cycle,
    heartbeat: Heartbeat,
    claims: SharedClaims,
) -> Result<(JoinHandle<()>, Vec<Step>), RunError> {
    let given = Arc::clone(orders);
    let request = SchedulingRequest { cpu: settings.cycle.cpu, priority: Some(settings.cycle.priority) };
    let required = settings.cycle.require_realtime;
    let names: Vec<_> = settings.motors.iter().map(|motor| motor.name.clone()).collect();
    if !std::thread::available_parallelism().is_ok_and(|processors| processors.get() > 1) {
        cycle.share_processor();
    }
    let (prepared, ready) = channel();
    let thread = start("cycle", orders, move || {
        let _held = claims;
        let mut steps = prepare_thread(request);
        steps.push(tighten_timers());
        steps.push(lock_memory());
        let refused = steps.iter().find_map(|step| Some((step.clone(), step.outcome.err()?)));
        steps.iter().for_each(|step| step.log("cycle"));
        let is_complete = refused.is_none();
        if let Some((step, errno)) = refused.filter(|_| required) {
            return report(
                &prepared,
                Err(RunError::Realtime { what: step.what, errno, remedy: step.remedy }),
            );
        }
        cycle.set_realtime(is_complete);
        report(&prepared, Ok(steps));
        drop(prepared);
        let ran = catch_unwind(AssertUnwindSafe(|| cycle.run_until(|| given.cycle_order())));
        if let Err(panic) = ran {
            cycle.stop_after_panic();
            resume_unwind(panic);
        }
        let unstopped: Vec<String> = cycle.unstopped().map(|motor| names[motor].clone()).collect();
        // Without it the dead man's switch acts: on motors that may still run it should.
        if unstopped.is_empty() {
            heartbeat.rest();
        } else {
            let _the_only_one = given.unstopped.set(unstopped);
        }
    })?;
    let steps = await_report(&ready, "cycle")??;
    Ok((thread, steps))
}

/// Detached: the thread may wait for the switch, and ends with the process.
fn start_registrar(
    settings: &Settings,
    instance: &Instance,
    orders: &Arc<Orders>,
    pulse: Pulse,
    counters: Arc<Counters>,
) -> Result<(), RunError> {
    let frames = SafeFrames::of(settings);
    if frames.buses.is_empty() {
        tracing::debug!("no dead man's switch: every bus is simulated, and ends with this process");
        return Ok(());
    }
    let mut registrar = Registrar::new(instance.clone(), frames, pulse);
    if settings.safety.require_deadman {
        registrar = registrar.reports(move |lost| counters.alarms.stand(lost.then_some(Cause::SwitchLost)));
    }
    let given = Arc::clone(orders);
    // This thread sleeps most of the time. But when the daemon is killed, its connection closes with this thread, and no motor
    // is damped before.
    let request = below_the_cycle(settings);
    let run = move || {
        let _refused_like_the_cycle = prepare_thread(request);
        // If the connection closed before the last cycle, the switch would act on motors that the cycle still drives.
        outlive_the_cycle("registrar", &given, || registrar.run(|| given.are(Orders::END)));
    };
    let _detached = start("registrar", orders, run)?;
    Ok(())
}

/// Detached: the thread ends with the process.
fn start_stop(
    settings: &Settings,
    instance: &Instance,
    orders: &Arc<Orders>,
    stops: Arc<EmergencyStops>,
    askers: Askers,
) -> Result<(), RunError> {
    let (instance, given) = (instance.clone(), Arc::clone(orders));
    // This thread sleeps until a stop comes. No other load of the computer may delay that stop.
    let request = below_the_cycle(settings);
    let _detached = start("stop", orders, move || {
        let _refused_like_the_cycle = prepare_thread(request);
        emergency_stop::run(&instance, stops, askers, || given.are(Orders::END));
    })?;
    Ok(())
}

/// For a thread that sleeps most of the time, and must not wait when it is needed.
fn below_the_cycle(settings: &Settings) -> SchedulingRequest {
    SchedulingRequest { cpu: None, priority: Some(settings.cycle.priority.saturating_sub(1).max(1)) }
}

/// Detached: the thread waits for the plant, and ends with the process. Returns the reason for which the plant ended,
/// once it has, and the body that IMUs measure.
fn start_plant(
    settings: &Settings,
    orders: &Arc<Orders>,
    plant: Option<(Plant, World)>,
    counters: Arc<Counters>,
) -> Result<(Arc<OnceLock<PlantError>>, World), RunError> {
    let Some((plant, world)) = plant else { return Ok((Arc::default(), World::BuiltIn)) };
    let ended = plant.ended();
    start_source(settings, orders, "plant", move |stop| plant.run(&counters.plant_lost_us, stop))?;
    Ok((ended, world))
}

/// Detached: the thread holds nothing, and ends with the process.
fn start_imus(
    settings: &Settings,
    orders: &Arc<Orders>,
    (inputs, world): (Vec<Input<ImuReading>>, World),
    boot_id: u64,
) -> Result<Sources, RunError> {
    let start_time = clock::monotonic();
    let mut sources = Sources::of(&settings.imus, inputs, start_time, world, boot_id);
    if let Some(running) = sources.simulated.clone() {
        start_source(settings, orders, "imus", move |stop| running.run(start_time, stop))?;
    }
    for imu in std::mem::take(&mut sources.serial) {
        start_source(settings, orders, "imu-line", move |stop| imu.run(stop))?;
    }
    Ok(sources)
}

/// Detached, as above.
fn start_source(
    settings: &Settings,
    orders: &Arc<Orders>,
    thread: &'static str,
    run: impl FnOnce(&dyn Fn() -> bool) + Send + 'static,
) -> Result<(), RunError> {
    let given = Arc::clone(orders);
    let request = below_the_cycle(settings);
    let _detached = start(thread, orders, move || {
        let _refused_like_the_cycle = prepare_thread(request);
        run(&|| given.are(Orders::END));
    })?;
    Ok(())
}

/// Detached: the thread waits for requesters, and ends with the process.
fn start_simulation(
    lock: &Arc<InstanceLock>,
    orders: &Arc<Orders>,
    mut injectors: Injectors,
) -> Result<(), RunError> {
    let listener = match InjectionListener::bind(lock) {
        Ok(listener) => listener,
        Err(error) => {
            tracing::warn!("no faults from `motorctl sim`: {error}");
            return Ok(());
        }
    };
    let _detached = start("simulation", orders, move || simulation::run(&listener, &mut injectors))?;
    Ok(())
}

/// Sends the report that the starting thread waits for.
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
