//! Robots of any size, for the benchmarks of the cycle.

use motord_harness::robot;
use motord_settings::settings::Settings;
use motord_shared::limits::BUSES_MAX;

/// Limit on the motors on a bus of 1 Mbit/s at 1 kHz, with room for a fault poll.
#[allow(dead_code, reason = "each benchmark has a size of its own")]
const MOTORS_PER_BUS: usize = 3;

/// Returns a robot with `motors` on the necessary number of buses. With too few buses, more motors
/// share one at half the rate.
#[allow(dead_code, reason = "as above")]
pub(crate) fn settings(motors: usize) -> Settings {
    let per_bus = motors.div_ceil(BUSES_MAX).max(MOTORS_PER_BUS);
    with(motors, per_bus, if per_bus > MOTORS_PER_BUS { 500 } else { 1000 })
}

/// Returns a robot with `motors`, at most `per_bus` on each bus.
pub(crate) fn with(motors: usize, per_bus: usize, rate_hz: u32) -> Settings {
    let mut text = format!("[cycle]\nrate-hz = {rate_hz}\n");
    for bus in 0..motors.div_ceil(per_bus) {
        text += &format!("[[bus]]\nname = \"bus-{bus}\"\ntype = \"simulated\"\n");
    }
    for motor in 0..motors {
        let (bus, id) = (motor / per_bus, (motor % per_bus + 1) as u8);
        text += &robot::motor(id, &format!("motor-{motor}"), &format!("bus-{bus}"), "");
    }
    robot::settings(&text)
}
