//! Motors that lose their power together, on virtual time. The adapter keeps frames while no node
//! acknowledges.

use super::family;
use super::faults_bus::{active, stopped_within};
use motord_bus::{Duration, Instant};
use motord_core::control::Event;
use motord_harness::robot::random::Random;
use motord_harness::robot::{self, Meaning, Robot};
use motord_protocol::SupplyReport;
use motord_settings::settings::Settings;
use motord_shared::{AdminRequest, BusCondition, Cause, JointSetpoint, MotorMode, Operation, Phase, Refusal};
use motord_simulator::{FaultVerb, Mode, MotorSettings};

/// Frames that the adapter keeps.
const ADAPTER: usize = 64;

/// Returns a robot whose adapters keep frames while no node acknowledges, and whose motors are
/// changed by `build`.
fn built(settings: Settings, seed: u64, build: impl Fn(&mut MotorSettings)) -> Robot {
    Robot::built(settings, seed, |bus, motors| {
        bus.adapter = Some(ADAPTER);
        motors.iter_mut().for_each(&build);
    })
}

/// Motors that execute the first control frame after their power returned.
fn without_enable(motor: &mut MotorSettings) {
    motor.behaviour.needs_start = false;
    motor.boot_time = Duration::from_millis(60);
}

fn condition(robot: &mut Robot, bus: usize) -> BusCondition {
    robot.bus(bus).condition.try_into().expect("conditions are known")
}

/// Moves every joint: the setpoints of a trot in the cycle with this number.
fn trot(rest: &[JointSetpoint], cycle: usize) -> Vec<JointSetpoint> {
    let phase = cycle as f32 * 0.0126;
    let joint = |(index, joint): (usize, &JointSetpoint)| JointSetpoint {
        position: joint.position + 0.2 * (phase + index as f32).sin() - 0.2 * (index as f32).sin(),
        kp: 40.0,
        kd: 1.0,
        ..*joint
    };
    rest.iter().enumerate().map(joint).collect()
}

/// Cuts the power of a bus in the middle of a cycle.
fn cut(robot: &mut Robot, bus: &str, after: Duration) -> Instant {
    let at = robot.now() + after;
    let verb: FaultVerb = format!("{bus} power-off").parse().expect("it is a fault");
    assert!(robot.buses.iter().any(|wire| wire.inject(at, &verb).is_ok()));
    at
}

fn follow_trot(robot: &mut Robot, rest: &[JointSetpoint], cycles: usize) {
    (0..cycles).for_each(|cycle| robot.follow(&trot(rest, cycle)));
}

/// Goal: frames from before the return of the power reach no motor, and move none that needs no
/// enable. Method: 1000 power cuts at random instants of a trot, each for 1 to 300 ms. The simulated
/// motors record which control frame they executed last.
#[test]
fn no_old_frame_is_executed_after_return() {
    let mut random = Random::new(47);
    let mut held = 0;
    for seed in 0..1000 {
        let mut robot = built(robot::three_motors(), seed, without_enable);
        let rest = robot.activate();
        follow_trot(&mut robot, &rest, 5 + random.below(50));
        let at = cut(&mut robot, "can", Duration::from_nanos(random.below(1_200_000) as u64));
        let dark = *random.pick(&[1, 8, 15, 60, 300]);
        follow_trot(&mut robot, &rest, dark);
        robot.take_sent();
        robot.disturb("can ok");
        let returned = robot.now();
        robot.steps(500);
        for sent in robot.take_sent() {
            assert!(sent.meaning.is_safe(), "seed {seed}, {dark} ms: {sent:?}");
            held += usize::from(sent.ready < returned);
        }
        for joint in 0..3 {
            let (executed, _) = robot.truth(joint).last_executed().expect("it trotted");
            assert!(executed <= at, "seed {seed}, {dark} ms: joint {joint} was moved");
        }
        assert_eq!((robot.phase(), condition(&mut robot, 0)), (Phase::Disarmed, BusCondition::Active));
        assert!((0..3).all(|joint| robot.mode(joint) == MotorMode::Idle), "seed {seed}, {dark} ms");
    }
    assert!(held <= 1000, "{held} probes from before the return: at most one for each cut");
}

/// Method: the joints are at rest without power before it returns.
#[test]
fn motor_without_enable_rests_at_return() {
    let mut robot = built(robot::three_motors(), 1, without_enable);
    let rest = robot.activate();
    follow_trot(&mut robot, &rest, 100);
    cut(&mut robot, "can", Duration::from_micros(300));
    follow_trot(&mut robot, &rest, 3000);
    family::check_rest::<3>(&mut robot);
}

#[test]
fn power_cut_of_one_bus_stops_group() {
    let mut robot = built(robot::quadruped(), 1, |_| {});
    let rest = robot.activate();
    robot.take_events();
    cut(&mut robot, "front-right", Duration::ZERO);
    let (cause, cycles) = stopped_within(&mut robot, &rest, 12);
    assert_eq!((cause, robot.group().cause_joint), (Cause::PowerLost, 3), "after {cycles} cycles");
    assert_eq!(
        [0, 1, 2, 3].map(|bus| condition(&mut robot, bus) == BusCondition::Held),
        [false, true, false, false]
    );
    let held = Event::Bus { bus: 1, condition: BusCondition::Held };
    assert!(robot.take_events().contains(&held));
    robot.steps(3000);
    assert_eq!(robot.operate(Operation::Reset).unwrap_err(), Refusal::BusDown);
    robot.disturb("front-right ok");
    robot.steps(1000);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Disarmed, Some(Cause::PowerLost)));
    robot.operate(Operation::Reset).unwrap();
    robot.activate();
}

#[test]
fn one_silent_motor_holds_no_bus() {
    let (mut robot, rest) = active();
    robot.disturb("thigh power-off");
    let (cause, _) = stopped_within(&mut robot, &rest, 12);
    assert_eq!((cause, condition(&mut robot, 0)), (Cause::MotorLost, BusCondition::Active));
    robot.steps(1000);
    assert_eq!(condition(&mut robot, 0), BusCondition::Active);
}

/// The others failed before: nothing distinguishes its power from its cable.
#[test]
fn last_silent_motor_holds_bus_as_lost() {
    let (mut robot, rest) = active();
    robot.disturb("hip off");
    robot.disturb("thigh off");
    let (cause, _) = stopped_within(&mut robot, &rest, 12);
    assert_eq!((cause, condition(&mut robot, 0)), (Cause::MotorLost, BusCondition::Active));
    robot.disturb("knee off");
    robot.steps(12);
    assert_eq!(condition(&mut robot, 0), BusCondition::Held);
}

#[test]
fn silent_motors_on_full_queue_lost_power() {
    let (mut robot, rest) = active();
    robot.disturb("can no-ack");
    let (cause, cycles) = stopped_within(&mut robot, &rest, 12);
    assert_eq!((cause, condition(&mut robot, 0)), (Cause::PowerLost, BusCondition::Held));
    assert!(cycles < 10, "the full queue shows it sooner: {cycles}");
}

/// Every frame on this bus leaves, as where another device acknowledges it.
#[test]
fn held_bus_gets_one_probe_at_a_time() {
    let (mut robot, rest) = active();
    robot.disturb("can power-off");
    stopped_within(&mut robot, &rest, 12);
    robot.steps(10);
    robot.take_sent();
    robot.steps(3000);
    let sent = robot.take_sent();
    assert!((29..=31).contains(&sent.len()), "{} in 3 s", sent.len());
    assert!(sent.iter().all(|sent| matches!(sent.meaning, Meaning::Stop | Meaning::GetFault)));
    let times = sent.windows(2).map(|pair| pair[1].ready.since(pair[0].ready));
    assert!(times.min() >= Some(Duration::from_millis(99)));
    let ids: Vec<_> = sent.iter().map(|sent| sent.id).collect();
    assert!(ids.windows(3).all(|three| three[0] % 3 + 1 == three[1] && three[1] % 3 + 1 == three[2]));
}

/// A stop reaches a motor whose replies are lost, although it may need no enable.
#[test]
fn each_motor_gets_a_stop_before_hold() {
    let (mut robot, rest) = active();
    for joint in ["hip", "thigh", "knee"] {
        robot.disturb(&format!("{joint} intermittent 100%"));
    }
    robot.follow_until(&rest, 12, |robot| robot.cause().is_some());
    robot.take_sent();
    robot.steps(2);
    let ids = [1, 2, 3];
    let sent: Vec<_> = robot.take_sent().iter().map(|sent| (sent.id, sent.meaning)).collect();
    assert_eq!(sent, ids.map(|id| (id, Meaning::Stop)));
    assert!((0..3).all(|joint| robot.truth(joint).mode() == Mode::Stopped));
}

/// Method: a motor was offline before, at each of its probes.
#[test]
fn offline_motor_gets_a_stop_before_hold() {
    for probe in 0..5 {
        let (mut robot, rest) = active();
        robot.disturb("hip off");
        stopped_within(&mut robot, &rest, 12);
        robot.steps(1000 + 100 * probe);
        robot.disturb("can power-off");
        while condition(&mut robot, 0) != BusCondition::Held {
            robot.step();
        }
        robot.take_sent();
        robot.steps(2);
        let sent = robot.take_sent_to(1);
        assert_eq!(sent.first().map(|sent| sent.meaning), Some(Meaning::Stop), "after {probe} probes");
    }
}

/// Goal: while one motor is missing, its bus is held. The operator excludes the joint.
#[test]
fn bus_is_held_until_every_motor_answered() {
    let (mut robot, rest) = active();
    robot.disturb("can power-off");
    stopped_within(&mut robot, &rest, 12);
    robot.steps(2100);
    robot.disturb("hip ok");
    robot.disturb("knee ok");
    robot.steps(1000);
    assert_eq!(
        [0, 1, 2].map(|joint| robot.mode(joint)),
        [MotorMode::Idle, MotorMode::Offline, MotorMode::Idle]
    );
    assert_eq!(condition(&mut robot, 0), BusCondition::Held);
    let zero = AdminRequest { operation: Operation::SetZero.code(), joint: 0, ..Default::default() };
    assert_eq!(robot.ask(zero).unwrap_err(), Refusal::BusDown);
    let exclude = AdminRequest { operation: Operation::Exclude.code(), joint: 1, ..Default::default() };
    robot.ask(exclude).unwrap();
    robot.steps(2);
    assert_eq!(condition(&mut robot, 0), BusCondition::Active);
    robot.operate(Operation::Reset).unwrap();
}

/// Seed 24 of the fault injection: nothing was sent that could have shown that the bus is up again.
#[test]
fn held_bus_that_was_down_is_served_again() {
    let (mut robot, rest) = active();
    robot.disturb("can power-off");
    stopped_within(&mut robot, &rest, 12);
    robot.steps(500);
    robot.disturb("can down");
    robot.steps(500);
    assert_eq!(condition(&mut robot, 0), BusCondition::Down);
    robot.disturb("can ok");
    robot.steps(1000);
    assert_eq!(condition(&mut robot, 0), BusCondition::Active);
}

/// Motors in fault answer only the question for it. Each of them was lost again at its next stop.
/// Method: one motor is lost before the others, so that they are asked in different rounds.
#[test]
fn motors_in_fault_end_hold() {
    let (mut robot, rest) = active();
    robot.disturb("hip off");
    stopped_within(&mut robot, &rest, 12);
    robot.steps(150);
    robot.disturb("can power-off");
    robot.steps(500);
    robot.disturb("can ok");
    robot.disturb("hip ok");
    for joint in ["hip", "thigh", "knee"] {
        robot.disturb(&format!("{joint} fault 0x02"));
    }
    robot.steps(4000);
    assert_eq!([0, 1, 2].map(|joint| robot.mode(joint)), [MotorMode::Fault; 3]);
    assert_eq!(condition(&mut robot, 0), BusCondition::Active);
}

/// Goal: motors in fault are found after one probe each, and one more. Method: the controller reports
/// that it is error passive, and never that it recovered, so the probes are a second apart.
#[test]
fn motors_in_fault_end_hold_of_passive_bus() {
    let (mut robot, rest) = active();
    robot.disturb("can power-off");
    robot.disturb("can passive");
    stopped_within(&mut robot, &rest, 12);
    robot.steps(500);
    robot.disturb("can ok");
    for joint in ["hip", "thigh", "knee"] {
        robot.disturb(&format!("{joint} fault 0x02"));
    }
    robot.steps(5500);
    assert_eq!([0, 1, 2].map(|joint| robot.mode(joint)), [MotorMode::Fault; 3]);
}

/// Goal: motors of each vendor, and native ones on a line, pass their probes.
#[test]
fn every_vendor_returns_from_power_cut() {
    let mut robot = Robot::new(robot::settings(include_str!("../../../config/mixed-simulated.toml")), 3);
    let rest = robot.activate();
    for bus in ["front-left", "front-right", "rear-left", "rear-right"] {
        robot.disturb(&format!("{bus} power-off"));
    }
    robot.follow_until(&rest, 200, |robot| robot.cause() == Some(Cause::PowerLost));
    robot.steps(1000);
    assert!((0..4).all(|bus| condition(&mut robot, bus) == BusCondition::Held));
    for bus in ["front-left", "front-right", "rear-left", "rear-right"] {
        robot.disturb(&format!("{bus} ok"));
    }
    robot.steps(1500);
    assert!((0..4).all(|bus| condition(&mut robot, bus) == BusCondition::Active));
    robot.operate(Operation::Reset).unwrap();
    robot.activate();
}

#[test]
fn line_is_held_and_served_again() {
    let mut text =
        String::from("[[bus]]\nname = \"arm\"\ntype = \"serial\"\ndevice = \"/dev/ttyUSB0\"\nevery = 5\n");
    for (id, name) in [(1, "shoulder"), (2, "elbow")] {
        let host_id = format!("host-id = {}", 9 + id);
        text += &robot::motor(id, name, "arm", &host_id).replace("\"mit\"", "\"gim\"");
    }
    let mut robot = Robot::new(robot::settings(&text), 1);
    robot.steps(500);
    assert_eq!([0, 1].map(|joint| robot.mode(joint)), [MotorMode::Idle; 2]);
    robot.disturb("arm power-off");
    robot.steps(200);
    assert_eq!(condition(&mut robot, 0), BusCondition::Held);
    robot.disturb("arm ok");
    robot.steps(1500);
    assert_eq!(condition(&mut robot, 0), BusCondition::Active);
    assert_eq!([0, 1].map(|joint| robot.mode(joint)), [MotorMode::Idle; 2]);
}

// The supply that motors report, on virtual time.

/// Legs of motors that report their supply, and one of motors that do not.
const FACTORY: &str = include_str!("../../../config/factory-simulated.toml");
/// Motors in native mode.
const NATIVE: &str = include_str!("../../../config/arm-native.toml");

fn reporting(robot: &Robot) -> Vec<usize> {
    let motors = robot.settings.motors.iter().enumerate();
    let reports = motors.filter(|(_, motor)| motor.capabilities.supply != SupplyReport::None);
    reports.map(|(joint, _)| joint).collect()
}

fn supply(robot: &mut Robot, joints: &[usize], volts: f64) {
    for &joint in joints {
        let name = robot.settings.motors[joint].name.clone();
        robot.disturb(&format!("{name} voltage {volts}"));
    }
}

fn voltages(robot: &mut Robot, joints: &[usize]) -> Vec<f32> {
    joints.iter().map(|&joint| (robot.joint(joint).supply_voltage * 10.0).round() / 10.0).collect()
}

/// Three CANSimple motors that are stopped below 22 V.
fn leg() -> Robot {
    let motor = |id, name| family::motor(family::CANSIMPLE, id, name, "");
    let text = String::from(
        "[cycle]\nrate-hz = 800\n[safety]\nsupply-warn-v = 23\nsupply-stop-v = 22\n\
         [[bus]]\nname = \"can\"\ntype = \"simulated\"\n",
    ) + &motor(1, "hip")
        + &motor(2, "thigh")
        + &motor(3, "knee");
    let mut robot = Robot::new(robot::settings(&text), 3);
    robot.steps(2000);
    robot
}

/// Follows setpoints for this many cycles, or until a stop.
fn follow(robot: &mut Robot, joints: &[JointSetpoint], cycles: usize) {
    for _ in 0..cycles {
        if robot.cause().is_none() {
            robot.follow(joints);
        }
    }
}

#[test]
fn motors_report_supply_at_rest_and_in_motion() {
    for text in [FACTORY, NATIVE] {
        let mut robot = Robot::new(robot::settings(text), 3);
        robot.steps(3000);
        let joints = reporting(&robot);
        assert!(joints.len() >= 3, "{joints:?}");
        supply(&mut robot, &joints, 30.5);
        robot.steps(1500);
        assert_eq!(voltages(&mut robot, &joints), vec![30.5; joints.len()], "at rest");
        let others = (0..robot.settings.motors.len()).filter(|joint| !joints.contains(joint));
        assert!(others.clone().all(|joint| robot.joint(joint).supply_voltage.is_nan()));

        let setpoints = robot.activate();
        supply(&mut robot, &joints, 31.5);
        follow(&mut robot, &setpoints, 1500);
        assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
        assert_eq!(voltages(&mut robot, &joints), vec![31.5; joints.len()], "in motion");
        for joint in 0..robot.settings.motors.len() {
            let name = robot.settings.motors[joint].name.clone();
            let joint = robot.joint(joint);
            assert_eq!((joint.fault, joint.missed, joint.implausible), (0, 0, 0), "{name}");
        }
    }
}

#[test]
fn silent_motor_has_no_supply() {
    let mut robot = leg();
    assert!(robot.joint(1).supply_voltage > 20.0 && robot.joint(1).supply_current.is_finite());
    robot.disturb("thigh power-off");
    robot.steps(500);
    assert!(robot.joint(1).supply_voltage.is_nan() && robot.joint(1).supply_current.is_nan());
}

#[test]
fn low_supply_warns_then_stops_and_forbids_motion() {
    let mut robot = leg();
    let setpoints = robot.activate();
    supply(&mut robot, &[0, 1, 2], 22.5);
    follow(&mut robot, &setpoints, 4000);
    assert_eq!(robot.phase(), Phase::Active, "a warning stops nothing");
    let warnings = |robot: &mut Robot| {
        let events = robot.take_events().into_iter();
        events.filter(|event| matches!(event, Event::Supply { .. })).collect::<Vec<_>>()
    };
    let seen = warnings(&mut robot);
    assert!(matches!(seen[..], [Event::Supply { group: 0, is_low: true, .. }]), "{seen:?}");

    supply(&mut robot, &[0, 1, 2], 21.5);
    follow(&mut robot, &setpoints, 1500);
    assert_eq!(robot.phase(), Phase::Active, "a dip of less than 2 s");
    follow(&mut robot, &setpoints, 2400);
    assert_eq!(robot.cause(), Some(Cause::SupplyLow));
    robot.steps(3000);
    assert_eq!(robot.phase(), Phase::Disarmed);
    robot.operate(Operation::Reset).unwrap();
    robot.claim().unwrap();
    (0..50).for_each(|_| robot.follow(&setpoints));
    assert_eq!(robot.operate(Operation::Enable), Err(Refusal::SupplyLow));

    supply(&mut robot, &[0, 1, 2], 24.0);
    (0..4000).for_each(|_| robot.follow(&setpoints));
    robot.operate(Operation::Enable).unwrap();
    let seen = warnings(&mut robot);
    assert!(matches!(seen[..], [Event::Supply { is_low: false, .. }]), "{seen:?}");
}

/// A sensor that is wrong, or the wires of one motor.
#[test]
fn one_motor_alone_stops_nothing() {
    let mut robot = leg();
    let setpoints = robot.activate();
    supply(&mut robot, &[1], 13.0);
    follow(&mut robot, &setpoints, 6000);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
    assert_eq!(voltages(&mut robot, &[1]), [13.0]);
}
