//! The sentence that tells the effect of a request.

use motord_terminal::printable;
use std::io::{self, Write};

/// Prints the effect of a request. An error of the output is not an error of the command: the
/// request was carried out, and the other groups follow.
pub(crate) fn print_effect(sentence: &str) {
    if let Err(error) = writeln!(io::stdout(), "{}", printable(sentence)) {
        let _closed =
            writeln!(io::stderr(), "motorctl: done, but standard output cannot be written: {error}");
    }
}
