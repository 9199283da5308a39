//! The client of motord: connect, claim a group of joints, read its states, send setpoints.
//!
//! # Start
//!
//! The daemon runs, and knows each joint by name.
//! `motord run --config config/quadruped-simulated.toml` simulates a robot: the instance `demo`
//! with the group `legs`. Positions are in rad, velocities in rad/s, torques in N·m, stiffness in
//! N·m/rad, damping in N·m·s/rad, on the joint's side of the gear. This is
//! `client/examples/start.rs`:
//!
//! ```no_run
#![doc = include_str!("../examples/start.rs")]
//! ```
//!
//! `client/examples/controller.rs` is a whole controller in about 100 lines: copy it, and
//! insert your control law. It runs at 500 Hz and survives stops, faults, lost motors and restarts
//! of the daemon. A signal ends it with the motors stopped.
//! `cargo run -p motord-client --example controller -- --instance demo --group legs` moves the
//! simulated robot. `hold`, `sine` and `watch` are smaller.
//!
//! # States and setpoints, by name
//!
//! [`State::of`] returns the joints of a claimed group. [`Claim::set`] stores the setpoint of a
//! joint until the next call for that joint. [`Claim::commit`] sends those of the whole group: call
//! it in every cycle of the controller, even if nothing changed.
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
//! // The hip keeps the setpoint of `claim.hold`.
//! claim.commit()?;
//! # Ok(())
//! # }
//! ```
//!
//! A joint holds a *fixed* position. A loop that sends the position which it has just measured sends
//! no torque against a load: the joint gives way a little in each cycle, and a standing robot falls.
//! Read the position once, before the loop, as [`Claim::hold`] does.
//!
//! A joint without a reply has no position: [`Joint::position`] is `None`, and
//! [`GroupView::position`] an error. [`Claim::limits`] returns the limits of a joint.
//! The library sends each value as it is, and the daemon clamps one that is beyond a limit, such as
//! a stiffness above `kp-max`. [`Joint::limits`] contains the limits that changed the last setpoint,
//! [`Joint::applied`] the command, and [`Joint::clamped`] the number of cycles with a clamped value.
//!
//! A controller with another order of joints, such as that of a URDF, queries them once, and uses
//! [slots](Slot) instead of names. [`Claim::order`] requires each joint of the group once:
//!
//! ```no_run
//! # use motord_client::{Claim, Error, Setpoint, State};
//! # fn policy(observed: &[f32]) -> Vec<f32> { observed.to_vec() }
//! # fn turn(claim: &mut Claim, state: &State) -> Result<(), Error> {
//! let order = claim.order(["fl-knee", "fl-thigh", "fl-hip"])?; // Once after each claim.
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
//! The daemon's cycle has a fixed grid, 1 ms by default. In cycle *k* it sends commands, collects
//! the replies, and publishes the states. Shortly before cycle *k + 1*, by the *lead* (`lead-us`,
//! 20 µs by default), it fetches the newest setpoint of each owner:
//!
//! ```text
//!  tick k            states of k                       setpoints   tick k+1
//!    | commands, replies | <---- the controller's time ---> | lead   |
//! ```
//!
//! A controller wakes with [`Client::wait`]. If it sends its setpoint before the lead begins, the
//! next cycle uses the setpoint: one cycle from measurement to command. Otherwise the cycle after
//! that uses it, and [`Group::late`] counts it.
//!
//! | call | for | costs |
//! |---|---|---|
//! | [`Client::wait`] | a turn in every cycle | a wake-up: 5 to 60 µs, the more the deeper the processor sleeps |
//! | [`Client::wait_cycles`] | a turn in every `n`th cycle, without wake-ups by other cycles | a timer, and the wake-up of `wait` |
//! | [`Client::spin`] | a turn in every cycle, with the shortest delay | a dedicated core |
//!
//! The newest setpoint holds until the daemon's setpoint timeout
//! (`description().setpoint_timeout`). Then the daemon damps and stops the group, until a reset.
//! [`Group::setpoint_age`] is the age of the setpoint in use. A slow controller may have the daemon
//! move to its setpoints: [`Claim::set_horizon`].
//!
//! # Ends and errors
//!
//! - The controller ends, crashes or hangs: the daemon damps and stops the group. Dropping a
//!   [`Claim`] releases the group.
//! - The daemon ends or hangs: calls return [`Error::NotRunning`] or [`Error::Silent`] after 50 ms
//!   without a state, or after five cycles if they are longer. Its motors are damped without the
//!   controller.
//! - The daemon restarts: the next call returns [`Error::Restarted`] once. Then the [`Client`]
//!   works again, with the new [`Client::description`]. Claims are void: claim again. No joint
//!   moves before its group is enabled.
//! - The daemon stops the group, for an emergency stop, a fault or a lost motor:
//!   [`GroupView::stop`] returns the cause, with the joint and advice, and [`Claim::commit`] fails with
//!   it. The claim stays valid. Leave the reset to a person who has inspected the robot.
//! - The daemon received no setpoint for too long: it stops the group and ends the claim.
//!   [`State::of`] and [`Claim::commit`] return [`Error::Stopped`] with the time without a setpoint and
//!   the timeout.
//! - Another process released the group: [`Error::ClaimLost`].
//! - The process was forked from the one that connected: [`Error::Forked`].
//!
//! [`Error::is_transient`] separates the errors after which the same program may retry from those
//! that need a person:
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
//! Threads may share a [`Client`], and move a [`Claim`] to another thread. Only one of the waiting
//! threads gets each state: two control loops need a client each. A thread that waits for a state
//! delays neither the setpoints nor the emergency stop of another thread. Ordinary requests of one
//! client run one after the other; an emergency stop waits for none.
//!
//! # Forks
//!
//! A [`Client`], [`Claim`], [`ImuPublisher`] and [`Records`] belong to the process that created them.
//! In a forked process each call that needs the daemon returns [`Error::Forked`], and dropping them
//! does nothing: the parent keeps its claim. The child may connect anew: a fork waits until no thread
//! connects or disconnects. States, names and limits
//! are plain values and stay readable. [`Client::emergency_stop`] and
//! [`Client::emergency_stop_signal_safe`] stop the robot from a forked process too.
//!
//! The check makes no system call. It detects each child that has a copy of the memory, whichever
//! call created it. A child that shares the memory, one of `vfork` or of `clone` with `CLONE_VM`, is
//! not detected: it may only call `execve` or `_exit`.

#![forbid(unsafe_code)]

mod claim;
mod client;
mod error;
mod group_view;
mod imu;
mod injection;
mod joint;
mod lateness;
mod link;
mod members;
mod publisher;
mod records;
mod setpoint;
mod state;
mod stop;
mod view;

pub use claim::Claim;
pub use client::Client;
pub use error::{About, Error, Stop};
pub use group_view::GroupView;
pub use imu::Imu;
pub use injection::{FaultError, inject_fault};
pub use joint::{Faults, Joint, Limits};
pub use lateness::Lateness;
pub use members::{JointKey, Slot};
pub use motord_ports::instance::{InstanceError, RUNTIME_DIR_VARIABLE};
pub use motord_ports::running::{Listeners, RunningInstance, listeners, running as running_instances};
pub use motord_ports::service::{Obstacle, Part, ServiceError};
pub use motord_ports::stop_socket::StopError;
#[doc(hidden)]
pub use motord_ports::{Creator, Forked};
pub use motord_shared::description::{
    ControlLatency, EncodedHistogram, FirstStop, GroupDescription, GroupHistory, Histograms, ImuDescription,
    JointDescription, JointLimits, NetworkLatency, Percentiles, Process, RobotDescription, Telemetry,
};
pub use motord_shared::{
    Applied, BusCondition, Cause, CycleRecord, DEFAULT_INSTANCE, Fault, Field, ImuContradiction, ImuState,
    Indicator, JointSetpoint, JointState, Kind, Lease, Limit, MotorMode, Operation, Phase, Refusal,
    Rejection, SetpointMode, StateMessage, joint_state,
};
pub use publisher::{ImuPublisher, ImuSample};
pub use records::{Records, named_telemetry};
pub use setpoint::Setpoint;
pub use state::{Bus, Group, Indicators, State};
pub use stop::{AllStopped, emergency_stop, emergency_stop_all, emergency_stop_for, emergency_stop_in};
