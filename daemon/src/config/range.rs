//! The default and the range of every number in the configuration: one table.
//!
//! The defaults are those of a real robot and cautious; a machine that is shared with others must widen the times.

/// What a number is when it is not written, and what it may be when it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Range {
    pub(super) default: f64,
    pub(super) min: f64,
    pub(super) max: f64,
}

const fn range(default: f64, min: f64, max: f64) -> Range {
    Range { default, min, max }
}

impl Range {
    /// The same range with the default that a motor's model or the cycle gives.
    pub(super) const fn or(self, default: f64) -> Self {
        Self { default, ..self }
    }
}

// [cycle]
/// One motor alone fills a bus of 1 Mbit/s at 4 kHz.
pub(super) const RATE_HZ: Range = range(1000.0, 1.0, 4000.0);
/// 99 belongs to the kernel's own threads.
pub(super) const PRIORITY: Range = range(80.0, 1.0, 98.0);
pub(super) const MAX_LATENESS_MS: Range = range(5.0, 0.1, 1000.0);
/// A stall of a second, where `max-lateness-ms` allows it, is no overload yet.
pub(super) const MAX_SKIPPED_PERCENT: Range = range(50.0, 1.0, 100.0);
pub(super) const REPLY_DEADLINE_PERCENT: Range = range(80.0, 10.0, 95.0);
pub(super) const BUSY_POLL_US: Range = range(0.0, 0.0, 1000.0);

// [exchange]
pub(super) const LEAD_US: Range = range(150.0, 10.0, 10_000.0);

// [safety]
pub(super) const SETPOINT_TIMEOUT_MS: Range = range(20.0, 1.0, 1000.0);
pub(super) const DAMP_SECONDS: Range = range(2.0, 0.1, 30.0);
pub(super) const REST_VELOCITY_RAD_S: Range = range(0.2, 0.01, 10.0);
pub(super) const LOST_CYCLES: Range = range(10.0, 3.0, 1000.0);
pub(super) const START_JUMP_RAD: Range = range(0.1, 0.001, 3.2);
pub(super) const START_RAMP_MS: Range = range(100.0, 10.0, 10_000.0);
pub(super) const START_TIMEOUT_MS: Range = range(1000.0, 10.0, 10_000.0);
pub(super) const FAULT_POLL_HZ: Range = range(10.0, 0.0, 100.0);
/// The dead man's switch waits for as long as a cycle may be late, and for this many more.
pub(super) const DEADMAN_CYCLES: f64 = 2.0;
pub(super) const DEADMAN_MS: Range = range(7.0, 0.5, 10_000.0);

// [[bus]]
/// Bit/s of classic CAN.
pub(super) const BITRATE: Range = range(1_000_000.0, 10_000.0, 1_000_000.0);
/// GIM document 3.1.1: 921600 8N1.
pub(super) const BAUD: Range = range(921_600.0, 9_600.0, 4_000_000.0);

// [[motor]]
/// A byte names the motor in a reply, and 0xFF begins every special MIT frame.
pub(super) const ID: Range = range(1.0, 1.0, 254.0);
/// A motor's id plus this is a reply id that is unique and yields to every command.
pub(super) const HOST_ID_OFFSET: f64 = 256.0;
pub(super) const HOST_ID_CAN: Range = range(256.0, 0.0, 2047.0);
/// The header of a serial frame has one byte for the receiver (GIM document, table 3).
pub(super) const HOST_ID_SERIAL: Range = range(0.0, 0.0, 255.0);
pub(super) const TORQUE_CONSTANT_NM_PER_A: Range = range(0.1, 0.001, 2.0);
pub(super) const GEAR_RATIO: Range = range(8.0, 1.0, 200.0);
pub(super) const RATED_TORQUE_NM: Range = range(1.0, 0.01, 1000.0);
pub(super) const PEAK_TORQUE_NM: Range = range(1.0, 0.01, 1000.0);
/// The windings of this series are small against their housings.
pub(super) const OVERLOAD_SECONDS: Range = range(10.0, 0.1, 600.0);
pub(super) const MAX_VELOCITY_RAD_S: Range = range(30.0, 0.1, 1000.0);
pub(super) const OFFSET_RAD: Range = range(0.0, -12.5, 12.5);
pub(super) const DAMPING_KD: Range = range(2.0, 0.0, 5.0);

// [motor.limits]: the protocol's scale bounds the first four.
pub(super) const TORQUE_NM: Range = range(1.0, 0.01, f64::MAX);
pub(super) const VELOCITY_RAD_S: Range = range(60.0, 0.01, f64::MAX);
pub(super) const KP_MAX: Range = range(100.0, 0.0, f64::MAX);
pub(super) const KD_MAX: Range = range(5.0, 0.0, f64::MAX);
/// Where a motor whose behaviour at the end of its range is not known should not go further.
pub(super) const CAUTIOUS_POSITION_RAD: f64 = 12.0;
/// Of a motor whose position code wraps round.
pub(super) const UNWRAPPED_POSITION_RAD: f64 = 1000.0;
/// Slews by default: the full torque within 20 ms, the full gains within 50 ms.
pub(super) const TORQUE_SLEW_PER_S: f64 = 50.0;
pub(super) const GAIN_SLEW_PER_S: f64 = 20.0;
pub(super) const TORQUE_SLEW_NM_PER_S: Range = range(100.0, 0.1, 1_000_000.0);
pub(super) const KP_SLEW_PER_S: Range = range(1000.0, 0.1, 1_000_000.0);
pub(super) const KD_SLEW_PER_S: Range = range(100.0, 0.1, 1_000_000.0);
pub(super) const TEMPERATURE_DERATE_CELSIUS: Range = range(70.0, 0.0, 120.0);
pub(super) const TEMPERATURE_MAX_CELSIUS: Range = range(90.0, 10.0, 120.0);
/// Derating takes at least this much by default.
pub(super) const DERATING_CELSIUS: f64 = 10.0;
pub(super) const FOLLOWING_ERROR_RAD: Range = range(1.0, 0.001, 25.0);

// [motor.simulation]
pub(super) const INITIAL_POSITION_RAD: Range = range(0.0, -1000.0, 1000.0);
pub(super) const LOAD_INERTIA_KG_M2: Range = range(0.01, 0.0, 100.0);
pub(super) const REPLY_LATENCY_US: Range = range(50.0, 0.0, 100_000.0);
