//! One robot on virtual time, with its owner and its operator.

use crate::coupled::{alone, coupled, simulate_all};
use crate::error::TwinError;
use crate::imus::{Body, Sensor};
use crate::joints::Mechanics;
use motord_bus::{Bus, Clock as _, Duration, Instant, VirtualClock};
use motord_core::cycle::{ANSWER_CYCLES, Cycle, LocalClient, Tick, assemble, outcome};
use motord_settings::settings::Settings;
use motord_shared::message::NO_JOINT;
use motord_shared::{AdminReply, JointSetpoint, Operation, Refusal, SetpointMessage, StateMessage};
use motord_simulator::{FaultVerb, InjectError, PlantBus, SharedBus};
use std::collections::VecDeque;
use std::path::Path;

/// The virtual time of the first tick.
const START: Instant = Instant::from_nanos(1_000_000_000);

/// The choices for a twin that its configuration does not make.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Options {
    /// Decides everything random in the motors and the sensors.
    pub seed: u64,
    /// Time that the controller computes: from the end of a cycle, when its states are published,
    /// to the sending of its setpoints. Setpoints that are sent after the next cycle has fetched
    /// them are used one cycle later.
    pub compute: Duration,
}

/// A setpoint message, and when the controller sends it.
type Outgoing = (Instant, usize, SetpointMessage);

/// Reads the time of a [`Twin`], also while it steps.
#[derive(Debug, Clone)]
pub struct TwinClock(VirtualClock);

impl TwinClock {
    /// As [`Twin::time`].
    #[must_use]
    pub fn time(&self) -> Duration {
        self.0.now().since(START)
    }

    /// Returns the time, ns, on the scale of the times in the states of the twin.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.0.now().as_nanos()
    }
}

/// The cycle of a configuration on virtual time, with simulated motors and IMUs. Time passes only
/// in [`step`](Self::step) and [`ask`](Self::ask).
pub struct Twin {
    settings: Settings,
    cycle: Cycle,
    client: LocalClient,
    clock: VirtualClock,
    tick: Tick,
    buses: Vec<SharedBus>,
    /// A bus of the plant, by which it is brought to the time of a measurement.
    plant: Option<PlantBus>,
    body: Option<Box<dyn Body>>,
    sensors: Vec<Sensor>,
    compute: Duration,
    outgoing: VecDeque<Outgoing>,
    /// Faults to come, the earliest first.
    faults: VecDeque<(Instant, FaultVerb)>,
}

impl Twin {
    /// As [`new`](Self::new), of the configuration at `path`. Its CAN interfaces and devices are
    /// not opened.
    ///
    /// # Errors
    /// [`TwinError::Configuration`] with every problem of the file; those of [`new`](Self::new).
    pub fn load(
        path: &Path,
        options: Options,
        mechanics: Option<Box<dyn Mechanics>>,
        body: Option<Box<dyn Body>>,
    ) -> Result<Self, TwinError> {
        let loaded = motord_configuration::load(path).map_err(TwinError::Configuration)?;
        Self::new(loaded.settings, options, mechanics, body)
    }

    /// Builds the robot of `settings` with its motors off. `mechanics` move the joints; without
    /// them, each motor moves its own inertia, as in the daemon. `body` is measured by the IMUs;
    /// without one, no IMU has a sample. The wire of an IMU is not simulated: samples arrive at its
    /// rate, with the errors of its `[imu.simulation]`.
    ///
    /// # Errors
    /// [`TwinError::SerialBus`], [`TwinError::Begin`].
    pub fn new(
        mut settings: Settings,
        options: Options,
        mechanics: Option<Box<dyn Mechanics>>,
        body: Option<Box<dyn Body>>,
    ) -> Result<Self, TwinError> {
        simulate_all(&mut settings)?;
        let sensors = settings.sensors.imus.iter().map(|imu| Sensor::new(imu, options.seed, START)).collect();
        let seed = |bus: usize| options.seed + bus as u64;
        let (buses, opened, plant) = match mechanics {
            Some(mechanics) => {
                let (buses, coupled) = coupled(&mut settings, seed, mechanics)?;
                let plant = coupled.first().cloned();
                (buses, boxed(coupled), plant)
            }
            None => {
                let buses = alone(&settings, seed);
                (buses.clone(), boxed(buses), None)
            }
        };
        let clock = VirtualClock::new(START);
        let (cycle, ends) = assemble(&settings, opened, clock.clone(), options.seed | 1);
        Ok(Self {
            settings,
            cycle,
            client: LocalClient::new(ends),
            clock,
            tick: Tick { number: 1, at: START },
            buses,
            plant,
            body,
            sensors,
            compute: options.compute,
            outgoing: VecDeque::new(),
            faults: VecDeque::new(),
        })
    }

    /// The checked configuration.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Virtual time since the first tick.
    #[must_use]
    pub fn time(&self) -> Duration {
        self.clock().time()
    }

    /// Returns a clock that shows the time of this twin.
    #[must_use]
    pub fn clock(&self) -> TwinClock {
        TwinClock(self.clock.clone())
    }

    /// Runs one cycle. Applies the faults and samples that are due, and uses setpoints sent at
    /// least `lead-us` before the tick. [`state`](Self::state) then returns the states at its end.
    pub fn step(&mut self) {
        let at = self.tick.at;
        self.disturb(at);
        self.sense(at);
        let lead = self.settings.ipc.lead;
        while let Some((_, group, message)) = self.outgoing.pop_front_if(|(due, ..)| *due + lead <= at) {
            self.client.deliver(group, &message);
        }
        self.tick = self.cycle.run(self.tick);
        while self.client.record().is_some() {}
        while self.client.event().is_some() {}
    }

    /// Returns the states of the last cycle.
    pub fn state(&mut self) -> &StateMessage {
        self.client.state()
    }

    /// Sends setpoints for the joints of a claimed group: the controller has computed for
    /// [`Options::compute`] since the end of the last cycle.
    ///
    /// # Errors
    /// [`Refusal::NotOwner`] when the group was never claimed here.
    pub fn send(&mut self, group: usize, joints: &[JointSetpoint], horizon: Duration) -> Result<(), Refusal> {
        let due = self.clock.now() + self.compute;
        let cycle = self.client.state().cycle;
        let message = self.client.message(group, due, joints).ok_or(Refusal::NotOwner)?;
        let horizon_ns = u32::try_from(horizon.as_nanos()).unwrap_or(u32::MAX);
        self.outgoing.push_back((due, group, SetpointMessage { horizon_ns, cycle, ..message }));
        Ok(())
    }

    /// Returns `true` if the newest states have the claim of this program as the owner of `group`.
    pub fn owns(&mut self, group: usize) -> bool {
        let Some(lease) = self.client.lease(group) else { return false };
        self.client.state().groups.get(group).is_some_and(|state| state.lease == lease.raw())
    }

    /// Sends a request as the owner of `group`, or as an operator without a lease, and runs cycles
    /// until it is answered.
    ///
    /// # Errors
    /// The refusal of the cycle; [`Refusal::Busy`] after [`ANSWER_CYCLES`] without an answer.
    pub fn ask(&mut self, operation: Operation, group: usize) -> Result<AdminReply, Refusal> {
        outcome(self.reply_to(operation, group))
    }

    /// As [`ask`](Self::ask). Returns the whole reply, whose [detail](Refusal::detail) names a
    /// joint.
    pub fn reply_to(&mut self, operation: Operation, group: usize) -> AdminReply {
        let busy = AdminReply { refusal: Refusal::Busy.code(), detail: NO_JOINT, ..AdminReply::default() };
        let Ok(ticket) = self.client.request(operation, group) else { return busy };
        for _ in 0..ANSWER_CYCLES {
            self.step();
            if let Some(reply) = self.client.answer_to(ticket) {
                return reply;
            }
        }
        busy
    }

    /// Gives a bus, a motor or an IMU a fault at the first tick that is not before `at`, counted as
    /// [`time`](Self::time).
    ///
    /// # Errors
    /// The target is unknown, or does not support this fault.
    pub fn inject_at(&mut self, at: Duration, verb: FaultVerb) -> Result<(), InjectError> {
        let is_known = self.sensors.iter().any(|sensor| sensor.is(&verb.target))
            || self.settings.motors.iter().any(|motor| motor.name == verb.target)
            || self.settings.buses.iter().any(|bus| bus.name == verb.target);
        if !is_known {
            return Err(InjectError::NoSuchTarget);
        }
        let at = START + at;
        let index = self.faults.partition_point(|(other, _)| *other <= at);
        self.faults.insert(index, (at, verb));
        Ok(())
    }

    fn disturb(&mut self, now: Instant) {
        while let Some((_, verb)) = self.faults.pop_front_if(|(at, _)| *at <= now) {
            let of_sensor = self.sensors.iter_mut().find_map(|sensor| sensor.inject(&verb));
            if of_sensor.is_none() {
                let _done = self.buses.iter().any(|bus| bus.lock().inject(now, &verb).is_ok());
            }
        }
    }

    /// Measures, and passes what has arrived.
    fn sense(&mut self, now: Instant) {
        let Some(body) = self.body.as_mut().filter(|_| !self.sensors.is_empty()) else { return };
        if self.sensors.iter().any(|sensor| sensor.is_due(now)) {
            if let Some(plant) = &self.plant {
                plant.advance(now);
            }
            let values = body.measure();
            self.sensors.iter_mut().for_each(|sensor| sensor.measure(now, &values));
        }
        for (index, sensor) in self.sensors.iter_mut().enumerate() {
            if let Some(reading) = sensor.arrived(now) {
                self.client.sample_imu(index, reading);
            }
        }
    }
}

fn boxed(buses: Vec<impl Bus + 'static>) -> Vec<Box<dyn Bus>> {
    buses.into_iter().map(|bus| Box::new(bus) as Box<dyn Bus>).collect()
}
