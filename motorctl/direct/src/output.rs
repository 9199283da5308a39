//! The sentences that the commands print.

use crate::failure::WireFailure;
use motord_terminal::printable;
use std::io::{self, Write};

/// Prints `sentence` on standard output. Control characters are spelled out.
pub(crate) fn print_line(sentence: &str) -> Result<(), WireFailure> {
    Ok(writeln!(io::stdout(), "{}", printable(sentence))?)
}
