//! The sentences that the commands print.

use crate::failure::DirectFailure;
use motord_terminal::printable;
use std::io::{self, Write};

/// Prints `sentence` on standard output. Control characters are spelled out.
pub(crate) fn print_line(sentence: &str) -> Result<(), DirectFailure> {
    Ok(writeln!(io::stdout(), "{}", printable(sentence))?)
}
