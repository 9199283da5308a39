//! Simulated motors and buses that behave as the vendor documents specify.
//!
//! A [`SimulatedBus`] is a [`motord_bus::Bus`]: CAN with arbitration and exact frame lengths, or a
//! serial line. Each of its [`Motor`]s has mechanics (rotor behind a gear, friction, a torque
//! limit, a winding that heats up). Its drive speaks MIT of one of several vendors, or native GIM.
//! [`Behaviour`] holds the choices that the documents leave open. [`FaultVerb`]s inject faults.
//! [`couple`] leaves the mechanics to an external [`Plant`], such as a physics engine.
//!
//! The caller passes the time in, and a seed determines all random numbers. The same seed and the
//! same calls give the same run. The physics steps on a fixed grid of 50 µs, so the number of calls
//! changes nothing. A gap of more than 0.2 s takes longer steps.
//!
//! ```
//! use motord_bus::{Bus, Frame, FrameId, Inbox, Instant};
//! use motord_simulator::{BusSettings, FaultVerb, MotorSettings, SimulatedBus};
//!
//! let hip = MotorSettings { name: "fl-hip".into(), id: 1, host_id: 0x101, ..Default::default() };
//! let mut bus = SimulatedBus::new(BusSettings::default(), vec![hip], 7);
//! let (start, later) = (Instant::ZERO, Instant::from_nanos(1_000_000));
//! let stop = Frame::classic(FrameId::new(1).unwrap(), [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD]);
//!
//! bus.send(start, &[stop]);
//! let mut inbox = Inbox::new();
//! bus.receive(later, &mut inbox);
//! assert_eq!(inbox.arrivals().len(), 1);
//! assert_eq!(bus.motor("fl-hip").unwrap().velocity(), 0.0);
//!
//! let off: FaultVerb = "fl-hip off".parse()?;
//! bus.inject(later, &off)?;
//! # Ok::<(), Box<dyn core::error::Error>>(())
//! ```
//!
//! The crate shares no codec with the host side, because it tests that side. It does not simulate
//! sensor noise, encoder offsets, backlash, the loops' gains (which have no documented unit), or
//! error counters of the CAN controllers.
//!
//! Units are SI: rad, rad/s, N·m, N·m/rad, N·m·s/rad, A, V, Ω, H, kg·m², s; temperatures in °C.
//! Positions, velocities and torques are those of the output shaft.

mod body;
#[cfg(feature = "bridge")]
mod bridge;
mod bus;
mod contention;
mod dialect;
mod drive_facts;
mod drives;
mod fault;
mod imu;
#[cfg(feature = "bridge")]
mod imu_console;
mod imu_node;
#[cfg(feature = "bridge")]
mod imu_port;
mod imu_stream;
mod length;
mod line;
mod motor;
mod plant;
#[cfg(feature = "bridge")]
mod port;
mod random;
mod serial;
mod settings;
mod shared;
#[cfg(feature = "bridge")]
mod store;
mod wire;

pub use body::Shaft;
#[cfg(feature = "bridge")]
pub use bridge::Bridge;
pub use bus::SimulatedBus;
pub use dialect::Dialect;
pub use drive_facts::{DriveFacts, FaultFacts, TemperatureFacts};
pub use fault::{Fault, FaultTarget, FaultVerb, InjectError, VERBS, Verb, VerbError};
pub use imu::{Imu, ImuOutput, ImuValues};
pub use imu_node::{ImuNodeDevice, ImuNodeSettings};
#[cfg(feature = "bridge")]
pub use imu_port::ImuPort;
pub use imu_stream::{ImuStream, ImuVendor};
pub use length::frame_bits;
pub use motor::{Mode, Motor};
pub use plant::{Plant, PlantBus, couple};
#[cfg(feature = "bridge")]
pub use port::SerialPort;
pub use serial::SerialSlave;
pub use settings::{
    Behaviour, BeyondRange, BusSettings, DurationEnd, HostLoss, InFault, Medium, MotorSettings, OtherBitrate,
    Persistence, ReplyTiming, RobStrideFirmware,
};
pub use shared::SharedBus;
#[cfg(feature = "bridge")]
pub use store::Store;
pub use wire::{Direction, Recorded};
