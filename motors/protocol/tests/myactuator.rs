//! Compares MyActuator's protocol with frames computed by hand from its sources.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_protocol::mit::{ControlCodes, Impedance};
use motord_protocol::myactuator::{Command, MOTORS_MAX, MotorStatus, Reply};
use motord_protocol::{Ends, Faults, Scales};

const MOTOR: u8 = 5;

struct Row {
    direction: String,
    kind: String,
    id: u16,
    payload: Vec<u8>,
    values: Vec<f32>,
    line: &'static str,
}

impl Row {
    fn of(line: &'static str) -> Self {
        let mut cells = line.split(',');
        let mut next = || cells.next().unwrap();
        let [direction, kind, id, hex, values] = [next(), next(), next(), next(), next()];
        let digits: Vec<char> = hex.chars().collect();
        let byte = |pair: &[char]| u8::from_str_radix(&pair.iter().collect::<String>(), 16).unwrap();
        Self {
            direction: direction.to_owned(),
            kind: kind.to_owned(),
            id: u16::from_str_radix(id, 16).unwrap(),
            payload: digits.chunks(2).map(byte).collect(),
            values: values.split_whitespace().map(|value| value.parse().unwrap()).collect(),
            line,
        }
    }

    fn has(&self, values: &[f32]) -> bool {
        let is_close = |(one, other): (&f32, &f32)| (one - other).abs() < 2e-6 * other.abs().max(1.0);
        values.len() == self.values.len() && values.iter().zip(&self.values).all(is_close)
    }
}

fn rows(direction: &str) -> Vec<Row> {
    let rows = include_str!("myactuator.csv").lines().skip(1).map(Row::of);
    let rows: Vec<_> = rows.filter(|row| row.direction == direction).collect();
    assert!(rows.len() >= 12);
    rows
}

fn scales() -> Scales {
    Scales::of(&Ends::new(12.5, 45.0, 24.0))
}

fn command(row: &Row) -> Command {
    match row.kind.as_str() {
        "control" => {
            let [position, velocity, kp, kd, torque] = row.values[..].try_into().unwrap();
            let wanted = Impedance { position, velocity, kp, kd, torque };
            Command::Control(ControlCodes::nearest(&wanted, &scales()).unwrap())
        }
        "id 7" => Command::SetId(7),
        "zero" => Command::SetZero,
        "reset" => Command::Reset,
        "stop" => Command::Stop,
        "angle" => Command::GetAngle,
        "status" => Command::GetStatus,
        "motion" => Command::GetMotion,
        "version" => Command::GetVersion,
        other => panic!("{other}"),
    }
}

#[test]
fn commands_are_those_of_the_sources() {
    for row in rows("to-motor") {
        let (id, payload) = command(&row).encode(MOTOR);
        assert_eq!((id, &payload[..]), (row.id, &row.payload[..]), "{}", row.line);
    }
}

#[test]
fn answers_are_read_as_in_the_sources() {
    for row in rows("to-host") {
        let reply = Reply::decode(row.id.into(), &row.payload, MOTOR).unwrap();
        let kind = row.kind.split(' ').next().unwrap();
        let (of, values) = match reply {
            Reply::State(codes) => ("state", codes.scaled(&scales()).to_vec()),
            Reply::Status(MotorStatus { celsius, decivolts, .. }) => {
                ("status", vec![f32::from(celsius), f32::from(decivolts)])
            }
            Reply::Angle(angle) => ("angle", vec![angle]),
            Reply::Motion { celsius, velocity } => ("motion", vec![celsius.into(), velocity]),
            Reply::Version(version) => ("version", vec![version as f32]),
            Reply::Confirmed(number) => {
                assert_eq!(row.kind, format!("confirmed {number:X}"), "{}", row.line);
                ("confirmed", vec![])
            }
        };
        assert!(kind == of && row.has(&values), "{values:?}: {}", row.line);
    }
}

/// V4.2, status 1. Bit 8, too much speed, has no name.
#[test]
fn errors_of_status_are_faults() {
    for (faults, errors) in [
        (Faults::NONE, 0x0000),
        (Faults::OVERLOAD, 0x0002),
        (Faults::UNDER_VOLTAGE, 0x0004),
        (Faults::OVER_VOLTAGE, 0x0008),
        (Faults::OVER_CURRENT, 0x0010),
        (Faults::OVERLOAD, 0x0040),
        (Faults::ENCODER, 0x0080),
        (Faults::of_unknown_code(8), 0x0100),
        (Faults::MOTOR_OVER_TEMPERATURE, 0x1000),
        (Faults::ENCODER, 0x2000),
        (Faults::MOTOR_OVER_TEMPERATURE.and(Faults::UNDER_VOLTAGE), 0x1004),
        (Faults::of_unknown_code(15), 0x8000),
    ] {
        let [low, high] = u16::to_le_bytes(errors);
        let payload = [0x9A, 25, 0, 1, 0xE0, 1, low, high];
        let Some(Reply::Status(status)) = Reply::decode(0x245, &payload, MOTOR) else { panic!("a status") };
        assert_eq!(status.faults(), faults, "{errors:#06x}");
    }
}

#[test]
fn no_other_frame_is_an_answer() {
    for id in 0..=0x7FF_u32 {
        for length in 0..=9 {
            let payload = [MOTOR, 0x80, 0, 0x80, 8, 0, 0, 0, 0];
            let is_state = id == 0x505 && length == 8;
            assert_eq!(Reply::decode(id, &payload[..length], MOTOR).is_some(), is_state, "{id:#x} {length}");
            let status = [0x9A, 0, 0, 0, 0, 0, 0, 0, 0];
            let is_status = id == 0x245 && length == 8;
            assert_eq!(Reply::decode(id, &status[..length], MOTOR).is_some(), is_status, "{id:#x} {length}");
        }
    }
    assert_eq!(Reply::decode(0x505, &[6, 0x80, 0, 0x80, 8, 0, 0, 0], MOTOR), None, "of another motor");
}

#[test]
fn ids_of_different_motors_never_meet() {
    let mut ids: Vec<u16> = (1..=MOTORS_MAX)
        .flat_map(|motor| [0x140, 0x240, 0x400, 0x500].map(|base| base + u16::from(motor)))
        .chain([0x280, 0x300])
        .collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), 4 * 32 + 2);
}

/// The permission to send impedances.
#[cfg(feature = "commissioning")]
mod dialect {
    use super::*;
    use motord_bus::{Duration, Frame, FrameId, Instant};
    use motord_protocol::drive::{
        Arrived, Command as Order, Dialect, DriveSettings, Impedance as Joint, Question, Reported, Setpoint,
        Shape, Transmission,
    };
    use motord_protocol::gim::ExecutionTime;
    use motord_protocol::myactuator::MyActuatorDialect;
    use motord_protocol::profile::MYACTUATOR;

    fn dialect() -> MyActuatorDialect {
        MyActuatorDialect::new(&DriveSettings {
            id: MOTOR,
            host_id: FrameId::new(0x505).unwrap(),
            profile: &MYACTUATOR,
            scales: scales(),
            gear_ratio: 6.0,
            transmission: Transmission::new(1.0, 0.0),
            limits: [10.0, 10.0],
            wraps: false,
            duration: ExecutionTime::MAX,
            error_feedback: true,
        })
    }

    fn stiff() -> Order {
        Order::Control(Setpoint::impedance(Joint::new(1.0, 0.0, 50.0, 1.0, 0.0)))
    }

    /// Returns whether the frame of a command is an impedance.
    fn moves(dialect: &mut MyActuatorDialect, order: &Order) -> bool {
        let mut frame = Frame::EMPTY;
        dialect.encode(order, &mut frame).is_some() && frame.id().raw() == 0x405
    }

    fn answer(dialect: &mut MyActuatorDialect, errors: u8) -> Reported {
        let frame = Frame::classic(FrameId::new(0x245).unwrap(), [0x9A, 25, 0, 1, 0xE0, 1, errors, 0]);
        let arrived = Arrived::new(&frame, Instant::ZERO);
        assert_eq!(dialect.classify(arrived, Some(Question::State)), Shape::Plain);
        dialect.accept(arrived, Question::State, Duration::ZERO)
    }

    fn checked() -> MyActuatorDialect {
        let mut dialect = dialect();
        for order in [Order::Stop, Order::Start] {
            assert!(!moves(&mut dialect, &order));
        }
        assert_eq!(answer(&mut dialect, 0), Reported::Alive);
        dialect
    }

    #[test]
    fn impedance_needs_status_without_error() {
        let mut dialect = dialect();
        let orders = [Order::Stop, Order::Neutral, Order::Start, Order::Neutral, Order::Start];
        assert!(orders.iter().all(|order| !moves(&mut dialect, order)));
        assert!(matches!(answer(&mut dialect, 4), Reported::Fault(Faults::UNDER_VOLTAGE)));
        assert!(!moves(&mut dialect, &Order::Neutral), "it has an error");
        assert_eq!(answer(&mut dialect, 0), Reported::Alive);
        assert!(moves(&mut dialect, &Order::Neutral) && moves(&mut dialect, &stiff()));
    }

    #[test]
    fn stop_and_silence_withdraw_permission() {
        for end in [Order::Stop, Order::Nothing] {
            let mut dialect = checked();
            assert!(moves(&mut dialect, &stiff()));
            moves(&mut dialect, &end);
            for order in [stiff(), Order::Neutral, Order::Start, Order::Neutral] {
                assert!(!moves(&mut dialect, &order), "{order:?} after {end:?}");
            }
        }
    }

    /// The switch and `safe-stop` make their frames without a motor.
    #[test]
    fn fresh_drive_damps_without_question() {
        let damping = Order::Control(Setpoint::impedance(Joint::new(0.0, 0.0, 0.0, 2.0, 0.0)));
        let mut dialect = dialect();
        assert!(moves(&mut dialect, &damping) && !moves(&mut dialect, &Order::Stop));
    }

    #[test]
    fn unasked_status_is_a_fault_and_no_permission() {
        let mut dialect = dialect();
        moves(&mut dialect, &Order::Stop);
        let status = |errors| Frame::classic(FrameId::new(0x245).unwrap(), [0x9A, 25, 0, 1, 0, 0, errors, 0]);
        let (error, healthy) = (status(0x10), status(0));
        for frame in [&error, &healthy] {
            let arrived = Arrived::new(frame, Instant::ZERO);
            assert_eq!(dialect.classify(arrived, Some(Question::State)), Shape::Unprompted);
        }
        let taken = |dialect: &mut MyActuatorDialect, frame| {
            dialect.accept_unprompted(Arrived::new(frame, Instant::ZERO))
        };
        assert_eq!(taken(&mut dialect, &error), Reported::Fault(Faults::OVER_CURRENT));
        assert_eq!(taken(&mut dialect, &healthy), Reported::Unprompted);
        assert!(!moves(&mut dialect, &Order::Neutral));
    }
}
