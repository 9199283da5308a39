//! The metrics as a file for the textfile collector of Prometheus' node exporter.

use crate::latest::Latest;
use motord_untrusted::recreate;
use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::time::Duration;

/// Period of the file. Prometheus usually scrapes every 15 s.
const PERIOD: Duration = Duration::from_secs(5);

/// Writes the newest text to `file` once per period. A file that cannot be written is logged once,
/// until it can be written again.
pub(crate) fn run(file: &Path, latest: &Latest) {
    let mut failed = false;
    loop {
        let text = latest.text();
        // Nothing is known before the first cycles.
        let written = if text.is_empty() { Ok(()) } else { replace(file, &text) };
        if let Err(error) = &written
            && !failed
        {
            tracing::warn!(
                see = "no-metrics",
                "{} cannot be written, and has no new metrics: {error}",
                file.display()
            );
        }
        failed = written.is_err();
        std::thread::sleep(PERIOD);
    }
}

/// Replaces `file` atomically: a reader reads the old text or the new one. Follows no link that
/// another user created under the temporary name.
fn replace(file: &Path, text: &[u8]) -> io::Result<()> {
    // The collector reads names that end with .prom only.
    let temporary = file.with_extension("prom.new");
    recreate(&temporary)?.write_all(text)?;
    fs::rename(&temporary, file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;

    #[test]
    fn textfile_is_replaced_atomically() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("motord.prom");
        replace(&file, b"first, and longer\n").unwrap();
        let open = File::open(&file).unwrap();
        replace(&file, b"second\n").unwrap();
        assert_eq!(io::read_to_string(open).unwrap(), "first, and longer\n", "a reader keeps what it opened");
        assert_eq!(fs::read_to_string(&file).unwrap(), "second\n");
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[test]
    fn prepared_link_is_not_written_through() {
        let directory = tempfile::tempdir().unwrap();
        let (file, elsewhere) = (directory.path().join("motord.prom"), directory.path().join("elsewhere"));
        fs::write(&elsewhere, "kept").unwrap();
        std::os::unix::fs::symlink(&elsewhere, file.with_extension("prom.new")).unwrap();
        replace(&file, b"text\n").unwrap();
        assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "kept");
        assert!(fs::symlink_metadata(&file).unwrap().is_file());
    }
}
