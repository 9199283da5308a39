//! The start of the ipc thread.

use super::starter::{Orders, Starter, await_report};
use crate::imus::ExternalImus;
use crate::ipc::owners::Owners;
use crate::ipc::{CycleEnd, IpcThread, Records, Schedule};
use crate::run_error::RunError;
use crate::telemetry::Questions;
use motord_configuration::describe;
use motord_ports::instance::InstanceLock;
use motord_ports::service::ServiceError;
use motord_ports::{DaemonPorts, ImuReceiver, Recorders};
use motord_realtime::{SchedulingRequest, prepare_thread, tighten_timers};
use motord_settings::settings::IpcSettings;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;

/// The thread's ends of its connections to the other threads.
pub(super) struct Ends {
    pub(super) cycle: CycleEnd,
    pub(super) owners: Owners,
    pub(super) imus: Option<ExternalImus>,
    pub(super) questions: Questions,
}

/// The running thread.
pub(super) struct Handle {
    pub(super) thread: JoinHandle<()>,
    /// Receives one message once the first state is published.
    pub(super) first_state: Receiver<()>,
    pub(super) recorders: Recorders,
}

/// Starts the thread. Returns once clients find its ports.
pub(super) fn start(starter: &Starter, ends: Ends) -> Result<Handle, RunError> {
    let (opened, ready) = channel();
    let (published, first_state) = channel();
    let (lock, setup) = (Arc::clone(&starter.lock), Setup::new(starter, ends));
    let thread = starter.start("ipc", move |orders| {
        let ports = match Ports::open(&lock, setup.ends.imus.is_some()) {
            Ok(ports) => ports,
            Err(error) => {
                let _starter_ended = opened.send(Err(error));
                return;
            }
        };
        schedule_thread(&setup.settings);
        let _starter_ended = opened.send(Ok(ports.daemon.recorders().clone()));
        let mut thread = setup.with_ports(ports).announcing(published);
        // The files of the ports are closed after the last cycle: to give back their memory takes
        // longer than the robot may be without damping.
        orders.outlive_the_cycle("ipc", || thread.run(|| orders.are(Orders::END)));
    })?;
    let recorders = await_report(&ready, "ipc")??;
    Ok(Handle { thread, first_state, recorders })
}

/// The ports, which cannot be sent to another thread.
struct Ports {
    daemon: DaemonPorts,
    imus: Option<ImuReceiver>,
}

impl Ports {
    fn open(lock: &InstanceLock, has_imus: bool) -> Result<Self, ServiceError> {
        let daemon = DaemonPorts::open(lock)?;
        let imus = has_imus.then(|| daemon.open_imus(lock)).transpose()?;
        if let Some(damage) = daemon.damage() {
            tracing::warn!("begins with new files, and clients from before must connect again: {damage}");
        }
        Ok(Self { daemon, imus })
    }
}

fn schedule_thread(settings: &IpcSettings) {
    let mut steps = prepare_thread(SchedulingRequest { cpu: settings.cpu, priority: None });
    steps.push(tighten_timers());
    let scheduled = prepare_thread(SchedulingRequest { cpu: None, priority: settings.priority });
    // This thread is refused real-time priority for the same reason as the cycle; the cycle's log
    // line says so.
    steps.extend(scheduled.into_iter().filter(|step| step.outcome.is_ok()));
    steps.iter().for_each(|step| step.log("ipc"));
}

/// The parts of the thread, without the ports.
struct Setup {
    ends: Ends,
    settings: IpcSettings,
    schedule: Schedule,
    description: String,
    records: Records,
}

impl Setup {
    fn new(Starter { settings, boot_id, .. }: &Starter, ends: Ends) -> Self {
        let ipc = settings.ipc.clone();
        let schedule = Schedule::new(settings.cycle.period, ipc.lead, ipc.busy_poll);
        let description =
            serde_json::to_string(&describe(settings, *boot_id)).expect("names and numbers are JSON");
        let joints = settings.groups.iter().map(|group| group.motors.clone()).collect();
        Self { ends, settings: ipc, schedule, description, records: Records::new(joints) }
    }

    fn with_ports(self, ports: Ports) -> IpcThread {
        let Self { ends, settings, schedule, description, records } = self;
        let (cycle, mode) = ((ends.cycle, Some(ends.owners)), settings.mode);
        let thread =
            IpcThread::new(ports.daemon, cycle, ends.questions, description, mode, schedule, records);
        match ports.imus.zip(ends.imus) {
            Some((receiver, imus)) => thread.with_imus(receiver, imus),
            None => thread,
        }
    }
}
