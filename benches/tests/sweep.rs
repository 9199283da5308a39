//! Goal: no value from a controller causes a forbidden frame, and the status shows every rejection.
//!
//! Method: the whole daemon in this process, on a bus that records the frames on its wire. A
//! controller without the checks of the client library sends every absurd value in every field of
//! every joint. The frames are checked by their bytes.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use motord::buses::{self, Buses};
use motord::threads::Daemon;
use motord_client::{Client, Group, Operation, Rejection, Setpoint, State};
use motord_configuration::{self as config, Machine};
use motord_harness::daemon::{TIMEOUT, simulated_bus, until};
use motord_ports::instance::Instance;
use motord_ports::{ClientPorts, SetpointPort, clock};
use motord_shared::SetpointMessage;
use motord_shared::message::AdminRequest;
use motord_simulator::{BusSettings, Direction, SharedBus, SimulatedBus};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

const CONFIG: &str = r#"
[daemon]
instance = "sweep"
[cycle]
rate-hz = 250
max-lateness-ms = 1000.0
[safety]
setpoint-timeout-ms = 1000.0
lost-cycles = 250
deadman-ms = 2000.0
start-timeout-ms = 5000.0
"#;

const NOT_FINITE: [f32; 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
const ABSURD: [f32; 5] = [f32::MAX, f32::MIN, f32::MIN_POSITIVE / 2.0, -0.0, 500.0];

fn group(state: &State) -> Group {
    state.group(0).unwrap()
}

fn rejections(state: &State) -> u32 {
    Rejection::ALL.iter().map(|&reason| group(state).rejected(reason)).sum()
}

/// Returns the setpoint with `value` in one of its five fields.
fn corrupted(mut setpoint: Setpoint, field: usize, value: f32) -> Setpoint {
    let fields = [
        &mut setpoint.position,
        &mut setpoint.velocity,
        &mut setpoint.kp,
        &mut setpoint.kd,
        &mut setpoint.torque,
    ];
    *fields.into_iter().nth(field).unwrap() = value;
    setpoint
}

/// The owner of the group, without the checks of the client library.
struct Owner {
    client: Client,
    ports: ClientPorts,
    port: SetpointPort,
    message: SetpointMessage,
}

impl Owner {
    fn new(directory: &Path) -> Self {
        let client = Client::connect_in(directory, "sweep").unwrap();
        // The test must not fail when the machine stalls for 50 ms.
        client.set_silence(TIMEOUT);
        let attachment = Instance::below(directory, "sweep").unwrap().attach().unwrap();
        let ports = ClientPorts::open(attachment.unwrap()).unwrap();
        let port = ports.setpoint_port().unwrap();
        Self { client, ports, port, message: SetpointMessage::default() }
    }

    /// Asks until the daemon agrees, and repeats the setpoints meanwhile. Returns the lease.
    fn ask(&mut self, operation: Operation, setpoints: &[Setpoint]) -> u64 {
        let (lease, pid) = (self.message.lease, std::process::id());
        let request = AdminRequest { lease, operation: operation.code(), pid, ..Default::default() };
        until("an answer", || {
            self.transmit(setpoints);
            self.state();
            let question = self.ports.ask(request).unwrap();
            let reply = until("a reply", || question.answer().unwrap()).0;
            (reply.refusal == 0).then_some(reply.lease)
        })
    }

    fn state(&self) -> State {
        self.client.wait(TIMEOUT).unwrap()
    }

    fn transmit(&mut self, setpoints: &[Setpoint]) {
        self.message.sequence += 1;
        self.message.time_ns = clock::now_ns();
        self.message.joint_count = u32::try_from(setpoints.len()).unwrap();
        self.message.joints.iter_mut().zip(setpoints).for_each(|(sent, setpoint)| *sent = (*setpoint).into());
        self.port.send(&self.message).unwrap();
    }

    /// Sends, and waits until the daemon has accepted or rejected the setpoint.
    fn send(&mut self, setpoints: &[Setpoint]) -> State {
        let counted = |state: &State| group(state).accepted.wrapping_add(rejections(state));
        let before = counted(&self.state());
        self.transmit(setpoints);
        until("a verdict", || Some(self.state()).filter(|state| counted(state) > before))
    }
}

#[test]
fn absurd_value_is_rejected_or_limited() {
    let directory = tempfile::TempDir::new().unwrap();
    let text = CONFIG.to_owned() + &simulated_bus(&["hip", "thigh", "knee"]);
    let settings =
        config::parse(Path::new("sweep.toml"), text.as_bytes(), &Machine::here()).unwrap().settings;
    let (wire, motors) = buses::physics(&settings, 0);
    let wire = BusSettings { record: 1 << 17, ..wire };
    let bus = SharedBus::new(SimulatedBus::new(wire, motors, 1));
    let lock = Arc::new(Instance::below(directory.path(), "sweep").unwrap().lock().unwrap());
    let torque_max = settings.motors[0].limits.torque;
    let torque_end = settings.motors[0].scales.torque.max();
    let opened = Buses::of(vec![Box::new(bus.clone())]);
    let daemon = Daemon::start(settings, None, opened, &lock, None).unwrap();

    let not_finite = send_absurd_values(directory.path());
    assert_eq!(rejected_by_status(directory.path()), not_finite);
    daemon.stop();
    daemon.end().unwrap();

    let mut guard = bus.lock();
    let frames: Vec<[u8; 8]> = guard
        .take_record()
        .filter(|frame| frame.direction == Direction::ToMotor)
        .map(|frame| frame.frame.payload().try_into().unwrap())
        .collect();
    assert!(frames.len() < 1 << 16, "the record kept everything");
    check(&frames, torque_end, f64::from(torque_max));
}

/// Claims the robot, sends every absurd value, and returns how many messages had a value that is
/// not finite.
fn send_absurd_values(directory: &Path) -> u32 {
    let mut owner = Owner::new(directory);
    let standing = until("a standing robot", || {
        Some(owner.state()).filter(|state| state.joints().all(|joint| joint.fresh))
    });
    let hold: Vec<_> = standing
        .joints()
        .map(|joint| Setpoint::impedance(joint.position().unwrap(), 0.0, 20.0, 0.5, 0.0))
        .collect();
    owner.message.lease = owner.ask(Operation::Claim, &hold);
    owner.ask(Operation::Enable, &hold);
    // Enabling repeats the setpoint. These cycles check the last repetition, so that each result
    // below belongs to its own message.
    for _ in 0..25 {
        let _state = owner.state();
    }
    let (mut not_finite, mut negative, mut limited) = (0, 0, 0);
    let joints_and_fields = (0..hold.len()).flat_map(|joint| (0..5).map(move |field| (joint, field)));
    for (joint, field) in joints_and_fields {
        for value in NOT_FINITE.into_iter().chain(ABSURD) {
            let mut setpoints = hold.clone();
            setpoints[joint] = corrupted(setpoints[joint], field, value);
            let gain = field == 2 || field == 3;
            let state = owner.send(&setpoints);
            not_finite += u32::from(!value.is_finite());
            negative += u32::from(gain && value.is_finite() && value < 0.0);
            limited += u32::from(value.is_finite() && !(gain && value < 0.0));
            let counted =
                [Rejection::NotFinite, Rejection::Negative].map(|reason| group(&state).rejected(reason));
            assert_eq!(counted, [not_finite, negative], "{value} in field {field}");
            owner.send(&hold);
        }
    }
    assert!(limited > 0 && not_finite == 3 * 5 * 3, "the sweep covered every field");
    not_finite
}

/// Returns the rejections that `motorctl status` shows.
fn rejected_by_status(directory: &Path) -> u32 {
    let output = Command::new(std::env::current_exe().unwrap().with_file_name("../motorctl"))
        .args(["--instance", "sweep", "status", "--json"])
        .env("MOTORD_RUNTIME_DIR", directory)
        .output()
        .unwrap();
    let status: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    serde_json::from_value(status["groups"][0]["rejected"]["not-finite"].clone()).unwrap()
}

/// Checks that no frame to a motor is all zeros, moves its zero, or requests more than
/// `torque_max`, N·m.
fn check(frames: &[[u8; 8]], full_scale: f64, torque_max: f64) {
    let starts = frames.iter().filter(|frame| **frame == [255, 255, 255, 255, 255, 255, 255, 0xFC]);
    assert_eq!(starts.count(), 3, "each motor was started once");
    for bytes in frames {
        assert_ne!(*bytes, [0; 8]);
        assert!(bytes[7] != 0xFE || bytes[..7] != [255; 7], "no client requested a new zero");
        if bytes[..6] != [255; 6] {
            let code = u16::from_be_bytes([bytes[6] & 0x0F, bytes[7]]);
            let torque = f64::from(code) * 2.0 * full_scale / 4095.0 - full_scale;
            assert!(torque.abs() <= torque_max + 0.12, "{torque} N·m");
        }
    }
}
