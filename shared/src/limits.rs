//! Every bound of the messages and services, by name. Changing one changes a layout: give the message a new version with it.

/// Most joints of one robot.
pub const JOINTS_MAX: usize = 64;
/// Most groups of joints.
pub const GROUPS_MAX: usize = 8;
/// Most buses.
pub const BUSES_MAX: usize = 16;
/// Most ports for setpoints at one time: one for the owner of each group, and one to spare for its next owner.
pub const CONTROLLERS_MAX: usize = 16;
/// Most processes that may watch the states.
pub const WATCHERS_MAX: usize = 32;
/// Most processes that may record every cycle.
pub const RECORDERS_MAX: usize = 2;
/// Cycles that a recorder may be late: a quarter of a second of a 1 kHz cycle.
pub const RECORDS_KEPT: usize = 256;
/// Most processes that may send administrative requests.
pub const ADMINS_MAX: usize = 32;
/// Places among `ADMINS_MAX` that are kept for processes that only want an emergency stop.
pub const STOP_PLACES: usize = 4;
/// Requests of one client that may be under way at a time: an ordinary one, and an emergency stop beside it.
pub const REQUESTS_PER_CLIENT: usize = 2;
/// Most indicators of one motor.
pub const INDICATORS_MAX: usize = 22;
/// Most joints whose indicators are published: the first in the configuration whose motors have some.
pub const INDICATOR_JOINTS_MAX: usize = 16;
/// Most latency histograms: one for each joint and each group, and those of the whole robot.
pub const HISTOGRAMS_MAX: usize = JOINTS_MAX + GROUPS_MAX + 16;
/// Most bytes of text in an answer to an administrative request.
pub const ANSWER_BYTES_MAX: usize = 64 * 1024;
/// Most bytes of a joint, group, bus or instance name.
pub const NAME_BYTES_MAX: usize = 32;

/// The instance of a robot that has only one.
pub const DEFAULT_INSTANCE: &str = "robot";
