//! The estimate of a motor's heat.

use super::*;

const RATED: f32 = 7.5;
const LIMIT: f32 = 20.0;
/// Twice the rated torque for ten seconds.
const COLD: Heat = Heat { value: 0.0, rated: RATED, peak: 22.0, time_constant: 10.0 / TWICE_RATED };
const CYCLE: f64 = 1e-3;

/// Gives `wanted` for `seconds`, as far as it is allowed. Returns what was allowed last.
fn give(heat: &mut Heat, wanted: f32, seconds: u32) -> f32 {
    for _ in 0..seconds * 1000 {
        heat.warm(wanted.min(heat.allowed(LIMIT)), CYCLE);
    }
    heat.allowed(LIMIT)
}

#[test]
fn the_rated_torque_is_allowed_for_good_and_no_torque_cools() {
    let mut heat = COLD;
    assert!(give(&mut heat, RATED, 1000) >= RATED);
    assert!(heat.value <= 1.0 && !heat.is_overheated());
    give(&mut heat, 0.0, 100);
    assert!(heat.value < 0.1, "{heat:?}");
    assert_eq!(heat.allowed(LIMIT), LIMIT);
}

#[test]
fn twice_the_rated_torque_warms_a_cold_winding_in_the_time_that_is_configured() {
    let mut heat = COLD;
    for _ in 0..10_000 {
        heat.warm(2.0 * RATED, CYCLE);
    }
    assert!((heat.value - 1.0).abs() < 1e-3, "{heat:?}");
}

#[test]
fn too_much_torque_sinks_to_the_rated_and_never_warms_the_winding_beyond_it() {
    let mut heat = COLD;
    assert!(give(&mut heat, 2.0 * RATED, 5) >= 2.0 * RATED, "for a while it is allowed");
    assert!(
        give(&mut heat, 2.0 * RATED, 5) < 2.0 * RATED,
        "not as long as a winding without a model would take"
    );
    assert!(give(&mut heat, LIMIT, 20) < 1.01 * RATED);
    assert!(heat.value <= 1.0, "{heat:?}");
}

#[test]
fn a_torque_that_no_motor_has_warms_it_as_much_as_its_peak() {
    let [mut reported, mut given] = [COLD; 2];
    for _ in 0..50 {
        reported.warm(-225.0, CYCLE);
        given.warm(22.0, CYCLE);
    }
    assert_eq!(reported, given);
    assert!(reported.value < 0.05, "garbage for 50 ms is no heat: {reported:?}");
}

#[test]
fn a_limit_below_the_rated_torque_stays_the_limit() {
    let mut heat = COLD;
    for _ in 0..100 {
        heat.warm(10.0 * RATED, 1.0);
    }
    assert!(heat.is_overheated());
    assert_eq!(heat.allowed(5.0), 5.0);
}
