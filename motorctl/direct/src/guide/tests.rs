//! The guide on a simulated CAN bus, with a person who answers and turns the joints by hand.

use super::dialog::{Input, Line};
use super::*;
use crate::target::arm_motor;
use motord_bus::{Monotonic, clock};
use motord_protocol::commissioning::Link;
use motord_simulator::{
    BusSettings, Dialect, FaultVerb, MotorSettings as Simulated, SharedBus, SimulatedBus,
};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::Write;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// Longest run on a busy machine.
const RUN_MAX: Duration = Duration::from_secs(60);

/// An action of the person once a text is on the screen.
#[derive(Debug, Clone)]
enum Act {
    Type(&'static str),
    /// A line of motord-sim.
    Verb(String),
    /// Turns a joint by hand: N·m, for this time, ms.
    Turn(&'static str, f64, u64),
}

type Script = VecDeque<(&'static str, Act)>;

struct Person {
    screen: Rc<RefCell<Vec<u8>>>,
    /// Bytes of the screen before the last act.
    read: usize,
    script: Script,
    bus: SharedBus,
    until: Instant,
}

impl Person {
    fn inject(&self, verb: &str) {
        let verb: FaultVerb = verb.parse().unwrap();
        self.bus.lock().inject(clock::monotonic(), &verb).unwrap();
    }

    fn act(&mut self, act: Act) -> Line {
        match act {
            Act::Type(text) => {
                self.read = self.screen.borrow().len();
                return Line::Text(text.to_owned());
            }
            Act::Verb(verb) => self.inject(&verb),
            Act::Turn(joint, torque, millis) => {
                self.inject(&format!("{joint} load {torque}"));
                // The guide watches the joint meanwhile.
                self.script.push_front(("", Act::Verb(format!("{joint} load 0"))));
                std::thread::sleep(Duration::from_millis(millis));
            }
        }
        Line::Nothing
    }
}

impl Input for Person {
    fn line(&mut self, wait: Duration) -> Line {
        std::thread::sleep(wait / 10);
        if Instant::now() > self.until {
            return Line::End;
        }
        let text = String::from_utf8_lossy(&self.screen.borrow()[self.read..]).into_owned();
        let Some((wanted, _)) = self.script.front() else { return Line::End };
        if !text.contains(*wanted) {
            return Line::Nothing;
        }
        self.script.pop_front().map_or(Line::End, |(_, act)| self.act(act))
    }

    fn discard(&mut self) {}
}

struct Screen(Rc<RefCell<Vec<u8>>>);

impl Write for Screen {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.borrow_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A CAN bus, and the configuration of its motors. Its folder is removed with it.
struct Robot {
    bus: SharedBus,
    bitrate: u32,
    folder: PathBuf,
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _removed = std::fs::remove_dir_all(&self.folder);
    }
}

const JOINTS: [(&str, &str); 4] =
    [("hip", "GIM8108-8"), ("thigh", "GIM8108-8"), ("elbow", "DM-J4310-2EC"), ("wrist", "DM-J4310-2EC")];

impl Robot {
    /// Four motors with ids 1 to 4 in the configuration, changed by `change` in the simulation.
    fn new(test: &str, bitrate: u32, change: impl Fn(Simulated) -> Simulated) -> Self {
        let motors = (1..).zip(JOINTS).map(|(id, (name, model))| {
            let motor = arm_motor(name, id, model.starts_with("DM"));
            change(Simulated { viscous_friction: 0.5, coulomb_friction: 0.1, ..motor })
        });
        let bus = SimulatedBus::new(BusSettings { bitrate, ..BusSettings::default() }, motors.collect(), 7);
        let folder = std::env::temp_dir().join(format!("motord-guide-{test}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let motor = |(id, (name, model)): (u8, (&str, &str))| {
            format!(
                "[[motor]] # {name}\nname = '{name}'\nbus = 'arm'\nid = {id}\nprotocol = 'mit'\nmodel = '{model}'\n\
                 limits = {{ position-rad = [-0.5, 0.5], torque-nm = 2.0 }}\n"
            )
        };
        let motors: String = (1..).zip(JOINTS).map(motor).collect();
        let head = "[cycle]\nrate-hz = 200\n[[bus]]\nname = 'arm'\ntype = 'socketcan'\ninterface = 'can0'\n";
        std::fs::write(folder.join("robot.toml"), format!("{head}{motors}")).unwrap();
        Self { bus: SharedBus::new(bus), bitrate, folder }
    }

    fn new_motors(test: &str) -> Self {
        Self::new(test, 1_000_000, |motor| Simulated { is_new: true, has_power: false, ..motor })
    }

    /// Runs the guide with this person. Returns what was printed.
    fn guide(&self, script: &[(&'static str, Act)]) -> String {
        let screen = Rc::new(RefCell::new(Vec::new()));
        let (script, until) = (script.iter().cloned().collect(), Instant::now() + RUN_MAX);
        let mut person = Person { screen: Rc::clone(&screen), read: 0, script, bus: self.bus.clone(), until };
        let mut output = Screen(Rc::clone(&screen));
        let path = self.folder.join("robot.toml");
        let link = Link::can(self.bus.clone(), Monotonic);
        let mut guide = Guide {
            dialog: Dialog::new(&mut person, &mut output),
            file: Configuration::load(&path).unwrap(),
            progress: Progress::load(&path).unwrap(),
            lines: vec![Some(OpenLine::simulated(link, Some(self.bitrate)))],
            joints: &[],
            skipped: Vec::new(),
            interrupt: &Interrupt::register(),
        };
        guide.run_to_the_end(&[]).unwrap();
        let text = String::from_utf8_lossy(&screen.borrow()).into_owned();
        assert!(person.script.is_empty(), "left: {:?}\n{text}", person.script);
        text
    }

    fn memory(&self, joint: &str) -> String {
        self.bus.lock().motor(joint).unwrap().memory()
    }

    fn text(&self) -> String {
        std::fs::read_to_string(self.folder.join("robot.toml")).unwrap()
    }
}

/// The answers up to the zero.
fn begin(joint: &'static str) -> Vec<(&'static str, Act)> {
    vec![
        ("Give power to one motor", Act::Verb(format!("{joint} on"))),
        ("Which joint", Act::Type(joint)),
        ("write id", Act::Type("")),
    ]
}

/// The answers of direction and range.
fn by_hand(joint: &'static str) -> Vec<(&'static str, Act)> {
    vec![
        ("to its mark", Act::Type("zero")),
        ("turned by", Act::Turn(joint, 0.4, 700)),
        ("turned by", Act::Type("")),
        ("from ", Act::Turn(joint, 0.4, 500)),
        ("from ", Act::Turn(joint, -0.4, 1500)),
        ("from ", Act::Turn(joint, 0.4, 500)),
        ("from ", Act::Type("")),
    ]
}

fn set_up(joint: &'static str, is_steadywin: bool) -> Vec<(&'static str, Act)> {
    let protocol = is_steadywin.then_some(("Type mit", Act::Type("mit")));
    let motion = [
        ("first motion", Act::Type("move")),
        ("Did ", Act::Type("y")),
        ("is done", Act::Verb("hip power-off".into())),
    ];
    [begin(joint), by_hand(joint), protocol.into_iter().collect(), motion.into()].concat()
}

#[test]
fn new_motors_of_two_vendors_share_bus() {
    let robot = Robot::new_motors("vendors");
    let mut script = JOINTS.map(|(joint, model)| set_up(joint, model.starts_with("GIM"))).concat();
    // The guide ends with the last joint.
    script.truncate(script.len() - 1);
    let printed = robot.guide(&script);
    assert!(printed.contains("All joints are done, and motord accepts"), "{printed}");
    let text = robot.text();
    assert_eq!(text.matches("direction = 1").count(), 4, "{text}");
    for (joint, address) in
        [("hip", [1, 0x101]), ("thigh", [2, 0x102]), ("elbow", [3, 0x13]), ("wrist", [4, 0x14])]
    {
        let [id, host_id] = address;
        for item in [format!("int 0x12 {id}\n"), format!("int 0x13 {host_id}\n")] {
            assert!(robot.memory(joint).contains(&item), "{joint}: {item}");
        }
        assert!(robot.bus.lock().motor(joint).unwrap().mode() == motord_simulator::Mode::Stopped);
    }
}

/// Goal: a CAN bus on which no motor has power, and so no node acknowledges, is not the end.
#[test]
fn bus_without_powered_motor_is_waited_for() {
    let robot = Robot::new_motors("no-ack");
    robot.bus.lock().inject(clock::monotonic(), &"can0 no-ack".parse().unwrap()).unwrap();
    let script = [
        ("can0: no node acknowledges", Act::Verb("can0 ok".into())),
        ("Give power to one motor", Act::Verb("hip on".into())),
        ("Which joint", Act::Type("hip")),
        ("write id", Act::Verb("can0 no-ack".into())),
        ("write id", Act::Type("")),
        ("Remove the cause", Act::Verb("can0 ok".into())),
        ("Remove the cause", Act::Type("")),
        ("Which joint", Act::Type("q")),
    ];
    let _printed = robot.guide(&script);
}

/// Goal: two new motors, which answer with the same bytes except for their angle, are not taken for
/// one.
#[test]
fn two_new_motors_are_not_taken_for_one() {
    for [one, other] in [["hip", "thigh"], ["elbow", "wrist"], ["hip", "wrist"]] {
        let robot = Robot::new_motors(&format!("two-{one}-{other}"));
        let script = [
            ("Give power to one motor", Act::Verb(format!("{one} on"))),
            ("Give power to one motor", Act::Verb(format!("{other} on"))),
            ("several motors answer as id 1", Act::Verb(format!("{one} power-off"))),
            ("Which joint", Act::Type("q")),
        ];
        let printed = robot.guide(&script);
        assert!(printed.contains("take the power from all but one"), "{printed}");
    }
}

/// Goal: a Damiao motor, which cannot take back a zero, gets its former one where the hand brings it,
/// and not elsewhere. A joint of another vendor is refused.
#[test]
fn former_zero_of_damiao_is_set_by_hand() {
    let robot = Robot::new("zero", 1_000_000, |motor| Simulated {
        is_new: true,
        has_power: false,
        initial_position: 0.0,
        ..motor
    });
    let undo = [
        ("Give power to one motor", Act::Verb("elbow on".into())),
        ("Which joint", Act::Type("hip")),
        ("answers like one of damiao", Act::Type("elbow")),
        ("write id", Act::Type("")),
        ("to its mark", Act::Type("zero")),
        ("turned by", Act::Type("b")),
        ("until it reads 0.0", Act::Type("zero")),
        ("elbow: zero: undone", Act::Type("zero")),
        ("turned by", Act::Type("b")),
        ("until it reads 0.0", Act::Turn("elbow", 0.4, 500)),
        ("until it reads 0.0", Act::Type("zero")),
        ("the joint is not there yet", Act::Type("s")),
        // The new zero is kept: the next step back is the id.
        ("to its mark", Act::Type("b")),
        ("id: undone", Act::Type("q")),
    ];
    let printed = robot.guide(&undo);
    assert_eq!(printed.matches("zero: undone").count(), 1, "{printed}");
}

/// Goal: the zero of a motor that was set in native mode is restored by hand after its change to MIT,
/// where its id stays.
#[test]
fn native_zero_is_restored_in_mit() {
    let robot = Robot::new_motors("native-zero");
    let mut script = set_up("hip", true);
    script.truncate(script.len() - 3);
    let undo = [
        ("first motion", Act::Type("b")),
        ("protocol: stays", Act::Type("b")),
        ("direction: undone", Act::Type("b")),
        ("until it reads 0.0", Act::Type("zero")),
        ("the joint is not there yet", Act::Type("b")),
        ("turned by", Act::Type("b")),
        ("until it reads 0.0", Act::Type("s")),
        ("zero: the new one is kept", Act::Type("b")),
        ("id: stays", Act::Type("q")),
    ];
    script.extend(undo);
    let _printed = robot.guide(&script);
    assert!(robot.memory("hip").contains("int 0x12 1\n"));
}

/// Goal: a second new motor that gets power while a question is open does not get the id.
#[test]
fn second_motor_during_question_prevents_writing() {
    for [one, other] in [["hip", "thigh"], ["elbow", "wrist"]] {
        let robot = Robot::new_motors(&format!("late-{one}"));
        let mut script = begin(one);
        script.insert(2, ("write id", Act::Verb(format!("{other} on"))));
        // It needs time to start.
        script.insert(3, ("write id", Act::Turn(other, 0.0, 900)));
        script.extend([
            ("Remove the cause", Act::Verb(format!("{other} power-off"))),
            ("Remove the cause", Act::Type("")),
            ("Which joint", Act::Type("q")),
        ]);
        let printed = robot.guide(&script);
        assert!(printed.contains("several motors"), "{printed}");
    }
}

#[test]
fn other_id_in_configuration_reopens_joint() {
    let robot = Robot::new_motors("reopen");
    let _printed = robot.guide(&[begin("elbow"), [("to its mark", Act::Type("q"))].into()].concat());
    std::fs::write(robot.folder.join("robot.toml"), robot.text().replace("id = 3\n", "id = 7\n")).unwrap();
    let script = [("Which joint", Act::Type("elbow")), ("write id 7", Act::Type("q"))];
    let printed = robot.guide(&script);
    assert!(printed.contains("elbow has another bus, id or model by now"), "{printed}");
}

/// Goal: another new motor does not continue a joint that was begun: its zero and range are those of
/// the first motor.
#[test]
fn other_motor_begins_joint_again() {
    let robot = Robot::new_motors("other");
    let to_direction = [("to its mark", Act::Type("zero")), ("turned by", Act::Type("q"))];
    let _printed = robot.guide(&[begin("hip"), to_direction.into()].concat());
    let script = [
        ("Give power to one motor", Act::Verb("hip power-off".into())),
        ("Give power to one motor", Act::Verb("thigh on".into())),
        ("Enter takes thigh", Act::Type("hip")),
        ("type new", Act::Type("")),
        ("only `new`", Act::Type("new")),
        ("write id 1", Act::Type("")),
        ("to its mark", Act::Type("b")),
        ("id: undone", Act::Type("q")),
    ];
    let printed = robot.guide(&script);
    assert!(printed.contains("begun: id, zero"), "{printed}");
}

#[test]
fn wrong_motor_with_address_of_joint_is_refused() {
    let robot = Robot::new("address", 1_000_000, |motor| match motor.name.as_ref() {
        "elbow" => Simulated { id: 1, host_id: 0x101, has_power: false, ..motor },
        _ => Simulated { is_new: true, has_power: false, ..motor },
    });
    let _printed = robot.guide(&[begin("hip"), [("to its mark", Act::Type("q"))].into()].concat());
    let script = [
        ("Give power to one motor", Act::Verb("hip power-off".into())),
        ("Give power to one motor", Act::Verb("elbow on".into())),
        ("with the id of hip. hip has the model GIM8108-8", Act::Type("q")),
    ];
    let _printed = robot.guide(&script);
}

#[test]
fn id_of_damiao_is_restored() {
    let robot = Robot::new_motors("restored");
    let undo = [("to its mark", Act::Type("b")), ("id: undone", Act::Type("q"))];
    let printed = robot.guide(&[begin("elbow"), undo.into()].concat());
    assert!(printed.contains("elbow: id: undone"), "{printed}");
    let memory = robot.memory("elbow");
    assert!(memory.contains("int 0x12 1\n") && memory.contains("int 0x13 0\n"), "{memory}");
}

/// Goal: a motor with the bit rate of its interface gets that of the configuration. The guide names
/// the commands for the interface, and goes on at the new rate, where the motor stores it.
#[test]
fn other_bit_rate_is_written_and_leaves_bus() {
    let mut robot = Robot::new("rate", 500_000, |motor| Simulated {
        has_power: motor.name == "hip",
        dialect: Dialect::Gim,
        ..motor
    });
    let printed = robot.guide(&[("Which joint", Act::Type("hip")), ("Write 1000000 bit/s", Act::Type(""))]);
    assert!(printed.contains("sudo ip link set can0 type can bitrate 1000000"), "{printed}");
    assert!(printed.contains("keep its power"), "{printed}");
    robot.bitrate = 1_000_000;
    robot.bus.lock().inject(clock::monotonic(), &"can0 bitrate 1000000".parse().unwrap()).unwrap();
    let _printed = robot.guide(&[("to its mark", Act::Type("q"))]);
    assert!(robot.memory("hip").contains("int 0x18 10\n"), "{}", robot.memory("hip"));
}

#[test]
fn motor_with_other_constants_changes_file() {
    let robot = Robot::new("constants", 1_000_000, |motor| Simulated {
        has_power: motor.name == "hip",
        torque_constant: 0.2,
        gear_ratio: 36.0,
        ..motor
    });
    let script = [
        ("Which joint", Act::Type("hip")),
        ("36 in the motor", Act::Type("")),
        ("to its mark", Act::Type("q")),
    ];
    let _printed = robot.guide(&script);
    let text = robot.text();
    assert!(text.contains("torque-constant-nm-per-a = 0.2") && text.contains("gear-ratio = 36"), "{text}");
    let _printed = robot.guide(&[("to its mark", Act::Type("b")), ("36 in the motor", Act::Type("q"))]);
    assert!(!robot.text().contains("gear-ratio"), "{}", robot.text());
}

#[test]
fn hot_motor_is_not_set_up() {
    let robot = Robot::new_motors("hot");
    let script = [
        ("Give power to one motor", Act::Verb("wrist on".into())),
        ("Give power to one motor", Act::Verb("wrist temperature 90".into())),
        ("Which joint", Act::Type("wrist")),
        ("let it cool", Act::Type("clear")),
        ("`clear` is no answer here", Act::Verb("wrist temperature 30".into())),
        ("let it cool", Act::Type("")),
        ("write id", Act::Type("q")),
    ];
    let printed = robot.guide(&script);
    assert!(printed.contains("its temperature reads 8"), "{printed}");
}
