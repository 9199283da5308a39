//! The address of a motor in RobStride's private protocol.

use super::values::{Address, IdChange, Wanted};
use crate::confirm::Confirm;
use crate::failure::DirectFailure;
use crate::output::print_line;
use crate::target::{Protocol, Session};
use motord_protocol::commissioning::{Error, is_taken};
use motord_protocol::robstride::{ID_MAX, parameter};

/// Follows a change of the protocol.
const POWER: &str = "changed; power it off and on: it speaks its former protocol until then";

/// `motorctl id`.
pub(super) fn run(
    session: &mut Session,
    wanted: &Wanted,
    confirm: Confirm,
    as_json: bool,
) -> Result<(), DirectFailure> {
    if wanted.has_others {
        let reason = "motorctl sets only the id of a motor in RobStride's private protocol: set its host id and its bit rate with the \
             vendor's tool";
        return Err(session.unfit(reason));
    }
    if let Some(to) = wanted.protocol {
        let reason = format!("use `motorctl protocol {}`", to.name());
        return Err(session.unfit(&reason));
    }
    match wanted.id {
        Some(id) => set_id(session, id, confirm),
        None => show(session, as_json),
    }
}

fn show(session: &mut Session, as_json: bool) -> Result<(), DirectFailure> {
    let host_id = session.private().read(parameter::HOST)?.map(|[host, ..]| host);
    let (id, can_protocol) = (session.id, Protocol::RobStride.name());
    let host = host_id.map_or_else(|| "not reported".to_owned(), |host| format!("{host:#04X}"));
    // No parameter of the protocol has the bit rate.
    Address { id: id.into(), host_id: host_id.map(i32::from), can_protocol, can_baud_rate: None }
        .show(as_json, &format!("{}: id {id}, host id {host}, {can_protocol} over CAN", session.name()))
}

fn set_id(session: &mut Session, id: u8, confirm: Confirm) -> Result<(), DirectFailure> {
    let effect = ". Connect it alone: every motor with this id would change.".to_owned();
    IdChange { motors: "a RobStride motor", item: "id", largest: ID_MAX, effect, change: change_id }
        .run(session, id, confirm)
}

/// Gives the motor another id, if it is free.
pub(super) fn change_id(session: &mut Session, id: u8) -> Result<(), DirectFailure> {
    if is_taken(&mut session.line.link, id)? {
        return Err(Error::Taken { id: session.id, taken: id }.into());
    }
    let mut motor = session.private();
    motor.stop()?;
    Ok(motor.set_id(id)?)
}

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
    use motord_protocol::commissioning::identify;
    use motord_simulator::{Dialect, MotorSettings};

    fn robstride(name: &str, id: u16) -> MotorSettings {
        let (vendor, dialect, host_id) = ("robstride", Dialect::RobStride, 0xFD);
        MotorSettings { name: name.into(), id, vendor, dialect, host_id, ..MotorSettings::default() }
    }

    fn session(id: u8) -> Session {
        let motors = vec![robstride("knee", 1), robstride("hip", 5)];
        Session::simulated(motors, id, Protocol::RobStride)
    }

    const YES: Confirm = Confirm { yes: true };

    #[test]
    fn new_id_must_be_free_and_in_range() {
        let mut session = session(1);
        assert!(matches!(
            set_id(&mut session, 5, YES),
            Err(DirectFailure::Motor(Error::Taken { taken: 5, .. }))
        ));
        assert!(matches!(set_id(&mut session, 128, YES), Err(DirectFailure::Usage(_))));
        set_id(&mut session, 3, YES).unwrap();
        assert!(identify(&mut session.line.link, 3).unwrap().is_some());
    }

    /// Another vendor's motor reads the request as a control frame of full stiffness.
    #[test]
    fn unknown_mit_motor_is_not_changed() {
        let mut session = Session { protocol: Protocol::Mit, ..session(1) };
        assert!(matches!(change_from_mit(&mut session, YES), Err(DirectFailure::Unfit { .. })));
    }
}
