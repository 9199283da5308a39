//! Compares the CANSimple dialect with frames computed by hand from its sources.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod nodes;

#[cfg(feature = "drive")]
use motord_bus::{Frame, FrameId};
use motord_protocol::cansimple::{
    AxisState, Command, ENDS, Errors, Heartbeat, Id, NODE_MAX, Reply, ReportedState,
};
use motord_protocol::mit::{ControlCodes, Impedance};
use motord_protocol::{Faults, Scales};
use nodes::{Row, faults};

const NODE: u8 = 5;
/// Of a GIM6010-8.
const RATIO: f32 = 8.0;

/// The lowest bit without a name in the table is that of the motor.
const UNNAMED: u8 = 6;

fn rows(direction: &str) -> Vec<Row> {
    nodes::rows(include_str!("cansimple.csv"), direction, 13)
}

fn control(values: &[f32]) -> Result<ControlCodes, motord_protocol::EncodeError> {
    let [position, velocity, kp, kd, torque] = values.try_into().unwrap();
    ControlCodes::nearest(&Impedance { position, velocity, kp, kd, torque }, &Scales::of(&ENDS))
}

fn command(row: &Row) -> Command {
    let argument = |index: usize| row.kind[index].as_str();
    match argument(0) {
        "errors" => Command::GetErrors,
        "node" => Command::SetNode(argument(1).parse().unwrap()),
        "idle" => Command::SetState(AxisState::Idle),
        "closed-loop" => Command::SetState(AxisState::ClosedLoop),
        "control" => Command::Control(control(&row.values).unwrap()),
        "estimates" => Command::GetEstimates,
        "mode" => Command::SetMode,
        "bus" => Command::GetBus,
        "clear" => Command::ClearErrors,
        "zero" => Command::SetZero,
        "save" => Command::Save,
        other => panic!("{other}"),
    }
}

#[test]
fn commands_are_those_of_the_sources() {
    for row in rows("to-motor") {
        let (id, payload) = command(&row).encode(NODE);
        assert_eq!((id, &payload[..]), (row.id, &row.payload[..]), "{}", row.line);
    }
}

fn check_heartbeat(row: &Row, heartbeat: Heartbeat) {
    let is_running = row.kind[1] == "running";
    assert_eq!(
        (heartbeat.state.is_running(), heartbeat.state.is_idle()),
        (is_running, !is_running),
        "{}",
        row.line
    );
    let flag = row.kind.get(2).map_or("-", String::as_str);
    let flags = (heartbeat.motor_failed, heartbeat.encoder_failed);
    assert_eq!(flags, (flag == "motor", flag == "encoder"), "{}", row.line);
    let mut errors = Errors::default();
    errors.beat(heartbeat);
    assert_eq!(errors.faults(), faults(row.kind.get(3..).unwrap_or_default(), UNNAMED), "{}", row.line);
}

#[test]
fn replies_are_read_as_in_the_sources() {
    for row in rows("to-host") {
        match (row.kind[0].as_str(), Reply::decode(row.id, &row.payload).unwrap()) {
            ("heartbeat", Reply::Heartbeat(heartbeat)) => check_heartbeat(&row, heartbeat),
            ("errors", Reply::Errors(bits)) => {
                assert_eq!(bits, u64::from_str_radix(&row.kind[1], 16).unwrap(), "{}", row.line);
                let mut errors = Errors::default();
                errors.record_motor(bits);
                assert_eq!(errors.faults(), faults(&row.kind[2..], UNNAMED), "{}", row.line);
            }
            ("state", Reply::State(codes)) => row.check(&codes.scaled(&Scales::of(&ENDS)), &row.values),
            ("estimates", Reply::Estimates(estimates)) => row.check(&estimates.at_output(RATIO), &row.values),
            ("bus", Reply::Bus { volts, amperes }) => row.check(&[volts, amperes], &row.values),
            (_, reply) => panic!("{reply:?}: {}", row.line),
        }
    }
}

/// A running motor also sends estimates and states of impedances.
#[cfg(feature = "drive")]
#[test]
fn only_heartbeat_of_idle_axis_confirms_stop() {
    let confirms = motord_protocol::cansimple::FAMILY.confirms_stop.unwrap();
    for row in rows("to-host") {
        let frame = Frame::new(FrameId::new(row.id.raw()).unwrap(), &row.payload).unwrap();
        let is_idle = row.kind.starts_with(&["heartbeat".into(), "idle".into()]);
        assert_eq!(confirms(&frame), is_idle, "{}", row.line);
    }
}

#[test]
fn no_other_frame_is_a_reply() {
    for command in 0..=0x1F_u8 {
        for length in 0..=12 {
            let id = Id { node: NODE, command };
            let is_reply = length == 8 && matches!(command, 0x01 | 0x03 | 0x09 | 0x17);
            let payload = &[NODE; 12][..length];
            let is_state = length == 6 && command == 0x08;
            assert_eq!(Reply::decode(id, payload).is_some(), is_reply || is_state, "{command} {length}");
        }
    }
    assert_eq!(Reply::decode(Id { node: 6, command: 0x08 }, &[NODE; 6]), None, "of another node");
}

#[test]
fn estimate_that_is_not_finite_is_no_reply() {
    for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut payload = [0; 8];
        payload[4..].copy_from_slice(&wrong.to_le_bytes());
        assert_eq!(Reply::decode(Id { node: NODE, command: 0x09 }, &payload), None);
    }
}

#[test]
fn every_id_has_a_node_and_a_command() {
    for raw in 0..=0x7FF_u16 {
        let id = Id::of(raw.into());
        assert!(id.raw() == raw && id.node <= NODE_MAX && id.command <= 0x1F, "{raw:#x}");
    }
}

#[test]
fn value_that_is_not_finite_has_no_frame() {
    for index in 0..5 {
        let mut values = [0.0; 5];
        values[index] = f32::NAN;
        assert!(control(&values).is_err());
    }
}

/// The axis only points to the motor, whose error has a name.
#[test]
fn motor_errors_name_the_failure_of_the_axis() {
    let heartbeat = |axis_errors| Heartbeat {
        axis_errors,
        state: ReportedState(1),
        motor_failed: axis_errors != 0,
        encoder_failed: false,
    };
    let mut errors = Errors::default();
    errors.beat(heartbeat(0x40));
    assert_eq!((errors.faults(), errors.is_unnamed()), (Faults::of_unknown_code(6), true));
    errors.record_motor(1 << 18);
    assert_eq!((errors.faults(), errors.is_unnamed()), (Faults::DRIVER_OVER_TEMPERATURE, false));
    errors.beat(heartbeat(0));
    assert_eq!((errors.faults(), errors.is_unnamed()), (Faults::NONE, false));
}

/// The requests for the estimates, which have the id of the estimates.
#[cfg(feature = "drive")]
mod requests {
    use super::*;
    use motord_bus::{Duration, Instant};
    use motord_protocol::cansimple::CanSimpleDialect;
    use motord_protocol::drive::{Arrived, Command as Order, Dialect, DriveSettings, Question, Transmission};
    use motord_protocol::gim::ExecutionTime;
    use motord_protocol::profile::STEADYWIN;

    fn dialect() -> CanSimpleDialect {
        CanSimpleDialect::new(&DriveSettings {
            id: NODE,
            host_id: FrameId::new(0x0A8).unwrap(),
            profile: &STEADYWIN,
            scales: Scales::of(&ENDS),
            gear_ratio: RATIO,
            transmission: Transmission::new(1.0, 0.0),
            limits: [10.0, 5.0],
            wraps: false,
            duration: ExecutionTime::MAX,
            error_feedback: true,
        })
    }

    /// Returns the number of requests in this number of cycles of a stopped node.
    fn requests(dialect: &mut CanSimpleDialect, cycles: usize, answers: bool) -> usize {
        let mut requests = 0;
        for _ in 0..cycles {
            let mut frame = Frame::EMPTY;
            dialect.encode(&Order::Stop, &mut frame).unwrap();
            match frame.id().raw() {
                0x0A3 if answers => {
                    let errors = Frame::classic(FrameId::new(0x0A3).unwrap(), [0; 8]);
                    let arrived = Arrived::new(&errors, Instant::ZERO);
                    dialect.accept(arrived, Question::State, Duration::ZERO);
                }
                0x0A9 => requests += 1,
                _ => {}
            }
        }
        requests
    }

    fn report(dialect: &mut CanSimpleDialect, command: u16, payload: [u8; 8]) {
        let frame = Frame::classic(FrameId::new(0x0A0 | command).unwrap(), payload);
        dialect.accept_unprompted(Arrived::new(&frame, Instant::ZERO));
    }

    /// The other cycles show whether the node sends them.
    #[test]
    fn estimates_are_requested_until_node_sends_them() {
        let mut dialect = dialect();
        report(&mut dialect, 0x01, [0, 0, 0, 0, 1, 0, 0, 0]);
        let asked = requests(&mut dialect, 1000, true);
        assert!((100..=150).contains(&asked), "{asked}");
        for _ in 0..100 {
            report(&mut dialect, 0x09, [0; 8]);
            assert_eq!(requests(&mut dialect, 30, true), 0);
        }
    }

    /// It may send them as soon as it returns.
    #[test]
    fn silent_node_is_not_asked_for_estimates() {
        let mut dialect = dialect();
        report(&mut dialect, 0x01, [0, 0, 0, 0, 1, 0, 0, 0]);
        assert_eq!(requests(&mut dialect, 10_000, false), 0);
    }
}
