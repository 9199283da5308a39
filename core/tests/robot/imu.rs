//! IMUs in the cycle: published samples, loss, and the stop for it.

use motord_bus::{Duration, Instant};
use motord_core::control::{Event, ImuReading};
use motord_harness::robot::{self, Robot};
use motord_settings::sensor::imu::{ImuSample, ImuSettings, ImuSimulation, ImuSource, Mount, WhenLost};
use motord_settings::settings::Settings;
use motord_shared::message::{IMU_FRESH, IMU_LOST, IMU_VALID};
use motord_shared::{Cause, ImuContradiction, ImuState, Operation, Phase, Refusal};

const LOST_AFTER: Duration = Duration::from_millis(12);

fn settings(when_lost: WhenLost) -> Settings {
    let errors = ImuSimulation { noise: 0.0, bias: 0.0, delay: Duration::ZERO, seed: 1 };
    let imu = ImuSettings {
        name: "base".to_owned(),
        source: ImuSource::Simulated(errors),
        rate_hz: 200.0,
        mount: Mount::ALIGNED,
        lost_after: LOST_AFTER,
        when_lost,
    };
    let mut settings = robot::three_motors();
    settings.sensors.imus = vec![imu];
    settings
}

/// The reading after the sample with this number.
fn reading(sequence: u64, received: Instant) -> ImuReading {
    let sample = ImuSample { angular_velocity: [sequence as f32, 0.0, 0.0], ..ImuSample::LEVEL };
    ImuReading { sample, received, sequence, is_connected: true, ..ImuReading::default() }
}

fn imu(robot: &mut Robot) -> ImuState {
    robot.state().imus()[0]
}

/// Writes a sample, and runs one cycle.
fn sampled(robot: &mut Robot, sequence: u64) -> ImuState {
    let now = robot.now();
    robot.client.sample_imu(0, reading(sequence, now));
    robot.step();
    imu(robot)
}

#[test]
fn imu_is_unknown_until_its_first_sample() {
    let mut robot = Robot::new(settings(WhenLost::Report), 1);
    robot.step();
    let unknown = imu(&mut robot);
    assert_eq!((unknown.flags, unknown.sequence, unknown.receive_ns), (IMU_LOST, 0, 0));
    assert!(unknown.orientation.iter().all(|value| value.is_nan()));
    let first = sampled(&mut robot, 1);
    assert_eq!(first.flags, IMU_FRESH | IMU_VALID);
    assert_eq!((first.orientation, first.acceleration), ([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 9.81]));
}

/// A resting body with roll 0.4, pitch 0.3, yaw 0.5 rad, whose driver sends x, y, z, w.
#[test]
fn convention_at_rest_is_named_within_two_seconds() {
    let mut settings = settings(WhenLost::Report);
    settings.sensors.imus[0].mount = Mount::from_roll_pitch_yaw([0.0, 0.0, 1.57]);
    let mount = settings.sensors.imus[0].mount;
    let mut robot = Robot::new(settings, 1);
    robot.step();
    robot.take_events();
    let rest = |robot: &mut Robot, begin: u64, orientation: [f32; 4]| {
        for sequence in begin..begin + 400 {
            let now = robot.now();
            let noise = 0.01 * (sequence % 5) as f32;
            let sent =
                ImuSample { orientation, acceleration: [-2.899, 3.650 + noise, 8.632], ..ImuSample::LEVEL };
            let reading = ImuReading { sample: mount.to_body(&sent), ..reading(sequence, now) };
            robot.client.sample_imu(0, reading);
            robot.steps(5);
        }
        let found = imu(robot).contradictions();
        let events: Vec<_> = robot.take_events().into_iter().collect();
        let named = |event: &Event| match *event {
            Event::Gravity { imu: 0, contradictions, .. } => Some(contradictions),
            _ => None,
        };
        (found, events.iter().filter_map(named).collect::<Vec<_>>())
    };
    let xyzw = ImuContradiction::QuaternionXyzw.bit();
    assert_eq!(rest(&mut robot, 1, [0.154_097, 0.190_506, 0.210_984, 0.946_281]), (xyzw, vec![xyzw]));
    assert_eq!(rest(&mut robot, 401, [0.946_281, 0.154_097, 0.190_506, 0.210_984]), (0, vec![0]));
}

#[test]
fn sample_is_fresh_in_one_cycle_only() {
    let mut robot = Robot::new(settings(WhenLost::Report), 1);
    let first = sampled(&mut robot, 1);
    robot.step();
    let second = imu(&mut robot);
    assert_eq!((second.flags, second.sequence), (IMU_VALID, 1));
    assert_eq!(second.receive_ns, first.receive_ns, "its age grows");
    assert_eq!(sampled(&mut robot, 2).angular_velocity, [2.0, 0.0, 0.0]);
}

#[test]
fn silent_imu_is_reported_lost_and_back() {
    let mut robot = Robot::new(settings(WhenLost::Report), 1);
    sampled(&mut robot, 1);
    robot.take_events();
    robot.steps(12);
    assert_eq!(imu(&mut robot).flags & IMU_LOST, 0, "12 ms old");
    robot.steps(2);
    assert_eq!(imu(&mut robot).flags, IMU_VALID | IMU_LOST);
    assert_eq!(sampled(&mut robot, 2).flags, IMU_VALID | IMU_FRESH);
    let changes = [true, false].map(|is_lost| Event::Sensor { sensor: 0, is_lost });
    assert_eq!(robot.take_events(), changes);
    assert_eq!(robot.cause(), None);
}

#[test]
fn unplugged_imu_is_lost_at_once() {
    let mut robot = Robot::new(settings(WhenLost::Report), 1);
    sampled(&mut robot, 1);
    let now = robot.now();
    robot.client.sample_imu(0, ImuReading { is_connected: false, ..reading(1, now) });
    robot.step();
    assert_eq!(imu(&mut robot).flags, IMU_VALID | IMU_LOST);
}

/// The cycle was late, and the samples were not: the cycle takes the newest one at its end.
#[test]
fn late_cycle_loses_no_sound_imu() {
    let mut settings = settings(WhenLost::Stop);
    settings.sensors.imus[0].lost_after = Duration::from_secs(1);
    settings.safety.setpoint_timeout = Duration::from_secs(3);
    (settings.cycle.max_lateness, settings.cycle.max_missed_ticks) = (Duration::from_secs(3), 1.0);
    let mut robot = Robot::new(settings, 1);
    sampled(&mut robot, 1);
    let joints = robot.activate();
    robot.take_events();
    let late = Duration::from_millis(1100);
    robot.oversleep(late);
    let newest = robot.now() + late;
    robot.client.sample_imu(0, reading(2, newest));
    robot.follow(&joints);
    robot.follow(&joints);
    let losses = robot.take_events().into_iter().filter(|event| matches!(event, Event::Sensor { .. }));
    assert_eq!(losses.collect::<Vec<_>>(), []);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
}

#[test]
fn imu_silent_in_late_cycle_is_lost() {
    let mut robot = Robot::new(settings(WhenLost::Report), 1);
    sampled(&mut robot, 1);
    robot.take_events();
    robot.oversleep(LOST_AFTER + Duration::from_millis(1));
    robot.steps(2);
    assert_eq!(imu(&mut robot).flags, IMU_VALID | IMU_LOST);
}

#[test]
fn imu_that_never_samples_is_reported_once() {
    let mut robot = Robot::new(settings(WhenLost::Report), 1);
    robot.steps(4000);
    let reports = robot.take_events().into_iter().filter(|event| matches!(event, Event::Sensor { .. }));
    assert_eq!(reports.collect::<Vec<_>>(), [Event::Sensor { sensor: 0, is_lost: true }]);
}

#[test]
fn lost_imu_stops_robot_by_setting() {
    for (when_lost, expected) in [(WhenLost::Stop, Some(Cause::ImuLost)), (WhenLost::Report, None)] {
        let mut settings = settings(when_lost);
        settings.sensors.imus[0].lost_after = Duration::from_secs(1);
        let mut robot = Robot::new(settings, 1);
        sampled(&mut robot, 1);
        let joints = robot.activate();
        sampled(&mut robot, 2);
        (0..999).for_each(|_| robot.follow(&joints));
        assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None), "less than 1 s old");
        robot.follow(&joints);
        robot.follow(&joints);
        assert_eq!(robot.cause(), expected);
        assert_eq!(robot.phase() == Phase::Damping, expected.is_some());
    }
}

#[test]
fn robot_without_required_imu_is_not_enabled() {
    let mut robot = Robot::new(settings(WhenLost::Stop), 1);
    robot.steps(100);
    robot.claim().unwrap();
    let joints = robot.hold(0.0, 1.0);
    robot.follow(&joints);
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::ImuLost);
}
