//! Every name that the log and `motorctl status` print has a page in `docs/explain`, and every page
//! is of such a name.

use crate::sources;
use motord_shared::{BusCondition, Cause, Fault, Refusal};
use std::collections::{BTreeMap, BTreeSet};

/// A page: its heading, and its paragraphs without their line breaks.
type Pages = BTreeMap<String, Vec<String>>;

fn pages(text: &str) -> Pages {
    let unbroken = |paragraph: &str| paragraph.split_whitespace().collect::<Vec<_>>().join(" ");
    let page = |section: &str| {
        let (name, text) = section.split_once('\n').unwrap_or((section, ""));
        (name.to_owned(), text.trim().split("\n\n").map(unbroken).collect())
    };
    text.split("\n## ").skip(1).map(page).collect()
}

fn file(name: &str) -> Pages {
    let path = format!("docs/explain/{name}.md");
    let found = sources::files(&[".md"]).into_iter().find(|source| source.path == path);
    pages(&found.unwrap().text)
}

/// Returns whether a page has exactly these parts, in this order, each with text.
fn has_parts(page: &[String], parts: &[&str]) -> bool {
    page.len() == parts.len()
        && page.iter().zip(parts).all(|(text, part)| text.starts_with(part) && text.len() > part.len() + 10)
}

/// Checks that each page begins with the sentence of its code, as states and log print it.
fn assert_pages(pages: &Pages, codes: &[(&str, &str)], parts: &[&str]) {
    let names: BTreeSet<&str> = pages.keys().map(String::as_str).collect();
    assert_eq!(names, codes.iter().map(|(name, _)| *name).collect());
    for (name, sentence) in codes {
        assert_eq!(pages[*name][0], *sentence, "{name}");
        assert!(has_parts(&pages[*name], parts), "{name}: {:#?}", pages[*name]);
    }
}

const FULL: [&str; 4] = ["", "**What happened.** ", "**Look at.** ", "**Do.** "];

#[test]
fn every_code_has_a_page_and_vice_versa() {
    let causes = file("causes");
    assert_pages(
        &causes,
        &Cause::ALL.iter().map(|code| (code.name(), code.sentence())).collect::<Vec<_>>(),
        &FULL,
    );
    for cause in Cause::ALL {
        let advice = format!("**Do.** {}", cause.advice());
        assert!(causes[cause.name()][3].starts_with(&advice), "{cause}: the log says: {}", cause.advice());
    }
    let faults: Vec<_> = Fault::ALL.iter().map(|code| (code.name(), code.sentence())).collect();
    assert_pages(&file("motor-faults"), &faults, &FULL);
    let refusals: Vec<_> = Refusal::ALL.iter().map(|code| (code.name(), code.sentence())).collect();
    assert_pages(&file("refusals"), &refusals, &["", "**Do.** "]);
}

/// The names in `see = "…"` of the programs.
fn named(code: &str) -> impl Iterator<Item = &str> {
    code.split("see = \"").skip(1).filter_map(|rest| Some(rest.split_once('"')?.0))
}

#[test]
fn every_named_log_line_has_a_page() {
    let is_of_program = |path: &str| path.contains("/src/") && !path.starts_with("verify/");
    let programs = sources::rust().into_iter().filter(|source| is_of_program(&source.path));
    let mut lines: BTreeSet<String> =
        programs.flat_map(|source| named(&source.text).map(str::to_owned).collect::<Vec<_>>()).collect();
    let down = BusCondition::ALL.iter().filter(|condition| **condition != BusCondition::Active);
    for condition in down.clone() {
        assert_eq!(file("log")[condition.name()][0], condition.sentence());
    }
    lines.extend(down.map(|condition| condition.name().to_owned()));
    let elsewhere = ["causes", "motor-faults", "refusals"].map(file);
    lines.retain(|name| !elsewhere.iter().any(|pages| pages.contains_key(name)));
    let pages = file("log");
    assert_eq!(pages.keys().cloned().collect::<BTreeSet<_>>(), lines);
    for (name, page) in &pages {
        assert!(has_parts(page, &FULL), "{name}: {page:#?}");
    }
}

#[test]
fn missing_page_part_and_named_line_are_found() {
    let pages = pages(
        "# Title\n\n## a\n\nA sentence\nof some words.\n\n**Do.** Nothing at all.\n\n## b\n\n**Do.** \n",
    );
    assert!(has_parts(&pages["a"], &["A sentence of", "**Do.** "]));
    assert!(!has_parts(&pages["a"], &FULL) && !has_parts(&pages["b"], &["**Do.** "]));
    assert_eq!(named("warn!(see = \"gone\", \"x\"); f(\"see\")").collect::<Vec<_>>(), ["gone"]);
}
