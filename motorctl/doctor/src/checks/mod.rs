//! The checks. Each is a function of the files in a tree and of answers of the kernel.

mod devices;
mod interface;
mod limits;
mod processor;
mod serial;
mod system;

use crate::finding::Finding;
use crate::process;
use crate::robot::{Interface, Robot};
use crate::tree::Tree;
use motord_bus::socketcan::{Coalescing, InterfaceName, Link};

#[cfg(test)]
mod choice_tests;
#[cfg(test)]
mod tests;

/// Runs every check of the computer and of the buses of `robot`. Reads files, interface settings
/// and locks. Changes nothing, and sends nothing on a bus.
#[must_use]
pub fn all(tree: &Tree, robot: &Robot) -> Vec<Finding> {
    let daemon = process::daemon(tree, robot.daemon);
    let mut findings = vec![
        system::kernel(tree),
        limits::priority(tree, robot, daemon),
        limits::memory(tree, daemon),
        system::runtime(tree, robot),
        processor::isolation(tree, robot),
        processor::governor(tree, robot),
        processor::idle(tree, robot, daemon),
        system::clock_source(tree),
        system::timer_slack(tree, daemon),
        interface::ksoftirqd(tree, robot),
        system::daemon(tree, robot, daemon),
    ];
    for interface in &robot.interfaces {
        findings.extend(of_interface(tree, robot, interface));
    }
    for device in &robot.devices {
        findings.extend(serial::device(tree, device, daemon));
        findings.extend(devices::rules(tree, &robot.units, device));
    }
    findings.extend(robot.imus.iter().map(serial::imu));
    findings
}

fn of_interface(tree: &Tree, robot: &Robot, interface: &Interface) -> Vec<Finding> {
    let name = interface.name.as_str();
    let Ok(parsed) = name.parse::<InterfaceName>() else { return Vec::new() };
    let link = Link::read(parsed);
    let is_there = link.is_ok();
    let mut findings = vec![interface::link(interface, link, interface::can_restart(tree, name))];
    if is_there {
        findings.extend([
            interface::queue(tree, interface),
            interface::coalescing(name, Coalescing::read(parsed)),
            interface::interrupts(tree, robot, name),
            interface::owners(tree, name),
        ]);
    }
    findings
}
