//! The SocketCAN bus on real kernels: virtual interfaces, two SJA1000 controllers on one bus, and a
//! serial adapter.
//!
//! These tests create and configure interfaces: they need root on a kernel with SocketCAN.
//! `verify/rigs/test-can` boots such kernels and runs them there; elsewhere they are reported as
//! ignored.

mod counting;
mod peer;
mod sja1000;
mod slcan;
mod vcan;

use motord_bus::IdFilter;
use motord_bus::conformance::HOST_IDS;
use motord_bus::socketcan::Settings;

const BITRATE: u32 = 1_000_000;

fn settings(interface: &str) -> Settings {
    let interface = interface.parse().expect("a valid name");
    Settings { host_ids: HOST_IDS.map(IdFilter::exact).to_vec(), ..Settings::new(interface, BITRATE) }
}
