//! The tables of `docs/configuration.md`, written from the table of keys.

use super::entry::Row;
use super::keys;

/// The opening mark of a generated table; its section follows.
const BEGIN: &str = "<!-- keys of ";
const END: &str = "<!-- end of keys -->";

/// `document` with the table of every section written anew between its marks:
///
/// ```text
/// <!-- keys of motor.limits -->
/// …
/// <!-- end of keys -->
/// ```
///
/// A section without marks in the document gets them at the end, so that no key is left out.
#[must_use]
pub fn reference(document: &str) -> String {
    keys::reference().into_iter().fold(document.to_owned(), |document, (path, rows)| {
        let begin = format!("{BEGIN}{path} -->");
        let (before, rest) = document.split_once(&begin).unwrap_or((&document, ""));
        let (_, after) = rest.split_once(END).unwrap_or(("", "\n"));
        format!("{before}{begin}\n{}{END}{after}", table(&rows))
    })
}

fn table(rows: &[Row]) -> String {
    let lines = [Row::HEAD, ["---"; 6]].map(|cells| Row::line(&cells));
    lines.into_iter().chain(rows.iter().map(Row::to_markdown)).map(|line| line + "\n").collect()
}
