//! The sentences that the commands print.

use crate::failure::DirectFailure;
use motord_terminal::printable;
use std::io::{self, BufRead, IsTerminal, Write};

/// Prints `sentence` on standard output. Control characters are spelled out.
pub(crate) fn print_line(sentence: &str) -> Result<(), DirectFailure> {
    Ok(writeln!(io::stdout(), "{}", printable(sentence))?)
}

/// The consent to a command that moves a motor or changes it permanently.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Confirm {
    /// Confirm in advance. Without this option the command asks at a terminal, and refuses
    /// elsewhere.
    #[arg(long)]
    pub(crate) yes: bool,
}

impl Confirm {
    /// Prints the effect and asks for consent.
    ///
    /// # Errors
    ///
    /// [`DirectFailure::Unconfirmed`] without a terminal, [`DirectFailure::Declined`] without
    /// consent.
    pub fn ask(self, effect: &str) -> Result<(), DirectFailure> {
        if self.yes {
            return Ok(());
        }
        if !io::stdin().is_terminal() {
            return Err(DirectFailure::Unconfirmed { warning: effect.to_owned() });
        }
        eprint!("{}\nType yes to go on: ", printable(effect));
        let _flushed = io::stderr().flush();
        let mut answer = String::new();
        let read = io::stdin().lock().read_line(&mut answer);
        if read.is_ok() && answer.trim() == "yes" { Ok(()) } else { Err(DirectFailure::Declined) }
    }
}
