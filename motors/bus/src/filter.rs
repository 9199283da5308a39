//! Which ids belong together.

use crate::frame::FrameId;

/// Ids of one width that agree in the bits of a mask, like those of a `can_filter` of `linux/can.h`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IdFilter {
    word: u32,
    mask: u32,
}

impl IdFilter {
    /// Only this id.
    #[must_use]
    pub const fn exact(id: FrameId) -> Self {
        Self::masked(id, if id.is_extended() { FrameId::MAX_EXTENDED.raw() } else { FrameId::MAX.raw() })
    }

    /// Every id with the width of `id` that agrees with it in the bits of `mask`.
    #[must_use]
    pub const fn masked(id: FrameId, mask: u32) -> Self {
        let width = FrameId::MAX_EXTENDED.word() & !FrameId::MAX_EXTENDED.raw();
        let mask = mask & FrameId::MAX_EXTENDED.raw() | width;
        Self { word: id.word() & mask, mask }
    }

    /// Returns `true` when its ids have 29 bits.
    #[cfg(feature = "linux")]
    pub(crate) const fn is_extended(self) -> bool {
        self.word > FrameId::MAX_EXTENDED.raw()
    }

    /// Returns id and mask as the kernel has them, for data frames only.
    #[cfg(feature = "linux")]
    pub(crate) const fn words(self) -> (u32, u32) {
        (self.word, self.mask | libc::CAN_RTR_FLAG)
    }

    /// Returns `true` when `id` belongs to them. Constant time.
    #[must_use]
    #[inline]
    pub const fn matches(self, id: FrameId) -> bool {
        id.word() & self.mask == self.word
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mask_ignores_bits_and_never_width() {
        let id = |raw| FrameId::extended(raw).unwrap();
        let filter = IdFilter::masked(id(0x0200_12FD), 0xFFFF);
        assert!(filter.matches(id(0x1780_12FD)));
        assert!(!filter.matches(id(0x0200_13FD)));
        let short = IdFilter::masked(FrameId::new(0x12).unwrap(), 0xFF);
        assert!(short.matches(FrameId::new(0x112).unwrap()));
        assert!(!short.matches(id(0x12)), "an extended id");
        assert!(!IdFilter::exact(id(0x12)).matches(FrameId::new(0x12).unwrap()));
    }
}
