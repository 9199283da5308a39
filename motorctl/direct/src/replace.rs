//! `motorctl replace`: gives a new motor the place of one that is missing.
//!
//! ```text
//!  one joint is missing, one new motor answers ▶ consent ▶ items ▶ zero ▶ address ▶ protocol ▶ lock file
//! ```
//!
//! A motor that was given the address, but not yet the protocol, counts as missing: the command can
//! be repeated after any interruption.

use crate::confirm::Confirm;
use crate::failure::DirectFailure;
use crate::file::{self, FACTORY_ID};
use crate::memory::text;
use crate::motor::{self, Health};
use crate::output::print_line;
use crate::setup;
use crate::target::{DEFAULT_CONFIG, OpenLine, Protocol, Session};
use crate::zero;
use motord_bus::FrameId;
use motord_configuration as config;
use motord_configuration::lock::Lock;
use motord_protocol::commissioning::{Change, Family, Found, Report, Scan, Wire, changes, scan};
use motord_protocol::gim::ConfigurationItem;
use motord_settings::settings::{MotorSettings, Settings};
use motord_terminal::Interrupt;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Items of a native motor that a person may have changed, and that fit any motor of its model.
const RESTORED: [&str; 10] = [
    "rated-current",
    "max-speed",
    "over-voltage",
    "under-voltage",
    "over-temperature",
    "speed-kp",
    "speed-ki",
    "position-kp",
    "position-ki",
    "position-kd",
];

/// The options of `motorctl replace`.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The joint whose motor is missing.
    #[arg(value_name = "JOINT")]
    joint: String,
    /// The configuration. Its lock file, if there is one, has the stored items of the former motor.
    #[arg(long, value_name = "FILE", default_value = DEFAULT_CONFIG)]
    config: PathBuf,
    #[command(flatten)]
    confirm: Confirm,
}

/// `motorctl replace`.
pub(crate) fn run(arguments: &Arguments) -> Result<(), DirectFailure> {
    let Arguments { joint, config, confirm } = arguments;
    let settings = config::load(config)?.settings;
    let chosen = setup::chosen(&settings, std::slice::from_ref(joint))?;
    let [joint] = *chosen else { return Ok(()) };
    let simulated =
        || DirectFailure::Usage(format!("{} is simulated inside the daemon, without a bus", joint.name));
    let line = setup::open(&settings, joint.bus, &[joint])?.ok_or_else(simulated)?;
    let replacement = Replacement { settings: &settings, joint, config };
    replacement.fill(line, *confirm, &Interrupt::register())
}

/// A joint without a motor, and its configuration.
struct Replacement<'p> {
    settings: &'p Settings,
    joint: &'p MotorSettings,
    config: &'p Path,
}

impl Replacement<'_> {
    /// Finds the new motor, and makes it that of the joint after consent.
    fn fill(&self, mut line: OpenLine, confirm: Confirm, interrupt: &Interrupt) -> Result<(), DirectFailure> {
        let report = scan(&mut line.link, &Scan::default(), &mut |_| !interrupt.is_raised())?;
        let found = self.new_motor(&report).map_err(DirectFailure::NotReplaced)?;
        let vendor = motor::vendor(&mut line.link, &found)?;
        let mut session = self.session(line, &found);
        if let Some(reason) = motor::mismatch(vendor, found.family, self.joint) {
            return Err(session.unfit(&reason));
        }
        let health = Health::read(&mut session)?;
        if let Some(problem) = health.problem() {
            return Err(session.unfit(&problem));
        }
        let items = self.items(&mut session)?;
        self.check_address(&session)?;
        confirm.ask(&self.describe(&session, &health, &items))?;
        self.write(&mut session, &items)
    }

    /// Returns the only motor that no joint has, if that of the joint is the only missing one.
    ///
    /// # Errors
    ///
    /// The bus is unclear: the text names what to do first.
    fn new_motor(&self, report: &Report) -> Result<Found, String> {
        let name = &self.joint.name;
        let bus = self.settings.buses[self.joint.bus].device();
        let doubled = report.found.windows(2).find(|pair| pair[0].id == pair[1].id).map(|pair| pair[0].id);
        if let Some(id) = report.collisions.first().copied().or(doubled) {
            return Err(format!(
                "{bus}: several motors answer as id {id}: take the power from all but one. A new motor has the id {FACTORY_ID}: the joint \
                 with this id must have no power while another one is replaced"
            ));
        }
        let neighbours = || self.settings.motors.iter().filter(|motor| motor.bus == self.joint.bus);
        let owner = |found: &Found| neighbours().find(|motor| self.is_motor_of(motor, found));
        let has_motor =
            |motor: &MotorSettings| report.found.iter().any(|found| self.is_motor_of(motor, found));
        if has_motor(self.joint) {
            return Err(format!(
                "{bus}: the motor of {name} answers: take its power, and give it to the new one"
            ));
        }
        let others =
            neighbours().filter(|motor| motor.name != *name && motor.id != FACTORY_ID && !has_motor(motor));
        let others: Vec<_> = others.map(|motor| motor.name.as_str()).collect();
        if !others.is_empty() {
            let others = others.join(", ");
            return Err(format!(
                "{bus}: beside {name} no motor answers for: {others}. Give them power, so that the new motor takes no wrong place"
            ));
        }
        let new: Vec<_> = report.found.iter().filter(|found| owner(found).is_none()).collect();
        match *new {
            [found] if [FACTORY_ID, self.joint.id].contains(&found.id) => Ok(*found),
            [found] => Err(format!(
                "{bus}: the motor with id {} is not new, and no joint has this id: give it the id {FACTORY_ID} first, alone on the cable",
                found.id
            )),
            [] => Err(format!(
                "{bus}: no new motor answers: check its power and wires. It may have another bit rate, or another protocol than its model"
            )),
            _ => {
                let ids = new.iter().map(|found| found.id.to_string()).collect::<Vec<_>>().join(", ");
                Err(format!(
                    "{bus}: several motors answer that no joint has, with the ids {ids}: take the power from all but one"
                ))
            }
        }
    }

    /// Returns whether an answer is that of the motor of `joint`. The motor of the replaced joint counts only
    /// in the protocol of the configuration.
    fn is_motor_of(&self, joint: &MotorSettings, found: &Found) -> bool {
        let is_native = found.family == Family::Native;
        let is_complete =
            joint.name != self.joint.name || is_native == (joint.protocol.name() == Protocol::Gim.name());
        let has_host_id = found.host_id.is_none() || found.host_id == Some(joint.host_id);
        found.id == joint.id && has_host_id && is_complete
    }

    /// Returns a session with the new motor, which has the settings of the joint except its address.
    fn session(&self, line: OpenLine, found: &Found) -> Session {
        let host_id = found.host_id.unwrap_or(self.joint.host_id);
        let settings = MotorSettings { id: found.id, host_id, ..self.joint.clone() };
        Session { settings: Some(settings), ..Session::with(line, found) }
    }

    /// Returns the items that the former motor had in the lock file, and this one has not. Refuses a
    /// motor with the constants of another model.
    fn items(&self, session: &mut Session) -> Result<Vec<Change>, DirectFailure> {
        if session.protocol == Protocol::Mit {
            session.read_ends()?;
            return Ok(Vec::new());
        }
        self.check_constants(session)?;
        let lock = Lock::load(self.config).map_err(|error| DirectFailure::Malformed {
            path: Lock::path(self.config),
            reason: error.to_string(),
        })?;
        let former = lock.as_ref().and_then(|lock| lock.motor(&self.joint.name));
        let Some(former) = former else { return Ok(Vec::new()) };
        let wanted: Vec<_> = RESTORED
            .iter()
            .filter_map(|name| {
                let item = ConfigurationItem::by_name(name)?;
                Some((item, setup::value_of(item, *former.values.get(*name)?)?))
            })
            .collect();
        Ok(changes(&file::present(session, &wanted)?, &wanted))
    }

    fn check_constants(&self, session: &mut Session) -> Result<(), DirectFailure> {
        let Some(constants) = self.joint.constants else { return Ok(()) };
        let wanted = [constants.torque_constant, constants.gear_ratio, constants.pole_pairs.into()];
        for (name, wanted) in ConfigurationItem::CONSTANTS.into_iter().zip(wanted) {
            let Some(item) = ConfigurationItem::by_name(name) else { continue };
            let stored = session.gim().configuration(item.key())?.as_f64();
            // A float of 32 bits, and a gear ratio that a motor stores as an integer.
            if (stored - wanted).abs() > 0.01 * wanted.abs() {
                let reason = format!(
                    "its {name} is {stored}, and that of {} in the configuration is {wanted}: it is another model. Every torque would be \
                     wrong by their ratio",
                    self.joint.name
                );
                return Err(session.unfit(&reason));
            }
        }
        Ok(())
    }

    fn check_address(&self, session: &Session) -> Result<(), DirectFailure> {
        let has_command = session.protocol == Protocol::Gim || self.joint.profile.has_registers;
        if has_command || self.has_address(session) {
            return Ok(());
        }
        let reason = format!(
            "its id cannot be changed over CAN in MIT mode: give it id {} and host id {:#05X} with the vendor's tool, then run `motorctl \
             zero` and `motorctl setup`",
            self.joint.id,
            self.joint.host_id.raw()
        );
        Err(session.unfit(&reason))
    }

    fn has_address(&self, session: &Session) -> bool {
        let has_host_id = session.host_id.is_none() || session.host_id == Some(self.joint.host_id);
        session.id == self.joint.id && has_host_id
    }

    /// Returns whether the motor is to be changed from native mode to MIT.
    fn needs_mit(&self, session: &Session) -> bool {
        let is_native = session.protocol == Protocol::Gim && session.line.link.wire() == Wire::Can;
        is_native && self.joint.protocol.name() != Protocol::Gim.name()
    }

    /// Describes everything that is written.
    fn describe(&self, session: &Session, health: &Health, items: &[Change]) -> String {
        let raw = |id: Option<FrameId>| id.map_or("-".to_owned(), |id| format!("{:#05X}", id.raw()));
        let MotorSettings { name, id, host_id, transmission, .. } = self.joint;
        let mut described = format!(
            "{name}: the new motor on {} ({}) has id {} and host id {}. This permanently writes into it:\n  id {id}, host id {}",
            session.line.name,
            health.describe(),
            session.id,
            raw(session.host_id),
            raw(Some(*host_id)),
        );
        for Change { item, from, to } in items {
            let _infallible = write!(
                described,
                "\n  {} {}{}, which is {} now",
                item.name,
                text(*to),
                unit(item),
                text(*from)
            );
        }
        let pose = transmission.position_to_joint(0.0);
        let _infallible = write!(
            described,
            "\n  its zero: hold the joint in the pose of {pose:.2} rad. The zero of the former motor fits no other"
        );
        if self.needs_mit(session) {
            described += "\n  the protocol MIT, which only its serial port can undo";
        }
        described + "\nThe former motor must not return to this bus with its id."
    }

    fn write(&self, session: &mut Session, items: &[Change]) -> Result<(), DirectFailure> {
        motor::write_items(session, items)?;
        zero::set(session, 0.0)?;
        if !self.has_address(session) {
            motor::set_address(session, self.joint.id, self.joint.host_id)?;
        }
        if self.needs_mit(session) {
            motor::set_mit(session)?;
        }
        let name = &self.joint.name;
        let differences = setup::record(self.config, self.settings, name, &mut session.line)?;
        differences.iter().try_for_each(|difference| print_line(difference))?;
        let (id, config) = (self.joint.id, self.config.display());
        print_line(&format!(
            "{name}: its new motor answers as id {id}. Next, after its power was off once:\n  motorctl setup --config {config} --joint {name}"
        ))
    }
}

fn unit(item: &ConfigurationItem) -> String {
    if item.unit.is_empty() { String::new() } else { format!(" {}", item.unit) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::VirtualClock;
    use motord_protocol::commissioning::Link;
    use motord_simulator::{BusSettings, Dialect, MotorSettings as Simulated, SharedBus, SimulatedBus};
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
            let motors = (1..).zip(NAMES).map(|(id, name)| {
                let is_damiao = id > 2;
                Simulated {
                    name: name.into(),
                    id,
                    host_id: if is_damiao { 0x10 + id } else { 0x100 + id },
                    dialect: if is_damiao { Dialect::Mit } else { Dialect::Gim },
                    vendor: if is_damiao { "damiao" } else { "steadywin" },
                    ends: is_damiao.then_some([12.5, 30.0, 10.0]),
                    initial_position: 0.1 * f64::from(id),
                    is_new: new.contains(&name),
                    has_power: !off.contains(&name),
                    ..Simulated::default()
                }
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
            let head =
                "[cycle]\nrate-hz = 100\n[[bus]]\nname = 'arm'\ntype = 'socketcan'\ninterface = 'can0'\n";
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
        type Case =
            (&'static str, &'static [&'static str], &'static [&'static str], &'static str, &'static str);
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
}
