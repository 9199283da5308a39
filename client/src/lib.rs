//! The client of motord: connect, own a group of joints, read its states, send setpoints.
//!
//! # Start
//!
//! The daemon runs (`motord run`, or `motorctl demo` for a simulated robot), and knows each joint by name. Positions are
//! in rad, velocities in rad/s, torques in N·m, stiffness in N·m/rad, damping in N·m·s/rad, on the joint's side of the
//! gear. This program holds every joint of the group `all` where it is:
//!
//! ```no_run
//! use motord_client::{Client, DEFAULT_INSTANCE, Error, Phase, Setpoint};
//! use std::time::Duration;
//!
//! fn main() -> Result<(), Error> {
//!     let patience = Duration::from_millis(100);
//!     let client = Client::connect(DEFAULT_INSTANCE)?;
//!     let mut claim = client.claim("all")?;
//!
//!     let start = client.wait(patience)?;
//!     let hold: Vec<Setpoint> = claim
//!         .joints()
//!         .iter()
//!         .filter_map(|&joint| start.joint(joint))
//!         .map(|joint| Setpoint::impedance(joint.position, 0.0, 20.0, 0.5, 0.0))
//!         .collect();
//!
//!     // The daemon starts motors only for an owner that sends setpoints near to where the joints are.
//!     claim.send(&hold)?;
//!     claim.enable()?;
//!     loop {
//!         let state = client.wait(patience)?;
//!         claim.send(&hold)?;
//!         let group = state.group(claim.index());
//!         if group.is_some_and(|group| group.phase == Some(Phase::Disarmed) && group.latched) {
//!             return Ok(()); // Stopped: `group.cause` says why, and `claim.reset()` allows a new start.
//!         }
//!     }
//! }
//! ```
//!
//! The examples `watch`, `hold` and `sine` are complete programs: `cargo run -p motord-client --example sine`.
//!
//! # Timing
//!
//! The daemon's cycle has a fixed grid, 1 ms by default. In cycle *k* it sends commands, collects the replies, and
//! publishes the states; shortly before cycle *k + 1*, by the *lead* (`lead-us`, 150 µs by default), it fetches the
//! newest setpoint of each owner:
//!
//! ```text
//!  tick k            states of k                       setpoints   tick k+1
//!    | commands, replies | <---- the controller's time ---> | lead   |
//! ```
//!
//! A controller that wakes with [`Client::wait`] and has sent its setpoint before the lead begins is heard in the next
//! tick: one cycle from measurement to command. A later one is heard one tick later. [`Client::spin`] saves the wake-up
//! of some 50 µs for a core of its own. A controller may also be slower than the grid: the newest setpoint holds until
//! the daemon's setpoint timeout (`description().setpoint_timeout`), after which the group is damped, stopped, and stays so
//! until someone resets it. [`Group::setpoint_age`] is the age of the setpoint in use.
//!
//! # When things end
//!
//! - The controller ends, crashes or hangs: the group is damped and stopped. Dropping a [`Claim`] releases the group.
//! - The daemon ends or hangs: calls return [`Error::NotRunning`] or [`Error::Silent`] once states have stopped for
//!   50 ms. Its motors are damped without the controller's help.
//! - The daemon is back: the next call returns [`Error::Restarted`] once, then the [`Client`] works again, with the new
//!   [`Client::description`]. Claims are void and must be made anew; nothing moves before someone enables.
//!
//! # Threads
//!
//! Threads may share a [`Client`], and a [`Claim`] may be handed to another thread. Each state is given to one of the threads
//! that ask for it. A thread that waits for a state keeps no other from sending setpoints or from an emergency stop. Ordinary
//! requests of one client follow one another; an emergency stop waits for none of them.

#![forbid(unsafe_code)]

mod claim;
mod client;
mod error;
mod link;
mod setpoint;
mod state;

pub use claim::Claim;
pub use client::Client;
pub use error::{About, Error};
pub use motord_shared::DEFAULT_INSTANCE;
pub use motord_shared::description::{
    GroupDescription, GroupHistory, JointDescription, JointLimits, Percentiles, Process, RobotDescription,
    Telemetry,
};
pub use motord_shared::instance::{InstanceError, RUNTIME_DIR_VARIABLE};
pub use motord_shared::service::{Obstacle, Part, ServiceError};
pub use motord_shared::{
    Applied, BusCondition, Cause, Fault, Lease, Limit, MotorMode, Operation, Phase, Refusal, Rejection,
    SetpointMode,
};
pub use setpoint::Setpoint;
pub use state::{Bus, Faults, Group, Joint, Limits, State};
