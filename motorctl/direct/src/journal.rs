//! The journal of `motorctl config apply`. Each write to a motor is on disk before it is sent.

use crate::failure::DirectFailure;
use motord_protocol::commissioning::{Change, Confirmation, Event};
use motord_terminal::{InputError, InputFile};
use serde_json::{Value as Json, json};
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Largest journal, bytes: tens of thousands of applications.
const BYTES_MAX: u64 = 64 << 20;

/// One JSON object per line: `begin`; `writing`, `refreshing` and `written` of each item; `end`.
/// Lines are appended.
pub(crate) struct Journal {
    path: PathBuf,
    file: File,
    last: Option<Json>,
    /// A power cut truncated the last line.
    is_cut: bool,
}

impl Journal {
    /// Opens the journal of `file`: `FILE.journal`, or `path`.
    pub(crate) fn open(file: &Path, path: Option<&Path>) -> Result<Self, DirectFailure> {
        let path = path.map_or_else(
            || {
                let mut name = file.as_os_str().to_owned();
                name.push(".journal");
                PathBuf::from(name)
            },
            Path::to_owned,
        );
        let failed = |source| DirectFailure::File { path: path.clone(), source };
        let text = match InputFile::open(&path).and_then(|file| file.read_text(BYTES_MAX)) {
            Err(InputError::System(error)) if error.kind() == io::ErrorKind::NotFound => String::new(),
            text => text.map_err(io::Error::from).map_err(failed)?,
        };
        let last = text
            .lines()
            .last()
            .map(|line| serde_json::from_str(line).unwrap_or_else(|_| json!({ "event": "cut line" })));
        let is_cut = !text.is_empty() && !text.ends_with('\n');
        let file = OpenOptions::new().append(true).create(true).open(&path).map_err(failed)?;
        Ok(Self { path, file, last, is_cut })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the last line of an earlier run that did not finish.
    pub(crate) fn unfinished(&self) -> Option<String> {
        let last = self.last.as_ref()?;
        (last["event"] != "end").then(|| last.to_string())
    }

    pub(crate) fn begin(&mut self, motor: &str, changes: &[Change]) -> Result<(), DirectFailure> {
        let items: Vec<&str> = changes.iter().map(|change| change.item.name).collect();
        self.append(json!({ "event": "begin", "motor": motor, "items": items }))
    }

    /// Appends `event`, which is on disk when this returns.
    pub(crate) fn note(&mut self, event: &Event) -> Result<(), DirectFailure> {
        let item = |event: &str, change: &Change| {
            json!({
                "event": event,
                "item": change.item.name,
                "from": change.from.as_f64(),
                "to": change.to.as_f64(),
            })
        };
        self.append(match event {
            Event::Writing(change) => item("writing", change),
            Event::Written(change, confirmation) => {
                let mut line = item("written", change);
                line["confirmed"] = match confirmation {
                    Confirmation::ReadBack(_) => "read back",
                    Confirmation::AnswersInMit => "answers in MIT",
                    Confirmation::Unreachable => "unreachable until the bus has the new bit rate",
                }
                .into();
                line
            }
            Event::Refreshing => json!({ "event": "refreshing" }),
        })
    }

    pub(crate) fn end(&mut self, outcome: &str) -> Result<(), DirectFailure> {
        self.append(json!({ "event": "end", "outcome": outcome }))
    }

    fn append(&mut self, mut line: Json) -> Result<(), DirectFailure> {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        line["unix_s"] = since.as_secs().into();
        // Ends a line that a power cut truncated.
        let start = if std::mem::take(&mut self.is_cut) { "\n" } else { "" };
        let text = format!("{start}{line}\n");
        let written = self.file.write_all(text.as_bytes()).and_then(|()| self.file.sync_data());
        written.map_err(|source| DirectFailure::File { path: self.path.clone(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn path_that_is_no_journal_is_refused() {
        for path in ["/dev/zero", "/dev/null", "/tmp"] {
            let refused = Journal::open(Path::new("x"), Some(Path::new(path))).map(|_| ()).unwrap_err();
            assert!(refused.to_string().contains("name a regular file"), "{path}: {refused}");
        }
    }

    #[test]
    fn line_without_its_end_is_completed_first() {
        let path = std::env::temp_dir().join(format!("motord-journal-{}", std::process::id()));
        std::fs::write(&path, r#"{"event":"refreshing"}"#).unwrap();
        let mut journal = Journal::open(&path, Some(&path)).unwrap();
        assert!(journal.unfinished().is_some());
        journal.begin("knee", &[]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let events: Vec<Json> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        assert_eq!(events.iter().map(|event| &event["event"]).collect::<Vec<_>>(), ["refreshing", "begin"]);
    }
}
