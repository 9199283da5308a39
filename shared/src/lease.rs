//! The right to command a group.

use crate::limits::GROUPS_MAX;
use std::fmt;
use std::num::NonZeroU64;

/// The right of one controller to command one group, from its claim until it is released or lost.
///
/// | bits | meaning |
/// |---|---|
/// | 63..32 | boot id of the daemon that granted it, low 32 bits |
/// | 31..8 | epoch: number of the claim since the daemon started, from 1 |
/// | 7..0 | index of the group + 1; 0 in no lease |
///
/// Therefore all leases differ, and a restarted daemon accepts no earlier lease. The messages
/// contain it as a number, where 0 means no lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Lease(NonZeroU64);

impl Lease {
    /// Largest epoch. The daemon grants no lease after it.
    pub const EPOCH_MAX: u32 = (1 << 24) - 1;

    /// Returns the lease of the claim number `epoch` on `group`. `None` when the epoch is above
    /// [`EPOCH_MAX`](Self::EPOCH_MAX), or the index of the group is not below [`GROUPS_MAX`].
    #[must_use]
    pub const fn new(boot_id: u64, epoch: u32, group: usize) -> Option<Self> {
        if epoch > Self::EPOCH_MAX || group >= GROUPS_MAX {
            return None;
        }
        Self::from_raw((boot_id << 32) | ((epoch as u64) << 8) | (group as u64 + 1))
    }

    /// Returns the lease in a message. `None` for 0, and for a number with an impossible group.
    #[must_use]
    pub const fn from_raw(raw: u64) -> Option<Self> {
        match NonZeroU64::new(raw) {
            Some(number) if raw & 0xFF != 0 && raw & 0xFF <= GROUPS_MAX as u64 => Some(Self(number)),
            _ => None,
        }
    }

    /// Returns the number in the messages; never 0.
    #[must_use]
    pub const fn raw(self) -> u64 {
        self.0.get()
    }

    /// Returns the low 32 bits of the boot id of the daemon that granted it.
    #[must_use]
    pub const fn boot_id(self) -> u32 {
        (self.raw() >> 32) as u32
    }

    /// Returns the number of the claim since the daemon started.
    #[must_use]
    pub const fn epoch(self) -> u32 {
        (self.raw() >> 8) as u32 & Self::EPOCH_MAX
    }

    /// Returns the index of the group, below [`GROUPS_MAX`]. The robot may have fewer groups.
    #[must_use]
    pub const fn group(self) -> usize {
        (self.raw() & 0xFF) as usize - 1
    }
}

impl fmt::Display for Lease {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers calculated by hand from the table of the layout.
    #[test]
    fn lease_holds_boot_epoch_and_group_bits() {
        for (boot_id, epoch, group, raw) in [
            (0, 0, 0, 0x0000_0000_0000_0001),
            (0, 1, 0, 0x0000_0000_0000_0101),
            (0x0123_4567, 0x89_ABCD, 6, 0x0123_4567_89AB_CD07),
            (0xFFFF_FFFF, 0xFF_FFFF, 7, 0xFFFF_FFFF_FFFF_FF08),
        ] {
            let lease = Lease::new(boot_id, epoch, group).unwrap();
            assert_eq!(lease.raw(), raw);
            assert_eq!((u64::from(lease.boot_id()), lease.epoch(), lease.group()), (boot_id, epoch, group));
            assert_eq!(Lease::from_raw(raw), Some(lease));
        }
    }

    #[test]
    fn lease_holds_low_half_of_boot_id() {
        assert_eq!(Lease::new(0xAAAA_AAAA_0000_0001, 1, 0), Lease::new(1, 1, 0));
    }

    #[test]
    fn impossible_group_number_is_no_lease() {
        for raw in [0, 0x0123_4567_89AB_CD00, 0x0123_4567_89AB_CD09, u64::MAX] {
            assert_eq!(Lease::from_raw(raw), None, "{raw:#x}");
        }
        assert_eq!(Lease::new(1, Lease::EPOCH_MAX + 1, 0), None);
        assert_eq!(Lease::new(1, 1, GROUPS_MAX), None);
    }
}
