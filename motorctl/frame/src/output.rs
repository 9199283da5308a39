//! The lines that the command prints.

use crate::object::Object;
use crate::rejected::FrameFailure;
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

/// Time and interface of a frame, as its log has them.
#[derive(Debug, Default)]
pub(super) struct Origin {
    /// Seconds.
    pub(super) time: Option<f64>,
    pub(super) interface: Option<String>,
}

impl Origin {
    /// Returns the known members of an object.
    pub(super) fn members(&self) -> impl Iterator<Item = (&'static str, Value)> {
        let time = self.time.map(|time| ("time", time.into()));
        let interface = self.interface.as_deref().map(|name| ("interface", name.into()));
        [time, interface].into_iter().flatten()
    }
}

fn reject(rejected: &Rejected) -> Value {
    json!({ "kind": "reject", "reason": cut(rejected.to_string()) })
}

fn cut(reason: String) -> String {
    match reason.char_indices().nth(REASON_MAX) {
        Some((end, _)) => format!("{}…", &reason[..end]),
        None => reason,
    }
}

impl ObjectWriter {
    pub(super) fn object(&mut self, object: Object) -> Result<(), io::Error> {
        self.line(Ok(Value::from(object).to_string()))
    }

    /// Prints why an input was rejected, and where it is.
    pub(super) fn reject(
        &mut self,
        rejected: &Rejected,
        file: Option<&str>,
        line: Option<u64>,
        origin: &Origin,
    ) -> Result<(), io::Error> {
        (self.total, self.refused) = (self.total + 1, self.refused + 1);
        let mut object = reject(rejected);
        let known = [file.map(|file| ("file", file.into())), line.map(|line| ("line", line.into()))];
        for (key, value) in known.into_iter().flatten().chain(origin.members()) {
            object[key] = value;
        }
        writeln!(self.out, "{object}")
    }

    pub(super) fn line(&mut self, line: Result<String, Rejected>) -> Result<(), io::Error> {
        self.total += 1;
        let line = line.unwrap_or_else(|refused| {
            self.refused += 1;
            reject(&refused).to_string()
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
