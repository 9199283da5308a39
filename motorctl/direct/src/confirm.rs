//! Asking before something that cannot be taken back.

use crate::failure::DirectFailure;
use motord_terminal::printable;
use std::io::{self, BufRead, IsTerminal, Write};

/// The confirmation of a command that moves a motor, or changes it for good.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Confirm {
    /// Confirm in advance: do not ask. Without it, the command asks at a terminal and refuses elsewhere.
    #[arg(long)]
    pub(crate) yes: bool,
}

impl Confirm {
    /// Says the effect, and goes on only with consent.
    ///
    /// # Errors
    ///
    /// [`DirectFailure::Unconfirmed`] when nobody can be asked, [`DirectFailure::Declined`].
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
