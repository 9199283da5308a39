//! The client of motord: connect, own a group of joints, read its states, send setpoints.
//!
//! # Start
//!
//! The daemon runs, and knows each joint by name: `motord run --config config/quadruped-simulated.toml` is a simulated robot,
//! the instance `demo` with the group `legs`. Positions are in rad, velocities in rad/s, torques in N·m, stiffness in N·m/rad,
//! damping in N·m·s/rad, on the joint's side of the gear. This is `client/examples/start.rs`:
//!
//! ```no_run
#![doc = include_str!("../examples/start.rs")]
//! ```
//!
//! `client/examples/controller.rs` is a whole controller in less than 100 lines: copy it, and put your control law into it. It
//! runs at 500 Hz, and survives stops, faults, lost motors and restarts of the daemon; a signal ends it with the motors
//! stopped. `cargo run -p motord-client --example controller -- --instance demo --group legs` moves the simulated robot; `hold`, `sine` and
//! `watch` are smaller.
//!
//! # States and setpoints, by name
//!
//! [`State::of`] gives the joints of a claimed group. [`Claim::set`] gives a joint its setpoint, which stays until the next
//! call for that joint. [`Claim::commit`] sends those of the whole group: call it in every cycle of the controller, also when
//! nothing changed.
//!
//! ```no_run
//! # use motord_client::{Claim, Client, Error, Setpoint};
//! # fn turn(client: &Client, claim: &mut Claim) -> Result<(), Error> {
//! let state = client.wait(std::time::Duration::from_secs(1))?;
//! let leg = state.of(claim)?;
//! let knee = leg.joint("fl-knee")?;
//! println!("{:?} rad, {:?} N·m, faults: {}", knee.position(), knee.torque(), knee.faults);
//!
//! // Stiffness and damping pull towards a position and a velocity; a torque is added.
//! claim.set("fl-knee", Setpoint::impedance(-1.5, 0.2, 40.0, 1.0, 0.0))?;
//! claim.set("fl-hip", Setpoint::hold(leg.position("fl-hip")?, 40.0, 1.0))?;
//! claim.commit()?;
//! # Ok(())
//! # }
//! ```
//!
//! A joint that was never heard has no position: [`Joint::position`] is `None`, and [`GroupView::position`] an error. The
//! limits of a joint are [`Claim::limits`]; the limits that changed its last setpoint are [`Joint::limits`].
//!
//! A controller that has its own order of joints looks each joint up once, and uses [slots](Slot) instead of names:
//!
//! ```no_run
//! # use motord_client::{Claim, Error, Setpoint, State};
//! # fn policy(observed: &[f32]) -> Vec<f32> { observed.to_vec() }
//! # fn turn(claim: &mut Claim, state: &State) -> Result<(), Error> {
//! let order = claim.slots(["fl-knee", "fl-thigh", "fl-hip"])?; // Once after each claim.
//!
//! let legs = state.of(claim)?;
//! let observed = order.iter().map(|&joint| legs.position(joint)).collect::<Result<Vec<_>, _>>()?;
//! for (&joint, position) in order.iter().zip(policy(&observed)) {
//!     claim.set(joint, Setpoint::hold(position, 40.0, 1.0))?;
//! }
//! claim.commit()?;
//! # Ok(())
//! # }
//! ```
//!
//! # Timing
//!
//! The daemon's cycle has a fixed grid, 1 ms by default. In cycle *k* it sends commands, collects the replies, and
//! publishes the states; shortly before cycle *k + 1*, by the *lead* (`lead-us`, 20 µs by default), it fetches the
//! newest setpoint of each owner:
//!
//! ```text
//!  tick k            states of k                       setpoints   tick k+1
//!    | commands, replies | <---- the controller's time ---> | lead   |
//! ```
//!
//! A controller wakes with [`Client::wait`]. If it sends its setpoint before the lead begins, the next cycle uses the setpoint:
//! one cycle from measurement to command. The cycle after that uses a later setpoint, which is counted in [`Group::late`].
//!
//! | call | for | costs |
//! |---|---|---|
//! | [`Client::wait`] | a turn in every cycle | a wake-up: 5 to 60 µs, the more the deeper the processor sleeps |
//! | [`Client::wait_cycles`] | a turn in every `n`th cycle; the others wake nobody | a wake-up of some 100 µs |
//! | [`Client::spin`] | a turn in every cycle, at once | a core of its own |
//!
//! The newest setpoint holds until the daemon's setpoint timeout (`description().setpoint_timeout`), after which the group is
//! damped, stopped, and stays so until someone resets it. [`Group::setpoint_age`] is the age of the setpoint in use.
//!
//! # When things end
//!
//! - The controller ends, crashes or hangs: the group is damped and stopped. Dropping a [`Claim`] releases the group.
//! - The daemon ends or hangs: calls return [`Error::NotRunning`] or [`Error::Silent`] once states have stopped for
//!   50 ms, or for five cycles if they take longer. Its motors are damped without the controller's help.
//! - The daemon is back: the next call returns [`Error::Restarted`] once, then the [`Client`] works again, with the new
//!   [`Client::description`]. Claims are void and must be made anew; no joint moves before someone enables its group.
//! - The group is stopped, for an emergency stop, a fault, a lost motor: [`GroupView::stop`] is the cause, with the joint and
//!   what to do. The claim stays valid. Leave the reset to a person who has looked at the robot.
//! - The controller was not heard for too long, or somebody took the group away: [`Error::ClaimLost`].
//!
//! [`Error::is_transient`] tells the errors after which the same program may try again from those that need a person:
//!
//! ```no_run
//! # use motord_client::Error;
//! # fn control() -> Result<(), Error> { Ok(()) }
//! // `control` connects, claims, and runs until its first error.
//! while let Err(error) = control() {
//!     eprintln!("{error}");
//!     if !error.is_transient() {
//!         std::process::exit(error.exit_status().into());
//!     }
//!     std::thread::sleep(std::time::Duration::from_millis(500));
//! }
//! ```
//!
//! # Threads
//!
//! Threads may share a [`Client`], and a [`Claim`] may be handed to another thread. Each state is given to one of the threads
//! that ask for it: two control loops need a client each. A thread that waits for a state delays neither the setpoints nor the
//! emergency stop of another thread. Ordinary requests of one client run one after the other; an emergency stop waits for none.

#![forbid(unsafe_code)]

mod claim;
mod client;
mod error;
mod group_view;
mod injection;
mod joint;
mod link;
mod members;
mod records;
mod setpoint;
mod state;
mod stop;

pub use claim::Claim;
pub use client::Client;
pub use error::{About, Error, Stop};
pub use group_view::GroupView;
pub use injection::{FaultError, inject_fault};
pub use joint::{Faults, Joint, Limits};
pub use members::{JointKey, Slot};
pub use motord_ports::instance::{InstanceError, RUNTIME_DIR_VARIABLE};
pub use motord_ports::service::{Obstacle, Part, ServiceError};
pub use motord_ports::stop_socket::{RunningInstance, StopError, running as running_instances};
pub use motord_shared::DEFAULT_INSTANCE;
pub use motord_shared::description::{
    ControlLatency, EncodedHistogram, GroupDescription, GroupHistory, Histograms, JointDescription,
    JointLimits, Percentiles, Process, RobotDescription, Telemetry,
};
pub use motord_shared::{
    Applied, BusCondition, Cause, CycleRecord, Fault, Field, Indicator, JointSetpoint, JointState, Kind,
    Lease, Limit, MotorMode, Operation, Phase, Refusal, Rejection, SetpointMode, joint_state,
};
pub use records::Records;
pub use setpoint::Setpoint;
pub use state::{Bus, Group, Indicators, State};
pub use stop::emergency_stop;
