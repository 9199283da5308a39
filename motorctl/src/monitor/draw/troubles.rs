//! The obstacles to a reset, with remedies: buses that are not up, faults, motors that do not
//! answer.

use super::super::picture::Reading;
use super::text::{alarm, bold, wrapped};
use crate::advice::motorctl;
use crate::joint_report::JointReport;
use crate::report::{BusReport, RobotReport};
use motord_client::{BusCondition, Cause, MotorMode};
use ratatui::text::Line;

/// Largest numbers of listed faults and names. Others are counted.
const FAULTS_MAX: usize = 3;
const NAMES_MAX: usize = 4;

/// Returns the obstacles; none for a healthy robot.
pub(super) fn lines(reading: &Reading, width: usize) -> Vec<Line<'static>> {
    let down = reading.report.buses.iter().filter(|bus| bus.remedy().is_some());
    let mut lines: Vec<Line<'static>> = down.flat_map(|bus| of_bus(bus, width)).collect();
    lines.extend(faults(reading, width));
    let offline = reading.report.joints.iter().filter(|joint| joint.mode == MotorMode::Offline.name());
    let silent: Vec<&str> = offline
        .filter(|joint| !is_on_bus_that_is_down(reading, joint))
        .map(|joint| joint.name.as_str())
        .collect();
    if !silent.is_empty() {
        let verb = if silent.len() == 1 { "does" } else { "do" };
        let stops = reading.report.groups.iter().filter_map(|group| group.stop.as_ref());
        let is_loss = stops.into_iter().any(|stop| stop.cause == Cause::FramesLost.name());
        let help = if is_loss { Cause::FramesLost } else { Cause::MotorLost }.advice();
        lines.extend(sentence(&format!("{} {verb} not answer. {help}.", listed(&silent)), width));
    }
    lines
}

/// Returns whether the lines include the advice for a stop of `cause`.
pub(super) fn advise(reading: &Reading, cause: &str) -> bool {
    let RobotReport { buses, joints, .. } = &reading.report;
    let is = |known: Cause| cause == known.name();
    let has_bus = |remedy_of: Cause| buses.iter().any(|bus| bus.remedy() == Some(remedy_of.advice()));
    let is_offline = |joint: &JointReport| joint.mode == MotorMode::Offline.name();
    is(Cause::BusOff) && has_bus(Cause::BusOff)
        || is(Cause::BusGone) && has_bus(Cause::BusGone)
        || is(Cause::PowerLost) && has_bus(Cause::PowerLost)
        || (is(Cause::MotorLost) || is(Cause::FramesLost))
            && joints.iter().any(|joint| is_offline(joint) && !is_on_bus_that_is_down(reading, joint))
        || is(Cause::MotorFault) && joints.iter().any(|joint| joint.mode == MotorMode::Fault.name())
}

/// A motor on a bus that is down cannot answer. The bus is listed already. On a held bus some motors
/// may answer again, and then the others are missing.
fn is_on_bus_that_is_down(reading: &Reading, joint: &JointReport) -> bool {
    let RobotReport { buses, joints, .. } = &reading.report;
    let is_offline = |other: &JointReport| other.mode == MotorMode::Offline.name();
    let is_silent = |bus: &str| joints.iter().filter(|other| other.bus == bus).all(is_offline);
    let is_down = |bus: &BusReport| bus.condition != BusCondition::Held.name() || is_silent(&bus.name);
    buses.iter().any(|bus| bus.name == joint.bus && bus.remedy().is_some() && is_down(bus))
}

fn of_bus(bus: &BusReport, width: usize) -> Vec<Line<'static>> {
    let help = bus.remedy().unwrap_or_default();
    sentence(&format!("Bus {} is {}. {help}.", bus.name, bus.condition), width)
}

fn faults(reading: &Reading, width: usize) -> Vec<Line<'static>> {
    let is_in_fault = |joint: &&JointReport| joint.mode == MotorMode::Fault.name();
    let faulty: Vec<&JointReport> = reading.report.joints.iter().filter(is_in_fault).collect();
    let mut lines = Vec::new();
    for joint in faulty.iter().take(FAULTS_MAX) {
        let faults = if joint.faults.is_empty() { "a fault".to_owned() } else { joint.faults.join(", ") };
        lines.extend(sentence(
            &format!("{} reports {faults}. Remove its cause, then paste:", joint.name),
            width,
        ));
        let motorctl = motorctl(&reading.report.instance);
        lines.push(bold(format!("  {motorctl} fault clear {}", joint.name)).into());
    }
    if faulty.len() > FAULTS_MAX {
        let names: Vec<&str> = faulty[FAULTS_MAX..].iter().map(|joint| joint.name.as_str()).collect();
        lines.extend(sentence(&format!("{} also report faults.", listed(&names)), width));
    }
    lines
}

fn listed(names: &[&str]) -> String {
    if names.len() <= NAMES_MAX {
        return names.join(", ");
    }
    format!("{} and {} more joints", names[..NAMES_MAX - 1].join(", "), names.len() + 1 - NAMES_MAX)
}

fn sentence(text: &str, width: usize) -> Vec<Line<'static>> {
    wrapped(text, width, 2).into_iter().map(|line| alarm(line).into()).collect()
}
