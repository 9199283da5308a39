//! The right of this daemon to its buses, which it keeps while an adapter is unplugged.

use super::opening::{BusError, nodes, open_expected, open_one};
use motord_bus::socketcan::LinkNote;
use motord_bus::transport::Hardware;
use motord_bus::{Adapter, Bus, BusLock, Identity};
use motord_settings::settings::{BusSettings, Settings};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// The locks of all buses, shared by the cycle, which holds them until the motors are stopped, and
/// the reconnector.
pub type SharedClaims = Arc<Mutex<Claims>>;

/// The claim of each bus, by index; `None` for a simulated one.
#[derive(Debug, Default)]
pub struct Claims(Vec<Option<Claim>>);

/// The lock of a bus, and its adapter.
#[derive(Debug)]
struct Claim {
    lock: BusLock,
    /// The adapter that was opened first: no other one is opened later.
    adapter: Option<Adapter>,
    /// The notes on its interface that were logged at the last opening.
    notes: Vec<LinkNote>,
}

impl Claim {
    /// Logs the notes, a lasting one once.
    fn log(&mut self, bus: &BusSettings, notes: &[LinkNote]) {
        for note in notes.iter().filter(|note| !note.is_lasting() || !self.notes.contains(note)) {
            tracing::warn!(bus = bus.name, see = "adapter", "{note}");
        }
        self.notes = notes.to_vec();
    }

    /// Returns the interface or device that has the name of the bus now, with its adapter; `None`
    /// without one.
    ///
    /// # Errors
    ///
    /// It is another adapter than the one that was opened first.
    fn expected(&self, bus: &BusSettings) -> Result<Option<(Identity, Adapter)>, BusError> {
        let Some(identity) = self.lock.current() else { return Ok(None) };
        let adapter = Adapter::of(identity);
        match self.adapter.as_ref().and_then(|expected| expected.difference(&adapter)) {
            Some(difference) => {
                let (bus, device) = (bus.name.clone(), bus.device().to_owned());
                Err(BusError::OtherAdapter { bus, device, difference })
            }
            None => Ok(Some((identity, adapter))),
        }
    }
}

impl Claims {
    /// Locks the next bus and opens it.
    pub(super) fn open(&mut self, settings: &Settings, index: usize) -> Result<Box<dyn Bus>, BusError> {
        self.0.push(lock(&settings.buses[index])?.map(|lock| Claim {
            lock,
            adapter: None,
            notes: Vec::new(),
        }));
        self.reopen(settings, index)
    }

    /// Opens a bus, after locking what has its name now. The adapter must be the one that was
    /// opened first: the kernel may give its name to another when several return.
    ///
    /// # Errors
    ///
    /// Why it cannot be opened. Its name stays locked.
    fn reopen(&mut self, settings: &Settings, index: usize) -> Result<Box<dyn Bus>, BusError> {
        let Some(claim) = self.0.get_mut(index).and_then(Option::as_mut) else {
            return open_one(settings, index).map(|opened| opened.bus);
        };
        let bus = &settings.buses[index];
        // Before it is locked: what has the name of this bus now may be another bus, whose lock it
        // must not take.
        let expected = claim.expected(bus).inspect_err(|_| claim.lock.leave())?;
        claim.lock.follow().map_err(|source| BusError::of(bus, source))?;
        let Some((identity, adapter)) = expected else { return Err(absent(settings, index)) };
        let opened = open_expected(settings, index, Some(identity))?;
        claim.log(bus, &opened.notes);
        let is_held = claim.lock.held() == Some(identity);
        if is_held && opened.identity.is_none_or(|opened| opened == identity) {
            claim.adapter.get_or_insert(adapter);
            Ok(opened.bus)
        } else {
            Err(BusError::Exchanged { bus: bus.name.clone() })
        }
    }

    /// Discards the frames that wait on a bus, if no other adapter has its name by now. Returns
    /// `true` if it took the interface down and up.
    ///
    /// # Errors
    ///
    /// Why they may be sent later, with a remedy.
    pub(super) fn discard_shared(
        claims: &Weak<Mutex<Self>>,
        settings: &Settings,
        index: usize,
    ) -> Result<bool, BusError> {
        let bus = &settings.buses[index];
        let Some(hardware) = bus.kind.hardware() else { return Ok(false) };
        let claims = claims.upgrade();
        let claims = claims.as_ref().map(|claims| claims.lock().unwrap_or_else(PoisonError::into_inner));
        let claim = claims.as_ref().and_then(|claims| claims.0.get(index)).and_then(Option::as_ref);
        let expected = claim.map(|claim| claim.expected(bus)).transpose()?.flatten();
        let discarded = hardware.discard_queue(expected.map(|(identity, _)| identity));
        discarded.map_err(|source| BusError::of(bus, source))
    }

    /// Opens a bus again. Without claims, or after the cycle has given them up, it is not locked.
    pub(super) fn reopen_shared(
        claims: &Weak<Mutex<Self>>,
        settings: &Settings,
        index: usize,
    ) -> Result<Box<dyn Bus>, BusError> {
        match claims.upgrade() {
            Some(claims) => claims.lock().unwrap_or_else(PoisonError::into_inner).reopen(settings, index),
            None => open_one(settings, index).map(|opened| opened.bus),
        }
    }
}

/// Why a bus cannot be opened whose name nothing had.
fn absent(settings: &Settings, index: usize) -> BusError {
    let bus = &settings.buses[index];
    let error = bus.kind.hardware().and_then(|hardware| hardware.absent(&nodes(settings, index)));
    error.map_or_else(|| BusError::Exchanged { bus: bus.name.clone() }, |source| BusError::of(bus, source))
}

fn lock(bus: &BusSettings) -> Result<Option<BusLock>, BusError> {
    let lock = bus.kind.hardware().map(Hardware::lock).transpose();
    lock.map_err(|source| BusError::of(bus, source))
}
