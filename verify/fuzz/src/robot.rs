//! A whole robot on virtual time: the real cycle on buses whose other end is the target. Its motors
//! answer every frame immediately, with the state of a motor at rest.

use motord_bus::frame::{Arrival, Content, Frame, FrameId};
use motord_bus::{Bus, Clock, Inbox, Instant, Readiness, Sent as Accepted, VirtualClock};
use motord_checker::protocol::mit::Meaning;
use motord_checker::protocol::ranges::Ranges;
use motord_configuration::Machine;
use motord_core::cycle::{Cycle, LocalClient, Tick, assemble};
use motord_settings::settings::{MotorSettings, Settings};
use motord_shared::{AdminReply, AdminRequest, JointSetpoint, Operation, Phase, SetpointMessage};
use std::collections::VecDeque;
use std::fmt;
use std::path::Path;
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};

/// Start of the clock, so that no age of a message is limited by the clock's zero.
const BEGIN: Instant = Instant::from_nanos(1_000_000_000);
/// Most cycles until an enabled robot becomes active.
const STARTING_MAX: usize = 400;

/// Returns motors of every dialect: three vendors' MIT, and the native protocol.
pub(crate) fn mixed() -> &'static Settings {
    static SETTINGS: LazyLock<Settings> = LazyLock::new(|| {
        let models = [("a", "GIM8108-8"), ("b", "DM-J8009-2EC"), ("c", "RS00")];
        let mit = models.map(|(name, model)| motor(name, model, "mit")).concat();
        settings(&(mit + &motor("d", "GIM8108-8", "gim")))
    });
    &SETTINGS
}

/// Returns two motors that can be enabled, with short times.
pub(crate) fn legs() -> &'static Settings {
    static SETTINGS: LazyLock<Settings> = LazyLock::new(|| {
        let motors = [("hip", "GIM8108-8"), ("knee", "RS00")].map(|(name, model)| motor(name, model, "mit"));
        settings(&("[safety]\nstart-ramp-ms = 10\n".to_owned() + &motors.concat()))
    });
    &SETTINGS
}

/// Returns a motor on a separate bus.
fn motor(name: &str, model: &str, protocol: &str) -> String {
    format!(
        "[[bus]]\nname = \"{name}\"\ntype = \"simulated\"\n[[motor]]\nname = \"{name}\"\nbus = \"{name}\"\nid = 1\n\
         protocol = \"{protocol}\"\nmodel = \"{model}\"\nlimits = {{ position-rad = [-3.0, 3.0], velocity-rad-s = 10.0, \
         torque-nm = 3.0 }}\n"
    )
}

fn settings(text: &str) -> Settings {
    let machine = Machine { processors: vec![0], priority_max: 98 };
    let loaded = motord_configuration::parse(Path::new("fuzz.toml"), text.as_bytes(), &machine);
    loaded.unwrap_or_else(|error| panic!("{error}")).settings
}

/// A bus between the cycle and the target.
#[derive(Debug, Default)]
struct TargetBus {
    sent: Vec<Frame>,
    arriving: VecDeque<Content>,
    /// The reply of a motor at rest; `None` when it must be silent.
    reply: Option<Frame>,
}

#[derive(Debug, Clone, Default)]
struct SharedTargetBus(Arc<Mutex<TargetBus>>);

impl SharedTargetBus {
    fn lock(&self) -> MutexGuard<'_, TargetBus> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Bus for SharedTargetBus {
    fn send(&mut self, _: Instant, frames: &[Frame]) -> Accepted {
        let mut wire = self.lock();
        wire.sent.extend(frames);
        let replies =
            wire.reply.into_iter().flat_map(|reply| frames.iter().map(move |_| Content::Frame(reply)));
        wire.arriving.extend(replies.collect::<Vec<_>>());
        Accepted::all(frames.len())
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        let mut wire = self.lock();
        while let Some(content) = wire.arriving.front().copied() {
            if inbox.push(Arrival { at: now, content }).is_err() {
                return;
            }
            wire.arriving.pop_front();
        }
    }

    fn readiness(&self) -> Readiness<'_> {
        match self.lock().arriving.is_empty() {
            true => Readiness::Never,
            false => Readiness::At(Instant::ZERO),
        }
    }
}

/// A frame to a motor.
pub(crate) struct Sent {
    pub(crate) motor: &'static MotorSettings,
    pub(crate) id: FrameId,
    pub(crate) bytes: [u8; 8],
}

impl fmt::Debug for Sent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {:02X?}, {:?}", self.motor.name, self.bytes, self.meaning())
    }
}

impl Sent {
    /// Returns `true` when it stops the motor or only requests a value: the motor does not move, in
    /// any mode.
    pub(crate) fn is_harmless(&self) -> bool {
        match (self.motor.protocol.name(), self.meaning()) {
            (_, Meaning::Stop | Meaning::GetFault | Meaning::ClearFault) => true,
            // A native command that a motor in MIT mode reads as no torque. Only these also have no
            // effect in native mode: stop, get version, get fault, retrieve an indicator, retrieve
            // a configuration.
            ("gim", Meaning::Control { kp: 0.0, kd: 0.0, neutral: true, .. }) => {
                matches!(self.bytes[0], 0x84 | 0x92 | 0xB1 | 0xB2 | 0xB4)
            }
            ("gim", _) => matches!(self.bytes[0], 0x92 | 0xB1 | 0xB2 | 0xB4),
            _ => self.reads_register(),
        }
    }

    /// Returns `true` when it reads the end of a code of its motor.
    fn reads_register(&self) -> bool {
        let is_read = matches!(self.bytes, [id, 0, 0x33, 21..=23, 0, 0, 0, 0] if id == self.motor.id);
        is_read && self.id.raw() == 0x7FF && self.motor.profile.has_registers
    }

    /// Returns the command as its motor reads it, if that speaks MIT.
    pub(crate) fn mit_meaning(&self) -> Option<Meaning> {
        (self.motor.protocol.name() == "mit").then(|| self.meaning())
    }

    /// Returns the command as a motor in MIT mode reads it.
    pub(crate) fn meaning(&self) -> Meaning {
        let scales = &self.motor.scales;
        let ranges = Ranges {
            position: scales.position.max(),
            velocity: scales.velocity.max(),
            kp: scales.kp.max(),
            kd: scales.kd.max(),
            torque: scales.torque.max(),
        };
        Meaning::of(self.bytes, &ranges)
    }
}

/// The robot and its client.
pub(crate) struct Robot {
    settings: &'static Settings,
    cycle: Cycle,
    pub(crate) client: LocalClient,
    clock: VirtualClock,
    wires: Vec<SharedTargetBus>,
    tick: Tick,
}

impl Robot {
    pub(crate) fn new(settings: &'static Settings) -> Self {
        let wires: Vec<SharedTargetBus> = settings.buses.iter().map(|_| SharedTargetBus::default()).collect();
        let buses = wires.iter().map(|wire| Box::new(wire.clone()) as Box<dyn Bus>).collect();
        let clock = VirtualClock::new(BEGIN);
        let (cycle, ends) = assemble(settings, buses, clock.clone(), 7);
        let tick = Tick { number: 1, at: BEGIN };
        Self { settings, cycle, client: LocalClient::new(ends), clock, wires, tick }
    }

    /// Returns a robot that follows its owner.
    pub(crate) fn active(settings: &'static Settings) -> Self {
        let mut robot = Self::new(settings);
        for motor in &settings.motors {
            robot.wires[motor.bus].lock().reply = Some(at_rest(motor));
        }
        for _ in 0..10 {
            robot.step();
        }
        robot.ask(Operation::Claim);
        robot.follow();
        robot.ask(Operation::Enable);
        for _ in 0..STARTING_MAX {
            if robot.phase() == Some(Phase::Active) {
                break;
            }
            robot.follow();
        }
        assert_eq!(robot.phase(), Some(Phase::Active), "its motors answer, and its owner holds them");
        robot.take_sent();
        robot
    }

    fn ask(&mut self, operation: Operation) {
        self.client.request(operation, 0).expect("the ring has room");
        self.step();
        let (_, reply) = self.client.answer().expect("it is answered in the next cycle");
        assert_eq!(reply.refusal, 0, "{operation:?}");
    }

    /// Runs a cycle in which the owner holds the joints at their positions.
    pub(crate) fn follow(&mut self) {
        let message = self.message();
        self.client.deliver(0, &message);
        self.step();
    }

    /// Returns a correct message of the owner; one without a lease when there is none.
    pub(crate) fn message(&mut self) -> SetpointMessage {
        let hold = JointSetpoint { kp: 20.0, kd: 1.0, ..JointSetpoint::default() };
        let mut joints = vec![hold; self.settings.motors.len()];
        for (joint, state) in joints.iter_mut().zip(self.client.state().joints()) {
            joint.position = state.position;
        }
        let now = self.clock.now();
        self.client.message(0, now, &joints).unwrap_or_default()
    }

    /// Runs a cycle.
    pub(crate) fn step(&mut self) {
        self.tick = self.cycle.run(self.tick);
        while self.client.record().is_some() {}
        while self.client.event().is_some() {}
    }

    pub(crate) fn phase(&mut self) -> Option<Phase> {
        Phase::try_from(self.client.state().groups[0].phase).ok()
    }

    /// Delivers `content` on the bus next, in addition to the motors' answers.
    pub(crate) fn deliver(&self, bus: usize, content: Content) {
        self.wires[bus % self.wires.len()].lock().arriving.push_back(content);
    }

    /// Returns the reply id of one of the motors.
    pub(crate) fn reply_id(&self, motor: u8) -> FrameId {
        self.settings.motors[usize::from(motor) % self.settings.motors.len()].host_id
    }

    /// Posts a request, valid or invalid.
    pub(crate) fn post(&mut self, request: AdminRequest) {
        let _full = self.client.post(request);
    }

    /// Returns the answers that have arrived.
    pub(crate) fn take_answers(&mut self) -> Vec<AdminReply> {
        std::iter::from_fn(|| self.client.answer()).map(|(_, reply)| reply).collect()
    }

    /// Returns the frames that the motors have received since the last call.
    pub(crate) fn take_sent(&self) -> Vec<Sent> {
        let frames_of = |motor: &'static MotorSettings| {
            let frames = std::mem::take(&mut self.wires[motor.bus].lock().sent);
            frames.into_iter().map(move |frame| {
                let (id, bytes) =
                    (frame.id(), frame.payload().try_into().expect("every command has eight bytes"));
                let sent = Sent { motor, id, bytes };
                let is_command = motor.addresses().commands.matches(id);
                assert!(is_command || sent.reads_register(), "no other motor is on its bus");
                sent
            })
        };
        self.settings.motors.iter().flat_map(frames_of).collect()
    }
}

/// Returns the state of a motor at rest: the middle codes, and temperatures of a cool motor.
/// RobStride's has the mode "motor" above its temperature.
fn at_rest(motor: &MotorSettings) -> Frame {
    let len = motor.profile.reply.lengths[0];
    let mode = if motor.profile.name == "robstride" { 0x80 } else { 0 };
    let state = [motor.id, 0x80, 0x00, 0x80, 0x08, 0x00, 0x01 | mode, 0x19];
    Frame::new(motor.host_id, &state[..len]).expect("a reply has at most eight bytes")
}
