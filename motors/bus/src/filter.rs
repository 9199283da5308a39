//! Which ids belong together.

use crate::frame::FrameId;

/// Ids of one width that agree in the bits of a mask, as a `can_filter` of `linux/can.h` does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IdFilter {
    word: u32,
    mask: u32,
}

impl IdFilter {
    /// Only this id.
    #[must_use]
    pub const fn exact(id: FrameId) -> Self {
        Self { word: id.word(), mask: u32::MAX }
    }

    /// Every id with the width of `id` that agrees with it in the bits of `mask`.
    #[must_use]
    pub const fn masked(id: FrameId, mask: u32) -> Self {
        let mask = mask | FrameId::MAX_EXTENDED.word() & !FrameId::MAX_EXTENDED.raw();
        Self { word: id.word() & mask, mask }
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
