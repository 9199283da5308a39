//! Identification of a joint: an excitation within its limits, and the fit of inertia and friction
//! to what was measured.
//!
//! ```text
//! inertia·ddq + viscous·dq + coulomb·sign(dq) + sine·sin(q) + cosine·cos(q) + offset = torque
//! ```
//!
//! No I/O and no clock: [`Plan`] returns the setpoint of a time, [`identify`] takes the samples
//! that were recorded meanwhile. Nothing is differentiated twice: the equation is integrated over
//! short windows with a weight that is zero at their ends (modulating functions), so that
//! derivatives act on the weight. Intervals come from residuals of blocks, which may be correlated,
//! and contain what the time stamps leave open. Terms that some joints have besides are taken where
//! they predict the motion better: friction that falls with the speed, a spring, cogging, a lag. A
//! joint that fits no equation is named.
//!
//! [`Steps`] returns the setpoints of small steps, [`Response`] what the joint did, and [`propose`]
//! stiffness and damping for a bandwidth.

#![forbid(unsafe_code)]

mod excitation;
mod fit;
mod interval;
mod law;
mod model;
mod normal;
mod regression;
mod response;
mod sample;
mod steps;
mod stiction;
mod terms;
mod tuning;
mod windows;

pub use excitation::{Command, Limits, Plan, PlanError, Shape, Stage};
pub use fit::{Identified, Note, identify};
pub use interval::{Value, Why};
pub use law::{KnownLoad, torque_scale};
pub use response::{Point, Response, Ring};
pub use sample::{Applied, BusTiming, Delay, Sample};
pub use steps::{Guard, StepError, Steps, Swing};
pub use terms::By;
pub use tuning::{
    Bound, Bounds, DAMPING_RATIO_MIN, Gains, Margins, PHASE_MARGIN_MIN, Plant, Proposal, Wanted, propose,
};
