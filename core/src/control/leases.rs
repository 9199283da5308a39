//! Leases for claims.

use motord_shared::Lease;

/// Creates leases. Each differs from every other, also from those of the previous daemon.
#[derive(Debug)]
pub(super) struct Leases {
    boot_id: u64,
    epoch: u32,
}

impl Leases {
    pub(super) const fn new(boot_id: u64) -> Self {
        Self { boot_id, epoch: 0 }
    }

    /// Returns a lease of `group`; `None` after the last epoch.
    pub(super) fn next(&mut self, group: usize) -> Option<Lease> {
        let lease = Lease::new(self.boot_id, self.epoch + 1, group)?;
        self.epoch = lease.epoch();
        Some(lease)
    }
}
