//! The daemon's measurements: histograms of all latencies ([`Distributions`]), their text for Prometheus ([`Metrics`]), and
//! the threads that hand that text out ([`Outputs`]).
//!
//! Nothing here is on the real-time path: the cycle and the ipc thread put their samples into rings, and the telemetry thread
//! takes them out. A sample that finds its ring full is counted, never waited for.

#![forbid(unsafe_code)]

mod distributions;
mod encoded;
mod histogram;
mod http;
mod latest;
mod metrics;
mod outputs;
mod textfile;

pub use distributions::Distributions;
pub use metrics::{Metrics, Names};
pub use outputs::{Outputs, Wanted};
