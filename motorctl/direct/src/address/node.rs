//! The address of a motor with a CANSimple driver.

use super::values::{Address, IdChange, Wanted};
use crate::confirm::Confirm;
use crate::failure::DirectFailure;
use crate::target::{Protocol, Session};
use motord_protocol::cansimple::NODE_MAX;
use motord_protocol::commissioning::{Axis, Error};

/// `motorctl id`.
pub(super) fn run(
    session: &mut Session,
    wanted: &Wanted,
    confirm: Confirm,
    as_json: bool,
) -> Result<(), DirectFailure> {
    if wanted.has_others {
        let reason = "motorctl sets only the node id of a CANSimple driver: it has no host id, and its bit rate (500 kbit/s from the \
             factory) is set with the vendor's tool";
        return Err(session.unfit(reason));
    }
    if wanted.protocol.is_some() {
        return Err(session.unfit("a CANSimple driver speaks no other protocol that motord supports"));
    }
    match wanted.id {
        Some(id) => set_node(session, id, confirm),
        None => show(session, as_json),
    }
}

fn show(session: &mut Session, as_json: bool) -> Result<(), DirectFailure> {
    session.axis().estimates()?;
    let (node, can_protocol) = (session.id, Protocol::CanSimple.name());
    let first = u16::from(node) << 5;
    let ids = format!("ids {first:#05X} to {:#05X}", first | 0x1F);
    Address { id: node.into(), host_id: None, can_protocol, can_baud_rate: None }
        .show(as_json, &format!("{}: node id {node}, {can_protocol} over CAN, {ids}", session.name()))
}

fn set_node(session: &mut Session, node: u8, confirm: Confirm) -> Result<(), DirectFailure> {
    let first = u16::from(node) << 5;
    let effect = format!(
        ". The motor then uses the ids {first:#05X} to {:#05X}. Connect it alone: every driver with this node id would change, and another \
         motor with one of these ids would read its frames as commands.",
        first | 0x1F
    );
    IdChange { motors: "a CANSimple driver", item: "node id", largest: NODE_MAX, effect, change: change_id }
        .run(session, node, confirm)
}

/// Gives the driver another node id, if it is free.
pub(super) fn change_id(session: &mut Session, node: u8) -> Result<(), DirectFailure> {
    // Sends nothing: another motor may have an id of that node.
    if Axis::new(&mut session.line.link, node).heartbeat()?.is_some() {
        return Err(Error::Taken { id: session.id, taken: node }.into());
    }
    let mut motor = session.axis();
    motor.stop()?;
    Ok(motor.set_node(node)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_protocol::commissioning::identify_node;
    use motord_simulator::{Dialect, MotorSettings};

    fn session(id: u8) -> Session {
        let motor = |name: &str, id| MotorSettings {
            name: name.into(),
            id,
            dialect: Dialect::CanSimple,
            ..MotorSettings::default()
        };
        let motors = vec![motor("knee", 1), motor("hip", 5)];
        Session::simulated(motors, id, Protocol::CanSimple)
    }

    const YES: Confirm = Confirm { yes: true };

    #[test]
    fn new_node_must_be_free_and_in_range() {
        let mut session = session(1);
        let taken = set_node(&mut session, 5, YES);
        assert!(matches!(taken, Err(DirectFailure::Motor(Error::Taken { taken: 5, .. }))), "{taken:?}");
        assert!(matches!(set_node(&mut session, 64, YES), Err(DirectFailure::Usage(_))));
        set_node(&mut session, 3, YES).unwrap();
        assert!(identify_node(&mut session.line.link, 3).unwrap().is_some());
        assert!(identify_node(&mut session.line.link, 1).unwrap().is_none());
    }
}
