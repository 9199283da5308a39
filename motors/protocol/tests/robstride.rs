//! Compares RobStride's private protocol with frames computed by hand from the vendor's manuals.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_protocol::robstride::{Command, ControlCodes, Feedback, Id, Mode, Reply, WideScales};
use motord_protocol::robstride::{HOST_ID, faults_of_report};
use motord_protocol::{Faults, Model};
use motord_shared::Fault;

const MOTOR: u8 = 5;

struct Row {
    kind: Vec<String>,
    scales: WideScales,
    id: Id,
    payload: [u8; 8],
    values: Vec<f32>,
    line: String,
}

fn rows(direction: &str) -> Vec<Row> {
    let lines = include_str!("robstride_private.csv").lines().skip(1);
    let rows = lines.map(|line| line.split(',').collect::<Vec<_>>()).filter(|row| row[0] == direction);
    let rows: Vec<Row> = rows.map(|row| self::row(&row)).collect();
    assert!(rows.len() > 15);
    rows
}

fn row(cells: &[&str]) -> Row {
    let [_, kind, model, id, payload, values, _] = cells.try_into().unwrap();
    Row {
        kind: kind.split(' ').map(str::to_owned).collect(),
        scales: WideScales::of(&Model::by_name(model).unwrap().scales().unwrap()),
        id: Id::of(u32::from_str_radix(id, 16).unwrap()),
        payload: u64::from_str_radix(payload, 16).unwrap().to_be_bytes(),
        values: values.split_whitespace().map(|value| value.parse().unwrap()).collect(),
        line: cells.join(","),
    }
}

fn number(digits: &str) -> u32 {
    u32::from_str_radix(digits, 16).unwrap()
}

fn faults(names: &[String]) -> Faults {
    let bit = |name: &String| {
        if name == "unrecognised" {
            return Faults::of_unknown_code(6);
        }
        Faults(Fault::ALL.iter().find(|fault| fault.name() == name).unwrap().bit())
    };
    names.iter().map(bit).fold(Faults::NONE, Faults::and)
}

fn command(row: &Row) -> Command {
    let argument = |index: usize| row.kind[index].as_str();
    match argument(0) {
        "device" => Command::GetDevice,
        "enable" => Command::Enable,
        "stop" => Command::Stop,
        "clear" => Command::ClearFault,
        "version" => Command::GetVersion,
        "zero" => Command::SetZero,
        "set-id" => Command::SetId(argument(1).parse().unwrap()),
        "read" => Command::Read(number(argument(1)) as u16),
        "write" => Command::Write(number(argument(1)) as u16, number(argument(2)).to_be_bytes()),
        "save" => Command::Save,
        "report" => Command::SetReport(argument(1) == "on"),
        "protocol" => Command::SetProtocol(argument(1).parse().unwrap()),
        "control" => {
            let values = row.values[..].try_into().unwrap();
            Command::Control(ControlCodes::nearest(values, &row.scales).unwrap())
        }
        other => panic!("{other}"),
    }
}

#[test]
fn commands_are_those_of_the_manuals() {
    for row in rows("to-motor") {
        assert_eq!(command(&row).encode(MOTOR, HOST_ID), (row.id, row.payload), "{}", row.line);
    }
}

fn check_state(row: &Row, feedback: Feedback) {
    let [position, velocity, torque] = feedback.scaled(&row.scales);
    for (decoded, expected) in [position, velocity, torque, feedback.celsius()].iter().zip(&row.values) {
        assert!((decoded - expected).abs() < 2e-6 * expected.abs().max(1.0), "{decoded}: {}", row.line);
    }
    let mode = match row.kind[1].as_str() {
        "run" => Mode::Run,
        "calibration" => Mode::Calibration,
        _ => Mode::Reset,
    };
    assert_eq!((feedback.mode, feedback.is_on()), (mode, mode == Mode::Run), "{}", row.line);
    assert_eq!(feedback.faults(), faults(&row.kind[2..]), "{}", row.line);
}

#[test]
fn replies_are_read_as_in_the_manuals() {
    for row in rows("to-host") {
        let (motor, reply) = Reply::decode(row.id, &row.payload).unwrap();
        assert_eq!(motor, MOTOR, "{}", row.line);
        match (row.kind[0].as_str(), reply) {
            ("state", Reply::Feedback(feedback)) | ("report", Reply::Report(feedback)) => {
                check_state(&row, feedback);
            }
            ("version", Reply::Version(version)) => {
                assert_eq!(u32::from_be_bytes(version), number(&row.kind[1]), "{}", row.line);
            }
            ("device", Reply::Device(serial)) => assert_eq!(serial, row.payload, "{}", row.line),
            ("parameter", Reply::Parameter(index, value)) => {
                assert_eq!(u32::from(index), number(&row.kind[1]), "{}", row.line);
                let value = value.map(u32::from_be_bytes);
                let expected = (row.kind[2] != "refused").then(|| number(&row.kind[2]));
                assert_eq!(value, expected, "{}", row.line);
            }
            ("faults", Reply::Faults { faults: bits, warnings }) => {
                assert_eq!([bits, warnings], [number(&row.kind[1]), number(&row.kind[2])], "{}", row.line);
                assert_eq!(faults_of_report(bits), faults(&row.kind[3..]), "{}", row.line);
            }
            (_, reply) => panic!("{reply:?}: {}", row.line),
        }
    }
}

#[test]
fn no_other_frame_is_a_reply() {
    for kind in 0..=0x1F_u8 {
        for length in 0..=8 {
            let id = Id { kind, data: 0x8005, target: HOST_ID };
            let is_reply = length == 8 && matches!(kind, 2 | 17 | 21 | 24);
            assert_eq!(Reply::decode(id, &[0xA5; 8][..length]).is_some(), is_reply, "{kind} {length}");
        }
    }
    assert_eq!(Reply::decode(Id { kind: 2, data: 0x8005, target: HOST_ID }, &[0xA5; 12]), None);
}

#[test]
fn value_that_is_not_finite_has_no_frame() {
    let scales = WideScales::of(&Model::by_name("RS03").unwrap().scales().unwrap());
    for index in 0..5 {
        for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut values = [0.0; 5];
            values[index] = wrong;
            assert_eq!(ControlCodes::nearest(values, &scales), None);
        }
    }
}

#[test]
fn parts_of_an_id_are_put_together_again() {
    for raw in [0, 0x0280_05FD, 0x1FFF_FFFF, 0x1234_5678] {
        assert_eq!(Id::of(raw).raw(), raw);
    }
}
