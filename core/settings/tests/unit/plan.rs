//! The part of a cycle that a bus needs.

use super::*;

const fn mit(cycle: u32) -> (u32, TransactionBits) {
    (cycle, TransactionBits { worst_case: 250, unstuffed: 206 })
}

#[test]
fn three_mit_motors_fill_a_bus_only_in_a_cycle_with_a_fault_poll() {
    let plan = BusPlan::of_turns(&[mit(0), mit(0), mit(0)], 1_000_000, 1000.0);
    assert_eq!((plan.worst_case_utilisation, plan.unstuffed_utilisation), (0.75, 0.618));
    assert_eq!(plan.fault_poll_utilisation, 1.0);
    assert_eq!(plan.expected, Duration::from_micros(618));
}

#[test]
fn a_bus_without_motors_needs_nothing() {
    let plan = BusPlan::of_turns(&[], 1_000_000, 1000.0);
    assert_eq!((plan.fault_poll_utilisation, plan.expected), (0.0, Duration::ZERO));
}

#[test]
fn motors_that_take_turns_need_the_bus_in_their_own_cycles_only() {
    let plan = BusPlan::of_turns(&[mit(0), mit(1), mit(0), mit(1)], 1_000_000, 1000.0);
    assert_eq!((plan.motors, plan.worst_case_utilisation), (4, 0.5));
    assert_eq!(plan.fault_poll_utilisation, 0.75);
}
