//! JSON, one object per line.

use serde::Serialize;
use std::io::{self, Write};

/// Writes `value` as one line, its keys in the order of its fields.
///
/// # Errors
///
/// When `out` cannot be written.
pub fn write_line(out: &mut dyn Write, value: &impl Serialize) -> io::Result<()> {
    serde_json::to_writer(&mut *out, value)?;
    writeln!(out)
}
