//! Compares the codecs with frames of other projects' clients: those that they sent, and the values that
//! they read. `verify/rigs/test-foreign-clients` records them while the clients move simulated motors,
//! except those of MWMotor, SteadyWin's C code, and of myactuator_rmd, which were compiled and run once in
//! the same way. EPA-Arduino, Explorer-Electronic, CU-Robotics, servo_sdk, ODriveArduino and pyodrivecan ran
//! once without a motor, and read replies that were composed by the vendors' documents.

#![expect(clippy::unwrap_used, clippy::panic, reason = "a test that cannot set itself up has failed")]

use motord_protocol::cansimple::{self, AxisState};
use motord_protocol::gim;
use motord_protocol::mit::{self, Asked, ControlCodes, Impedance};
use motord_protocol::myactuator;
use motord_protocol::odrive;
use motord_protocol::robstride::{self, WideScales};
use motord_protocol::{Ends, Model, Profile, Scales};

/// Ends of the codes in two clients for SteadyWin motors. SteadyWin's MIT document has others.
const OTHER_ENDS: Ends = Ends::new(95.5, 45.0, 18.0);

struct Row {
    motor: &'static str,
    what: &'static str,
    id: u32,
    payload: Vec<u8>,
    values: Vec<f32>,
    line: &'static str,
}

fn rows(direction: &str) -> Vec<Row> {
    let lines = include_str!("foreign.csv").lines().skip(1);
    let rows: Vec<Row> = lines.filter(|line| line.starts_with(direction)).map(row).collect();
    assert!(rows.len() >= 6);
    rows
}

fn row(line: &'static str) -> Row {
    let [_, _, motor, what, id, payload, values] = line.split(',').collect::<Vec<_>>().try_into().unwrap();
    let pairs = payload.as_bytes().chunks(2);
    Row {
        motor,
        what,
        id: u32::from_str_radix(id, 16).unwrap(),
        payload: pairs.map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap()).collect(),
        values: values
            .split(' ')
            .filter(|value| !value.is_empty())
            .map(|value| value.parse().unwrap())
            .collect(),
        line,
    }
}

impl Row {
    fn scales(&self) -> Scales {
        match self.motor {
            "GIM6010-8" => Scales::of(&cansimple::ENDS),
            "GIM8008" | "GIM8115" => Scales::of(&OTHER_ENDS),
            name => Model::by_name(name).unwrap().scales().unwrap(),
        }
    }

    fn profile(&self) -> &'static Profile {
        match self.motor {
            "GIM8008" | "GIM8115" => Profile::by_name("steadywin").unwrap(),
            name => Profile::of_model(name).unwrap().0,
        }
    }

    fn impedance(&self) -> Impedance {
        let [position, velocity, kp, kd, torque] = self.values[..].try_into().unwrap();
        Impedance { position, velocity, kp, kd, torque }
    }

    /// Returns the frame that motord sends for the same.
    fn own(&self) -> (u32, Vec<u8>) {
        match self.motor {
            "RS02" => self.own_private(),
            "GIM6010-8" => self.own_node(),
            "GIM8108-9" => self.own_gim(),
            "ODrive-S1" => self.own_odrive(),
            "X8-20" => self.own_rmd(),
            _ => self.own_mit(),
        }
    }

    fn own_mit(&self) -> (u32, Vec<u8>) {
        let command = match self.what {
            "enable" => mit::Command::Start,
            "disable" => mit::Command::Stop,
            "zero" => mit::Command::SetZero,
            "clear-fault" => mit::Command::ClearFault,
            "control" => mit::Command::Control(self.impedance()),
            other => panic!("{other}"),
        };
        (self.id & 0x7FF, self.profile().encode(&command, &self.scales()).unwrap().to_vec())
    }

    fn own_private(&self) -> (u32, Vec<u8>) {
        let command = match self.what {
            "device" => robstride::Command::GetDevice,
            "enable" => robstride::Command::Enable,
            "disable" => robstride::Command::Stop,
            "control" => {
                let scales = WideScales::of(&self.scales());
                let values = self.values[..].try_into().unwrap();
                robstride::Command::Control(robstride::ControlCodes::nearest(values, &scales).unwrap())
            }
            other => panic!("{other}"),
        };
        let host = (self.id >> 8) as u8;
        let (id, payload) = command.encode(self.id as u8, host);
        (id.raw(), payload.to_vec())
    }

    fn own_node(&self) -> (u32, Vec<u8>) {
        use cansimple::Command;
        let command = match self.what {
            "clear-errors" => Command::ClearErrors,
            "mode" => Command::SetMode,
            "closed-loop" => Command::SetState(AxisState::ClosedLoop),
            "idle" => Command::SetState(AxisState::Idle),
            "errors" => Command::GetErrors,
            "estimates" => Command::GetEstimates,
            "save" => Command::Save,
            "control" => Command::Control(ControlCodes::nearest(&self.impedance(), &self.scales()).unwrap()),
            other => panic!("{other}"),
        };
        let (id, payload) = command.encode(1);
        (id.raw().into(), payload.to_vec())
    }

    fn own_gim(&self) -> (u32, Vec<u8>) {
        use gim::{Command, ExecutionTime, Finite};
        let finite = |value: f32| Finite::new(value).unwrap();
        let duration = |millis: f32| ExecutionTime::from_millis(millis as u32).unwrap();
        let command = match (self.what, &self.values[..]) {
            ("start", []) => Command::StartMotor,
            ("stop", []) => Command::StopMotor,
            ("stop-control", []) => Command::StopControl,
            ("fault", []) => Command::GetFault,
            ("clear-fault", []) => Command::AcknowledgeFault,
            ("version", []) => Command::GetVersion,
            ("indicator", &[id]) => Command::RetrieveIndicator { ind_id: id as u8 },
            ("torque", &[torque, millis]) => {
                Command::TorqueControl { torque: finite(torque), duration: duration(millis) }
            }
            ("speed", &[rpm, millis]) => {
                Command::SpeedControl { speed_rpm: finite(rpm), duration: duration(millis) }
            }
            ("position", &[position, millis]) => {
                Command::PositionControl { position: finite(position), duration: duration(millis) }
            }
            other => panic!("{other:?}"),
        };
        (self.id, command.encode().to_vec())
    }

    fn own_odrive(&self) -> (u32, Vec<u8>) {
        use odrive::{Command, ControlMode};
        let command = match (self.what, &self.values[..]) {
            ("clear-errors", []) => Command::ClearErrors,
            ("closed-loop", []) => Command::SetState(AxisState::ClosedLoop),
            ("idle", []) => Command::SetState(AxisState::Idle),
            ("zero", []) => Command::SetZero,
            ("torque-mode", []) => Command::SetMode(ControlMode::Torque),
            ("velocity-mode", []) => Command::SetMode(ControlMode::Velocity),
            ("position-mode", []) => Command::SetMode(ControlMode::Position),
            ("torque", &[torque]) => Command::Torque(torque),
            ("velocity", &[turns]) => Command::Velocity(turns),
            ("position", &[turns]) => Command::Position(turns),
            other => panic!("{other:?}"),
        };
        let (id, payload) = command.encode(2);
        (id.raw().into(), payload.to_vec())
    }

    /// Returns the payload of the client's frame. Some clients end a frame to an ODrive before its zeros,
    /// which motord sends.
    fn filled(&self) -> Vec<u8> {
        let mut payload = self.payload.clone();
        if self.motor == "ODrive-S1" {
            payload.resize(8, 0);
        }
        payload
    }

    fn own_rmd(&self) -> (u32, Vec<u8>) {
        let command = match self.what {
            "status" => myactuator::Command::GetStatus,
            "angle" => myactuator::Command::GetAngle,
            "motion" => myactuator::Command::GetMotion,
            "disable" => myactuator::Command::Stop,
            other => panic!("{other}"),
        };
        let (id, payload) = command.encode(2);
        (id.into(), payload.to_vec())
    }

    /// Returns the codes of a control frame.
    fn codes(&self, id: u32, payload: &[u8]) -> [u32; 5] {
        let all = payload.iter().fold(0_u64, |all, byte| all << 8 | u64::from(*byte));
        let field = |shift: u32, bits: u32| (all >> shift) as u32 & ((1 << bits) - 1);
        if self.motor == "RS02" {
            return [field(48, 16), field(32, 16), field(16, 16), field(0, 16), id >> 8 & 0xFFFF];
        }
        [field(48, 16), field(36, 12), field(24, 12), field(12, 12), field(0, 12)]
    }
}

/// Most clients truncate a code, and motord takes the nearest.
#[test]
fn commands_are_those_of_other_clients() {
    for row in rows("to-motor") {
        let (id, payload) = row.own();
        if row.what != "control" {
            assert_eq!((id, payload), (row.id, row.filled()), "{}", row.line);
            continue;
        }
        let [own, other] = [row.codes(id, &payload), row.codes(row.id, &row.payload)];
        let is_near = own.iter().zip(other).all(|(own, other)| own.abs_diff(other) <= 1);
        assert!(is_near, "{own:X?} {other:X?}: {}", row.line);
        if row.motor != "RS02" {
            assert_eq!(id, row.id, "{}", row.line);
        }
    }
}

/// Returns what motord reads from the frame of a motor that speaks SteadyWin's GIM protocol.
fn read_gim(row: &Row) -> Vec<f32> {
    match gim::decode_reply(&row.payload, gim::Pending::Other, &row.scales()) {
        Ok(gim::Reply::State { outcome: Ok(state), .. }) => {
            vec![state.position, state.velocity, state.torque]
        }
        Ok(gim::Reply::Indicator { outcome: Ok(value), .. }) => vec![value.get()],
        other => panic!("{other:?}: {}", row.line),
    }
}

/// Returns what motord reads from the frame of an ODrive.
fn read_odrive(row: &Row) -> Vec<f32> {
    use odrive::Reply;
    match Reply::decode(cansimple::Id::of(row.id), &row.payload) {
        Some(Reply::Heartbeat(heartbeat)) => vec![heartbeat.errors as f32, heartbeat.state.0.into()],
        Some(Reply::Estimates(estimates)) => vec![estimates.position, estimates.velocity],
        Some(Reply::Torque(torque)) => vec![torque],
        Some(Reply::Temperature(celsius)) => vec![celsius],
        Some(Reply::Bus { volts, amperes }) => vec![volts, amperes],
        None => panic!("{}", row.line),
    }
}

/// Returns what motord reads from the frame.
fn read(row: &Row) -> Vec<f32> {
    match row.motor {
        "GIM8108-9" => read_gim(row),
        "ODrive-S1" => read_odrive(row),
        "RS02" => {
            let id = robstride::Id::of(row.id);
            let Some((_, robstride::Reply::Feedback(state))) = robstride::Reply::decode(id, &row.payload)
            else {
                panic!("{}", row.line)
            };
            let [position, velocity, torque] = state.scaled(&WideScales::of(&row.scales()));
            vec![position, velocity, torque, state.celsius()]
        }
        "GIM6010-8" => match cansimple::Reply::decode(cansimple::Id::of(row.id), &row.payload) {
            Some(cansimple::Reply::State(codes)) => codes.scaled(&row.scales()).to_vec(),
            other => panic!("{other:?}: {}", row.line),
        },
        "X8-20" => match myactuator::Reply::decode(row.id, &row.payload, 2) {
            Some(myactuator::Reply::Status(status)) => {
                vec![status.celsius.into(), status.volts()]
            }
            Some(myactuator::Reply::Angle(angle)) => vec![angle],
            Some(myactuator::Reply::Motion { celsius, velocity }) => vec![velocity, celsius.into()],
            other => panic!("{other:?}: {}", row.line),
        },
        _ => match row.profile().decode(&row.payload, Asked::State, &row.scales()) {
            Ok(mit::Reply::State(state)) => vec![state.position, state.velocity, state.torque],
            other => panic!("{other:?}: {}", row.line),
        },
    }
}

/// The clients' arithmetic differs by less than a code.
#[test]
fn states_are_read_as_by_other_clients() {
    for row in rows("from-motor") {
        let (own, scales) = (read(&row), row.scales());
        let steps = [scales.position.step(), scales.velocity.step(), scales.torque.step(), 0.1];
        for ((own, other), step) in own.iter().zip(&row.values).zip(steps) {
            assert!(f64::from((own - other).abs()) < step, "{own} {other}: {}", row.line);
        }
    }
}
