//! The simulated IMU of a serial line, for a daemon in another process.

use motord_bus::{Duration, Instant};
use motord_protocol::imu::SerialProtocol;
use motord_settings::sensor::imu::{ImuSettings, ImuSource};
use motord_simulator::{Imu, ImuPort, ImuVendor};
use std::path::PathBuf;

/// Standard deviation of each axis of the angular velocity, rad/s.
const NOISE: f64 = 0.002;

/// Opens a pseudo terminal for an IMU on a serial line, with `link` to it; `None` for another IMU.
///
/// # Errors
///
/// The kernel provides no pseudo terminal, or the link cannot be created.
pub fn simulated_port(
    imu: &ImuSettings,
    start: Instant,
    link: Option<PathBuf>,
    seed: u64,
) -> Option<Result<ImuPort, std::io::Error>> {
    let ImuSource::Serial(line) = &imu.source else { return None };
    let vendor = match line.protocol {
        SerialProtocol::Hipnuc => ImuVendor::Hipnuc,
        SerialProtocol::Xsens => ImuVendor::Xsens,
    };
    let device = Imu::new(NOISE, 0.0, Duration::ZERO, seed);
    Some(ImuPort::open(imu.name.clone(), (device, vendor), (imu.rate_hz, line.baud), start, link))
}
