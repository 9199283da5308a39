//! The address of a MyActuator motor.

use super::values::{Address, IdChange, Wanted};
use crate::confirm::Confirm;
use crate::failure::DirectFailure;
use crate::target::{Protocol, Session};
use motord_protocol::commissioning::{Error, Question, identify_by};
use motord_protocol::myactuator::MOTORS_MAX;

/// `motorctl id`.
pub(super) fn run(
    session: &mut Session,
    wanted: &Wanted,
    confirm: Confirm,
    as_json: bool,
) -> Result<(), DirectFailure> {
    match *wanted {
        Wanted { has_others: true, .. } => Err(session.unfit(
            "motorctl sets only the id of a MyActuator motor: it has no host id, and its bit rate is set with the vendor's tool",
        )),
        Wanted { protocol: Some(_), .. } => Err(session.unfit("a MyActuator motor speaks no other protocol")),
        Wanted { id: Some(id), .. } => set_id(session, id, confirm),
        Wanted { id: None, .. } => show(session, as_json),
    }
}

fn show(session: &mut Session, as_json: bool) -> Result<(), DirectFailure> {
    session.rmd().status()?;
    let (id, protocol, name) = (session.id, Protocol::MyActuator.name(), session.name());
    let [command, control, answer, state] = [0x140, 0x400, 0x240, 0x500].map(|base| base + u16::from(id));
    let ids = format!("ids {command:#05X} and {control:#05X}, answers {answer:#05X} and {state:#05X}");
    Address { id: id.into(), host_id: None, can_protocol: protocol, can_baud_rate: None }
        .show(as_json, &format!("{name}: id {id}, {protocol} over CAN, {ids}"))
}

fn set_id(session: &mut Session, id: u8, confirm: Confirm) -> Result<(), DirectFailure> {
    let effect = ", and restarts it. Connect it alone: every motor with this id would change.".to_owned();
    IdChange { motors: "a MyActuator motor", item: "id", largest: MOTORS_MAX, effect, change: change_id }
        .run(session, id, confirm)
}

/// Gives the motor another id, if it is free.
pub(super) fn change_id(session: &mut Session, id: u8) -> Result<(), DirectFailure> {
    if identify_by(&mut session.line.link, id, Question::MotorStatus)?.is_some() {
        return Err(Error::Taken { id: session.id, taken: id }.into());
    }
    let mut motor = session.rmd();
    motor.stop()?;
    Ok(motor.set_id(id)?)
}
