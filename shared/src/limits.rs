//! All limits of the messages and services, as constants. Changing one changes a layout: raise the
//! version of the message as well.

/// Limit on the joints of one robot.
pub const JOINTS_MAX: usize = 64;
/// Limit on the groups of joints.
pub const GROUPS_MAX: usize = 8;
/// Limit on the buses.
pub const BUSES_MAX: usize = 16;
/// Limit on the IMUs.
pub const IMUS_MAX: usize = 4;
/// Limit on the ports for the samples of external IMUs: one for the publisher of each, and one for
/// its next.
pub const IMU_PUBLISHERS_MAX: usize = 8;
/// Limit on those of one process: one for each IMU.
pub const IMU_PUBLISHERS_PER_PROCESS: usize = IMUS_MAX;
/// Samples of a publisher that wait for the daemon; a newer one replaces the oldest.
pub const IMU_SAMPLES_KEPT: usize = 32;
/// Limit on the ports for setpoints: one for the owner of each group, and one for its next owner.
pub const CONTROLLERS_MAX: usize = 16;
/// Limit on the processes that watch the states.
pub const WATCHERS_MAX: usize = 32;
/// Limit on the processes that record every cycle.
pub const RECORDERS_MAX: usize = 2;
/// Cycles buffered for a recorder: a quarter of a second of a 1 kHz cycle.
pub const RECORDS_KEPT: usize = 256;
/// Limit on the processes that send administrative requests.
pub const ADMINS_MAX: usize = 32;
/// Slots of `ADMINS_MAX` that are reserved for emergency stops.
pub const STOP_SLOTS: usize = 4;
/// Limit on the open requests of one client: an ordinary one and an emergency stop.
pub const REQUESTS_PER_CLIENT: usize = 2;
/// Limit on the indicators of one motor.
pub const INDICATORS_MAX: usize = 22;
/// Limit on the joints whose indicators are published: the first ones with indicators in the
/// configuration.
pub const INDICATOR_JOINTS_MAX: usize = 16;
/// Limit on the latency histograms: one for each joint and each group, and those of the whole
/// robot.
pub const HISTOGRAMS_MAX: usize = JOINTS_MAX + GROUPS_MAX + 16;
/// Limit on the bytes of text in an answer to an administrative request.
pub const ANSWER_BYTES_MAX: usize = 48 * 1024;
/// Limit on the bytes of a joint, group, bus or instance name.
pub const NAME_BYTES_MAX: usize = 32;

/// Default name of an instance.
pub const DEFAULT_INSTANCE: &str = "robot";
