//! Each convention of an IMU is named within 2 s, through the frames of each device on a CAN bus,
//! and through a reader. Virtual time.

use motord_bus::{Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Readiness, Sent};
use motord_core::control::ImuReading;
use motord_harness::conventions::{CONVENTIONS, Convention};
use motord_harness::robot;
use motord_harness::robot::line::Wire;
use motord_harness::robot::{Robot, Shared};
use motord_settings::sensor::imu::{ImuSample, ImuSource, Mount};
use motord_settings::settings::Settings;
use motord_shared::ImuState;
use motord_shared::message::IMU_LOST;
use motord_simulator::SharedBus;
use std::collections::VecDeque;

/// Feeds a sample, with noise that differs from turn to turn.
type Feed = Box<dyn FnMut(&mut Robot, &Convention, u32)>;

/// Each convention is named within 2 s of its first sample, and that of motord is not within 4 s.
fn each_convention_is_named(source: &str, built: impl Fn() -> (Robot, Feed)) {
    for convention in &CONVENTIONS {
        let (mut robot, mut feed) = built();
        let begin = robot.now();
        let (mut imu, mut seconds) = (ImuState::UNKNOWN, 0.0);
        for turn in 0.. {
            if imu.contradictions() != 0 || seconds > 4.0 {
                break;
            }
            feed(&mut robot, convention, turn);
            robot.steps(4);
            (imu, seconds) = (robot.state().imus()[0], robot.now().since(begin).as_secs_f64());
        }
        println!("{source}: {:?} after {seconds:.2} s", convention.contradiction);
        assert_eq!(imu.contradictions(), convention.bits(), "{source} {convention:?}");
        assert_eq!((imu.flags & IMU_LOST, imu.rejected), (0, 0), "{source} {convention:?}");
        assert!(convention.contradiction.is_none() || seconds < 2.0, "{source} {convention:?}: {seconds} s");
    }
}

fn settings(imu: &str) -> Settings {
    let bus = "[[bus]]\nname = 'body'\ntype = 'simulated'\n[[bus]]\nname = 'leg'\ntype = 'simulated'\n";
    robot::settings(&format!("{bus}{}{imu}", robot::motor(1, "knee", "leg", "")))
}

/// A robot whose simulated sensor is silent.
fn silent(imu: &str) -> Robot {
    let mut robot = Robot::new(settings(imu), 1);
    robot.disturb("base off");
    robot
}

/// TPDOs of a HiPNUC, node 8: codes of 0.001 G, 0.1 °/s and 0.0001, little endian (user manual, CAN
/// protocol).
fn tpdos(convention: &Convention, turn: u32) -> [(u16, Vec<u8>); 3] {
    let codes = |values: &[f32]| {
        values.iter().flat_map(|value| (value.round() as i16).to_le_bytes()).collect::<Vec<_>>()
    };
    [
        (0x188, codes(&convention.noisy(turn).map(|part| part / 9.8 * 1000.0))),
        (0x288, codes(&[0.0; 3])),
        (0x488, codes(&convention.orientation.map(|part| part * 10_000.0))),
    ]
}

/// By hand: x = 0.154097 is 1541 = 0x0605, -2.899 m/s² is -296 = 0xFED8.
#[test]
fn tpdos_of_test_have_documented_bytes() {
    let [acceleration, _, orientation] = tpdos(&CONVENTIONS[0], 0);
    assert_eq!(acceleration, (0x188, vec![0xD8, 0xFE, 0x74, 0x01, 0x71, 0x03]));
    assert_eq!(orientation, (0x488, vec![0x05, 0x06, 0x71, 0x07, 0x3E, 0x08, 0xF7, 0x24]));
}

#[test]
fn each_convention_of_hipnuc_on_can_is_named() {
    each_convention_is_named("hipnuc-can", || {
        let robot = silent("[[imu]]\nname = 'base'\ntype = 'hipnuc-can'\nbus = 'body'\nrate-hz = 200\n");
        let feed = |robot: &mut Robot, convention: &Convention, turn| {
            for (id, bytes) in tpdos(convention, turn) {
                robot.deliver_frame(0, id, &bytes);
            }
        };
        (robot, Box::new(feed))
    });
}

/// Replies of a DM-IMU-L1 of firmware 1024 with its registers 1, 2 and 4: 16 bits for ±235.2 m/s²
/// and ±34.88 rad/s, little endian; 14 bits for each part of the quaternion, most significant first
/// (manual, chapter CAN communication).
fn replies(convention: &Convention, turn: u32) -> [[u8; 8]; 3] {
    let code = |value: f32, end: f32, most: f32| ((value + end) / (2.0 * end) * most).round() as u64;
    let vector = |register: u8, values: [f32; 3], end: f32| {
        let [[a, b, ..], [c, d, ..], [e, f, ..]] =
            values.map(|value| code(value, end, 65_535.0).to_le_bytes());
        [register, 0, a, b, c, d, e, f]
    };
    let word = convention.orientation.iter().fold(4, |word, part| word << 14 | code(*part, 1.0, 16_383.0));
    [vector(1, convention.noisy(turn), 235.2), vector(2, [0.0; 3], 34.88), word.to_be_bytes()]
}

/// By hand: 9.8 of ±235.2 is 0.520833 · 65535 = 34133 = 0x8555; -1, 0, 1 of ±1 are the codes 0,
/// 0x2000, 0x3FFF.
#[test]
fn replies_of_test_have_documented_bytes() {
    let level =
        Convention { contradiction: None, orientation: [1.0, 0.0, 0.0, -1.0], acceleration: [0.0, 0.0, 9.8] };
    let [acceleration, velocity, orientation] = replies(&level, 0);
    assert_eq!(acceleration, [1, 0, 0x00, 0x80, 0x00, 0x80, 0x55, 0x85]);
    assert_eq!(velocity, [2, 0, 0x00, 0x80, 0x00, 0x80, 0x00, 0x80]);
    assert_eq!(orientation, [4, 0xFF, 0xFE, 0x00, 0x08, 0x00, 0x00, 0x00]);
}

/// A bus with a DM-IMU-L1 that answers each request, device 1, with the id 0x11.
struct Asked {
    bus: SharedBus,
    replies: Shared<[[u8; 8]; 3]>,
    in_flight: VecDeque<(Instant, Frame)>,
}

impl Bus for Asked {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        for frame in frames.iter().filter(|frame| frame.id().raw() == 1) {
            let asked = frame.payload().get(1).copied();
            let reply = self.replies.get().into_iter().find(|reply| asked == Some(reply[0]));
            let reply = Frame::classic(FrameId::new(0x11).expect("eleven bits"), reply.expect("a register"));
            self.in_flight.push_back((now + Duration::from_micros(450), reply));
        }
        self.bus.send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        while let Some((at, frame)) = self.in_flight.pop_front_if(|(at, _)| *at <= now) {
            self.bus.lock().deliver(at, Content::Frame(frame));
        }
        self.bus.receive(now, inbox);
    }

    fn readiness(&self) -> Readiness<'_> {
        let next = self.in_flight.front().map(|(at, _)| *at);
        match (self.bus.readiness(), next) {
            (Readiness::At(arrival), Some(next)) => Readiness::At(arrival.min(next)),
            (_, Some(next)) => Readiness::At(next),
            (readiness, None) => readiness,
        }
    }
}

#[test]
fn each_convention_of_damiao_on_can_is_named() {
    each_convention_is_named("damiao", || {
        let simulated = silent("[[imu]]\nname = 'base'\ntype = 'damiao'\nbus = 'body'\nrate-hz = 250\n");
        let shared = Shared::new(replies(&CONVENTIONS[7], 0));
        let wires = simulated.buses.iter().enumerate().map(|(index, wire)| {
            let Wire::Bus(bus) = wire.clone() else { unreachable!("the robot has no line") };
            let asked = Asked { bus: bus.clone(), replies: shared.clone(), in_flight: VecDeque::new() };
            if index == 0 { Box::new(asked) as Box<dyn Bus> } else { Box::new(bus) }
        });
        let mut robot = Robot::on(wires.collect(), simulated.now(), simulated.settings.clone());
        robot.buses = simulated.buses;
        let feed = move |_: &mut Robot, convention: &Convention, turn| shared.set(replies(convention, turn));
        (robot, Box::new(feed))
    });
}

/// The path of serial lines, other processes and simulated IMUs: their readers turn the samples by
/// the mount.
#[test]
fn each_convention_behind_a_mount_is_named() {
    for angles in [[0.0; 3], [0.0, 0.0, 1.57], [3.1, 0.2, -0.8]] {
        let mount = Mount::from_roll_pitch_yaw(angles);
        each_convention_is_named("reader", || {
            let mut settings = settings("[[imu]]\nname = 'base'\ntype = 'external'\nrate-hz = 250\n");
            assert!(matches!(settings.sensors.imus[0].source, ImuSource::External));
            settings.sensors.imus[0].mount = mount;
            let feed = move |robot: &mut Robot, convention: &Convention, turn: u32| {
                let acceleration = convention.noisy(turn);
                let orientation = convention.orientation;
                let sent = ImuSample { orientation, acceleration, ..ImuSample::LEVEL };
                let reading = ImuReading {
                    sample: mount.to_body(&sent),
                    received: robot.now(),
                    sequence: u64::from(turn) + 1,
                    is_connected: true,
                    ..ImuReading::default()
                };
                robot.client.sample_imu(0, reading);
            };
            (Robot::new(settings, 1), Box::new(feed))
        });
    }
}
