//! The right of this daemon to its buses, which it keeps while an adapter is unplugged.

use super::opening::{BusError, interface_name, open_one};
use motord_bus::{Bus, BusLock};
use motord_core::settings::{BusKind, BusSettings, Settings};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// The locks of all buses, shared by the cycle, which holds them until the motors are stopped, and the reconnector.
pub type SharedClaims = Arc<Mutex<Claims>>;

/// The lock of each bus, by index; `None` for a simulated one.
#[derive(Debug, Default)]
pub struct Claims(Vec<Option<BusLock>>);

impl Claims {
    /// Locks the next bus and opens it.
    pub(super) fn open(&mut self, settings: &Settings, index: usize) -> Result<Box<dyn Bus>, BusError> {
        self.0.push(lock(&settings.buses[index])?);
        self.reopen(settings, index)
    }

    /// Opens a bus whose adapter may be another one than before, after locking what has its name now.
    ///
    /// # Errors
    ///
    /// Why it cannot be opened. What was locked before stays locked.
    fn reopen(&mut self, settings: &Settings, index: usize) -> Result<Box<dyn Bus>, BusError> {
        let Some(lock) = self.0.get_mut(index).and_then(Option::as_mut) else {
            return open_one(settings, index).map(|(bus, _)| bus);
        };
        let refused = |source| BusError::Lock { bus: settings.buses[index].name.clone(), source };
        lock.follow().map_err(refused)?;
        let (bus, interface) = open_one(settings, index)?;
        match interface {
            Some(opened) if !lock.is_of_interface(opened) => {
                Err(BusError::Exchanged { bus: settings.buses[index].name.clone() })
            }
            _ => Ok(bus),
        }
    }

    /// Opens a bus again. Without claims, or after the cycle has given them up, it is not locked.
    pub(super) fn reopen_shared(
        claims: &Weak<Mutex<Self>>,
        settings: &Settings,
        index: usize,
    ) -> Result<Box<dyn Bus>, BusError> {
        match claims.upgrade() {
            Some(claims) => claims.lock().unwrap_or_else(PoisonError::into_inner).reopen(settings, index),
            None => open_one(settings, index).map(|(bus, _)| bus),
        }
    }
}

fn lock(bus: &BusSettings) -> Result<Option<BusLock>, BusError> {
    let lock = match &bus.kind {
        BusKind::SocketCan { interface, .. } => BusLock::interface(interface_name(bus, interface)?),
        BusKind::Serial { device, .. } => BusLock::device(device),
        BusKind::Simulated { .. } => return Ok(None),
    };
    lock.map(Some).map_err(|source| BusError::Lock { bus: bus.name.clone(), source })
}
