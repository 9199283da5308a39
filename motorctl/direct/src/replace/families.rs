//! Replacements of motors whose address is one id, on a bus with a motor of each family.

use super::*;
use motord_bus::{
    Bus, Content, Duration, Frame, Inbox, Instant, Readiness, Refusal, Sent, Unsupported, VirtualClock,
};
use motord_protocol::commissioning::{LISTEN, Link, Private};
use motord_protocol::robstride::parameter::TIMEOUT;
use motord_simulator::{
    BusSettings, Dialect, FaultVerb, Motor, MotorSettings as Simulated, SharedBus, SimulatedBus,
};
use std::fs;
use std::sync::atomic::{AtomicU32, Ordering};

/// Name, id, protocol, vendor and model of each joint.
const JOINTS: [(&str, u16, &str, &str, &str); 7] = [
    ("native", 10, "gim", "steadywin", "GIM8108-8"),
    ("mit", 11, "mit", "steadywin", "GIM8108-8"),
    ("damiao", 12, "mit", "damiao", "DM-J4310-2EC"),
    ("ak", 13, "mit", "cubemars", "AK80-9"),
    ("private", 14, "robstride", "robstride", "RS02"),
    ("node", 3, "cansimple", "steadywin", "GIM6010-8"),
    ("rmd", 16, "myactuator", "myactuator", "X6-40"),
];
/// The joints whose motors have one id.
const REPLACED: [&str; 3] = ["private", "node", "rmd"];

fn simulated(joint: &str) -> Simulated {
    let (name, id, protocol, vendor, _) = JOINTS.into_iter().find(|(name, ..)| *name == joint).unwrap();
    let (host_id, ends) = match name {
        "damiao" => (0x10 + id, Some([12.5, 30.0, 10.0])),
        "ak" => (0, Some([12.5, 50.0, 18.0])),
        "private" => (0xFD, Some([12.57, 44.0, 17.0])),
        "rmd" => (0, Some([12.5, 45.0, 24.0])),
        _ => (0x100 + id, None),
    };
    let dialect = Dialect::by_name(protocol).unwrap();
    let initial_position = 0.05 * f64::from(id);
    Simulated {
        name: name.into(),
        id,
        host_id,
        dialect,
        vendor,
        ends,
        initial_position,
        ..Simulated::default()
    }
}

/// A motor from the factory, of the family of `joint`.
fn new_motor(name: &str, joint: &str, initial_position: f64) -> Simulated {
    Simulated { name: name.into(), is_new: true, initial_position, ..simulated(joint) }
}

fn configuration(bitrate: u32) -> String {
    let motor = |(name, id, protocol, _, model): (&str, u16, &str, &str, &str)| {
        let torque = if name == "rmd" { "torque-end-nm = 24\n" } else { "" };
        format!(
            "[[motor]]\nname = '{name}'\nbus = 'arm'\nid = {id}\nprotocol = '{protocol}'\nmodel = '{model}'\n{torque}"
        )
    };
    let head = format!(
        "[cycle]\nrate-hz = 50\n[[bus]]\nname = 'arm'\ntype = 'socketcan'\ninterface = 'can0'\nbitrate = {bitrate}\n"
    );
    head + &JOINTS.map(motor).concat()
}

/// A bus, and the configuration of its robot. Its folder is removed with it.
struct Bench {
    bus: SharedBus,
    clock: VirtualClock,
    folder: PathBuf,
    joint: &'static str,
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _removed = fs::remove_dir_all(&self.folder);
    }
}

impl Bench {
    /// The motor of `joint` and those in `off` have no power; `new` ones have.
    fn new(joint: &'static str, off: &[&str], new: Vec<Simulated>) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        // A new driver with CANSimple has 500 kbit/s.
        let bitrate = if joint == "node" { 500_000 } else { 1_000_000 };
        let has_power = |name: &str| name != joint && !off.contains(&name);
        let motors = JOINTS.map(|(name, ..)| Simulated { has_power: has_power(name), ..simulated(name) });
        let motors = motors.into_iter().chain(new).collect();
        let bus = SimulatedBus::new(BusSettings { bitrate, ..BusSettings::default() }, motors, 7);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("motord-families-{}-{count}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("robot.toml"), configuration(bitrate)).unwrap();
        Self { bus: SharedBus::new(bus), clock: VirtualClock::default(), folder, joint }
    }

    fn replace_over(&self, bus: impl Bus + 'static) -> Result<(), DirectFailure> {
        let config = self.folder.join("robot.toml");
        let settings = config::load(&config).unwrap().settings;
        let joint = settings.motors.iter().find(|motor| motor.name == self.joint).unwrap();
        let line = OpenLine::simulated(Link::can(bus, self.clock.clone()), None);
        let replacement = Replacement { settings: &settings, joint, config: &config };
        replacement.fill(line, Confirm { yes: true }, &Interrupt::register())
    }

    fn replace(&self) -> Result<(), DirectFailure> {
        self.replace_over(self.bus.clone())
    }

    fn link(&self) -> Link {
        Link::can(self.bus.clone(), self.clock.clone())
    }

    /// Takes the power of a motor for a moment.
    fn power_cycle(&self, motor: &str) {
        let verb: FaultVerb = format!("{motor} power-cycle").parse().unwrap();
        let mut link = self.link();
        self.bus.lock().inject(link.now(), &verb).unwrap();
        link.pause(Duration::from_millis(500));
    }

    /// The memories of all motors except `new`.
    fn memories(&self) -> Vec<String> {
        let bus = self.bus.lock();
        bus.motors().iter().filter(|motor| motor.name() != "new").map(Motor::memory).collect()
    }

    fn all_memories(&self) -> Vec<String> {
        self.bus.lock().motors().iter().map(Motor::memory).collect()
    }

    /// Checks that the new motor has, without power, what the joint's has.
    fn assert_replaced(&self) {
        self.power_cycle("new");
        let id = simulated(self.joint).id;
        let bus = self.bus.lock();
        let new = bus.motor("new").unwrap();
        let stored = format!("int 0x12 {id}\n");
        assert!(new.memory().contains(&stored), "{}: {}", self.joint, new.memory());
        assert!(new.position().abs() < 0.01, "{}: {}", self.joint, new.position());
        drop(bus);
        if self.joint == "private" {
            let timeout = Private::new(&mut self.link(), id as u8).read(TIMEOUT).unwrap();
            assert_eq!(timeout, Some(4000_u32.to_le_bytes()));
        }
    }

    /// Replaces over `bus`, which must fail with this reason and change no memory.
    fn assert_refused(&self, bus: impl Bus + 'static, reason: &str) {
        let before = self.all_memories();
        let failure = self.replace_over(bus).unwrap_err().to_string();
        assert!(failure.contains(reason), "{}: {failure}", self.joint);
        assert_eq!(self.all_memories(), before, "{}", self.joint);
        assert!(!Lock::path(&self.folder.join("robot.toml")).exists());
    }
}

#[test]
fn new_motor_of_each_family_is_set_up() {
    for joint in REPLACED {
        let bench = Bench::new(joint, &[], vec![new_motor("new", joint, 0.4)]);
        let before = bench.memories();
        bench.replace().unwrap();
        bench.assert_replaced();
        assert_eq!(bench.memories(), before, "{joint}");
        let lock = fs::read_to_string(Lock::path(&bench.folder.join("robot.toml"))).unwrap();
        assert!(lock.contains(&format!("name = \"{joint}\"")), "{lock}");
        let again = bench.replace().unwrap_err().to_string();
        assert!(again.contains(&format!("the motor of {joint} answers")), "{again}");
    }
}

#[test]
fn plan_names_what_cannot_be_read() {
    for (joint, line) in [("private", "a timeout of 200 ms"), ("node", "its zero"), ("rmd", "its zero")] {
        let bench = Bench::new(joint, &[], vec![new_motor("new", joint, 0.4)]);
        let config = bench.folder.join("robot.toml");
        let settings = config::load(&config).unwrap().settings;
        let joint = settings.motors.iter().find(|motor| motor.name == joint).unwrap();
        let line_of = OpenLine::simulated(bench.link(), None);
        let replacement = Replacement { settings: &settings, joint, config: &config };
        let before = bench.all_memories();
        // Without a terminal there is no consent.
        let Err(DirectFailure::Unconfirmed { warning }) =
            replacement.fill(line_of, Confirm { yes: false }, &Interrupt::register())
        else {
            panic!("it was done without consent")
        };
        let id = format!("  id {}\n", joint.id);
        let label =
            format!("cannot be read: its model, bit rate and limits. Compare its label with {}", joint.model);
        for part in [line, &id, &label, "has id 1. This permanently writes"] {
            assert!(warning.contains(part), "{part}: {warning}");
        }
        assert_eq!(bench.all_memories(), before);
    }
}

#[test]
fn new_motor_of_another_family_is_refused() {
    for joint in REPLACED {
        for (other, ..) in JOINTS.into_iter().filter(|(name, ..)| *name != joint) {
            // One with another bit rate is silent.
            if joint != "node" && other != "node" {
                let bench = Bench::new(joint, &[], vec![new_motor("new", other, 0.4)]);
                bench.assert_refused(bench.bus.clone(), &format!("{joint} has the "));
            }
        }
    }
}

#[test]
fn driver_beside_other_families_is_refused() {
    let other = Simulated { name: "new".into(), id: 1, ..simulated("node") };
    for joint in ["private", "rmd"] {
        let bench = Bench::new(joint, &[], vec![other.clone()]);
        bench.assert_refused(bench.bus.clone(), &format!("{joint} has the "));
    }
    let mit = Simulated { name: "new".into(), id: 1, host_id: 0x101, ..simulated("mit") };
    let bench = Bench::new("node", &[], vec![mit]);
    bench.assert_refused(bench.bus.clone(), "node has the protocol cansimple");
}

#[test]
fn unclear_bus_of_each_family_is_refused() {
    for joint in REPLACED {
        let new = |name, of, at| new_motor(name, of, at);
        let two = Bench::new(joint, &[], vec![new("new", joint, 0.4), new("other", joint, 0.9)]);
        two.assert_refused(two.bus.clone(), "several motors answer as ");
        let none = Bench::new(joint, &[], vec![]);
        none.assert_refused(none.bus.clone(), "no new motor answers");
        let missing = Bench::new(joint, &["mit", "ak"], vec![new("new", joint, 0.4)]);
        missing.assert_refused(missing.bus.clone(), "no motor answers for: mit, ak");
        let in_use = Simulated { name: "new".into(), ..simulated(joint) };
        let answers = Bench::new(joint, &[], vec![in_use]);
        answers.assert_refused(answers.bus.clone(), &format!("the motor of {joint} answers"));
    }
    let both = vec![new_motor("new", "private", 0.4), new_motor("other", "rmd", 0.9)];
    let both = Bench::new("private", &[], both);
    both.assert_refused(both.bus.clone(), "several motors answer as id 1: 1 (robstride), 1 (myactuator)");
}

/// A motor from another robot has neither the joint's id nor that of a new one.
#[test]
fn used_motor_of_each_family_is_refused() {
    for joint in REPLACED {
        let used = Simulated { name: "new".into(), id: 24, ..simulated(joint) };
        let bench = Bench::new(joint, &[], vec![used]);
        bench.assert_refused(bench.bus.clone(), "the motor with id 24");
    }
}

/// Another node, which sends a frame every 2 ms from a time on.
struct Noise {
    bus: SharedBus,
    next: Instant,
    content: Content,
}

impl Bus for Noise {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.bus.send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        while self.next <= now {
            self.bus.lock().deliver(self.next, self.content);
            self.next = self.next + Duration::from_millis(2);
        }
        self.bus.receive(now, inbox);
    }

    fn readiness(&self) -> Readiness<'_> {
        match self.bus.readiness() {
            Readiness::At(arrival) => Readiness::At(arrival.min(self.next)),
            _ => Readiness::At(self.next),
        }
    }
}

#[test]
fn noise_is_named_and_nothing_is_written() {
    let frame = |id: FrameId| Content::Frame(Frame::classic(id, [0x0E, 0x7F, 0xFF, 0x7F, 0xF7, 0xFF, 25, 0]));
    let begin = Instant::from_nanos(1);
    let after = begin + LISTEN;
    let table = [
        ("node", frame(FrameId::new(0x7A0).unwrap()), begin, "frames with id 0x7A0"),
        ("private", frame(FrameId::new(0x7A0).unwrap()), after, "with the ids 0x7A0"),
        ("rmd", frame(FrameId::new(0x7A0).unwrap()), after, "with the ids 0x7A0"),
        ("rmd", frame(FrameId::extended(0x18FE_F1FD).unwrap()), begin, "with 29-bit ids"),
        ("node", Content::Unsupported(Unsupported::Fd), begin, "in CAN FD format"),
    ];
    for (joint, content, next, reason) in table {
        let bench = Bench::new(joint, &[], vec![new_motor("new", joint, 0.4)]);
        bench.assert_refused(Noise { bus: bench.bus.clone(), next, content }, reason);
    }
}

/// A bus that is lost after some frames that write into a motor.
struct Cut {
    bus: SharedBus,
    writes: usize,
}

/// Returns whether a frame writes into a motor of one of the three families, or restarts it.
fn writes(frame: &Frame) -> bool {
    let (raw, first) = (frame.id().raw(), frame.payload().first().copied());
    match frame.id().is_extended() {
        true => matches!(raw >> 24, 6 | 7 | 18 | 22),
        false if (0x141..=0x160).contains(&raw) => matches!(first, Some(0x20 | 0x64 | 0x76)),
        // Nodes 1 and 3: node id, zero, save.
        false => matches!(raw >> 5, 1 | 3) && matches!(raw & 0x1F, 0x06 | 0x19 | 0x1F),
    }
}

impl Bus for Cut {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        if frames.iter().any(writes) {
            if self.writes == 0 {
                return Sent { accepted: 0, refusal: Some(Refusal::Down) };
            }
            self.writes -= 1;
        }
        self.bus.send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        self.bus.receive(now, inbox);
    }

    fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }
}

/// Goal: after an interruption at any write, the same command goes on, or nothing is left to write. Method: it
/// loses the bus before each write in turn, and the new motor loses its power.
#[test]
fn interrupted_replacement_of_each_family_goes_on() {
    for joint in REPLACED {
        let mut writes = 0;
        loop {
            let bench = Bench::new(joint, &[], vec![new_motor("new", joint, 0.4)]);
            let before = bench.memories();
            let first = bench.replace_over(Cut { bus: bench.bus.clone(), writes });
            if first.is_ok() {
                break;
            }
            bench.power_cycle("new");
            if let Err(failure) = bench.replace() {
                let reason = failure.to_string();
                assert!(reason.contains("If it is the new one"), "{joint} {writes}: {reason}");
            }
            bench.assert_replaced();
            assert_eq!(bench.memories(), before, "{joint} {writes}");
            writes += 1;
        }
        assert!(writes >= 4, "{joint}: {writes}");
    }
}

/// A new driver obeys the ids 32 to 63, and a joint's motor with the id 1 is no new one.
#[test]
fn joint_with_ids_of_new_motors_is_refused() {
    for (joint, from, to) in
        [("node", "id = 11", "id = 40"), ("node", "id = 3", "id = 1"), ("private", "id = 14", "id = 127")]
    {
        let bench = Bench::new(joint, &[], vec![new_motor("new", joint, 0.4)]);
        let config = bench.folder.join("robot.toml");
        let text = fs::read_to_string(&config).unwrap();
        fs::write(&config, text.replace(&format!("\n{from}\n"), &format!("\n{to}\n"))).unwrap();
        bench.assert_refused(bench.bus.clone(), "shares an id with new motors");
    }
}
