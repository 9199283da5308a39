//! The commands `motorctl record`, `motorctl flight` and `motorctl plot`, and the reading of recordings for `motorctl replay`.
//!
//! Recording is a process of its own: the daemon hands out each cycle without waiting for anybody, and whatever the disk does is
//! counted here.
//!
//! ```text
//! daemon ── shared memory, half a second ──▶ reading thread ── memory, some seconds ──▶ writing thread ──▶ disk
//!             full: lost, counted                               full: dropped, counted
//! ```

#![forbid(unsafe_code)]

mod disk;
mod failure;
mod flight;
mod picture;
mod plot;
mod record;
mod recording;

pub use failure::RecorderFailure;
pub use flight::{FlightArguments, run as flight};
pub use plot::{PlotArguments, run as plot};
pub use record::{RecordArguments, run as record};
pub use recording::Recording;
