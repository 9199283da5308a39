//! The errors of `motorctl tune`.

use crate::exit_status::{DATA, INTERRUPTED, IO, USAGE};
use crate::failure::CommandFailure;
use crate::tune::timing::Site;
use motord_identify::{PlanError, StepError, Swing};
use std::io;
use std::path::PathBuf;

/// Why a joint was not tuned.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TuneFailure {
    /// The steps do not fit the limits.
    #[error("{joint} is not tuned: {reason}")]
    Steps {
        /// The joint.
        joint: String,
        /// The limit.
        reason: StepError,
    },
    /// Steps with the proposed gains do not fit the limits.
    #[error("{joint}: the proposed gains are not tried: {reason}")]
    Untried {
        /// The joint.
        joint: String,
        /// The limit.
        reason: StepError,
    },
    /// The joint does not come to rest. Its group is stopped.
    #[error(
        "{joint} is not tuned: {reason}, with kp {kp:.1}, kd {kd:.2}. Its group is stopped, after damping what moves: check that the joint \
         is free and that its weight turns it little (torque of the weight / kp), and choose a lower --bandwidth or --kp, {calmer}, or a \
         longer --seconds",
        calmer = .site.calmer()
    )]
    Swung {
        /// The joint.
        joint: String,
        /// Its motion.
        reason: Swing,
        /// N·m/rad.
        kp: f64,
        /// N·m·s/rad.
        kd: f64,
        /// Where the gains act.
        site: Site,
    },
    /// The proposed gains reached a limit of the torque. The group is stopped.
    #[error(
        "{joint}: the proposed gains are not good: with kp {kp:.1}, kd {kd:.2} the torque reached its limit. Its group is stopped, after damping \
         what moves: choose a lower --bandwidth or a smaller --step-rad"
    )]
    Torque {
        /// The joint.
        joint: String,
        /// N·m/rad.
        kp: f64,
        /// N·m·s/rad.
        kd: f64,
    },
    /// The given gains leave too little.
    #[error(
        "{joint} is not tuned: kp {kp:.1} and kd {kd:.2} leave a phase margin of {degrees:.0}°, and {least:.0}° are the least for a step: choose {advice}"
    )]
    Margin {
        /// The joint.
        joint: String,
        /// N·m/rad.
        kp: f64,
        /// N·m·s/rad.
        kd: f64,
        /// Phase margin, degrees.
        degrees: f64,
        /// The least, degrees.
        least: f64,
        /// Other gains.
        advice: String,
    },
    /// The identification does not fit the limits, or ended.
    #[error(
        "{joint} is not identified: {reason}. Run `motorctl identify {joint} --json >FILE` with a smaller --amplitude-rad, and give \
         --identified FILE. A native motor needs the MIT protocol for that (`motorctl set-protocol`)"
    )]
    Identification {
        /// The joint.
        joint: String,
        /// The limit.
        reason: String,
    },
    /// Its inertia is not known.
    #[error(
        "{joint} is not tuned: its inertia is not known{why}. Write it with `motorctl identify {joint} --json >FILE`, and give --identified FILE. \
         A native motor needs the MIT protocol for that (`motorctl set-protocol`)"
    )]
    Inertia {
        /// The joint.
        joint: String,
        /// The reason, after a colon.
        why: String,
    },
    /// A bound permits no gains.
    #[error("{joint} is not tuned: no bandwidth is possible: {reason}")]
    Forbidden {
        /// The joint.
        joint: String,
        /// The bound.
        reason: String,
    },
    /// Too much of the motion is missing.
    #[error("{joint} is not tuned: {reason}")]
    Lost {
        /// The joint.
        joint: String,
        /// The loss, and what to do.
        reason: String,
    },
    /// The file of the identification cannot be used.
    #[error(
        "{path}: {reason}. Write it with `motorctl identify {joint} --json >{path}`, while its motor has the MIT protocol"
    )]
    Identified {
        /// The file.
        path: String,
        /// The joint.
        joint: String,
        /// The reason.
        reason: String,
    },
    /// A signal ended the motion.
    #[error("{0} is not tuned: the motion was interrupted. Its group is stopped, after damping what moves")]
    Interrupted(String),
    /// Two results for the standard output.
    #[error("--json and the picture exclude each other on the standard output: give the picture a file")]
    Outputs,
    /// The picture cannot be drawn.
    #[error("the picture cannot be drawn: {0}")]
    Picture(String),
    /// The picture cannot be written.
    #[error("{}: {source}", .path.display())]
    Output {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: io::Error,
    },
}

impl TuneFailure {
    /// The motor of a joint does not answer.
    pub(crate) fn silent(joint: &str) -> Self {
        let reason = "it does not answer: `motorctl status` shows its motor".to_owned();
        Self::Lost { joint: joint.to_owned(), reason }
    }

    /// The identification of a joint does not fit, or ended.
    pub(crate) fn identification(joint: &str, reason: PlanError) -> Self {
        let reason = match reason {
            PlanError::Narrow { position, limits: [lower, upper], .. } => format!(
                "it is at {position:.2} rad, where its limits, {lower:.2} to {upper:.2} rad, leave too little"
            ),
            PlanError::Left { position, limits: [lower, upper] } => {
                format!(
                    "it reached {position:.2} rad, at the end of its limits, {lower:.2} to {upper:.2} rad"
                )
            }
            PlanError::Fast { velocity, limit } => {
                format!("it reached {velocity:.2} rad/s, and its limit is {limit:.2} rad/s")
            }
        };
        Self::Identification { joint: joint.to_owned(), reason }
    }
}

impl CommandFailure for TuneFailure {
    fn status(&self) -> u8 {
        match self {
            Self::Steps { .. } | Self::Margin { .. } | Self::Outputs => USAGE,
            Self::Identified { .. } => DATA,
            Self::Interrupted(_) => INTERRUPTED,
            Self::Output { .. } => IO,
            Self::Untried { .. }
            | Self::Swung { .. }
            | Self::Torque { .. }
            | Self::Identification { .. }
            | Self::Inertia { .. }
            | Self::Forbidden { .. }
            | Self::Lost { .. }
            | Self::Picture(_) => 1,
        }
    }
}
