//! The commands `motorctl record`, `motorctl flight` and `motorctl plot`, and the reader of
//! recordings for `motorctl replay`.
//!
//! A separate process records. The daemon publishes each cycle without waiting, and the recorder
//! counts the cycles lost by delays of the disk.
//!
//! ```text
//! daemon ── shared memory, half a second ──▶ reading thread ── memory, some seconds ──▶ writing thread ──▶ disk
//!             full: lost, counted                               full: dropped, counted
//! ```

#![forbid(unsafe_code)]

mod bitmap;
mod disk;
mod failure;
mod flight;
mod picture;
mod plot;
mod record;
mod recording;
mod store;

pub use failure::RecorderFailure;
pub use flight::{FlightArguments, run as flight};
pub use motord_mcap::{Event, Events};
pub use picture::{Curve, Layout, Mark, Panel, Row, png, svg};
pub use plot::{PlotArguments, run as plot};
pub use record::{RecordArguments, run as record};
pub use recording::{Recording, concerns, is_mark};
