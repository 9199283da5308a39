//! A frame from the host to a device on a CAN bus.

/// Bytes of the longest request.
const LEN_MAX: usize = 8;

/// A classic frame with an 11-bit id.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanRequest {
    id: u16,
    len: usize,
    bytes: [u8; LEN_MAX],
}

impl CanRequest {
    /// Returns a frame with this id and payload.
    pub(super) fn new<const N: usize>(id: u16, payload: [u8; N]) -> Self {
        const { assert!(N <= LEN_MAX) };
        let mut bytes = [0; LEN_MAX];
        bytes[..N].copy_from_slice(&payload);
        Self { id, len: N, bytes }
    }

    /// Returns the id.
    #[must_use]
    pub const fn id(&self) -> u16 {
        self.id
    }

    /// Returns the payload.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}
