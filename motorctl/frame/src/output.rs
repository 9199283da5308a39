//! The lines that the command prints.

use crate::failure::FrameFailure;
use crate::object::Object;
use crate::rejected::Rejected;
use serde_json::{Value, json};
use std::io::{self, Write};

/// Prints results, and counts the rejected ones.
#[derive(Default)]
pub(super) struct ObjectWriter {
    refused: usize,
    total: usize,
}

impl ObjectWriter {
    pub(super) fn object(&mut self, object: Result<Object, Rejected>) -> Result<(), io::Error> {
        self.line(object.map(|object| Value::from(object).to_string()))
    }

    pub(super) fn line(&mut self, line: Result<String, Rejected>) -> Result<(), io::Error> {
        self.total += 1;
        let line = line.unwrap_or_else(|refused| {
            self.refused += 1;
            json!({ "kind": "reject", "reason": refused.to_string() }).to_string()
        });
        writeln!(io::stdout(), "{line}")
    }

    /// Returns an error when an input was rejected.
    pub(super) fn finish(self) -> Result<(), FrameFailure> {
        let Self { refused, total } = self;
        if refused == 0 { Ok(()) } else { Err(FrameFailure::Rejected { refused, total }) }
    }
}
