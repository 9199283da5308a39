//! `motorctl explain`: prints the pages of `docs/explain`, by the names in the log and in `motorctl
//! status`.

use crate::failure::Failure;
use motord_client::{ImuContradiction, Limit, MotorMode, Phase, Rejection};
use motord_terminal::printable;
use std::io::{self, Write};

/// Columns of the text, as in the help.
const WIDTH: usize = 100;

/// The book: one file for each kind of name.
const FILES: [&str; 4] = [
    include_str!("../../docs/explain/causes.md"),
    include_str!("../../docs/explain/motor-faults.md"),
    include_str!("../../docs/explain/refusals.md"),
    include_str!("../../docs/explain/log.md"),
];

/// The text of one name.
#[derive(Debug, PartialEq)]
struct Explanation {
    /// Such as "Causes".
    kind: String,
    name: &'static str,
    /// Markdown; its paragraphs are separated by empty lines.
    text: String,
}

/// Prints every page with this name: a cause and a fault may share one. Without a name, lists all
/// names.
///
/// # Errors
///
/// There is no such name, or the output cannot be written.
pub(crate) fn run(name: Option<&str>) -> Result<(), Failure> {
    let (pages, out) = (pages(), &mut io::stdout().lock());
    let Some(name) = name else { return Ok(list(&pages, out)?) };
    let named: Vec<&Explanation> = pages.iter().filter(|page| page.name == name).collect();
    if named.is_empty() {
        return Err(Failure::NoPage { name: name.to_owned(), near: near(name, &pages) });
    }
    for (index, page) in named.into_iter().enumerate() {
        let gap = if index > 0 { "\n" } else { "" };
        writeln!(out, "{gap}{} ({})\n\n{}", page.name, page.kind, plain(&page.text))?;
    }
    Ok(())
}

/// Returns the names that are similar to an unknown one, the most similar first.
fn near(written: &str, pages: &[Explanation]) -> Vec<&'static str> {
    /// Least similarity (Jaro-Winkler); 1 is equal.
    const ALIKE: f64 = 0.85;
    const SHOWN_MAX: usize = 3;
    let written = written.to_lowercase().replace(['_', ' '], "-");
    let mut alike: Vec<_> = pages
        .iter()
        .map(|page| (strsim::jaro_winkler(&written, page.name), page.name))
        .filter(|(likeness, _)| *likeness >= ALIKE)
        .collect();
    alike.sort_by(|(one, _), (other, _)| other.total_cmp(one));
    let mut names: Vec<_> = alike.into_iter().map(|(_, name)| name).collect();
    names.dedup();
    names.truncate(SHOWN_MAX);
    names
}

/// Returns the names of all pages.
pub(crate) fn names() -> Vec<String> {
    pages().into_iter().map(|page| page.name.to_owned()).collect()
}

fn list(pages: &[Explanation], out: &mut dyn Write) -> io::Result<()> {
    for same in pages.chunk_by(|one, other| one.kind == other.kind) {
        let names = same.iter().map(|page| page.name).collect::<Vec<_>>().join(" ");
        let indented = lines().initial_indent("  ").subsequent_indent("  ");
        writeln!(out, "{}:\n{}", same[0].kind, textwrap::fill(&names, indented))?;
    }
    Ok(())
}

/// Lines of [`WIDTH`]. No name is broken at its hyphens.
fn lines() -> textwrap::Options<'static> {
    textwrap::Options::new(WIDTH).word_splitter(textwrap::WordSplitter::NoHyphenation)
}

/// Returns every page. Some codes have only the sentence of their code.
fn pages() -> Vec<Explanation> {
    let mut pages: Vec<Explanation> = FILES.iter().flat_map(|file| sections(file)).collect();
    let mut add = |kind: &str, words: Vec<(&'static str, &'static str)>| {
        let page =
            |(name, text): (_, &str)| Explanation { kind: kind.to_owned(), name, text: text.to_owned() };
        pages.extend(words.into_iter().map(page));
    };
    add("Limits of a setpoint", Limit::ALL.iter().map(|code| (code.name(), code.sentence())).collect());
    add("Rejected setpoints", Rejection::ALL.iter().map(|code| (code.name(), code.sentence())).collect());
    add("Modes of a motor", MotorMode::ALL.iter().map(|code| (code.name(), code.sentence())).collect());
    let conventions = ImuContradiction::ALL.iter().map(|code| (code.name(), code.sentence()));
    add("Conventions of an IMU", conventions.collect());
    add("Phases of a group", Phase::ALL.iter().map(|code| (code.name(), code.sentence())).collect());
    pages
}

/// Returns the pages of a file. Its title is their kind, and each has a heading.
fn sections(file: &'static str) -> impl Iterator<Item = Explanation> {
    let title = file.lines().next().unwrap_or_default().trim_start_matches("# ");
    let kind = title.split(':').next().unwrap_or_default();
    file.split("\n## ").skip(1).map(move |section| {
        let (name, text) = section.split_once('\n').unwrap_or((section, ""));
        Explanation { kind: kind.to_owned(), name, text: text.trim().to_owned() }
    })
}

/// Markdown as text for a terminal: without marks for bold, each link as its words and its file, in
/// lines of [`WIDTH`].
fn plain(markdown: &str) -> String {
    let paragraphs = markdown.replace("**", "");
    let paragraphs = paragraphs.split("\n\n").map(|paragraph| {
        let line = paragraph.split_whitespace().collect::<Vec<_>>().join(" ");
        textwrap::fill(&without_links(&line), lines())
    });
    printable(&paragraphs.collect::<Vec<_>>().join("\n\n")).into_owned()
}

/// `text` with "words (file)" for `[words](file)`.
fn without_links(text: &str) -> String {
    let mut parts = text.split('[');
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let link = part.split_once("](").and_then(|(words, rest)| Some((words, rest.split_once(')')?)));
        match link {
            Some((words, (file, rest))) => plain += &format!("{words} ({}){rest}", of_docs(file)),
            None => plain += &format!("[{part}"),
        }
    }
    plain
}

/// The path of a linked file, as the package installs it.
fn of_docs(link: &str) -> String {
    match link.strip_prefix("../") {
        Some(file) => format!("docs/{file}"),
        None => format!("docs/explain/{link}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_plain_text_in_short_lines() {
        let text =
            "**Do.** Look at\n[a file](../realtime.md), and `ip link`, [1\nor 2].\n\nSee [faults](a.md).";
        assert_eq!(
            plain(text),
            "Do. Look at a file (docs/realtime.md), and `ip link`, [1 or 2].\n\nSee faults (docs/explain/a.md)."
        );
        let pages = pages();
        assert!(pages.iter().all(|page| plain(&page.text).lines().all(|line| line.chars().count() <= WIDTH)));
        assert!(pages.iter().all(|page| !page.text.is_empty() && !page.name.contains(' ')), "{pages:?}");
    }

    #[test]
    fn a_name_of_two_kinds_has_two_pages() {
        let pages = pages();
        let kinds = |name: &str| -> Vec<&str> {
            pages.iter().filter(|page| page.name == name).map(|page| page.kind.as_str()).collect()
        };
        assert_eq!(kinds("overload"), ["Causes", "Motor faults", "Limits of a setpoint"]);
        assert_eq!(kinds("switch-hangs"), ["Lines of the log"]);
    }
}
