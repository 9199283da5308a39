//! Replacements on simulated buses.

use super::*;
use crate::target::arm_motor;
use motord_bus::VirtualClock;
use motord_protocol::commissioning::Link;
use motord_simulator::{BusSettings, MotorSettings as Simulated, SharedBus, SimulatedBus};
use std::fs;

const NAMES: [&str; 4] = ["hip", "thigh", "elbow", "wrist"];

/// A bus with the motors of hip and thigh (SteadyWin, native), elbow and wrist (Damiao). Its folder
/// is removed with it.
struct Robot {
    bus: SharedBus,
    clock: VirtualClock,
    folder: PathBuf,
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _removed = fs::remove_dir_all(&self.folder);
    }
}

impl Robot {
    /// The motors of the joints in `new` come from the factory; those in `off` have no power.
    fn new(test: &str, new: &[&str], off: &[&str]) -> Self {
        let motors = (1..).zip(NAMES).map(|(id, name)| Simulated {
            is_new: new.contains(&name),
            has_power: !off.contains(&name),
            ..arm_motor(name, id, id > 2)
        });
        let bus = SimulatedBus::new(BusSettings::default(), motors.collect(), 7);
        let folder = std::env::temp_dir().join(format!("motord-replace-{test}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let motor = |(id, name): (u8, &str)| {
            let (protocol, model) = if id > 2 { ("mit", "DM-J4310-2EC") } else { ("gim", "GIM8108-8") };
            format!(
                "[[motor]]\nname = '{name}'\nbus = 'arm'\nid = {id}\nprotocol = '{protocol}'\nmodel = '{model}'\n"
            )
        };
        let head = "[cycle]\nrate-hz = 100\n[[bus]]\nname = 'arm'\ntype = 'socketcan'\ninterface = 'can0'\n";
        let motors: String = (1..).zip(NAMES).map(motor).collect();
        fs::write(folder.join("robot.toml"), format!("{head}{motors}")).unwrap();
        Self { bus: SharedBus::new(bus), clock: VirtualClock::default(), folder }
    }

    fn line(&self) -> OpenLine {
        OpenLine::simulated(Link::can(self.bus.clone(), self.clock.clone()), Some(1_000_000))
    }

    fn replace(&self, joint: &str) -> Result<(), DirectFailure> {
        let config = self.folder.join("robot.toml");
        let settings = config::load(&config).unwrap().settings;
        let joint = settings.motors.iter().find(|motor| motor.name == joint).unwrap();
        let line = self.line();
        let replacement = Replacement { settings: &settings, joint, config: &config };
        replacement.fill(line, Confirm { yes: true }, &Interrupt::register())
    }

    fn memory(&self, joint: &str) -> String {
        self.bus.lock().motor(joint).unwrap().memory()
    }

    fn memories(&self) -> [String; 4] {
        NAMES.map(|name| self.memory(name))
    }

    /// Writes the lock file as `motorctl setup` does while the former motors answer.
    fn set_up(&self, joint: &str) {
        let config = self.folder.join("robot.toml");
        let settings = config::load(&config).unwrap().settings;
        let mut line = self.line();
        setup::record(&config, &settings, joint, &mut line).unwrap();
    }
}

#[test]
fn new_motor_gets_address_limits_and_zero() {
    let former = Robot::new("former", &[], &[]);
    former.set_up("thigh");
    let robot = Robot::new("native", &["thigh"], &["hip"]);
    let lock = Lock::path(&robot.folder.join("robot.toml"));
    let text = fs::read_to_string(Lock::path(&former.folder.join("robot.toml"))).unwrap();
    let changed = text.lines().map(|line| match line.split_once(" = ") {
        Some(("over-temperature", _)) => "over-temperature = 77.0",
        _ => line,
    });
    fs::write(lock, changed.collect::<Vec<_>>().join("\n")).unwrap();
    let others = [0, 2, 3].map(|index| robot.memories()[index].clone());
    robot.replace("thigh").unwrap();
    let line = robot.line();
    let mut session =
        Session { line, id: 2, host_id: FrameId::new(0x102), protocol: Protocol::Gim, settings: None };
    let read = |session: &mut Session, name| {
        session.gim().configuration(ConfigurationItem::by_name(name).unwrap().key()).unwrap().as_f64()
    };
    assert_eq!(read(&mut session, "over-temperature"), 77.0);
    assert!(zero::off_by(zero::position(&mut session).unwrap(), 0.0) <= zero::TOLERANCE);
    assert_eq!([0, 2, 3].map(|index| robot.memories()[index].clone()), others);
}

#[test]
fn new_damiao_gets_both_ids() {
    let robot = Robot::new("damiao", &["wrist"], &["hip"]);
    robot.replace("wrist").unwrap();
    assert!(
        matches!(robot.replace("wrist"), Err(DirectFailure::NotReplaced(why)) if why.contains("answers"))
    );
}

#[test]
fn interrupted_replacement_can_be_repeated() {
    let robot = Robot::new("repeated", &[], &[]);
    let config = robot.folder.join("robot.toml");
    let text = fs::read_to_string(&config).unwrap();
    let (head, thigh) = text.split_at(text.find("'thigh'").unwrap());
    fs::write(&config, format!("{head}{}", thigh.replacen("'gim'", "'mit'", 1))).unwrap();
    robot.replace("thigh").unwrap();
    assert!(
        matches!(robot.replace("thigh"), Err(DirectFailure::NotReplaced(why)) if why.contains("answers"))
    );
}

#[test]
fn unclear_bus_is_refused_without_a_write() {
    type Case = (&'static str, &'static [&'static str], &'static [&'static str], &'static str, &'static str);
    let table: [Case; 6] = [
        ("two-new", &["thigh", "wrist"], &["hip"], "thigh", "several motors answer as id 1"),
        ("same-id", &["thigh"], &[], "thigh", "several motors answer as id 1"),
        ("none-new", &[], &["thigh"], "thigh", "no new motor answers"),
        ("none-missing", &[], &[], "thigh", "the motor of thigh answers"),
        ("two-missing", &[], &["thigh", "wrist"], "thigh", "no motor answers for: wrist"),
        ("other-vendor", &["hip"], &["elbow"], "elbow", "has the model DM-J4310-2EC"),
    ];
    for (test, new, off, joint, reason) in table {
        let robot = Robot::new(test, new, off);
        let before = robot.memories();
        let failure = robot.replace(joint).unwrap_err().to_string();
        assert!(failure.contains(reason), "{test}: {failure}");
        assert_eq!(robot.memories(), before, "{test}");
    }
}
