//! The lines that the command prints.

use crate::failure::FrameFailure;
use crate::object::Object;
use crate::rejected::Rejected;
use serde_json::{Value, json};
use std::io::{self, BufWriter, Stdout, Write};

/// Limit on the letters of a reason: it may repeat what it rejects.
const REASON_MAX: usize = 300;

/// Prints results, and counts the rejected ones.
pub(super) struct ObjectWriter {
    out: BufWriter<Stdout>,
    refused: usize,
    total: usize,
}

impl Default for ObjectWriter {
    fn default() -> Self {
        Self { out: BufWriter::new(io::stdout()), refused: 0, total: 0 }
    }
}

fn cut(reason: String) -> String {
    match reason.char_indices().nth(REASON_MAX) {
        Some((end, _)) => format!("{}…", &reason[..end]),
        None => reason,
    }
}

impl ObjectWriter {
    pub(super) fn object(&mut self, object: Result<Object, Rejected>) -> Result<(), io::Error> {
        self.line(object.map(|object| Value::from(object).to_string()))
    }

    pub(super) fn line(&mut self, line: Result<String, Rejected>) -> Result<(), io::Error> {
        self.total += 1;
        let line = line.unwrap_or_else(|refused| {
            self.refused += 1;
            json!({ "kind": "reject", "reason": cut(refused.to_string()) }).to_string()
        });
        writeln!(self.out, "{line}")
    }

    /// Prints all results so far.
    pub(super) fn flush(&mut self) -> Result<(), io::Error> {
        self.out.flush()
    }

    /// Returns an error when an input was rejected.
    pub(super) fn finish(mut self) -> Result<(), FrameFailure> {
        self.flush()?;
        let Self { refused, total, .. } = self;
        if refused == 0 { Ok(()) } else { Err(FrameFailure::Rejected { refused, total }) }
    }
}
