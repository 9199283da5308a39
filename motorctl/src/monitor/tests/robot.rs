//! The robot of the tests: twelve joints that trot for 15 s, or stop 4 s before the end.

use super::super::picture::{Picture, Reading, Sample};
use crate::advice::Advice;
use crate::imu_report::ImuReport;
use crate::joint_report::JointReport;
use crate::report::{BusReport, GroupReport, ProcessReport, RobotReport, StopReport};
use motord_client::{
    Cause, Fault, GroupDescription, GroupHistory, JointDescription, JointLimits, MotorMode, Percentiles,
    Process, RobotDescription, State, StateMessage, Telemetry,
};
use std::f64::consts::TAU;
use std::sync::Arc;

pub(super) const LEGS: [(&str, &str); 4] =
    [("fl", "front-left"), ("fr", "front-right"), ("rl", "rear-left"), ("rr", "rear-right")];
/// Readings, ten a second.
const STEPS: u64 = 151;
/// The reading in which a stopped robot stops.
const STOP: u64 = 110;
const LIMITS: [[f32; 2]; 3] = [[-0.9, 0.9], [-1.0, 2.6], [-2.7, -0.5]];

/// Position, velocity and torque of a joint `seconds` after the first reading.
fn motion(joint: usize, seconds: f64) -> [f32; 3] {
    let (leg, part) = (joint / 3, joint % 3);
    let (middle, swing) = [(-0.0004, 0.0), (0.8, 0.22), (-1.6, 0.3)][part];
    let phase = TAU * (0.8 * seconds + if leg == 0 || leg == 3 { 0.0 } else { 0.5 });
    let velocity = TAU * 0.8 * swing * phase.cos();
    [middle + swing * phase.sin(), velocity, 0.3 * velocity - 0.1].map(|value| value as f32)
}

/// The reading after which nothing moves any more.
fn moving(step: u64, is_stopped: bool) -> u64 {
    if is_stopped { step.min(STOP) } else { step }
}

fn quantities(joint: usize, step: u64, is_stopped: bool) -> [f32; 3] {
    let [position, velocity, torque] = motion(joint, moving(step, is_stopped) as f64 / 10.0);
    if moving(step, is_stopped) < step { [position, 0.0, 0.0] } else { [position, velocity, torque] }
}

fn limits(joint: usize) -> JointLimits {
    JointLimits { position: LIMITS[joint % 3], velocity: 12.0, torque: 20.0, ..JointLimits::default() }
}

fn joint(index: usize, is_stopped: bool) -> JointReport {
    let (prefix, bus) = LEGS[index / 3];
    let [position, velocity, torque] = quantities(index, STEPS - 1, is_stopped);
    JointReport {
        name: format!("{prefix}-{}", ["hip", "thigh", "knee"][index % 3]),
        bus: bus.to_owned(),
        mode: "active",
        position_rad: Some(position),
        velocity_rad_s: Some(velocity),
        torque_nm: Some(torque),
        position_range_rad: limits(index).position,
        torque_max_nm: limits(index).torque,
        temperature_celsius: Some(41.0 + (index % 3) as f32),
        valid: true,
        ..JointReport::default()
    }
}

/// The right side 8.6° down, the nose 4° up.
fn imu() -> ImuReport {
    ImuReport {
        name: "base".to_owned(),
        roll_pitch_yaw: Some([0.15, -0.07, 0.3]),
        angular_velocity: Some([0.1, 0.2, 0.2]),
        acceleration: Some([0.0, 0.0, 9.81]),
        age_us: Some(1_200.0),
        valid: true,
        ..ImuReport::default()
    }
}

pub(super) fn bus(name: &str) -> BusReport {
    BusReport {
        name: name.to_owned(),
        condition: "active",
        sent: 36_000,
        received: 36_000,
        ..BusReport::default()
    }
}

fn percentiles(p50: f64) -> Percentiles {
    Percentiles { count: 12_000, p50, p99: 4.0 * p50, p99_9: 20.0 * p50, max: 80.0 * p50 }
}

fn telemetry() -> Telemetry {
    let owner = Some(Process { pid: 4711, program: "trot".to_owned() });
    Telemetry {
        wake_latency_us: percentiles(27.0),
        reply_latency_us: percentiles(8.0),
        cycle_us: percentiles(9.0),
        setpoint_age_us: percentiles(3.0),
        control_latency_us: percentiles(11.0),
        publication_us: percentiles(2.0),
        joints: vec![percentiles(8.0); 12],
        groups: vec![GroupHistory { owner, phase_cycle: 300, ..GroupHistory::default() }],
        ..Telemetry::default()
    }
}

fn robot(joints: &[JointReport]) -> RobotDescription {
    let described = |(index, joint): (usize, &JointReport)| JointDescription {
        name: joint.name.clone(),
        bus: joint.bus.clone(),
        limits: limits(index),
        ..JointDescription::default()
    };
    RobotDescription {
        instance: "demo".to_owned(),
        joints: joints.iter().enumerate().map(described).collect(),
        groups: vec![GroupDescription { name: "legs".to_owned(), joints: (0..12).collect() }],
        frame_times: vec![125e-6; 4],
        ..RobotDescription::default()
    }
}

/// Twelve joints that trot.
pub(super) fn trotting() -> Reading {
    let joints: Vec<JointReport> = (0..12).map(|index| joint(index, false)).collect();
    let legs = GroupReport {
        name: "legs".to_owned(),
        phase: "active",
        lease: Some(77),
        setpoint_age_us: Some(214.3),
        ..GroupReport::default()
    };
    let robot = Arc::new(robot(&joints));
    let report = RobotReport {
        instance: "demo".to_owned(),
        version: "0.1.0".to_owned(),
        pid: 4242,
        rate_hz: 1000.0,
        cycle: 20_000,
        realtime: true,
        groups: vec![legs],
        joints,
        buses: LEGS.iter().map(|(_, name)| bus(name)).collect(),
        imus: vec![imu()],
        ..RobotReport::default()
    };
    Reading { robot, report, telemetry: telemetry(), ..Reading::default() }
}

/// The same robot, stopped by `cause` of a joint or by a process.
pub(super) fn stopped_by(cause: Cause, joint: Option<usize>) -> Reading {
    let mut reading = trotting();
    let report = &mut reading.report;
    report.joints = (0..12).map(|index| self::joint(index, true)).collect();
    report.joints.iter_mut().for_each(|joint| joint.mode = "idle");
    report.emergency_stop = cause == Cause::EmergencyStop;
    let described = joint.map(|joint| &reading.robot.joints[joint]);
    let steps = Advice::new(Some(cause), "demo", "legs", described.map(|joint| joint.name.as_str()), false);
    report.groups[0].phase = "disarmed";
    report.groups[0].setpoint_age_us = Some(12_300_000.0);
    report.groups[0].stop = Some(StopReport {
        cause: cause.name(),
        sentence: cause.sentence(),
        joint: described.map(|joint| joint.name.clone()),
        bus: described.filter(|_| cause == Cause::BusOff).map(|joint| joint.bus.clone()),
        first: None,
        asked_by: report
            .emergency_stop
            .then(|| ProcessReport { pid: 4815, program: Some("motorctl".to_owned()) }),
        advice: steps.to_string(),
        steps,
    });
    reading.telemetry.groups[0].stop_cycle = Some(20_000 - (STEPS - 1 - STOP) * 100);
    reading
}

/// A bus is off, and its motors do not answer.
pub(super) fn put_off(reading: &mut Reading) {
    let report = &mut reading.report;
    for joint in report.joints.iter_mut().filter(|joint| joint.bus == "rear-right") {
        joint.mode = "offline";
        (joint.valid, joint.age_cycles, joint.missed) = (false, 11_000, 11_000);
        (joint.position_rad, joint.velocity_rad_s, joint.torque_nm) = (None, None, None);
    }
    (report.buses[3].condition, report.buses[3].errors) = ("off", 258);
}

/// The motor of a joint reports a fault.
pub(super) fn put_in_fault(reading: &mut Reading, joint: usize) {
    reading.report.joints[joint].mode = "fault";
    reading.report.joints[joint].faults = vec!["over-voltage".to_owned()];
}

/// Its emergency stop is latched, one motor is in fault, one bus is off.
pub(super) fn stopped() -> Reading {
    let mut reading = stopped_by(Cause::EmergencyStop, None);
    (reading.report.realtime, reading.report.overruns) = (false, 3);
    put_in_fault(&mut reading, 5);
    put_off(&mut reading);
    reading
}

/// Returns the picture of a robot after 15 s, which end with `reading`.
pub(super) fn picture(reading: Reading) -> Picture {
    let mut picture = Picture::default();
    for step in 0..STEPS {
        let mut reading = reading.clone();
        reading.report.cycle -= 100 * (STEPS - 1 - step);
        let frames = 300 * step as u32;
        for bus in &mut reading.report.buses {
            (bus.sent, bus.received) = (frames, frames);
        }
        let wave = (step % 8) as f64;
        reading.sample = Sample { wake: 20.0 + wave, cycle: 700.0, reply: 100.0 * wave, age: 200.0 };
        reading.state = Some(state(&reading, step));
        picture.take(reading);
    }
    picture
}

/// Returns the state of the joints that `reading`, the last one, has at `step`.
fn state(reading: &Reading, step: u64) -> State {
    let stop = reading.report.groups.first().and_then(|group| group.stop.as_ref());
    let is_over = stop.is_some() && step >= STOP;
    let mut message = StateMessage {
        cycle: reading.report.cycle,
        tick_ns: reading.report.cycle * 1_000_000,
        ..Default::default()
    };
    (message.joint_count, message.group_count) = (reading.report.joints.len().min(12) as u32, 1);
    for (index, (joint, report)) in message.joints.iter_mut().zip(&reading.report.joints).enumerate() {
        let is_lost = is_over && report.mode == MotorMode::Offline.name();
        joint.flags = if is_lost { 0 } else { u32::MAX };
        [joint.position, joint.velocity, joint.torque] = quantities(index, step, stop.is_some());
        let is_faulty = report.mode == MotorMode::Fault.name() && step >= STOP + 10;
        joint.fault = if is_faulty { Fault::OverVoltage.bit() } else { 0 };
    }
    let cause =
        stop.filter(|_| is_over).and_then(|stop| Cause::ALL.iter().find(|cause| cause.name() == stop.cause));
    message.groups[0].cause = cause.map_or(0, |cause| cause.code());
    message.groups[0].cause_joint = u32::MAX;
    State::from(&message)
}
