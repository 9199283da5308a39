//! Faults on their way into the simulated buses of a running daemon.
//!
//! ```text
//!   thread that injects ──verb──▶ cycle: the bus that is read next
//!                       ◀──verb, outcome──┘
//! ```
//!
//! Only a configuration whose buses are all simulated gets such buses: the cycle of a real bus
//! never passes here.

use super::fault_line::{self, FaultLineError};
use super::simulate;
use crate::imus::SimulatedImus;
use motord_bus::{Bus, Content, Duration, ErrorFrame, Frame, Inbox, Instant, Readiness, Sent, clock};
use motord_settings::settings::Settings;
use motord_simulator::{Fault, FaultVerb, InjectError, PlantBus, SharedBus, SimulatedBus};
use motord_twin::{Mechanics, TwinError, coupled};
use rtrb::{Consumer, Producer, RingBuffer};

/// The cycle takes a fault within this time, as long as it runs.
const TIMEOUT: Duration = Duration::from_secs(1);
/// Between two looks for its outcome.
const TURN: Duration = Duration::from_millis(1);

/// A verb and its outcome. It returns to the thread that allocated it, because the cycle frees
/// nothing.
type Outcome = (FaultVerb, Result<(), InjectError>);

/// A simulated bus.
enum BusModel {
    /// Its motors turn by themselves.
    Alone(Box<SimulatedBus>),
    /// A plant moves them. No other thread uses it, so that nothing waits for its locks.
    Coupled(SharedBus, PlantBus),
}

impl BusModel {
    fn with<T>(&mut self, act: impl FnOnce(&mut SimulatedBus) -> T) -> T {
        match self {
            Self::Alone(bus) => act(bus),
            Self::Coupled(bus, _) => act(&mut bus.lock()),
        }
    }

    fn bus(&mut self) -> &mut dyn Bus {
        match self {
            Self::Alone(bus) => &mut **bus,
            Self::Coupled(_, bus) => bus,
        }
    }
}

/// A simulated bus that takes faults from another thread.
pub struct InjectedBus {
    name: String,
    wire: BusModel,
    verbs: Consumer<FaultVerb>,
    outcomes: Producer<Outcome>,
    unplugged: bool,
}

impl InjectedBus {
    /// Obeys the next verb, if there is one. Neither allocates nor blocks.
    fn obey(&mut self, now: Instant) {
        if self.outcomes.is_full() {
            return;
        }
        let Ok(verb) = self.verbs.pop() else { return };
        let outcome = self.wire.with(|bus| bus.inject(now, &verb));
        if verb.target == self.name {
            self.plug(now, verb.fault);
        }
        let _queued = self.outcomes.push((verb, outcome));
    }

    /// The cycle sends nothing to a bus that is gone until its controller reports a restart: the
    /// verb that ends the fault makes that report. A real bus is opened again instead.
    fn plug(&mut self, now: Instant, fault: Fault) {
        if fault == Fault::Ok && std::mem::take(&mut self.unplugged) {
            let restarted = ErrorFrame { class: ErrorFrame::RESTARTED, data: [0; 8] };
            self.wire.with(|bus| bus.deliver(now, Content::Error(restarted)));
        }
        self.unplugged |= fault == Fault::Gone;
    }
}

impl Bus for InjectedBus {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.wire.bus().send(now, frames)
    }

    /// The cycle calls this every time, even for a bus that is off or gone, so that faults can end.
    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        self.obey(now);
        self.wire.bus().receive(now, inbox);
    }

    fn discard_queue(&mut self) -> bool {
        self.wire.bus().discard_queue()
    }

    fn readiness(&self) -> Readiness<'_> {
        match &self.wire {
            BusModel::Alone(bus) => bus.readiness(),
            BusModel::Coupled(_, bus) => bus.readiness(),
        }
    }
}

/// The other end of one bus.
struct Injector {
    verbs: Producer<FaultVerb>,
    outcomes: Consumer<Outcome>,
}

impl Injector {
    /// The bus `name` with this wire, and the end that gives it faults. Allocates.
    fn of(name: &str, wire: BusModel) -> (InjectedBus, Self) {
        let (verbs, taken) = RingBuffer::new(1);
        let (returned, outcomes) = RingBuffer::new(1);
        let name = name.to_owned();
        (
            InjectedBus { name, wire, verbs: taken, outcomes: returned, unplugged: false },
            Self { verbs, outcomes },
        )
    }

    fn inject(&mut self, verb: FaultVerb) -> Result<(), FaultLineError> {
        self.verbs.push(verb.clone()).map_err(|_| FaultLineError::Unanswered(TIMEOUT))?;
        let begun = clock::monotonic();
        while clock::monotonic().since(begun) < TIMEOUT {
            match self.outcomes.pop() {
                Ok((obeyed, outcome)) if obeyed == verb => return Ok(outcome?),
                // Also the outcome of an earlier verb, which the cycle took too late.
                Ok(_) | Err(_) => std::thread::sleep(TURN),
            }
        }
        Err(FaultLineError::Unanswered(TIMEOUT))
    }
}

/// Gives faults to the buses of a configuration, which are all simulated.
pub struct Injectors {
    settings: Settings,
    /// In the order of the configuration.
    injectors: Vec<Injector>,
    imus: Option<SimulatedImus>,
}

impl Injectors {
    /// The buses of `settings`, and the end that gives them faults; `None` when one of them is
    /// real. Allocates.
    #[must_use]
    pub fn open(settings: &Settings) -> Option<(Vec<Box<dyn Bus>>, Self)> {
        let seeds: Vec<_> = settings.buses.iter().map(|bus| bus.kind.seed()).collect::<Option<_>>()?;
        let wires = seeds
            .iter()
            .enumerate()
            .map(|(index, seed)| BusModel::Alone(simulate(settings, index, *seed).into()));
        Some(Self::of(settings, wires))
    }

    /// As [`open`](Self::open), where `mechanics` move the motors. They begin where the mechanics
    /// have them; `settings` says so afterwards. Every bus must be a simulated one. Allocates.
    ///
    /// # Errors
    ///
    /// The mechanics begin where no joint can be.
    pub fn open_coupled(
        settings: &mut Settings,
        mechanics: Box<dyn Mechanics>,
    ) -> Result<(Vec<Box<dyn Bus>>, Self), TwinError> {
        let seeds: Vec<_> = settings.buses.iter().map(|bus| bus.kind.seed().unwrap_or_default()).collect();
        let (shared, coupled) = coupled(settings, |bus| seeds[bus], mechanics)?;
        Ok(Self::of(
            settings,
            shared.into_iter().zip(coupled).map(|(shared, bus)| BusModel::Coupled(shared, bus)),
        ))
    }

    fn of(settings: &Settings, wires: impl Iterator<Item = BusModel>) -> (Vec<Box<dyn Bus>>, Self) {
        let (mut buses, mut injectors) = (Vec::<Box<dyn Bus>>::new(), Vec::new());
        for (bus, wire) in settings.buses.iter().zip(wires) {
            let (bus, injector) = Injector::of(&bus.name, wire);
            buses.push(Box::new(bus));
            injectors.push(injector);
        }
        (buses, Self { settings: settings.clone(), injectors, imus: None })
    }

    /// Gives faults to these IMUs as well.
    #[must_use]
    pub fn with_imus(self, imus: Option<SimulatedImus>) -> Self {
        Self { imus, ..self }
    }

    /// Gives the fault that `line` asks for to its motor, bus or IMU. Waits for the cycle, at most
    /// 1 s.
    ///
    /// # Errors
    ///
    /// Why nothing has changed; or that the cycle did not answer, and may still obey.
    pub fn obey(&mut self, line: &str) -> Result<(), FaultLineError> {
        let verb = fault_line::read(line, &self.settings)?;
        if let Some(outcome) = self.imus.as_ref().and_then(|imus| imus.inject(&verb)) {
            return Ok(outcome?);
        }
        let motor =
            self.settings.motors.iter().find(|motor| motor.name == verb.target).map(|motor| motor.bus);
        let imu = self.settings.sensors.imus.iter().find(|imu| imu.name == verb.target);
        let motor = motor.or(imu.and_then(|imu| imu.source.can()).map(|can| can.bus));
        let bus = self.settings.buses.iter().position(|bus| bus.name == verb.target);
        let injector = bus.or(motor).and_then(|bus| self.injectors.get_mut(bus));
        injector.ok_or(InjectError::NoSuchTarget)?.inject(verb)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::Refusal;
    use std::path::Path;
    use std::sync::atomic::{AtomicBool, Ordering};

    fn settings(file: &str) -> Settings {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config").join(file);
        motord_configuration::load(&file).unwrap().settings
    }

    /// The first bus.
    fn one(settings: &Settings) -> (InjectedBus, Injector) {
        Injector::of(&settings.buses[0].name, BusModel::Alone(simulate(settings, 0, 0).into()))
    }

    #[test]
    fn configuration_with_real_bus_accepts_no_faults() {
        assert!(Injectors::open(&settings("quadruped.toml")).is_none());
        assert!(Injectors::open(&settings("quadruped-simulated.toml")).is_some());
    }

    /// Runs `test` while another thread reads the first bus over and over. Returns the bus.
    fn with_cycle(mut bus: Box<dyn Bus>, test: impl FnOnce()) -> Box<dyn Bus> {
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let cycle = scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    bus.receive(clock::monotonic(), &mut Inbox::new());
                    std::thread::sleep(TURN);
                }
                bus
            });
            test();
            over.store(true, Ordering::Relaxed);
            cycle.join().unwrap()
        })
    }

    #[test]
    fn fault_reaches_bus_of_motor_and_refusal_returns() {
        let (mut buses, mut injectors) = Injectors::open(&settings("quadruped-simulated.toml")).unwrap();
        with_cycle(buses.swap_remove(0), || {
            assert_eq!(injectors.obey("fl-knee off"), Ok(()));
            assert_eq!(injectors.obey("fl-knee down"), Err(InjectError::NotForMotors.into()));
            assert_eq!(injectors.obey("front-left off"), Err(InjectError::NotForBuses.into()));
        });
        assert!(matches!(injectors.obey("rr-knee off"), Err(FaultLineError::Unanswered(_))));
        assert!(
            matches!(injectors.obey("rr-knee ok"), Err(FaultLineError::Unanswered(_))),
            "one waits already"
        );
    }

    #[test]
    fn late_outcome_is_not_taken_for_next_verb() {
        let (mut bus, mut injector) = one(&settings("quadruped-simulated.toml"));
        std::thread::scope(|scope| {
            let injects = scope.spawn(move || injector.inject("fl-knee off".parse().unwrap()));
            while bus.verbs.is_empty() {
                std::thread::sleep(TURN);
            }
            let earlier = ("fl-knee down".parse().unwrap(), Err(InjectError::NotForMotors));
            assert!(bus.outcomes.push(earlier).is_ok());
            while !injects.is_finished() {
                bus.receive(clock::monotonic(), &mut Inbox::new());
                std::thread::sleep(TURN);
            }
            assert_eq!(injects.join().unwrap(), Ok(()));
        });
    }

    #[test]
    fn an_adapter_that_is_plugged_in_again_reports() {
        let (mut buses, mut injectors) = Injectors::open(&settings("quadruped-simulated.toml")).unwrap();
        let mut bus = with_cycle(buses.swap_remove(0), || injectors.obey("front-left gone").unwrap());
        assert_eq!(bus.send(clock::monotonic(), &[]).refusal, Some(Refusal::Gone));
        injectors.injectors[0].verbs.push("front-left ok".parse().unwrap()).unwrap();
        let mut inbox = Inbox::new();
        bus.receive(clock::monotonic(), &mut inbox);
        assert!(matches!(inbox.arrivals()[0].content, Content::Error(error) if error.state().is_some()));
        assert_eq!(bus.send(clock::monotonic(), &[]).refusal, None);
    }
}
