//! The bus plan: how much of a cycle each bus needs for the motors on it.
//!
//! Every motor is asked once in every cycle, and at most one motor of a bus is asked for its faults besides. On CAN a
//! frame's length depends on its bits: the worst case says what must fit, the length without stuffing bits what a reply
//! cannot be faster than.

use motord_bus::Duration;
use motord_bus::arithmetic::{SERIAL_FRAME_BITS, utilisation, wire_time};

use crate::drive;
use crate::settings::{BusKind, BusSettings, MotorSettings, Settings};

/// Above this fraction of the worst case a bus has too little left for retransmissions and faults: worth a warning.
pub const WORST_CASE_SOUND: f64 = 0.8;

/// The load of one bus in a cycle. Utilisations are fractions of a cycle: 1.0 leaves no gap.
#[derive(Debug, Clone, PartialEq)]
pub struct BusPlan {
    /// Number of its motors.
    pub motors: usize,
    /// Commands and replies of all its motors, every stuffing bit included.
    pub worst_case_utilisation: f64,
    /// The same frames without stuffing bits.
    pub unstuffed_utilisation: f64,
    /// The worst case of a cycle in which one motor is asked for its faults too.
    pub fault_poll_utilisation: f64,
    /// Wire time of the frames of a cycle without stuffing bits: the last reply cannot be complete before.
    pub expected: Duration,
    /// Least wire time of one command and its reply.
    pub transaction_least: Duration,
    /// Most wire time of one command and its reply.
    pub transaction_worst: Duration,
}

impl BusPlan {
    /// The plan of every bus, in the order of `settings.buses`.
    #[must_use]
    pub fn of(settings: &Settings) -> Vec<Self> {
        let plan = |(index, bus): (usize, &BusSettings)| {
            let motors = settings.motors.iter().filter(|motor| motor.bus == index);
            let transactions: Vec<_> = motors.map(|motor| TransactionBits::of(motor, &bus.kind)).collect();
            Self::of_bus(&transactions, bus.kind.bitrate(), settings.cycle.rate_hz)
        };
        settings.buses.iter().enumerate().map(plan).collect()
    }

    fn of_bus(transactions: &[TransactionBits], bitrate: u32, rate_hz: f64) -> Self {
        let worst_case: u32 = transactions.iter().map(|transaction| transaction.worst_case).sum();
        let unstuffed: u32 = transactions.iter().map(|transaction| transaction.unstuffed).sum();
        let fault_poll = transactions.iter().map(|transaction| transaction.worst_case).max().unwrap_or(0);
        let least = transactions.iter().map(|transaction| transaction.unstuffed).min().unwrap_or(0);
        Self {
            motors: transactions.len(),
            worst_case_utilisation: utilisation(worst_case, rate_hz, bitrate),
            unstuffed_utilisation: utilisation(unstuffed, rate_hz, bitrate),
            fault_poll_utilisation: utilisation(worst_case + fault_poll, rate_hz, bitrate),
            expected: wire_time(unstuffed, bitrate),
            transaction_least: wire_time(least, bitrate),
            transaction_worst: wire_time(fault_poll, bitrate),
        }
    }
}

/// Bits of a command and its reply.
struct TransactionBits {
    worst_case: u32,
    unstuffed: u32,
}

impl TransactionBits {
    fn of(motor: &MotorSettings, bus: &BusKind) -> Self {
        if matches!(bus, BusKind::Serial { .. }) {
            // A serial line stuffs nothing.
            return Self { worst_case: 2 * SERIAL_FRAME_BITS, unstuffed: 2 * SERIAL_FRAME_BITS };
        }
        let transaction = drive::transaction(motor);
        Self { worst_case: transaction.worst_case_bits(), unstuffed: transaction.unstuffed_bits() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIT: TransactionBits = TransactionBits { worst_case: 250, unstuffed: 206 };

    #[test]
    fn three_mit_motors_fill_a_bus_only_in_a_cycle_with_a_fault_poll() {
        let plan = BusPlan::of_bus(&[MIT, MIT, MIT], 1_000_000, 1000.0);
        assert_eq!((plan.worst_case_utilisation, plan.unstuffed_utilisation), (0.75, 0.618));
        assert_eq!(plan.fault_poll_utilisation, 1.0);
        assert_eq!(plan.expected, Duration::from_micros(618));
    }

    #[test]
    fn a_bus_without_motors_needs_nothing() {
        let plan = BusPlan::of_bus(&[], 1_000_000, 1000.0);
        assert_eq!((plan.fault_poll_utilisation, plan.expected), (0.0, Duration::ZERO));
    }
}
