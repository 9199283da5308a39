//! ODrive's CANSimple, as an ODrive Pro, S1 and Micro speak it (firmware 0.6), over CAN. Ids have 11
//! bits: the node in the upper six, the command in the lower five.
//!
//! Sources: the messages and enumerations that ODrive publishes with its ROS node
//! (`can_simple_messages.hpp`, `odrive_enums.h`), and its manual, chapter "CAN Protocol". None of them is
//! confirmed on hardware.
//!
//! - Every frame has eight bytes, but the one that clears errors has one. Values are little endian. Positions, velocities and torques are
//!   those of the rotor.
//! - No command is answered. The drive sends its state by itself: a heartbeat every 100 ms and the
//!   estimates of its encoder every 10 ms from the factory; torques, temperatures and supply where it is
//!   set up so.
//! - No command has stiffness and damping. The drive holds a position with the gains in its memory.
//! - SteadyWin's drivers descend from it and speak [`cansimple`](crate::cansimple). There 0x006 sets the
//!   node id and 0x01F saves; here they are the address and the boot loader.

#[cfg(feature = "commissioning")]
pub(crate) mod commissioning;
#[cfg(feature = "drive")]
mod drive;
mod family;
mod frame;

#[cfg(feature = "drive")]
pub use drive::ODriveDialect;
pub use family::FAMILY;
pub use frame::{AxisState, Command, ControlMode, Heartbeat, Reply, ReportedState, faults};

/// Largest node id. 63 addresses a drive without one.
pub const NODE_MAX: u8 = 62;
