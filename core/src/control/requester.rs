//! The sender of a request, the right that it claims, and the leases that give it.

use motord_shared::{AdminRequest, Lease};

/// The process that sends a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Requester {
    pub(super) pid: u32,
    pub(super) right: Right,
}

/// The right that a request claims.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Right {
    /// That of an operator, who owns no group.
    Operator,
    /// That of the owner with this lease. It may be lost.
    Owner(Lease),
    /// The request has a number that no daemon grants as a lease.
    Invalid,
}

impl Requester {
    pub(super) fn of(request: &AdminRequest) -> Self {
        let right = match (request.lease, Lease::from_raw(request.lease)) {
            (0, _) => Right::Operator,
            (_, Some(lease)) => Right::Owner(lease),
            (_, None) => Right::Invalid,
        };
        Self { pid: request.pid, right }
    }

    /// Returns the lease in the request.
    pub(super) const fn lease(&self) -> Option<Lease> {
        match self.right {
            Right::Owner(lease) => Some(lease),
            Right::Operator | Right::Invalid => None,
        }
    }
}

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
