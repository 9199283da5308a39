//! The values that `motorctl imu set` writes, and its result.

use serde::Serialize;

/// The new values.
#[derive(Debug, Clone, Copy, Serialize, clap::Args)]
#[group(required = true, multiple = true)]
pub(crate) struct Values {
    /// Samples per second.
    #[arg(long, value_name = "HZ", value_parser = clap::value_parser!(u16).range(1..))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rate_hz: Option<u16>,
    /// Baud rate of the serial port.
    #[arg(id = "new_baud", long = "new-baud", value_name = "BIT/S", requires = "device")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) baud: Option<u32>,
    /// CANopen node, 1 to 64.
    #[arg(id = "new_node", long = "new-node", value_name = "NODE", requires = "bus")]
    #[serde(rename = "node_id", skip_serializing_if = "Option::is_none")]
    pub(crate) node: Option<u8>,
    /// Bit rate on the CAN bus: 125000, 250000, 500000 or 1000000.
    #[arg(id = "new_bitrate", long = "new-bitrate", value_name = "BIT/S", requires = "bus")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) bitrate: Option<u32>,
}

/// A device that was set.
#[derive(Debug, Serialize)]
pub(crate) struct Set {
    #[serde(rename = "type")]
    pub(crate) kind: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) device: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) bus: Option<String>,
    /// Node before the change.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) node_id: Option<u8>,
    pub(crate) asked: Values,
    /// Samples per second that arrive after the change.
    pub(crate) measured_hz: f64,
    /// Node or bit rate act after a power cycle of the device.
    pub(crate) needs_power_cycle: bool,
}

impl Set {
    /// Returns its port, or its interface and node.
    pub(crate) fn address(&self) -> String {
        match (&self.bus, self.node_id) {
            (Some(bus), Some(node)) => format!("{bus} node {node}"),
            _ => self.device.clone().unwrap_or_default(),
        }
    }

    /// Returns the sentence for a person.
    pub(crate) fn sentence(&self) -> String {
        let Values { rate_hz, baud, node, bitrate } = self.asked;
        let mut parts = Vec::new();
        let asked = rate_hz.map_or_else(String::new, |rate| format!("asked for {rate} Hz, "));
        parts.push(format!("{asked}{:.1} Hz arrive", self.measured_hz));
        parts.extend(baud.map(|baud| format!("at {baud} baud")));
        let mut text = format!("{}: {}", self.address(), parts.join(" "));
        let stored = [node.map(|node| format!("node {node}")), bitrate.map(|rate| format!("{rate} bit/s"))];
        let stored: Vec<_> = stored.into_iter().flatten().collect();
        if !stored.is_empty() {
            text += &format!(
                "; stored {}, as read back; switch the power of the device off and on, then check: motorctl imu find --bus {}",
                stored.join(" and "),
                self.bus.as_deref().unwrap_or_default()
            );
        }
        text
    }
}
