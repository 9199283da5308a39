//! Simulated motors on a virtual interface, with a host in the same process. Needs root on a kernel
//! with SocketCAN: `verify/rigs/test-can` runs it there.

use motord_bus::frame::ControllerState;
use motord_bus::socketcan::{InterfaceName, Link, Settings, SocketCanBus};
use motord_bus::transport::SocketCan;
use motord_bus::{Bus, Content, Duration, Frame, FrameId, IdFilter, Inbox, Instant, clock, wait};
use motord_simulator::{Bridge, BusSettings, Dialect, MotorSettings, SimulatedBus};

const BITRATE: u32 = 1_000_000;
/// MIT document 1.1: "stop motor".
const STOP: [u8; 8] = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD];

struct Robot {
    host: SocketCanBus,
    bridge: Bridge,
}

impl Robot {
    /// Creates two motors on an interface of the rig.
    fn new(interface: &str) -> Self {
        Self::built(interface, |_| {})
    }

    /// As [`new`](Self::new), with motors that `build` changes.
    fn built(interface: &str, build: impl Fn(&mut MotorSettings)) -> Self {
        let interface: InterfaceName = interface.parse().expect("a valid name");
        let motor = |name: &str, id| {
            let mut motor =
                MotorSettings { name: name.into(), id, host_id: 0x100 + id, ..Default::default() };
            build(&mut motor);
            motor
        };
        let bus = BusSettings { name: "leg".into(), bitrate: BITRATE, ..Default::default() };
        let simulated = SimulatedBus::new(bus, vec![motor("hip", 1), motor("knee", 2)], 7);
        let host_ids =
            [0x101, 0x102].map(|raw| IdFilter::exact(FrameId::new(raw).expect("11 bits"))).to_vec();
        let host = SocketCanBus::open(&Settings { host_ids, ..Settings::new(interface, BITRATE) })
            .expect("vcan is there");
        let end = SocketCan { interface: interface.to_string(), bitrate: BITRATE };
        Self { host, bridge: Bridge::open(simulated, &end).expect("vcan is there") }
    }

    fn inject(&mut self, verb: &str) {
        let verb = verb.parse().expect("a verb");
        self.bridge.inject(clock::monotonic(), &verb).expect("a target that can have it");
    }

    fn stop(&mut self, id: u16) -> Instant {
        let asked = clock::monotonic();
        let command = Frame::classic(FrameId::new(id).expect("11 bits"), STOP);
        assert_eq!(self.host.send(asked, &[command]).refusal, None);
        asked
    }

    /// Serves the bridge for 50 ms, and returns the frames that the host has received.
    fn listen(&mut self) -> Inbox {
        let end = clock::monotonic() + Duration::from_millis(50);
        while clock::monotonic() < end {
            let now = clock::monotonic();
            self.bridge.serve(now);
            let until = self.bridge.due().min(end);
            let _ready = wait(&[self.bridge.readiness()], now, until);
        }
        let mut inbox = Inbox::new();
        self.host.receive(clock::monotonic(), &mut inbox);
        inbox
    }
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn kernel_answers_are_never_faster_than_wire() {
    let mut robot = Robot::new("vcan0");
    let asked = robot.stop(2);
    let inbox = robot.listen();
    let [answer] = inbox.arrivals() else { panic!("{:?}", inbox.arrivals()) };
    let Content::Frame(frame) = answer.content else { panic!("{answer:?}") };
    assert_eq!((frame.id().raw(), frame.payload()[0]), (0x102, 2));
    let wire = Duration::from_micros(206);
    assert!(
        answer.at.since(asked) >= wire,
        "a pair of frames takes {wire:?} at least, not {:?}",
        answer.at.since(asked)
    );
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn motor_and_bus_faults_reach_the_host() {
    let mut robot = Robot::new("vcan1");
    robot.inject("hip off");
    robot.stop(1);
    assert_eq!(robot.listen().arrivals(), []);
    robot.inject("hip ok");
    robot.inject("leg bus-off");
    robot.stop(1);
    let inbox = robot.listen();
    let [report] = inbox.arrivals() else { panic!("{:?}", inbox.arrivals()) };
    let Content::Error(report) = report.content else { panic!("{report:?}") };
    assert_eq!(report.state(), Some(ControllerState::Off));
    robot.inject("leg ok");
    assert_eq!(robot.listen().arrivals().len(), 1, "restarted");
    robot.stop(1);
    assert_eq!(robot.listen().arrivals().len(), 1, "the motor answers again");
    assert!(Link::read("vcan1".parse().unwrap()).unwrap().up, "the interface itself was never touched");
}

/// Requests for registers of Damiao motors have an id that is no motor's: DM_CAN.py, 0x7FF.
#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn register_request_reaches_motor_over_interface() {
    let mut robot = Robot::built("vcan1", |motor| {
        (motor.vendor, motor.ends) = ("damiao", Some([12.5, 30.0, 10.0]));
    });
    let request = Frame::classic(FrameId::MAX, [2, 0, 0x33, 22, 0, 0, 0, 0]);
    assert_eq!(robot.host.send(clock::monotonic(), &[request]).refusal, None);
    let inbox = robot.listen();
    let [answer] = inbox.arrivals() else { panic!("{:?}", inbox.arrivals()) };
    let Content::Frame(frame) = answer.content else { panic!("{answer:?}") };
    // 30.0 is 0x41F00000.
    assert_eq!((frame.id().raw(), frame.payload()), (0x102, &[2, 0, 0x33, 22, 0, 0, 0xF0, 0x41][..]));
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn motor_with_changed_id_is_received_under_it() {
    /// GIM document 3.2.3 and 3.2.14.
    const NEW_ID: [u8; 8] = [0x83, 0x00, 0x12, 0, 9, 0, 0, 0];
    const VERSION: [u8; 8] = [0xB1, 0, 0, 0, 0, 0, 0, 0];
    let mut robot = Robot::built("vcan2", |motor| motor.dialect = Dialect::Gim);
    for (id, bytes) in [(1, NEW_ID), (9, VERSION)] {
        let command = Frame::classic(FrameId::new(id).expect("11 bits"), bytes);
        assert_eq!(robot.host.send(clock::monotonic(), &[command]).refusal, None);
        assert_eq!(robot.listen().arrivals().len(), 1, "{id}");
    }
    let command = Frame::classic(FrameId::new(1).expect("11 bits"), VERSION);
    assert_eq!(robot.host.send(clock::monotonic(), &[command]).refusal, None);
    assert_eq!(robot.listen().arrivals(), [], "no motor has the old id");
}
