//! The last bytes of a stream, in a buffer of a fixed size.

/// Holds at least the last `CAPACITY / 2` bytes, without a gap. `CAPACITY` is even.
#[derive(Debug, Clone)]
pub(super) struct Window<const CAPACITY: usize> {
    bytes: [u8; CAPACITY],
    len: usize,
}

impl<const CAPACITY: usize> Default for Window<CAPACITY> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const CAPACITY: usize> Window<CAPACITY> {
    /// Returns a window without bytes.
    pub(super) const fn new() -> Self {
        Self { bytes: [0; CAPACITY], len: 0 }
    }

    /// Appends a byte. Moves `CAPACITY / 2` bytes once in as many calls.
    pub(super) fn push(&mut self, byte: u8) {
        if self.len == CAPACITY {
            self.bytes.copy_within(CAPACITY / 2.., 0);
            self.len = CAPACITY / 2;
        }
        self.bytes[self.len] = byte;
        self.len += 1;
    }

    /// Returns the last `count` bytes; `None` when fewer arrived since the start or
    /// [`clear`](Self::clear).
    pub(super) fn last(&self, count: usize) -> Option<&[u8]> {
        self.bytes.get(self.len.checked_sub(count)?..self.len)
    }

    /// Removes all bytes.
    pub(super) const fn clear(&mut self) {
        self.len = 0;
    }
}

/// A frame of a known length that has begun. A decoder follows one at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Begun {
    len: usize,
    left: usize,
}

impl Begun {
    /// Of a frame of `len` bytes, `left` are still to come: at least one.
    pub(super) const fn new(len: usize, left: usize) -> Self {
        Self { len, left }
    }

    /// Counts a byte. Returns the length of the frame that it completes, and forgets that frame.
    pub(super) fn count(begun: &mut Option<Self>) -> Option<usize> {
        let frame = begun.as_mut()?;
        frame.left -= 1;
        if frame.left > 0 { None } else { begun.take().map(|frame| frame.len) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_bytes_are_held_at_every_position() {
        let mut window = Window::<8>::new();
        let stream: [u8; 40] = core::array::from_fn(|at| at as u8);
        for end in 1..=stream.len() {
            window.push(stream[end - 1]);
            for count in 0..=end.min(4) {
                assert_eq!(window.last(count), Some(&stream[end - count..end]));
            }
        }
        assert_eq!(window.last(9), None);
        window.clear();
        assert_eq!((window.last(0), window.last(1)), (Some(&[][..]), None));
    }
}
