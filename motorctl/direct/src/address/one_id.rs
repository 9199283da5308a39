//! Motors whose address is one id: with a CANSimple driver, with RobStride's private protocol, and of
//! MyActuator.

use crate::failure::DirectFailure;
use crate::output::{Confirm, print_line};
use crate::target::{Protocol, Session};
use motord_protocol::cansimple::NODE_MAX;
use motord_protocol::commissioning::{Axis, Error, Question, identify_by, is_taken};
use motord_protocol::myactuator::MOTORS_MAX;
use motord_protocol::robstride::{ID_MAX, parameter};
use motord_terminal::json;
use serde::Serialize;
use std::io;

/// The wanted changes of an address.
pub(super) struct Wanted {
    pub(super) id: Option<u8>,
    pub(super) protocol: Option<Protocol>,
    /// The command line names a host id or a bit rate.
    pub(super) has_others: bool,
}

/// An address, as `motorctl id` shows it.
#[derive(Serialize)]
pub(super) struct Address {
    pub(super) id: i32,
    pub(super) host_id: Option<i32>,
    pub(super) can_protocol: &'static str,
    pub(super) can_baud_rate: Option<i32>,
}

impl Address {
    pub(super) fn show(&self, as_json: bool, text: &str) -> Result<(), DirectFailure> {
        if as_json {
            return Ok(json::write_line(&mut io::stdout().lock(), self)?);
        }
        print_line(text)
    }
}

/// The host id of a motor, and the text behind its name.
type Reported = (Option<i32>, String);

/// The address of the motors of a family.
pub(super) struct OneId {
    /// The motors, with their article.
    motors: &'static str,
    /// The name of the id.
    item: &'static str,
    largest: u8,
    /// Why no other part of an address is set.
    no_others: &'static str,
    /// Why no other protocol is set.
    no_protocol: fn(Protocol) -> String,
    /// Reads what the motor reports.
    read: fn(&mut Session) -> Result<Reported, DirectFailure>,
    /// Returns the end of the sentence that asks for consent to a new id.
    effect: fn(u8) -> String,
    /// Gives the motor another id, if it is free. The session keeps the former one.
    pub(super) change: fn(&mut Session, u8) -> Result<(), DirectFailure>,
}

/// A CANSimple driver.
pub(super) const NODE: OneId = OneId {
    motors: "a CANSimple driver",
    item: "node id",
    largest: NODE_MAX,
    no_others: "motorctl sets only the node id of a CANSimple driver: it has no host id, and its bit rate (500 kbit/s from the \
                factory) is set with the vendor's tool",
    no_protocol: |_| "a CANSimple driver speaks no other protocol that motord supports".to_owned(),
    read: |session| {
        session.axis().estimates()?;
        let node = session.id;
        let ids = node_ids(node);
        Ok((None, format!("node id {node}, {} over CAN, ids {ids}", Protocol::CanSimple.name())))
    },
    effect: |node| {
        format!(
            ". The motor then uses the ids {}. Connect it alone: every driver with this node id would change, and another \
             motor with one of these ids would read its frames as commands.",
            node_ids(node)
        )
    },
    change: |session, node| {
        // Sends nothing: another motor may have an id of that node.
        if Axis::new(&mut session.line.link, node).heartbeat()?.is_some() {
            return Err(Error::Taken { id: session.id, taken: node }.into());
        }
        let mut motor = session.axis();
        motor.stop()?;
        Ok(motor.set_node(node)?)
    },
};

fn node_ids(node: u8) -> String {
    let first = u16::from(node) << 5;
    format!("{first:#05X} to {:#05X}", first | 0x1F)
}

/// A motor in RobStride's private protocol.
pub(super) const PRIVATE: OneId = OneId {
    motors: "a RobStride motor",
    item: "id",
    largest: ID_MAX,
    no_others: "motorctl sets only the id of a motor in RobStride's private protocol: set its host id and its bit rate with the \
                vendor's tool",
    no_protocol: |to| format!("use `motorctl protocol {}`", to.name()),
    // No parameter of the protocol has the bit rate.
    read: |session| {
        let host_id = session.private().read(parameter::HOST)?.map(|[host, ..]| host);
        let host = host_id.map_or_else(|| "not reported".to_owned(), |host| format!("{host:#04X}"));
        let text = format!("id {}, host id {host}, {} over CAN", session.id, Protocol::RobStride.name());
        Ok((host_id.map(i32::from), text))
    },
    effect: |_| ". Connect it alone: every motor with this id would change.".to_owned(),
    change: |session, id| {
        if is_taken(&mut session.line.link, id)? {
            return Err(Error::Taken { id: session.id, taken: id }.into());
        }
        let mut motor = session.private();
        motor.stop()?;
        Ok(motor.set_id(id)?)
    },
};

/// A MyActuator motor.
pub(super) const RMD: OneId = OneId {
    motors: "a MyActuator motor",
    item: "id",
    largest: MOTORS_MAX,
    no_others: "motorctl sets only the id of a MyActuator motor: it has no host id, and its bit rate is set with the vendor's tool",
    no_protocol: |_| "a MyActuator motor speaks no other protocol".to_owned(),
    read: |session| {
        session.rmd().status()?;
        let (id, protocol) = (session.id, Protocol::MyActuator.name());
        let [command, control, answer, state] = [0x140, 0x400, 0x240, 0x500].map(|base| base + u16::from(id));
        let ids = format!("ids {command:#05X} and {control:#05X}, answers {answer:#05X} and {state:#05X}");
        Ok((None, format!("id {id}, {protocol} over CAN, {ids}")))
    },
    effect: |_| ", and restarts it. Connect it alone: every motor with this id would change.".to_owned(),
    change: |session, id| {
        if identify_by(&mut session.line.link, id, Question::MotorStatus)?.is_some() {
            return Err(Error::Taken { id: session.id, taken: id }.into());
        }
        let mut motor = session.rmd();
        motor.stop()?;
        Ok(motor.set_id(id)?)
    },
};

impl OneId {
    /// `motorctl id`.
    pub(super) fn run(
        &self,
        session: &mut Session,
        wanted: &Wanted,
        confirm: Confirm,
        as_json: bool,
    ) -> Result<(), DirectFailure> {
        match *wanted {
            Wanted { has_others: true, .. } => Err(session.unfit(self.no_others)),
            Wanted { protocol: Some(to), .. } => Err(session.unfit(&(self.no_protocol)(to))),
            Wanted { id: Some(id), .. } => self.set_id(session, id, confirm),
            Wanted { id: None, .. } => self.show(session, as_json),
        }
    }

    fn show(&self, session: &mut Session, as_json: bool) -> Result<(), DirectFailure> {
        let (host_id, text) = (self.read)(session)?;
        let can_protocol = session.protocol.name();
        Address { id: session.id.into(), host_id, can_protocol, can_baud_rate: None }
            .show(as_json, &format!("{}: {text}", session.name()))
    }

    /// Gives the motor another id after consent.
    fn set_id(&self, session: &mut Session, id: u8, confirm: Confirm) -> Result<(), DirectFailure> {
        let Self { motors, item, largest, .. } = *self;
        if !(1..=largest).contains(&id) {
            return Err(DirectFailure::Usage(format!("the {item} of {motors} is 1 to {largest}")));
        }
        let (name, old) = (session.name(), session.id);
        if id == old {
            return print_line(&format!("{name}: nothing differs"));
        }
        let effect = (self.effect)(id);
        confirm.ask(&format!("This permanently changes the {item} of {name} from {old} to {id}{effect}"))?;
        (self.change)(session, id)?;
        print_line(&format!("{name}: {item} was {old}, confirmed as {id}"))
    }
}

/// Follows a change of the protocol.
const POWER: &str = "changed; power it off and on: it speaks its former protocol until then";

/// `motorctl protocol mit`.
pub(super) fn change_to_mit(session: &mut Session, confirm: Confirm) -> Result<(), DirectFailure> {
    let name = session.name();
    confirm.ask(&format!(
        "This permanently changes {name} to MIT. Connect it alone: every motor with this id would change."
    ))?;
    let mut motor = session.private();
    motor.stop()?;
    motor.change_to_mit()?;
    print_line(&format!("{name}: {POWER}"))
}

/// `motorctl protocol robstride`. Only for a motor that the configuration names as RobStride's:
/// another vendor's reads the request as a control frame.
pub(super) fn change_from_mit(session: &mut Session, confirm: Confirm) -> Result<(), DirectFailure> {
    let is_known = session.settings.as_ref().is_some_and(|motor| motor.profile.name == "robstride");
    if !is_known {
        let reason = "a motor in MIT mode does not report its vendor, and another vendor's reads the request as a control frame: use \
             --config and --joint, with a RobStride model";
        return Err(session.unfit(reason));
    }
    let name = session.name();
    confirm.ask(&format!(
        "This permanently changes {name} to RobStride's private protocol. Make sure that it is a RobStride motor, and connect it alone."
    ))?;
    let mut motor = session.mit();
    motor.stop()?;
    motor.change_to_private()?;
    print_line(&format!("{name}: {POWER}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_protocol::commissioning::{identify, identify_node};
    use motord_simulator::{Dialect, MotorSettings};

    /// The motor with id 1; another one on its bus has id 5.
    fn session(protocol: Protocol) -> Session {
        let motor = |name: &str, id| {
            let motor = MotorSettings { name: name.into(), id, ..MotorSettings::default() };
            match protocol {
                Protocol::CanSimple => MotorSettings { dialect: Dialect::CanSimple, ..motor },
                _ => {
                    let (vendor, dialect, host_id) = ("robstride", Dialect::RobStride, 0xFD);
                    MotorSettings { vendor, dialect, host_id, ..motor }
                }
            }
        };
        Session::simulated(vec![motor("knee", 1), motor("hip", 5)], 1, protocol)
    }

    const YES: Confirm = Confirm { yes: true };

    #[test]
    fn new_id_must_be_free_and_in_range() {
        for (protocol, family) in [(Protocol::CanSimple, &NODE), (Protocol::RobStride, &PRIVATE)] {
            let mut session = session(protocol);
            let taken = family.set_id(&mut session, 5, YES);
            assert!(matches!(taken, Err(DirectFailure::Motor(Error::Taken { taken: 5, .. }))), "{taken:?}");
            let beyond = family.set_id(&mut session, family.largest + 1, YES);
            assert!(matches!(beyond, Err(DirectFailure::Usage(_))), "{beyond:?}");
            family.set_id(&mut session, 3, YES).unwrap();
            let at = |session: &mut Session, id| match protocol {
                Protocol::CanSimple => identify_node(&mut session.line.link, id).unwrap().is_some(),
                _ => identify(&mut session.line.link, id).unwrap().is_some(),
            };
            assert!(at(&mut session, 3) && !at(&mut session, 1));
        }
    }

    /// Another vendor's motor reads the request as a control frame of full stiffness.
    #[test]
    fn unknown_mit_motor_is_not_changed() {
        let mut session = Session { protocol: Protocol::Mit, ..session(Protocol::RobStride) };
        assert!(matches!(change_from_mit(&mut session, YES), Err(DirectFailure::Unfit { .. })));
    }
}
