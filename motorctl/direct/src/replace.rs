//! `motorctl replace`: gives a new motor the place of one that is missing.
//!
//! ```text
//!  one joint is missing, one new motor answers ▶ consent ▶ items ▶ timeout ▶ zero ▶ address ▶ protocol ▶ lock file
//! ```
//!
//! A motor that was given the address, but not yet the protocol, counts as missing: the command can
//! be repeated after any interruption. Items are those of native motors, the timeout that of RobStride's.

mod candidate;

use crate::failure::DirectFailure;
use crate::file::{self, FACTORY_ID};
use crate::find::frame_id;
use crate::memory::text;
use crate::motor::{self, Health};
use crate::output::{Confirm, print_line};
use crate::target::{DEFAULT_CONFIG, OpenLine, Protocol, Session};
use crate::{setup, zero};
use motord_bus::FrameId;
use motord_configuration as config;
use motord_configuration::lock::Lock;
use motord_protocol::commissioning::{Axis, Change, Found, Scan, Wire, changes, scan};
use motord_protocol::gim::ConfigurationItem;
use motord_settings::settings::{MotorSettings, Settings};
use motord_terminal::Interrupt;
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

/// Values that a new motor stores beside its address and its zero.
struct Stored {
    /// Items of a native motor.
    items: Vec<Change>,
    /// The timeout of a RobStride motor that has none.
    timeout: bool,
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
        self.check_factory_ids().map_err(DirectFailure::NotReplaced)?;
        self.check_nodes(&mut line)?;
        let report = scan(&mut line.link, &Scan::default(), &mut |_| !interrupt.is_raised())?;
        let found = self.new_motor(&report).map_err(DirectFailure::NotReplaced)?;
        let vendor = motor::vendor(&mut line.link, &found)?;
        let mut session = self.session(line, &found);
        if let Some(reason) = motor::mismatch(vendor, found.family, self.joint) {
            return Err(session.unfit(&reason));
        }
        motor::must_be_alone(&mut session)?;
        let health = Health::read(&mut session)?;
        if let Some(problem) = health.problem() {
            return Err(session.unfit(&problem));
        }
        let stored = self.stored(&mut session)?;
        self.check_address(&session)?;
        confirm.ask(&self.describe(&session, &health, &stored))?;
        self.write(&mut session, &stored)
    }

    /// Refuses two drivers with the node id of new ones. They destroy each other's frames, and leave no time for a
    /// scan.
    fn check_nodes(&self, line: &mut OpenLine) -> Result<(), DirectFailure> {
        let is_node = self.joint.protocol.name() == Protocol::CanSimple.name();
        if !is_node || Axis::new(&mut line.link, FACTORY_ID).is_alone()? {
            return Ok(());
        }
        Err(DirectFailure::NotReplaced(format!(
            "{}: several motors answer as node {FACTORY_ID}: take the power from all but one",
            line.name
        )))
    }

    /// Returns the values to store beside address and zero.
    fn stored(&self, session: &mut Session) -> Result<Stored, DirectFailure> {
        let is_private = session.protocol == Protocol::RobStride;
        let id = session.id;
        let timeout = is_private && setup::lacks_timeout(&mut session.line, id)?;
        let items = if session.protocol.has_one_id() { Vec::new() } else { self.items(session)? };
        Ok(Stored { items, timeout })
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
        let host = session.host_id.filter(|host| *host != self.joint.host_id);
        if let (Protocol::RobStride, Some(host)) = (session.protocol, host) {
            let reason = format!(
                "it stores the host id {}, and {} has {} in the configuration: write its host id with the vendor's tool, or `host-id` for all \
                 motors of the bus",
                frame_id(host),
                self.joint.name,
                frame_id(self.joint.host_id)
            );
            return Err(session.unfit(&reason));
        }
        let has_command = session.protocol != Protocol::Mit || self.joint.profile.has_registers;
        if has_command || self.has_address(session) {
            return Ok(());
        }
        let reason = format!(
            "its id cannot be changed over CAN in MIT mode: give it id {} and host id {} with the vendor's tool, then run `motorctl \
             zero` and `motorctl setup`",
            self.joint.id,
            frame_id(self.joint.host_id)
        );
        Err(session.unfit(&reason))
    }

    fn has_address(&self, session: &Session) -> bool {
        let has_host_id = session.protocol.has_one_id()
            || session.host_id.is_none()
            || session.host_id == Some(self.joint.host_id);
        session.id == self.joint.id && has_host_id
    }

    /// Returns whether the motor is to be changed from native mode to MIT.
    fn needs_mit(&self, session: &Session) -> bool {
        let is_native = session.protocol == Protocol::Gim && session.line.link.wire() == Wire::Can;
        is_native && self.joint.protocol.name() != Protocol::Gim.name()
    }

    /// Describes everything that is written, and the facts that cannot be compared.
    fn describe(&self, session: &Session, health: &Health, stored: &Stored) -> String {
        let MotorSettings { name, id, host_id, model, transmission, .. } = self.joint;
        let address = |id: u8, comma: &str, host: Option<FrameId>| match session.protocol.has_one_id() {
            true => format!("id {id}"),
            false => format!("id {id}{comma} host id {}", host.map_or("-".to_owned(), frame_id)),
        };
        let mut lines = vec![format!(
            "{name}: the new motor on {} ({}) has {}. This permanently writes into it:\n  {}",
            session.line.name,
            health.describe(),
            address(session.id, " and", session.host_id),
            address(*id, ",", Some(*host_id)),
        )];
        lines.extend(stored.items.iter().map(|Change { item, from, to }| {
            format!("  {} {}{}, which is {} now", item.name, text(*to), unit(item), text(*from))
        }));
        if stored.timeout {
            lines.push(format!(
                "  a timeout of {} ms without a command (canTimeout), which is off now",
                setup::TIMEOUT_MS
            ));
        }
        let pose = transmission.position_to_joint(0.0);
        lines.push(format!(
            "  its zero: hold the joint in the pose of {pose:.2} rad. The zero of the former motor fits no other"
        ));
        if self.needs_mit(session) {
            lines.push("  the protocol MIT, which only its serial port can undo".to_owned());
        }
        if session.protocol.has_one_id() {
            lines.push(format!(
                "cannot be read: its model, bit rate and limits. Compare its label with {model}"
            ));
        }
        lines.push("The former motor must not return to this bus with its id.".to_owned());
        lines.join("\n")
    }

    fn write(&self, session: &mut Session, stored: &Stored) -> Result<(), DirectFailure> {
        motor::must_be_alone(session)?;
        if session.protocol == Protocol::Gim {
            motor::write_items(session, &stored.items)?;
        }
        if stored.timeout {
            let id = session.id;
            setup::store_timeout(&mut session.line, id)?;
        }
        zero::set(session, 0.0)?;
        if !self.has_address(session) {
            motor::set_address(session, self.joint.id, self.joint.host_id)?;
        }
        if self.needs_mit(session) {
            motor::set_mit(session)?;
        }
        zero::note(session.protocol).map_or(Ok(()), print_line)?;
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
mod families;
#[cfg(test)]
mod tests;
