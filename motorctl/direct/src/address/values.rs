//! The address of a motor, as wanted and as shown.

use crate::failure::DirectFailure;
use crate::output::print_line;
use crate::target::Protocol;
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
