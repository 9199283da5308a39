//! Simulated motors on a simulated CAN bus, inside the daemon.

use super::access::Transport;

/// A simulated CAN bus. The crate that has the simulator builds it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Simulated {
    /// Bit/s.
    pub bitrate: u32,
    /// Seed of everything random in it.
    pub seed: u64,
}

impl Simulated {
    /// Its type in configurations.
    pub const NAME: &'static str = "simulated";
}

impl Transport for Simulated {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn bitrate(&self) -> u32 {
        self.bitrate
    }

    fn seed(&self) -> Option<u64> {
        Some(self.seed)
    }
}
