//! The section `[foxglove]`.

use serde::Deserialize;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

/// The WebSocket server for Foxglove, and for other viewers that speak its protocol.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct Foxglove {
    /// Start the server.
    pub(crate) enabled: bool,
    /// The address on which it listens.
    pub(crate) address: IpAddr,
    /// 0 for any free port.
    pub(crate) port: u16,
    /// Permit an address that other computers reach. Each of them may stop the robot.
    pub(crate) allow_remote: bool,
    /// The certificate of the server, PEM. With it, the server accepts TLS only.
    pub(crate) tls_certificate: Option<PathBuf>,
    /// The private key of the certificate, in PEM.
    pub(crate) tls_key: Option<PathBuf>,
    /// Messages per second of each joint, 0 for none. At most one per cycle.
    pub(crate) joints_hz: f64,
    /// As `joints_hz`, of each IMU.
    pub(crate) imus_hz: f64,
    /// As `joints_hz`, of each group, and of the cycle. A change of a group's phase, cause or owner
    /// is sent with the next state.
    pub(crate) groups_hz: f64,
    /// As `joints_hz`, of each bus.
    pub(crate) buses_hz: f64,
    /// Messages per second of the latencies, at most 10.
    pub(crate) latencies_hz: f64,
    /// Messages that wait for a slow viewer. Beyond them the server drops its oldest ones.
    pub(crate) backlog: u16,
    /// The URDF in the parameter `/robot_description`. `None`: that of `[ros2]`.
    pub(crate) robot_description: Option<PathBuf>,
    /// The folder with the packages whose files viewers may read, such as the meshes of the URDF:
    /// `package://NAME/FILE` is `NAME/FILE` in it.
    pub(crate) assets: Option<PathBuf>,
}

impl Default for Foxglove {
    fn default() -> Self {
        Self {
            enabled: false,
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            port: 8765,
            allow_remote: false,
            tls_certificate: None,
            tls_key: None,
            joints_hz: 50.0,
            imus_hz: 50.0,
            groups_hz: 10.0,
            buses_hz: 2.0,
            latencies_hz: 1.0,
            backlog: 1024,
            robot_description: None,
            assets: None,
        }
    }
}

impl Foxglove {
    /// Returns `true` if only this computer reaches the address.
    pub(crate) fn is_local(&self) -> bool {
        self.address.is_loopback()
    }
}
