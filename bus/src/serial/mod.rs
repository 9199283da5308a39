//! Serial lines, RS485 and RS232.
//!
//! - [`framing`]: the bytes of a frame, and finding frames in a stream of bytes.

pub mod framing;
