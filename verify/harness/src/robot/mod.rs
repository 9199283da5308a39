//! A whole robot on virtual time: the cycle and simulated motors, with the test as client and
//! operator.
//!
//! The virtual clock advances only when the cycle sleeps or waits: a run is reproducible. The buses
//! record every frame, and the invariant checker decodes it with a separate codec.

pub mod checker;
mod clock;
mod configurations;
pub mod fuzz_client;
pub mod line;
pub mod random;
pub mod ranges;

pub use clock::{Shared, Virtual};
pub use configurations::{motor, quadruped, settings, three_motors};
use line::{SharedLine, Wire};
use motord::buses;
use motord_bus::{Bus, Clock, Content, Duration, Frame, FrameId, Instant};
pub use motord_checker::protocol::mit::Meaning;
use motord_checker::run::Command;
pub use motord_checker::run::Reply;
use motord_core::control::Event;
use motord_core::cycle::{Cycle, LocalClient, Tick, assemble};
use motord_protocol::register;
use motord_settings::settings::{MotorSettings as MotorConfig, Settings};
use motord_shared::{
    AdminReply, AdminRequest, BusState, Cause, GroupState, JointSetpoint, JointState, Lease, MotorMode,
    Operation, Phase, Refusal, SetpointMessage, StateMessage,
};
use motord_simulator::{
    BusSettings, Direction, FaultVerb, Motor, MotorSettings, Plant, SerialSlave, SharedBus, SimulatedBus,
    couple,
};
pub use random::{for_each_seed, number};

/// The period of the cycle.
pub const PERIOD: Duration = Duration::from_millis(1);

/// A frame to a motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sent {
    /// When the cycle handed the frame to the bus.
    pub ready: Instant,
    /// When the frame ended on the wire.
    pub at: Instant,
    /// Index of the bus.
    pub bus: usize,
    /// The frame.
    pub frame: Frame,
    /// Id of the motor; 0x7FF of a request to a register.
    pub id: u16,
    /// Payload, filled with zeros.
    pub bytes: [u8; 8],
    /// Meaning of the frame; of one with an id of 11 bits, in MIT.
    pub meaning: Meaning,
}

impl Sent {
    /// Returns the frame in the invariant checker's type.
    pub fn command(&self) -> Command {
        Command { ready: self.ready, bus: self.bus, frame: self.frame }
    }
}

/// A robot with its client, and the faults that a test can inject.
pub struct Robot {
    /// The checked configuration.
    pub settings: Settings,
    /// The cycle of motord.
    pub cycle: Cycle,
    /// The client's end of the cycle's buffers.
    pub client: LocalClient,
    /// The clock that the cycle reads.
    pub clock: Virtual,
    /// The wires of the buses, in the order of the configuration.
    pub buses: Vec<Wire>,
    tick: Tick,
    /// Frames to motors since the last [`Robot::take_sent`].
    sent: Vec<Sent>,
    /// Frames to the host since the last [`Robot::take_replies`].
    replies: Vec<Reply>,
    /// Events for the log since the last [`Robot::take_events`].
    events: Vec<Event>,
}

impl Robot {
    /// Builds the configured robot; `seed` decides everything random in it.
    pub fn new(settings: Settings, seed: u64) -> Self {
        Self::built(settings, seed, |_, _| {})
    }

    /// Builds a robot that differs from its configuration: `build` changes the settings of each bus
    /// and its motors.
    pub fn built(
        settings: Settings,
        seed: u64,
        build: impl FnMut(&mut BusSettings, &mut Vec<MotorSettings>),
    ) -> Self {
        Self::begun_at(Instant::from_nanos(1_000_000_000), settings, seed, build)
    }

    /// Builds a robot whose clock starts at `start`.
    pub fn begun_at(
        start: Instant,
        settings: Settings,
        seed: u64,
        build: impl FnMut(&mut BusSettings, &mut Vec<MotorSettings>),
    ) -> Self {
        let buses = simulated(&settings, seed, build);
        let open = |(index, wire): (usize, &Wire)| wire.open(&settings, index).expect("it is plugged in");
        let opened = buses.iter().enumerate().map(open).collect();
        Self { buses, ..Self::on(opened, start, settings) }
    }

    /// Builds a robot whose shafts are moved by `plant`.
    pub fn with_plant(settings: Settings, seed: u64, plant: impl Plant + 'static) -> Self {
        let buses: Vec<_> = (0..settings.buses.len())
            .map(|bus| SharedBus::new(simulated_bus(&settings, bus, seed, &mut |_, _| {})))
            .collect();
        let opened = couple(&buses, plant).into_iter().map(|bus| Box::new(bus) as Box<dyn Bus>).collect();
        let buses = buses.into_iter().map(Wire::Bus).collect();
        Self { buses, ..Self::on(opened, Instant::from_nanos(1_000_000_000), settings) }
    }

    /// Builds the cycle alone, on the caller's buses, which record what it sends.
    pub fn on(buses: Vec<Box<dyn Bus>>, start: Instant, settings: Settings) -> Self {
        let clock = Virtual {
            now: Shared::new(start),
            reading: Shared::default(),
            waits: Shared::default(),
            late: Shared::default(),
            wakes_at: Shared::default(),
            always_late: Shared::default(),
            suspended: Shared::default(),
            broken: Shared::default(),
            freeze: Shared::default(),
        };
        let (cycle, ends) = assemble(&settings, buses, clock.clone(), 7);
        let tick = Tick { number: 1, at: start };
        Self {
            settings,
            cycle,
            client: LocalClient::new(ends),
            clock,
            buses: Vec::new(),
            tick,
            sent: Vec::new(),
            replies: Vec::new(),
            events: Vec::new(),
        }
    }

    /// Reads the clock, as the cycle does.
    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Returns the tick of the next cycle.
    pub fn next(&self) -> Instant {
        self.tick.at
    }

    /// Runs one cycle.
    pub fn step(&mut self) {
        self.cycle_only();
        while self.client.record().is_some() {}
        while let Some((_, event)) = self.client.event() {
            self.events.push(event);
        }
        for bus in 0..self.buses.len() {
            self.collect_record(bus);
        }
    }

    /// Runs one cycle and leaves its record to the caller.
    pub fn cycle_only(&mut self) {
        self.tick = self.cycle.run(self.tick);
    }

    /// Runs several cycles.
    pub fn steps(&mut self, cycles: usize) {
        (0..cycles).for_each(|_| self.step());
    }

    /// Collects the recorded frames of a bus. Every step does so.
    pub fn collect_record(&mut self, bus: usize) {
        for recorded in self.buses[bus].take_record() {
            let (at, frame) = (recorded.at, recorded.frame);
            if recorded.direction == Direction::ToHost {
                self.replies.push(Reply { at, bus, frame });
                continue;
            }
            let mut imus = self.settings.sensors.imus.iter().filter_map(|imu| imu.source.can());
            let is_for = |id: Option<u16>| id.and_then(FrameId::new) == Some(frame.id());
            if imus.any(|can| can.bus == bus && (is_for(can.device.request_id()) || is_for(Some(0)))) {
                continue;
            }
            let mut motors = self.settings.motors.iter();
            let motor =
                motors.find(|motor| motor.bus == bus && motor.addresses().receives().matches(frame.id()));
            // A request to a register names its motor in the payload.
            let named = |motor: &&MotorConfig| {
                motor.bus == bus && frame.payload().first() == Some(&motor.id) && motor.profile.has_registers
            };
            let is_register = frame.id().raw() == u32::from(register::REQUEST_ID);
            let motor =
                motor.or_else(|| self.settings.motors.iter().find(|motor| is_register && named(motor)));
            let motor = motor.expect("frames go to motors of the bus");
            let mut bytes = [0; 8];
            bytes[..frame.payload().len()].copy_from_slice(frame.payload());
            let meaning = match motor.protocol.name() {
                "robstride" | "cansimple" | "myactuator" | "odrive" => ranges::protocol(motor).order(&frame),
                _ => Meaning::of(bytes, &ranges::ranges(motor)),
            };
            self.sent.push(Sent {
                ready: recorded.ready,
                at,
                bus,
                frame,
                id: if is_register { register::REQUEST_ID } else { motor.id.into() },
                bytes,
                meaning,
            });
        }
    }

    /// Takes the frames to motors since the last call.
    pub fn take_sent(&mut self) -> Vec<Sent> {
        std::mem::take(&mut self.sent)
    }

    /// Takes the frames to the motor with this id since the last call, and drops those to other
    /// motors.
    pub fn take_sent_to(&mut self, id: u16) -> Vec<Sent> {
        self.take_sent().into_iter().filter(|sent| sent.id == id).collect()
    }

    /// Takes the frames to the host since the last call.
    pub fn take_replies(&mut self) -> Vec<Reply> {
        std::mem::take(&mut self.replies)
    }

    /// Takes the events for the log since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Delivers a frame to the host that no motor sent.
    pub fn deliver_frame(&mut self, bus: usize, id: u16, payload: &[u8]) {
        match &self.buses[bus] {
            Wire::Bus(_) => {
                let id = FrameId::new(id).expect("an id has eleven bits");
                self.deliver_with_id(bus, id, payload);
            }
            Wire::Line(line) => line.deliver_frame(id as u8, payload),
        }
    }

    /// Delivers a frame with an id of either width to the host, on a CAN bus.
    pub fn deliver_with_id(&mut self, bus: usize, id: FrameId, payload: &[u8]) {
        let now = self.now();
        let Wire::Bus(bus) = &self.buses[bus] else { panic!("a line has no arbitration ids") };
        let frame = Frame::new(id, payload).expect("a frame has at most eight bytes");
        bus.lock().deliver(now, Content::Frame(frame));
    }

    /// Reopens a bus that the cycle gave up, as the daemon's reconnector does, if it can be opened.
    pub fn reopen(&mut self, bus: usize) {
        let Some(opened) = self.buses[bus].open(&self.settings, bus) else { return };
        assert!(self.client.supply().hand_over(bus, opened), "there is room for every bus");
    }

    /// Returns the simulated motor of a joint, with its true state.
    pub fn truth(&self, joint: usize) -> Motor {
        let motor = &self.settings.motors[joint];
        let found = |bus: &mut SimulatedBus| bus.motor(&motor.name).cloned();
        self.buses[motor.bus].with(found).expect("every joint has a motor")
    }

    /// Returns the newest state.
    pub fn state(&mut self) -> StateMessage {
        *self.client.state()
    }

    /// Returns the newest state of a joint.
    pub fn joint(&mut self, index: usize) -> JointState {
        self.state().joints[index]
    }

    /// Returns the newest state of a bus.
    pub fn bus(&mut self, index: usize) -> BusState {
        self.state().buses[index]
    }

    /// Returns the mode of a joint's motor.
    pub fn mode(&mut self, index: usize) -> MotorMode {
        self.joint(index).mode.try_into().expect("modes are known")
    }

    /// Returns the newest state of the first group.
    pub fn group(&mut self) -> GroupState {
        self.state().groups[0]
    }

    /// Returns the phase of the first group.
    pub fn phase(&mut self) -> Phase {
        self.group().phase.try_into().expect("phases are known")
    }

    /// Returns the cause that is latched in the first group.
    pub fn cause(&mut self) -> Option<Cause> {
        Cause::try_from(self.group().cause).ok()
    }

    /// Posts a request and runs cycles until its answer arrives.
    pub fn ask(&mut self, request: AdminRequest) -> Result<AdminReply, Refusal> {
        let ticket = self.client.post(request).expect("the ring has room");
        for _ in 0..4000 {
            self.step();
            if let Some(reply) = self.client.answer_to(ticket) {
                return if reply.refusal == 0 { Ok(reply) } else { Err(refusal(reply)) };
            }
        }
        panic!("no answer to {request:?}");
    }

    /// Requests an operation for the first group, and waits for the answer.
    pub fn operate(&mut self, operation: Operation) -> Result<AdminReply, Refusal> {
        self.ask(AdminRequest { operation: operation.code(), group: 0, ..Default::default() })
    }

    /// Requests an operation for a joint, and waits for the answer.
    pub fn operate_joint(&mut self, operation: Operation, joint: usize) -> Result<AdminReply, Refusal> {
        self.ask(AdminRequest { operation: operation.code(), joint: joint as u32, ..Default::default() })
    }

    /// Claims the first group and returns the lease.
    pub fn claim(&mut self) -> Result<u64, Refusal> {
        Ok(self.operate(Operation::Claim)?.lease)
    }

    /// Returns the newest lease of the first group; 0 without one.
    pub fn lease(&self) -> u64 {
        self.client.lease(0).map_or(0, Lease::raw)
    }

    /// Posts a request without waiting, and returns the ticket of its answer.
    pub fn post(&mut self, request: AdminRequest) -> u32 {
        // A full ring is reported to the client as busy.
        self.client.post(request).unwrap_or(0)
    }

    /// Takes the next answer.
    pub fn take_answer(&mut self) -> Option<(u32, AdminReply)> {
        self.client.answer()
    }

    /// Returns a valid message in the owner's name.
    pub fn message(&mut self, joints: &[JointSetpoint]) -> SetpointMessage {
        let now = self.now();
        self.client.message(0, now, joints).unwrap_or_else(|| message(0, 1, now, joints))
    }

    /// Hands a message for the first group to the cycle, as the ipc thread does.
    pub fn deliver(&mut self, message: &SetpointMessage) {
        self.deliver_to(0, message);
    }

    /// Hands a message for `group` to the cycle.
    pub fn deliver_to(&mut self, group: usize, message: &SetpointMessage) {
        self.client.deliver(group, message);
    }

    /// Sends `joints` in the name of the first group's owner.
    pub fn send(&mut self, joints: &[JointSetpoint]) {
        let message = self.message(joints);
        self.deliver(&message);
    }

    /// Setpoints that hold every joint of the first group at its position, with these gains.
    pub fn hold(&mut self, kp: f32, kd: f32) -> Vec<JointSetpoint> {
        self.hold_group(0, kp, kd)
    }

    /// Setpoints that hold every joint of `group` at its position, with these gains.
    pub fn hold_group(&mut self, group: usize, kp: f32, kd: f32) -> Vec<JointSetpoint> {
        let state = self.state();
        let motors = self.settings.groups[group].motors.iter();
        motors
            .map(|&motor| JointSetpoint {
                position: state.joints[motor].position,
                kp,
                kd,
                ..Default::default()
            })
            .collect()
    }

    /// Sends `joints` and runs one cycle.
    pub fn follow(&mut self, joints: &[JointSetpoint]) {
        self.send(joints);
        self.step();
    }

    /// Brings the first group from any stopped state to `Active`; the owner holds the joints.
    pub fn activate(&mut self) -> Vec<JointSetpoint> {
        self.steps(10);
        // A motor may report only every 100 ms that it is there.
        let mut cycles = (self.settings.cycle.rate_hz * 0.2) as usize;
        while cycles > 0 && self.misses_motor() {
            self.step();
            cycles -= 1;
        }
        if self.group().lease == 0 {
            self.claim().expect("the group is free");
        }
        let joints = self.hold(40.0, 1.0);
        self.follow(&joints);
        self.operate(Operation::Enable).unwrap_or_else(|refusal| panic!("{refusal}"));
        // A motor may report only every 100 ms that it runs.
        let cycles = (self.settings.cycle.rate_hz * 0.2) as usize;
        for _ in 0..cycles.max(200) {
            self.follow(&joints);
        }
        assert_eq!(self.phase(), Phase::Active, "{:?}", self.cause());
        self.take_sent();
        joints
    }

    fn misses_motor(&mut self) -> bool {
        let motors = self.settings.groups[0].motors.clone();
        motors.into_iter().any(|motor| self.mode(motor) == MotorMode::Offline)
    }

    /// Injects the fault that `line` names, as `motord-sim` does.
    pub fn disturb(&mut self, line: &str) {
        let verb: FaultVerb = line.parse().unwrap_or_else(|error| panic!("{line}: {error}"));
        let now = self.now();
        let done = self.buses.iter().any(|bus| bus.inject(now, &verb).is_ok());
        assert!(done, "{line}: no bus or motor has this name");
    }

    /// Sends `joints` in each cycle until `end` holds, for at most `cycles` cycles.
    pub fn follow_until(&mut self, joints: &[JointSetpoint], cycles: usize, end: impl Fn(&mut Self) -> bool) {
        for _ in 0..cycles {
            if end(self) {
                return;
            }
            self.follow(joints);
        }
        assert!(end(self), "not within {cycles} cycles: {} for {:?}", self.phase(), self.cause());
    }

    /// Sets the clock back, as a faulty clock does.
    pub fn turn_clock_back(&mut self, back: Duration) {
        self.clock.now.set(self.now() - back);
    }

    /// Suspends the computer for `time`, which the clock of the cycle does not count.
    pub fn suspend(&mut self, time: Duration) {
        self.clock.suspended.set(self.clock.suspended.get() + time);
    }

    /// Ends the next sleep of the cycle at `late` after its tick.
    pub fn oversleep(&mut self, late: Duration) {
        self.clock.wakes_at.set(Some(self.next() + late));
    }
}

/// Returns a message with the setpoints `joints`.
pub fn message(lease: u64, sequence: u64, now: Instant, joints: &[JointSetpoint]) -> SetpointMessage {
    let mut message = SetpointMessage {
        lease,
        sequence,
        time_ns: now.as_nanos(),
        joint_count: joints.len() as u32,
        ..Default::default()
    };
    message.joints[..joints.len()].copy_from_slice(joints);
    message
}

fn refusal(reply: AdminReply) -> Refusal {
    reply.refusal.try_into().expect("refusals are known")
}

/// Builds the buses of a configuration with their motors, changed by `build`.
fn simulated(
    settings: &Settings,
    seed: u64,
    mut build: impl FnMut(&mut BusSettings, &mut Vec<MotorSettings>),
) -> Vec<Wire> {
    let wire = |index: usize| {
        let bus = simulated_bus(settings, index, seed, &mut build);
        match settings.buses[index].is_line() {
            true => Wire::Line(SharedLine::new(SerialSlave::new(bus, seed + index as u64), settings, index)),
            false => Wire::Bus(SharedBus::new(bus)),
        }
    };
    (0..settings.buses.len()).map(wire).collect()
}

fn simulated_bus(
    settings: &Settings,
    index: usize,
    seed: u64,
    build: &mut impl FnMut(&mut BusSettings, &mut Vec<MotorSettings>),
) -> SimulatedBus {
    let (bus, mut motors) = buses::physics(settings, index);
    // As the CAN interfaces of Linux are set up: two cycles, each with a request for a motor's
    // faults.
    let mut bus = BusSettings { record: 4096, tx_queue: 2 * (motors.len() + 3 * bus.imus.len() + 1), ..bus };
    build(&mut bus, &mut motors);
    SimulatedBus::new(bus, motors, seed + index as u64)
}
