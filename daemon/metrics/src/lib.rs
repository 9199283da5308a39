//! The daemon's measurements: histograms of all latencies ([`Distributions`]), their text for
//! Prometheus ([`Metrics`]), and the threads that serve that text ([`Outputs`]).
//!
//! Nothing here is on the real-time path. The cycle and the ipc thread push samples into rings, and
//! the telemetry thread pops them. A sample that finds its ring full is dropped and counted.

#![forbid(unsafe_code)]

mod connection;
mod distributions;
mod encoded;
mod histogram;
mod http;
mod latest;
mod metrics;
mod names;
mod outputs;
mod textfile;

pub use distributions::Distributions;
pub use metrics::Metrics;
pub use names::Names;
pub use outputs::{Outputs, Wanted};
