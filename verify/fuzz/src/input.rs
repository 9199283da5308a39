//! The fuzzer's bytes as a sequence of numbers. After the end, every number is zero.

use arbitrary::{Arbitrary, Unstructured};

/// The remaining bytes.
pub(crate) struct Input<'a>(Unstructured<'a>);

impl<'a> Input<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self(Unstructured::new(bytes))
    }

    /// Returns `true` when no byte is left.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns a number of any type.
    pub(crate) fn any<T: Arbitrary<'a> + Default>(&mut self) -> T {
        self.0.arbitrary().unwrap_or_default()
    }

    /// Returns one of `items`, which are not empty and at most 256.
    pub(crate) fn pick<T: Copy>(&mut self, items: &[T]) -> T {
        items[usize::from(self.any::<u8>()) % items.len()]
    }

    /// Returns the next 0 to `most` bytes.
    pub(crate) fn bytes(&mut self, most: u8) -> &'a [u8] {
        let wanted = usize::from(self.any::<u8>() % (most + 1)).min(self.0.len());
        self.0.bytes(wanted).unwrap_or_default()
    }
}
