//! The address of a motor, as wanted and as shown.

use crate::confirm::Confirm;
use crate::failure::DirectFailure;
use crate::output::print_line;
use crate::target::{Protocol, Session};
use motord_terminal::json;
use serde::Serialize;
use std::io;

/// The wanted changes of an address.
pub(super) struct Wanted {
    pub(super) id: Option<u8>,
    pub(super) protocol: Option<Protocol>,
    /// The command line names a host id or a bit rate.
    pub(super) has_others: bool,
}

/// An address, as `motorctl id` shows it.
#[derive(Serialize)]
pub(super) struct Address {
    pub(super) id: i32,
    pub(super) host_id: Option<i32>,
    pub(super) can_protocol: &'static str,
    pub(super) can_baud_rate: Option<i32>,
}

impl Address {
    pub(super) fn show(&self, as_json: bool, text: &str) -> Result<(), DirectFailure> {
        if as_json {
            return Ok(json::write_line(&mut io::stdout().lock(), self)?);
        }
        print_line(text)
    }
}

/// The change of an address that is one id.
pub(super) struct IdChange {
    /// The motors that have it, with their article.
    pub(super) motors: &'static str,
    /// Its name.
    pub(super) item: &'static str,
    pub(super) largest: u8,
    /// The end of the sentence that asks for consent.
    pub(super) effect: String,
    /// Changes it, if the new one is free.
    pub(super) change: fn(&mut Session, u8) -> Result<(), DirectFailure>,
}

impl IdChange {
    /// Gives the motor another id after consent.
    pub(super) fn run(&self, session: &mut Session, id: u8, confirm: Confirm) -> Result<(), DirectFailure> {
        let Self { motors, item, largest, ref effect, change } = *self;
        if !(1..=largest).contains(&id) {
            return Err(DirectFailure::Usage(format!("the {item} of {motors} is 1 to {largest}")));
        }
        let (name, old) = (session.name(), session.id);
        if id == old {
            return print_line(&format!("{name}: nothing differs"));
        }
        confirm.ask(&format!("This permanently changes the {item} of {name} from {old} to {id}{effect}"))?;
        change(session, id)?;
        print_line(&format!("{name}: {item} was {old}, confirmed as {id}"))
    }
}
