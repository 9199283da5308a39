//! Commissioning: transactions with motors, one at a time, over any [`Bus`](motord_bus::Bus) and
//! any clock.
//!
//! A [`Link`] sends a request and waits for its answer. [`Native`], [`Mit`], [`Private`], [`Axis`],
//! [`Rmd`] and [`Odrive`] are the typed commands of the six protocols. [`scan`] finds the motors of a bus without moving one. [`Apply`]
//! writes a configuration and reads back every item.
//!
//! Rules of every transaction:
//! - One request is open. Frames that arrived before it are dropped.
//! - A native answer repeats the command and the number of the request
//!   ([`Reply::answers`](crate::gim::Reply::answers)), and has the motor's host id where
//!   that is known. A frame that equals the request is its echo, never an answer.
//! - A request is repeated only where repeating is harmless: reads, stops, and storing. Each native
//!   retry waits twice as long as the one before.
//! - A write is always read back, even when its answer was lost.
//! - A refusal contains the vendor's term and number. Numbers without a term are kept.
//!
//! Not for the real-time path: calls block until the motor answers or the time limit passes, and
//! allocate.
//!
//! ```
//! use motord_bus::{Instant, VirtualClock};
//! use motord_protocol::commissioning::{Link, Native};
//! use motord_simulator::{BusSettings, Dialect, MotorSettings, SimulatedBus};
//!
//! let knee = MotorSettings { id: 3, host_id: 0x103, dialect: Dialect::Gim, ..Default::default() };
//! let bus = SimulatedBus::new(BusSettings::default(), vec![knee], 1);
//! let mut link = Link::can(bus, VirtualClock::new(Instant::ZERO));
//! let mut motor = Native::new(&mut link, 3, None);
//! assert_eq!(motor.version()?, 0x0001_0203);
//! # Ok::<(), motord_protocol::commissioning::Error>(())
//! ```

mod apply;
mod scan;
mod survey;

pub use crate::cansimple::commissioning::Axis;
pub use crate::gim::commissioning::{CALIBRATION_MAX, Confirmation, Native, NextMotor, answers};
pub use crate::link::{Error, Formats, LASTING, Link, LinkEvent, MotorRefusal, Unprompted, Wire};
pub use crate::mit::commissioning::Mit;
pub use crate::mit::registers::{Registers, ends};
pub use crate::myactuator::commissioning::Rmd;
pub use crate::odrive::commissioning::Odrive;
pub use crate::reported::{Question, ReportedMotor, ReportedProtocol};
pub use crate::robstride::commissioning::Private;
pub use apply::{Apply, Change, Event, Failed, bitrate_unit, changes, check_value};
pub use scan::{
    Family, Found, LISTEN, Progress, Report, Scan, identify, identify_by, identify_node, identify_private,
    is_taken, scan,
};
pub use survey::{Survey, constants, survey};
