//! Which ids belong together.

use crate::frame::FrameId;

/// Ids of one width that agree in the bits of a mask, like those of a `can_filter` of
/// `linux/can.h`.
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
    pub(crate) const fn is_extended(self) -> bool {
        self.word > FrameId::MAX_EXTENDED.raw()
    }

    /// Returns id and mask as the kernel has them, for data frames only.
    #[cfg(feature = "linux")]
    pub(crate) const fn words(self) -> (u32, u32) {
        (self.word, self.mask | libc::CAN_RTR_FLAG)
    }

    /// Returns the id among them that wins the bus against all others.
    #[must_use]
    pub const fn lowest(self) -> FrameId {
        FrameId(self.word)
    }

    /// Returns the id among them that loses the bus to all others.
    #[must_use]
    pub const fn highest(self) -> FrameId {
        let largest = if self.is_extended() { FrameId::MAX_EXTENDED } else { FrameId::MAX };
        FrameId(self.word | largest.raw() & !self.mask)
    }

    /// Returns `true` when some id belongs to both. Constant time.
    #[must_use]
    pub const fn overlaps(self, other: Self) -> bool {
        (self.word ^ other.word) & self.mask & other.mask == 0
    }

    /// Returns `true` when `id` belongs to them. Constant time.
    #[must_use]
    #[inline]
    pub const fn matches(self, id: FrameId) -> bool {
        id.word() & self.mask == self.word
    }
}

/// Most filters of a set.
const FILTERS_MAX: usize = 4;

/// The ids of some filters, at most four.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IdSet {
    /// The first one again where there are fewer.
    filters: [IdFilter; FILTERS_MAX],
}

impl From<IdFilter> for IdSet {
    fn from(filter: IdFilter) -> Self {
        Self { filters: [filter; FILTERS_MAX] }
    }
}

impl IdSet {
    /// The ids of both filters.
    #[must_use]
    pub const fn of_two(first: IdFilter, second: IdFilter) -> Self {
        Self { filters: [first, second, first, first] }
    }

    /// The ids of four filters.
    #[must_use]
    pub const fn of_four(filters: [IdFilter; FILTERS_MAX]) -> Self {
        Self { filters }
    }

    /// Returns its filters, each once.
    pub fn filters(self) -> impl Iterator<Item = IdFilter> + Clone {
        let is_first = move |index: &usize| !self.filters[..*index].contains(&self.filters[*index]);
        (0..FILTERS_MAX).filter(is_first).map(move |index| self.filters[index])
    }

    /// Returns `true` when `id` belongs to one of them. Constant time.
    #[must_use]
    pub fn matches(self, id: FrameId) -> bool {
        self.filters.iter().any(|filter| filter.matches(id))
    }

    /// Returns the first of its filters that has an id of `other`.
    #[must_use]
    pub fn overlap(self, other: Self) -> Option<IdFilter> {
        self.filters().find(|filter| other.filters().any(|others| filter.overlaps(others)))
    }

    /// Returns `true` when some id belongs to both.
    #[must_use]
    pub fn overlaps(self, other: Self) -> bool {
        self.overlap(other).is_some()
    }

    /// Returns the id among them that loses the bus to all others.
    #[must_use]
    pub fn highest(self) -> FrameId {
        self.filters().map(IdFilter::highest).max().unwrap_or(self.filters[0].highest())
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

    #[test]
    fn filters_overlap_where_both_masks_agree() {
        let id = |raw| FrameId::extended(raw).unwrap();
        let any_status = |motor: u32| IdFilter::masked(id(0x0200_00FD | motor << 8), 0x1F00_FFFF);
        assert!(any_status(0x12).overlaps(any_status(0x12)));
        assert!(!any_status(0x12).overlaps(any_status(0x13)));
        assert!(any_status(0x12).overlaps(IdFilter::exact(id(0x0280_12FD))));
        assert!(IdFilter::exact(id(0x0280_12FD)).overlaps(any_status(0x12)));
        assert!(!any_status(0x12).overlaps(IdFilter::exact(id(0x0300_12FD))));
        let standard = |raw| IdFilter::exact(FrameId::new(raw).unwrap());
        assert!(standard(0x101).overlaps(standard(0x101)) && !standard(0x101).overlaps(standard(0x102)));
        assert!(!standard(0x101).overlaps(IdFilter::exact(id(0x101))), "another width");
    }

    #[test]
    fn lowest_and_highest_differ_in_free_bits() {
        let id = |raw| FrameId::extended(raw).unwrap();
        let filter = IdFilter::masked(id(0x0212_34FD), 0x1F00_FFFF);
        assert_eq!([filter.lowest(), filter.highest()], [id(0x0200_34FD), id(0x02FF_34FD)]);
        let short = |raw| FrameId::new(raw).unwrap();
        let filter = IdFilter::masked(short(0x112), 0xFF);
        assert_eq!([filter.lowest(), filter.highest()], [short(0x012), short(0x712)]);
        assert_eq!(IdFilter::exact(short(0x112)).highest(), short(0x112));
    }

    #[test]
    fn set_has_the_ids_of_each_filter_once() {
        let exact = |raw| IdFilter::exact(FrameId::new(raw).unwrap());
        let [one, two] = [IdSet::from(exact(0x141)), IdSet::of_two(exact(0x240), exact(0x141))];
        assert_eq!((one.filters().count(), two.filters().count()), (1, 2));
        let has = |raw| two.matches(FrameId::new(raw).unwrap());
        assert!(has(0x141) && has(0x240) && !has(0x142));
        assert_eq!(two.overlap(one), Some(exact(0x141)));
        assert!(!IdSet::from(exact(0x140)).overlaps(two));
        assert_eq!(two.highest().raw(), 0x240);
    }
}
