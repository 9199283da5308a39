//! Arrivals that are no frames of motord: other formats, and bytes that are part of no frame.

use motord_bus::{Content, Unsupported};

/// The number of arrivals in formats that motord does not use: neither a request nor a supported
/// answer has them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Formats {
    /// Frames in CAN FD format.
    pub fd: u64,
    /// Frames with 29-bit ids.
    pub extended: u64,
    /// Reads of a serial line with bytes that are part of no frame.
    pub unmatched: u64,
}

impl Formats {
    /// Counts an arrival, if it has such a format. `is_other`: a frame whose id has another width
    /// than the request.
    pub(crate) fn note(&mut self, content: &Content, is_other: bool) {
        match content {
            Content::Frame(frame) if is_other && frame.id().is_extended() => self.extended += 1,
            Content::Unsupported(Unsupported::Fd) => self.fd += 1,
            Content::Unsupported(Unsupported::Extended) => self.extended += 1,
            Content::Unsupported(Unsupported::Unmatched) => self.unmatched += 1,
            _ => {}
        }
    }

    /// Returns the frames that arrived after `earlier` was read.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Self {
        Self {
            fd: self.fd - earlier.fd,
            extended: self.extended - earlier.extended,
            unmatched: self.unmatched - earlier.unmatched,
        }
    }

    /// Returns whether any such frame arrived.
    #[must_use]
    pub const fn is_any(self) -> bool {
        self.fd > 0 || self.extended > 0 || self.unmatched > 0
    }

    /// Returns the frames without the other bytes, which a motor that answers does not explain.
    #[must_use]
    pub const fn frames(self) -> Self {
        Self { unmatched: 0, ..self }
    }

    /// Returns a clause on each format, with the next step.
    pub fn advice(self) -> impl Iterator<Item = String> {
        let Self { fd, extended, unmatched } = self;
        let in_fd = (fd > 0).then(|| {
            format!(
                "frames arrive, {fd} in CAN FD format: motord speaks classic CAN; set the motor to a classic bit rate with its vendor's tool \
                 (Damiao: register 35, can_br, to 4 for 1 Mbit/s)"
            )
        });
        let with_long_ids = (extended > 0).then(|| {
            format!(
                "frames arrive, {extended} with 29-bit ids: a RobStride motor in its private protocol sends such frames, and `motorctl scan` \
                 finds it; of another vendor's motor, select MIT with its tool, or end its unasked reports"
            )
        });
        let of_no_frame = (unmatched > 0).then(|| {
            "bytes arrive, but no frame: two motors with one id? Connect one motor at a time, and give each its own id with \
             `motorctl id`; or the bit rate or the wiring is wrong"
                .to_owned()
        });
        [in_fd, with_long_ids, of_no_frame].into_iter().flatten()
    }
}
