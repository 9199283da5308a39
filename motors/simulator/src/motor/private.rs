//! The memory of a RobStride drive that only its private protocol reaches. Sources: as for that
//! protocol.

use motord_bus::{Duration, Instant};

/// Units of the timeout in a second.
const TIMEOUT_HZ: f64 = 20_000.0;

/// Indices of parameters.
pub(super) mod index {
    pub(crate) const ID: u16 = 0x200A;
    pub(crate) const HOST: u16 = 0x200B;
    pub(crate) const FAULTS: u16 = 0x3022;
    pub(crate) const RUN_MODE: u16 = 0x7005;
    pub(crate) const LIMIT_TORQUE: u16 = 0x700B;
    pub(crate) const LIMIT_CURRENT: u16 = 0x7018;
    pub(crate) const POSITION: u16 = 0x7019;
    pub(crate) const VELOCITY: u16 = 0x701B;
    pub(crate) const VOLTAGE: u16 = 0x701C;
    pub(crate) const TIMEOUT: u16 = 0x7028;
}

/// The parameters that can be written.
const WRITABLE: [u16; 4] = [index::RUN_MODE, index::LIMIT_TORQUE, index::LIMIT_CURRENT, index::TIMEOUT];

/// The memory of a drive that only this protocol reaches.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Memory {
    /// In effect, in the order of [`WRITABLE`].
    values: [[u8; 4]; WRITABLE.len()],
    /// Without power.
    stored: [[u8; 4]; WRITABLE.len()],
    /// It sends its state unasked.
    pub(super) reports: bool,
    stored_reports: bool,
    pub(super) reported_at: Instant,
    /// The faults of the last frame of type 21.
    pub(super) reported_fault: u32,
}

impl Memory {
    /// Loads the stored values when the power returns.
    pub(super) fn boot(&mut self) {
        (self.values, self.reports) = (self.stored, self.stored_reports);
        self.reported_fault = 0;
    }

    pub(super) fn store(&mut self) {
        (self.stored, self.stored_reports) = (self.values, self.reports);
    }

    pub(super) fn value(&self, index: u16) -> Option<[u8; 4]> {
        WRITABLE.iter().position(|known| *known == index).map(|slot| self.values[slot])
    }

    pub(super) fn write(&mut self, index: u16, value: [u8; 4]) {
        if let Some(slot) = WRITABLE.iter().position(|known| *known == index) {
            self.values[slot] = value;
        }
    }

    /// Returns the time without commands after which the drive disables itself.
    pub(super) fn timeout(&self) -> Option<Duration> {
        let units = u32::from_le_bytes(self.value(index::TIMEOUT)?);
        (units > 0).then(|| Duration::from_secs_f64(f64::from(units) / TIMEOUT_HZ))
    }
}
