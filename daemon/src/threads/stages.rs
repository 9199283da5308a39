//! The start of the threads, in stages: each consumes the one before, whose fields are what it
//! needs.
//!
//! ```text
//!   Assembled ──plant, IMUs, ipc, owners──▶ Served ──reconnector, telemetry──▶ Observed
//!                                                                                  │
//!                        Daemon ◀──cycle, registrar, stop, simulation──────────────┘
//! ```

use super::starter::{Orders, Starter};
use super::{Daemon, cycle, ipc};
use crate::buses::Buses;
use crate::buses::claims::SharedClaims;
use crate::buses::injection::Injectors;
use crate::buses::reconnector::Reconnector;
use crate::buses::watch::{BusWatch, Task};
use crate::emergency_stop::CycleStop;
use crate::housekeeping::{ConfigWatch, DeadClients, DirectoryGuard};
use crate::imus::{Sources, World};
use crate::ipc::CycleEnd;
use crate::ipc::owners::{Deaths, owners};
use crate::plant::{Plant, PlantError};
use crate::run_error::RunError;
use crate::simulation;
use crate::telemetry::programs::Programs;
use crate::telemetry::{self, Answers, Housekeeping, TelemetryLoop};
use motord_bus::{Duration, Monotonic, clock};
use motord_core::control::ImuReading;
use motord_core::cycle::{Cycle, EmergencyStops, Ends, Supply, assemble};
use motord_deadman::heartbeat::{Heartbeat, Pulse};
use motord_deadman::registrar::Registrar;
use motord_deadman::safe_frames::SafeFrames;
use motord_metrics::Outputs;
use motord_ports::Presence;
use motord_ports::injection::InjectionListener;
use motord_ports::instance::InstanceLock;
use motord_settings::settings::Settings;
use motord_shared::Cause;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use triple_buffer::Input;

/// Period in which the thread that waits for the deaths of owners checks whether the daemon ends.
const OWNERS_TURN: Duration = Duration::from_secs(1);

impl Daemon {
    /// Starts everything on `buses`, for the instance that `lock` holds. The file of the
    /// configuration and its hash are watched for changes, if there is one. The metrics go to
    /// `outputs`.
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
        let assembled = Assembled::new(settings, buses, Arc::clone(lock));
        assembled.start_clients()?.start_telemetry(config, outputs)?.start_cycle()
    }
}

/// No thread runs.
struct Assembled {
    starter: Starter,
    cycle: Cycle,
    claims: SharedClaims,
    ends: Ends,
    plant: Option<(Plant, World)>,
    injectors: Option<Injectors>,
}

impl Assembled {
    fn new(settings: Settings, buses: Buses, lock: Arc<InstanceLock>) -> Self {
        let boot_id = RandomState::new().build_hasher().finish();
        let Buses { buses, mismatched, claims, injectors, plant } = buses;
        let (mut cycle, ends) = assemble(&settings, buses, Monotonic, boot_id);
        mismatched.into_iter().for_each(|joint| cycle.mark_mismatch(joint));
        let counters = Arc::clone(&ends.counters);
        let starter = Starter { settings, lock, orders: Arc::default(), counters, boot_id };
        Self { starter, cycle, claims: Arc::new(Mutex::new(claims)), ends, plant, injectors }
    }

    fn start_clients(self) -> Result<Served, RunError> {
        let Self { starter, mut cycle, claims, mut ends, plant, injectors } = self;
        let (plant, world) = plant.unzip();
        let unplanted = plant.as_ref().map(Plant::ended).unwrap_or_default();
        plant.map_or(Ok(()), |plant| start_plant(&starter, plant))?;
        let imus = start_imus(&starter, std::mem::take(&mut ends.imus), world.unwrap_or(World::BuiltIn))?;
        let injectors = injectors.map(|injectors| injectors.with_imus(imus.simulated));
        let stops = Arc::clone(&ends.stops);
        let (owners, deaths) = owners().map_err(io::Error::from)?;
        let (end, observed, supply) = CycleEnd::split(ends);
        let (questions, answers) = telemetry::questions();
        let stops = Stops { stops, programs: questions.programs.clone(), injectors };
        let ends = ipc::Ends { cycle: end, owners, imus: imus.external, questions };
        let ipc = ipc::start(&starter, ends)?;
        start_owners(&starter, deaths)?;
        let wakes = ipc.thread.thread().clone();
        cycle.on_publish(move || wakes.unpark());
        Ok(Served { starter, cycle, claims, observed, supply, answers, stops, unplanted, ipc })
    }
}

/// The thread waits for the plant.
fn start_plant(starter: &Starter, plant: Plant) -> Result<(), RunError> {
    let counters = Arc::clone(&starter.counters);
    starter.detach_below_the_cycle("plant", move |orders| {
        plant.run(&counters.plant_lost_us, || orders.are(Orders::END));
    })
}

fn start_imus(starter: &Starter, inputs: Vec<Input<ImuReading>>, world: World) -> Result<Sources, RunError> {
    let imus = &starter.settings.sensors.imus;
    let mut sources = Sources::of(imus, inputs, clock::monotonic(), world, starter.boot_id);
    for mut reader in std::mem::take(&mut sources.readers) {
        starter.detach_below_the_cycle(reader.thread(), move |orders| {
            while !orders.are(Orders::END) {
                reader.turn();
            }
        })?;
    }
    Ok(sources)
}

fn start_owners(starter: &Starter, deaths: Deaths) -> Result<(), RunError> {
    let counters = Arc::clone(&starter.counters);
    starter.detach_below_the_cycle("owners", move |orders| {
        while !orders.are(Orders::END) {
            if let Some(lease) = deaths.next(OWNERS_TURN) {
                counters.alarms.owner_ended(lease);
            }
        }
    })
}

/// IMUs are read, and clients find the daemon.
struct Served {
    starter: Starter,
    cycle: Cycle,
    claims: SharedClaims,
    observed: telemetry::CycleEnd,
    supply: Supply,
    answers: Answers,
    stops: Stops,
    unplanted: Arc<OnceLock<PlantError>>,
    ipc: ipc::Handle,
}

impl Served {
    fn start_telemetry(
        self,
        config: Option<(&Path, u64)>,
        outputs: Option<Outputs>,
    ) -> Result<Observed, RunError> {
        let Self { starter, cycle, claims, observed, supply, answers, stops, unplanted, ipc } = self;
        let Starter { settings, lock, counters, .. } = &starter;
        let (reports, tasks) = channel();
        start_reconnector(&starter, Reconnector::new(supply, Arc::downgrade(&claims)), tasks)?;
        let directory = DirectoryGuard::new(Presence::of(lock), Arc::clone(counters));
        let lost = directory.lost();
        let config = ConfigWatch::new(config, Arc::clone(counters));
        let buses = BusWatch::new(settings, reports);
        let housekeeping = Housekeeping { directory, config, buses, recorders: ipc.recorders.clone() };
        let answers = (answers, ipc.thread.thread().clone());
        let mut telemetry_loop = TelemetryLoop::new(settings, observed, answers, housekeeping, outputs);
        let instance = Arc::clone(lock);
        let telemetry = starter.start("telemetry", move |orders| {
            telemetry_loop.run(DeadClients::open(&instance), || orders.are(Orders::END));
        })?;
        Ok(Observed { starter, cycle, claims, stops, unplanted, ipc, telemetry, lost })
    }
}

/// Opening a bus has no time limit.
fn start_reconnector(
    starter: &Starter,
    mut reconnector: Reconnector,
    tasks: Receiver<Task>,
) -> Result<(), RunError> {
    let settings = starter.settings.clone();
    let run = move |orders: &Orders| reconnector.run(&settings, &tasks, || orders.are(Orders::STOP));
    starter.start("reconnector", run).map(drop)
}

/// Histograms, log and housekeeping are ready for the cycle.
struct Observed {
    starter: Starter,
    cycle: Cycle,
    claims: SharedClaims,
    stops: Stops,
    unplanted: Arc<OnceLock<PlantError>>,
    ipc: ipc::Handle,
    telemetry: JoinHandle<()>,
    lost: Arc<OnceLock<PathBuf>>,
}

impl Observed {
    fn start_cycle(self) -> Result<Daemon, RunError> {
        let Self { starter, mut cycle, claims, stops, unplanted, ipc, telemetry, lost } = self;
        let (heartbeat, pulse) = Heartbeat::create().map_err(io::Error::from)?;
        cycle.on_begin(move |cycle| heartbeat.beat(cycle));
        let cycle = cycle::start(&starter, cycle::Owned { claims, cycle, heartbeat })?;
        start_registrar(&starter, pulse)?;
        stops.start(&starter)?;
        let Starter { orders, counters, .. } = starter;
        Ok(Daemon { orders, counters, cycle, ipc, telemetry, lost, unplanted })
    }
}

/// The thread may wait for the switch. It sleeps most of the time, but when the daemon is killed,
/// its connection closes with this thread, and no motor is damped before: so it must not wait.
fn start_registrar(starter: &Starter, pulse: Pulse) -> Result<(), RunError> {
    let frames = SafeFrames::of(&starter.settings);
    if frames.buses.is_empty() {
        tracing::debug!("no dead man's switch: every bus is simulated, and ends with this process");
        return Ok(());
    }
    let mut registrar = Registrar::new(starter.lock.instance().clone(), frames, pulse);
    if starter.settings.safety.require_deadman {
        let counters = Arc::clone(&starter.counters);
        registrar = registrar.reports(move |lost| counters.alarms.stand(lost.then_some(Cause::SwitchLost)));
    }
    // If the connection closed before the last cycle, the switch would act on motors that the cycle
    // still drives.
    starter.detach_below_the_cycle("registrar", move |orders| {
        orders.outlive_the_cycle("registrar", || registrar.run(|| orders.are(Orders::END)));
    })
}

/// The ends of the threads that take emergency stops and simulated faults.
struct Stops {
    stops: Arc<EmergencyStops>,
    programs: Programs,
    injectors: Option<Injectors>,
}

impl Stops {
    fn start(self, starter: &Starter) -> Result<(), RunError> {
        let Self { stops, programs, injectors } = self;
        let instance = starter.lock.instance().clone();
        // This thread sleeps until a stop arrives. No other load of the computer may delay that
        // stop.
        starter.detach_below_the_cycle("stop", move |orders| {
            motord_stop::run(&instance, CycleStop { stops, programs }, || orders.are(Orders::END));
        })?;
        injectors.map_or(Ok(()), |injectors| start_simulation(starter, injectors))
    }
}

/// The thread waits for requesters.
fn start_simulation(starter: &Starter, mut injectors: Injectors) -> Result<(), RunError> {
    match InjectionListener::bind(&starter.lock) {
        Ok(listener) => starter.detach("simulation", move |_| simulation::run(&listener, &mut injectors)),
        Err(error) => {
            tracing::warn!("no faults from `motorctl sim`: {error}");
            Ok(())
        }
    }
}
