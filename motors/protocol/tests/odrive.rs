//! Compares ODrive's CANSimple with frames computed by hand from its sources.

mod nodes;

#[cfg(feature = "drive")]
use motord_bus::{Frame, FrameId};
use motord_protocol::Faults;
use motord_protocol::cansimple::Id;
#[cfg(feature = "drive")]
use motord_protocol::odrive::FAMILY;
use motord_protocol::odrive::{AxisState, Command, ControlMode, Heartbeat, Reply, faults};
use nodes::Row;
use std::f32::consts::TAU;

const NODE: u8 = 5;
const RATIO: f32 = 8.0;

fn rows(direction: &str) -> Vec<Row> {
    nodes::rows(include_str!("odrive.csv"), direction, 20)
}

fn command(row: &Row) -> Command {
    let value = row.values.first().copied().unwrap_or(f32::NAN);
    let turns = value * RATIO / TAU;
    match row.kind.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["idle"] => Command::SetState(AxisState::Idle),
        ["closed-loop"] => Command::SetState(AxisState::ClosedLoop),
        ["mode", "torque"] => Command::SetMode(ControlMode::Torque),
        ["mode", "velocity"] => Command::SetMode(ControlMode::Velocity),
        ["mode", "position"] => Command::SetMode(ControlMode::Position),
        ["torque"] => Command::Torque(value / RATIO),
        ["velocity"] => Command::Velocity(turns),
        ["position"] => Command::Position(turns),
        ["clear"] => Command::ClearErrors,
        ["zero"] => Command::SetZero,
        _ => panic!("{}", row.line),
    }
}

#[test]
fn commands_are_those_of_the_sources() {
    for row in rows("to-motor") {
        let command = command(&row);
        let (id, payload) = command.encode(NODE);
        assert_eq!((id, &payload[..command.length()]), (row.id, &row.payload[..]), "{}", row.line);
    }
}

/// Of a heartbeat; the value of a row is the lowest bit without a name.
fn named(row: &Row) -> Faults {
    nodes::faults(&row.kind[2..], row.values.first().map_or(0, |bit| *bit as u8))
}

fn check_heartbeat(row: &Row, heartbeat: Heartbeat) {
    let state = row.kind[1].as_str();
    let is = (heartbeat.state.is_running(), heartbeat.state.is_idle());
    assert_eq!(is, (state == "running", state == "idle"), "{}", row.line);
    assert_eq!(faults(heartbeat.errors), named(row), "{}", row.line);
}

#[test]
fn reports_are_read_as_in_the_sources() {
    for row in rows("to-host") {
        let reply = Reply::decode(row.id, &row.payload);
        match (row.kind[0].as_str(), reply) {
            ("heartbeat", Some(Reply::Heartbeat(heartbeat))) => check_heartbeat(&row, heartbeat),
            ("estimates", Some(Reply::Estimates(estimates))) => {
                row.check(&estimates.at_output(RATIO), &row.values);
            }
            ("torques", Some(Reply::Torque(torque))) => {
                row.check(&[torque * RATIO], &row.values[1..]);
            }
            ("supply", Some(Reply::Bus { volts, amperes })) => {
                row.check(&[volts, amperes], &row.values);
            }
            ("temperatures", Some(Reply::Temperature(celsius))) => {
                row.check(&[celsius], &row.values[1..]);
            }
            // A heartbeat has the active errors too.
            ("errors", None) => {}
            (_, reply) => panic!("{reply:?}: {}", row.line),
        }
    }
}

#[cfg(feature = "drive")]
#[test]
fn only_heartbeat_of_idle_axis_confirms_stop() {
    let confirms = FAMILY.confirms_stop.unwrap();
    for row in rows("to-host") {
        let frame = Frame::new(FrameId::new(row.id.raw()).unwrap(), &row.payload).unwrap();
        let is_idle = row.kind.starts_with(&["heartbeat".into(), "idle".into()]);
        assert_eq!(confirms(&frame), is_idle, "{}", row.line);
    }
}

/// A foreign master is found by its ids, and no id of a report is among them.
#[cfg(feature = "drive")]
#[test]
fn ids_of_commands_and_reports_are_separate() {
    let addresses = (FAMILY.addresses)(NODE, FrameId::new(0x0A9).unwrap());
    for row in rows("to-motor") {
        let id = FrameId::new(row.id.raw()).unwrap();
        assert!(addresses.commands.matches(id) && !addresses.replies.matches(id), "{}", row.line);
    }
    for row in rows("to-host") {
        let id = FrameId::new(row.id.raw()).unwrap();
        assert!(addresses.replies.matches(id) && !addresses.commands.matches(id), "{}", row.line);
    }
}

#[test]
fn drive_that_boots_has_no_fault() {
    assert_eq!(faults(1), Faults::NONE);
}

#[test]
fn number_that_is_not_finite_is_no_report() {
    for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for (command, at) in [(0x09, 0), (0x09, 4), (0x17, 0), (0x1C, 4)] {
            let mut payload = [0; 8];
            payload[at..at + 4].copy_from_slice(&wrong.to_le_bytes());
            assert_eq!(Reply::decode(Id { node: NODE, command }, &payload), None, "{command:#X}");
        }
    }
}
