//! The vendor bytes.
