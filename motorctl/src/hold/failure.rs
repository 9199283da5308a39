//! The errors of `motorctl hold`.

use crate::exit_status;
use crate::failure::CommandFailure;

/// Why nothing was held.
#[derive(Debug, thiserror::Error)]
pub(crate) enum HoldFailure {
    /// The name is neither a joint's nor a group's.
    #[error("there is no joint or group {name}. The groups are {groups}; the joints are {joints}")]
    Unknown {
        /// The name.
        name: String,
        /// The names of the groups.
        groups: String,
        /// The names of the joints.
        joints: String,
    },
    /// No name was given, and the robot has several groups.
    #[error("the robot has the groups {0}: name one of them, or a joint")]
    Ambiguous(String),
    /// The joint is not in any group.
    #[error("{0} belongs to no group: add it to a [[group]] of the configuration")]
    Ungrouped(String),
    /// The joint is excluded.
    #[error("{joint} is excluded, so its motor receives only stop frames: `{include}` ends that")]
    Excluded {
        /// The joint.
        joint: String,
        /// The command that ends the exclusion.
        include: String,
    },
    /// The sine would leave the joint's position limits.
    #[error(
        "{joint} is at {position:.2} rad, and with ±{amplitude} rad it would leave its limits, {lower:.2} to {upper:.2}: \
         choose a smaller --amplitude-rad, or move the joint by hand"
    )]
    OutOfRange {
        /// The joint.
        joint: String,
        /// Its position, rad.
        position: f32,
        /// Amplitude, rad.
        amplitude: f32,
        /// Lowest position, rad.
        lower: f32,
        /// Highest position, rad.
        upper: f32,
    },
    /// The sine would be faster than the joint's velocity limit.
    #[error(
        "the sine needs {peak:.2} rad/s, and {joint} may turn at {limit:.2} rad/s: choose a smaller --amplitude-rad or \
         --frequency-hz"
    )]
    TooFast {
        /// The joint.
        joint: String,
        /// Largest speed of the sine, rad/s.
        peak: f32,
        /// The limit, rad/s.
        limit: f32,
    },
    /// The group was stopped, and the cause is still latched.
    #[error(
        "{group} was stopped for {cause}: {sentence} {remedy}. Then run `{commands}`, and this command again"
    )]
    Stopped {
        /// The group.
        group: String,
        /// The name of the cause.
        cause: String,
        /// The sentence of the cause.
        sentence: String,
        /// The remedy.
        remedy: String,
        /// The commands that end the stop.
        commands: String,
    },
    /// Another process owns the group.
    #[error(
        "{group} belongs to another process{owner}: end that program first, or take the group from it with `{release}`"
    )]
    Owned {
        /// The group.
        group: String,
        /// The process and its program, in brackets.
        owner: String,
        /// The command that removes the owner.
        release: String,
    },
}

impl CommandFailure for HoldFailure {
    fn status(&self) -> u8 {
        match self {
            // The state of the robot is the reason, not the options.
            Self::Stopped { .. } | Self::Owned { .. } | Self::Excluded { .. } => 1,
            _ => exit_status::USAGE,
        }
    }
}
